"""Coordinate conventions of predictions: conversion by the header, and checks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np

from pipeline.answering.predictions import Header, PredictedBox
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.camera import Camera, project
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
