"""Boxes and masks of objects edited by hand: a box in level numbers, a mask grown, drawn or taken from the labels."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.diagnosis.whatif.edits import Three
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.masks import decode_run_length
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import FrameCases
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

SMALLEST_SIDE = 0.01
"""Metres; a flatter box could not be taken hold of again."""


def pulled(box: Box3D, axis: int, side: float, by: float) -> Box3D:
    """Pull a face (`side` 1 or -1 of its own `axis`) of a box outwards by metres; the opposite stays."""
    grown = max(box.size[axis] + by, SMALLEST_SIDE) - box.size[axis]
    outwards = box.R[:, axis] * side
    return Box3D(box.center + outwards * grown / 2, box.R, box.size + grown * (np.arange(3) == axis))


@dataclass(frozen=True)
class BoxNumbers:
    """Box in the viewer's level axes."""

    center: Three  # Along (right, forward, up), metres
    size: Three  # Along the box's own axes, for an upright box (width, height, depth), metres
    yaw: float  # Of the box's first axis in plan, degrees from right towards forward, in (-180, 180]


def box_numbers(box: Box3D, viewer: ViewerAxes) -> BoxNumbers:
    """Numbers of a box (camera frame)."""
    x, y, z = (_axes(viewer) @ box.center).tolist()
    width, height, depth = box.size.tolist()
    return BoxNumbers((x, y, z), (width, height, depth), float(np.rad2deg(_yaw(box, viewer))))


def with_numbers(
    box: Box3D,
    viewer: ViewerAxes,
    *,
    center: Three | None = None,
    size: Three | None = None,
    yaw: float | None = None,
) -> Box3D:
    """Change some numbers of a box; None keeps a number."""
    axes = _axes(viewer)
    moved = box.center if center is None else axes.T @ np.array(center, np.float64)
    sides = box.size if size is None else np.maximum(np.array(size, np.float64), SMALLEST_SIDE)
    R = box.R
    if yaw is not None:
        angle = np.deg2rad(yaw) - _yaw(box, viewer)
        cos, sin = np.cos(angle), np.sin(angle)
        R = axes.T @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ axes @ R
    return Box3D(moved, R, sides)


def _axes(viewer: ViewerAxes) -> np.ndarray:
    """(3, 3): rotation of the camera frame into (right, forward, up)."""
    return np.stack([viewer.right, viewer.forward, viewer.up])


def _yaw(box: Box3D, viewer: ViewerAxes) -> float:
    x, y, _ = _axes(viewer) @ box.R[:, 0]
    return float(np.arctan2(y, x))


MOST_PIXELS = 200
"""A mask is grown or shrunk by no more at once."""
SAME = 0.1
"""The labelled object that overlaps most is meant where its 2D box overlaps by as much (IoU): badly placed boxes are
what another mask is for."""


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Grow a mask by a disc, or shrink it for a negative radius.

    `mask`: (H, W) bool; `pixels`: -200..200.
    """
    require(
        abs(pixels) <= MOST_PIXELS,
        "a mask grows by so many pixels at most",
        got=pixels,
        expected=f"at most {MOST_PIXELS}",
    )
    if pixels == 0:
        return mask
    step = np.arange(-abs(pixels), abs(pixels) + 1)
    disc = (step[:, None] ** 2 + step[None] ** 2 <= pixels**2).astype(np.uint8)
    change, beyond = (cv2.dilate, 0) if pixels > 0 else (cv2.erode, 1)
    # What lies beyond the picture's edge neither adds to a mask nor takes from it.
    changed = change(mask.view(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=beyond)
    return changed.astype(np.bool_)


def rectangle(height: int, width: int, corners: tuple[float, float, float, float]) -> np.ndarray:
    """(H, W) bool: pixels between two corners, x0, y0, x1, y1 as fractions of width and height in any order."""
    x0, y0, x1, y1 = corners
    require(np.isfinite([x0, y0, x1, y1]).all(), "the corners of a rectangle must be finite", got=corners)
    xs, ys = sorted((x0, x1)), sorted((y0, y1))
    left, right = (int(np.clip(round(x * width), 0, width)) for x in xs)
    top, bottom = (int(np.clip(round(y * height), 0, height)) for y in ys)
    mask = np.zeros((height, width), np.bool_)
    mask[top:bottom, left:right] = True
    require(mask.any(), "the rectangle holds no pixel", got=corners)
    return mask


def labelled_mask(truth: FrameCases, bbox: np.ndarray, height: int, width: int) -> np.ndarray | None:
    """(H, W) bool: labelled pixels of the object of a 2D box; None without any."""
    if not len(truth.boxes):
        return None
    overlap = iou_2d(bbox, truth.boxes)[0]
    k = int(overlap.argmax())
    code = truth.masks[k]
    if overlap[k] < SAME or code is None:
        return None
    return decode_run_length((height, width), code, f"labelled object {truth.numbers[k]} of frame {truth.frame}")
