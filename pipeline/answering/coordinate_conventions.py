"""Coordinate conventions of predictions: conversion by the header, and the check that boxes lie where it says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.predictions import Header, PredictedBox, Prediction, Predictions
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.camera import Camera, project
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import mask_box
from pipeline.proposals.base import Proposals
from pipeline.system.errors import InputError, needed, require

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
FLIP = np.diag([1.0, -1.0, -1.0])
"""OpenGL's camera axes in OpenCV's, and back."""
MARGIN_M, MARGIN_SHARE = 0.05, 0.1
MEETS = 0.5
"""A 3D box meets its object where it holds at least this share of the object's points."""
IN_ORDER = ("xyxy", "xywh", "cxcywh", "yxyx")


def box_2d(box: tuple[float, ...], header: Header, width: int, height: int) -> np.ndarray:
    """(4,) float64: x0, y0, x1, y1 in pixels, of a box in the header's convention.

    >>> from pipeline.answering import Header
    >>> box_2d((0.1, 0.2, 0.5, 0.5), Header(boxes="xywh", box_unit="shares"), 640, 480).tolist()
    [64.0, 96.0, 384.0, 336.0]
    """
    a, b, c, d = box
    found = {
        "xyxy": (a, b, c, d),
        "xywh": (a, b, a + c, b + d),
        "yxyx": (b, a, d, c),
        "cxcywh": (a - c / 2, b - d / 2, a + c / 2, b + d / 2),
    }[header.boxes]
    return np.array(found) * np.tile(pixel_scale(header, width, height), 2)


def pixel_scale(header: Header, width: int, height: int) -> np.ndarray:
    """(2,) float64: pixels in a unit of the header's 2D boxes, along x and y."""
    whole = {"pixels": None, "shares": 1.0, "thousandths": 1000.0}[header.box_unit]
    return np.ones(2) if whole is None else np.array([width, height]) / whole


def box_3d(given: PredictedBox, header: Header, camera: Camera | None) -> Box3D:
    """3D box in the camera frame, metres; InputError for an invalid rotation, invalid corners, or a missing pose."""
    if given.corners is not None:
        box = box_of_corners(np.array(given.corners))
    else:
        assert given.center is not None
        assert given.size is not None
        R = np.eye(3) if given.rotation is None else np.array(given.rotation).reshape(3, 3)
        box = Box3D(np.array(given.center), R, np.array(given.size))
    scale = METRES[header.length]
    center, R = box.center * scale, box.R
    if header.coordinates == "camera_opengl":
        center, R = FLIP @ center, FLIP @ R
    elif header.coordinates == "world":
        pose = needed(camera and camera.T_world_camera, "boxes in the world, and the frame has no pose")
        center, R = pose[:3, :3].T @ (center - pose[:3, 3]), pose[:3, :3].T @ R
    if np.linalg.det(R) < 0:
        R = R * np.array([1.0, 1.0, -1.0])
    return Box3D(center, R, box.size * scale)


def box_at_hand(box: Any, where: str) -> Box3D | None:
    """3D box of an array or mapping: (8, 3) corners, or `center`, `size` and `rotation`, (3, 3) or nine numbers, by
    default along the axes; a Box3D or None unchanged. InputError for anything else."""
    if box is None or isinstance(box, Box3D):
        return box
    try:
        if not isinstance(box, Mapping):
            return box_of_corners(np.asarray(box, np.float64).reshape(8, 3))
        R = np.asarray(box.get("rotation", np.eye(3)), np.float64).reshape(3, 3)
        return Box3D(np.asarray(box["center"], np.float64), R, np.asarray(box["size"], np.float64))
    except (KeyError, TypeError, ValueError) as error:
        forms = "a Box3D, (8, 3) corners, or center, size and rotation"
        raise InputError(f"{where}: no 3D box", got=str(error), expected=forms) from error


def box_of_corners(corners: np.ndarray) -> Box3D:
    """Box of eight corners in any order; InputError for no box."""
    from_first = corners[1:] - corners[0]
    size = float(np.abs(from_first).max(initial=0.0))
    for edges in combinations(from_first, 3):
        sums = np.array([np.array(c) @ np.array(edges) for c in product((0, 1), repeat=3)])
        gram = np.array(edges) @ np.array(edges).T
        square = np.abs(gram - np.diag(np.diag(gram))).max() <= 1e-2 * size**2
        apart = np.abs(sums[:, None] - (corners - corners[0])[None]).max(axis=2).min(axis=1).max()
        if square and apart <= 1e-2 * size and size > 0:
            lengths = np.linalg.norm(edges, axis=1)
            if lengths.min() > 0:
                R = (np.array(edges) / lengths[:, None]).T
                R[:, 2] *= 1 if np.linalg.det(R) > 0 else -1
                u, _, vt = np.linalg.svd(R)
                return Box3D(corners.mean(axis=0), u @ vt, lengths)
    raise InputError("the eight corners are not those of a box", expected="eight corners, edges at right angles")


