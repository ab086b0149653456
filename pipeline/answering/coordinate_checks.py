"""Check of the coordinates, units and orders declared by the header of predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.answering.coordinate_conventions import (
    IN_ORDER,
    MEETS,
    box_2d,
    box_3d,
    box_overlap,
    checked_box,
    holds,
    other_conventions,
    pixel_scale,
    seen_box,
    try_box,
)
from pipeline.answering.imported import ImportedDetector, ImportedPipeline
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.predictions import Header, PredictedBox, Prediction, Predictions
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import mask_box
from pipeline.proposals.base import Proposals
from pipeline.system.errors import InputError, require

LOOKED_AT = 24
"""Frames whose coordinates are looked at, spread evenly."""
LEAST_PLACED = 3
"""Of fewer answers in points or boxes nothing is said of their unit."""
A_PIXEL = 1.0
"""Boxes that are no larger, in pixels, are in another unit."""
FEW_MEET, MOST_MEET = 0.5, 0.7
"""Boxes are of another convention where fewer than this share meet their objects, and by another at least this."""


def check_places(frames: Sequence[tuple[ImportedPipeline, str]]) -> None:
    """Check 2D boxes against the picture, and 3D boxes against their pixels.

    Parameters
    ----------
    frames : sequence of (ImportedPipeline, str)
        Ids of frames, each with what opens it; all have the same predictions, and there is at least one.

    Raises
    ------
    InputError
        A box that is none by the header; or most boxes do not meet their pixels, and by another convention they do.
    """
    predictions = frames[0][0].predictions
    header = predictions.header
    conventions = list(other_conventions(header))
    met: list[list[float]] = [[] for _ in range(1 + len(conventions))]
    flat: dict[str, list[float]] = {order: [] for order in IN_ORDER}
    worst: tuple[str, int] | None = None
    placed: list[tuple[Prediction, bool]] = []
    sizes: list[tuple[float, str]] = []
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(LOOKED_AT, len(frames))).astype(int))
    for source, frame_id in (frames[int(k)] for k in chosen):
        detector, frame = source.needed_detector(), source.dataset.load(frame_id)
        assert isinstance(detector, ImportedDetector)
        context = prepare_frame(source.dataset, frame, source.config.lift)
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
            own = None if given is None else _placed(given, source, context, line, o.id)
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


def _placed(given: PredictedBox, source: ImportedPipeline, context: PreparedFrame, line: Prediction, i: int) -> Box3D:
    try:
        return box_3d(given, source.predictions.header, context.frame.camera)
    except InputError as error:
        where = source.predictions.where(line, f"boxes_3d.{i}")
        raise InputError(f"{where}: {error.what}", path=source.predictions.path) from error


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