def holds(box: Box3D, points: np.ndarray) -> float:
    """Share of an object's points ((N, 3), camera frame) in a box, or slightly beyond."""
    local = np.abs((points - box.center) @ box.R)
    return float((local <= box.size / 2 * (1 + MARGIN_SHARE) + MARGIN_M).all(axis=1).mean()) if len(points) else 0.0


def other_conventions(header: Header) -> Iterator[tuple[str, Header, bool]]:
    """Other conventions of 3D boxes: in words, as a header, and with center and size swapped or not."""
    lengths = [n for n in METRES if n != header.length]
    frames = [n for n in ("camera_opencv", "camera_opengl", "world") if n != header.coordinates]
    yield from ((f'"length": "{n}"', replace(header, length=n), False) for n in lengths)
    yield from ((f'"coordinates": "{n}"', replace(header, coordinates=n), False) for n in frames)
    yield "center and size are swapped", header, True
    for frame, length in product(frames, lengths):
        words = f'"coordinates": "{frame}" and "length": "{length}"'
        yield words, replace(header, coordinates=frame, length=length), False


def try_box(given: PredictedBox, header: Header, camera: Camera | None, swapped: bool) -> Box3D | None:
    """3D box by another convention; None for no box."""
    if swapped and (given.center is None or min(given.center) < 0):
        return None
    try:
        return box_3d(replace(given, center=given.size, size=given.center) if swapped else given, header, camera)
    except InputError:
        return None


def box_overlap(given: tuple[float, ...], header: Header, seen: np.ndarray, width: int, height: int) -> float:
    """IoU of a 2D box, read by a header, with its object's seen box ((4,) pixels)."""
    box = box_2d(given, header, width, height)
    return float(iou_2d(box[None], seen[None])[0, 0]) if (box[2:] > box[:2]).all() else 0.0


def seen_box(box: Box3D, camera: Camera) -> np.ndarray | None:
    """(4,) float64: 2D box of a 3D box, pixels; None for a part behind the camera."""
    if (box.corners[:, 2] <= 0.05).any():
        return None
    uv = project(box.corners, camera)
    found = np.concatenate([uv.min(axis=0), uv.max(axis=0)])
    return np.clip(found, 0, [camera.width, camera.height] * 2)


def checked_box(box: tuple[float, ...], header: Header, width: int, height: int, where: str, path: Any) -> None:
    """Raise InputError for a 2D box invalid by the header: upside down, or mostly outside the picture."""
    found = box_2d(box, header, width, height)
    require(
        (found[2:] >= found[:2]).all(),
        f"{where}: no box of this header: right or bottom lies before left or top",
        got=list(box),
        expected=header.boxes,
        cause="are they x, y, width, height, or in shares of the picture?",
        path=path,
    )
    inside = np.clip(found, 0, [width, height] * 2)
    area, kept = (float(np.prod(b[2:] - b[:2])) for b in (found, inside))
    require(
        kept >= 0.25 * area and (area > 0 or kept >= 0),
        f"{where}: the box lies outside the picture",
        got=list(box),
        expected=f"{header.boxes} in {header.box_unit} within {width}x{height}",
        cause="another order of numbers, another unit, or another size of the picture?",
        path=path,
    )


LOOKED_AT = 24
"""Frames whose coordinates are looked at, spread evenly."""
LEAST_PLACED = 3
"""Of fewer answers in points or boxes nothing is said of their unit."""
A_PIXEL = 1.0
"""Boxes that are no larger, in pixels, are in another unit."""
FEW_MEET, MOST_MEET = 0.5, 0.7
"""Boxes are of another convention where fewer than this share meet their objects, and by another at least this."""


def check_places(frames: Sequence[tuple[Pipeline, str]]) -> None:
    """Check 2D boxes against the picture, and 3D boxes against their pixels.

    Parameters
    ----------
    frames : sequence of (Pipeline, str)
        Ids of frames, each with the imported pipeline that opens it; all have the same predictions, and there is one.

    Raises
    ------
    InputError
        A box that is none by the header; or most boxes do not meet their pixels, and by another convention they do.
    """
    predictions = needed(frames[0][0].predictions, "these are no predictions")
    header = predictions.header
    conventions = list(other_conventions(header))
    met: list[list[float]] = [[] for _ in range(1 + len(conventions))]
    flat: dict[str, list[float]] = {order: [] for order in IN_ORDER}
    worst: tuple[str, int] | None = None
    placed: list[tuple[Prediction, bool]] = []
    sizes: list[tuple[float, str]] = []
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(LOOKED_AT, len(frames))).astype(int))
    for pipeline, frame_id in (frames[int(k)] for k in chosen):
        detector, frame = pipeline.needed_detector(), pipeline.dataset.load(frame_id)
        context = prepare_frame(pipeline.dataset, frame, pipeline.config.lift)
        camera = context.frame.camera
        for line in predictions.of_frame(frame_id):
            spot = _answered_spot(line, header, frame.width, frame.height)
            if spot is not None:
                inside = (spot >= 0).all() and (spot <= [frame.width, frame.height]).all() and (spot > 1).any()
                placed.append((line, bool(inside)))
            for name, found in (line.proposals or {}).items():
                for k, p in enumerate(found):
                    where = predictions.where(line, f"proposals.{name}.{k}.box")
                    assert p.box is not None
                    checked_box(p.box, header, frame.width, frame.height, where, predictions.path)
                    found2d = box_2d(p.box, header, frame.width, frame.height)
                    sizes.append((float((found2d[2:] - found2d[:2]).max()), where))
        plain = _PixelDetector(predictions)
        proposals = detector.detect(context.frame, None) if detector.vocabulary else None
        for o in context.lift(proposals, plain) if proposals is not None else ():
            given = predictions.box_of(frame_id, o.id)
            line = next(one for one in predictions.of_frame(frame_id) if o.id in one.objects)
            box2 = line.objects[o.id].box
            assert box2 is not None
            own = None if given is None else _placed(given, predictions, context, line, o.id)
            seen = None if own is None else seen_box(own, camera)
            if o.lifted.quality.mask_source != "box":
                seen = np.array(mask_box(np.ascontiguousarray(o.mask)), np.float64)
            if seen is not None:
                for order in IN_ORDER:
                    read = replace(header, boxes=order)
                    flat[order].append(box_overlap(box2, read, seen, frame.width, frame.height))
            points = o.lifted.points
            if own is None or given is None or len(points) < 20:
                continue
            met[0].append(holds(own, points))
            if met[0][-1] < MEETS and worst is None:
                worst = predictions.where(line, f"boxes_3d.{o.id}"), o.id
            for k, (_, other, swapped) in enumerate(conventions, 1):
                tried = try_box(given, other, camera, swapped)
                met[k].append(0.0 if tried is None else holds(tried, points))
    if len(sizes) >= LEAST_PLACED and header.box_unit == "pixels" and max(sizes)[0] <= A_PIXEL:
        raise InputError(
            f"{sizes[0][1]}: none of {len(sizes)} boxes is larger than a pixel",
            got='"box_unit": "pixels"',
            expected='"box_unit": "shares", of width and height',
            path=predictions.path,
        )
    wrong = [line for line, inside in placed if not inside]
    if len(placed) >= LEAST_PLACED and len(wrong) > len(placed) / 2:
        where = predictions.where(wrong[0], "answer")
        raise InputError(
            f"{where}: {len(wrong)} of {len(placed)} answers lie outside the picture or in its first pixel",
            got=f'"box_unit": "{header.box_unit}"',
            expected="pixels, shares or thousandths of width and height, as the answers are",
            path=predictions.path,
        )
    _judge_flat(flat, header, predictions)
    if not met[0] or worst is None:
        return
    shares = [float((np.array(m) >= MEETS).mean()) for m in met]
    best = int(np.argmax(shares))
    if shares[0] < FEW_MEET and shares[best] >= max(MOST_MEET, 2 * shares[0]):
        raise InputError(
            f"{worst[0]}: the box does not meet its object's pixels, like {1 - shares[0]:.0%} of {len(met[0])} boxes",
            got=f'"coordinates": "{header.coordinates}", "length": "{header.length}"',
            expected=conventions[best - 1][0],
            cause=f"by that {shares[best]:.0%} meet",
            path=predictions.path,
        )


def _answered_spot(line: Prediction, header: Header, width: int, height: int) -> np.ndarray | None:
    """(2,) float64: answered point, or centre of the box, pixels; None for another answer."""
    if line.answer is None or (line.answer.point is None and line.answer.box is None):
        return None
    if line.answer.point is not None:
        return np.array(line.answer.point) * pixel_scale(header, width, height)
    assert line.answer.box is not None
    return box_2d(line.answer.box, header, width, height).reshape(2, 2).mean(axis=0)


class _PixelDetector:
    """Detector by name alone, with objects lifted here from their pixels, ignoring boxes of the file."""

    exact, reads_annotations, vocabulary = False, False, None

    def __init__(self, predictions: Predictions) -> None:
        self.name = predictions.header.system

    def fingerprint(self) -> str:
        return "as it is lifted here"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        raise NotImplementedError


def _placed(given: PredictedBox, predictions: Predictions, context: PreparedFrame, line: Prediction, i: int) -> Box3D:
    try:
        return box_3d(given, predictions.header, context.frame.camera)
    except InputError as error:
        where = predictions.where(line, f"boxes_3d.{i}")
        raise InputError(f"{where}: {error.what}", path=predictions.path) from error


def _judge_flat(flat: dict[str, list[float]], header: Header, predictions: Predictions) -> None:
    """Raise InputError for 2D boxes on their objects in another order, but not in the header's."""
    if len(flat[header.boxes]) < 3:
        return
    found = {order: float(np.median(values)) for order, values in flat.items()}
    best = max(found, key=found.__getitem__)
    require(
        found[header.boxes] >= 0.3 or found[best] < max(0.6, 2 * found[header.boxes]),
        f"line 1, boxes: the boxes overlap their objects by {found[header.boxes]:.0%}",
        got=f'"{header.boxes}"',
        expected=f'"{best}", by which they overlap by {found[best]:.0%}',
        path=predictions.path,
    )
