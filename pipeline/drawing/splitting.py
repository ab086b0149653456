"""A mask cut in parts: by a polygon, along a line, or where its depth comes apart. Parts never share a pixel."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.drawing.depth_region import joined, link_grid
from pipeline.drawing.strokes import polygon_mask
from pipeline.errors import InputError

LEAST_PIXELS, LEAST_SHARE = 30, 0.03
"""A part of a mask in depth has at least so many pixels, and this share of the mask; less goes to its neighbour."""
MOST_PARTS = 12


def split_by_polygon(mask: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of a mask is outside and inside of a polygon, the larger part first.

    Parameters
    ----------
    mask : (H, W) bool
    points : (N, 2) float
        Corners x, y, pixels.

    Raises
    ------
    InputError
        One of the parts is empty.
    """
    return _parts(mask, polygon_mask(points, *mask.shape))


def split_by_line(mask: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of a mask lies on either side of a line, the larger part first.

    Parameters
    ----------
    mask : (H, W) bool
    points : (N, 2) float
        x, y, pixels; its ends go on straight.

    Raises
    ------
    InputError
        It is no line, or one of the parts is empty.
    """
    line = np.asarray(points, np.float64).reshape(-1, 2)
    line = line[np.concatenate([[True], (np.diff(line, axis=0) != 0).any(axis=1)])]
    if len(line) < 2:
        raise InputError("a cut needs a line", got="one point")
    height, width = mask.shape
    reach = 4.0 * (height + width) + float(np.abs(line).max())
    # The hand's first and last pixels jitter: the ends go on in the direction of a good piece of the line.
    piece = max(1, len(line) // 4)
    ahead, behind = _unit(line[-1] - line[-1 - piece]), _unit(line[0] - line[piece])
    start, end = line[0] + reach * behind, line[-1] + reach * ahead
    from_, to = np.arctan2(ahead[1], ahead[0]), np.arctan2(behind[1], behind[0])
    turn = (to - from_) % (2 * np.pi)
    # One side of the line is closed by an arc far outside of the picture.
    angles = from_ + turn * np.linspace(0, 1, 34)[1:-1]
    arc = line.mean(axis=0) + 2 * reach * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return _parts(mask, polygon_mask(np.concatenate([[start], line, [end], arc]), height, width))


def split_by_depth(mask: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, ...]:
    """The parts of a mask that no surface joins, the largest first.

    Pixels without depth, and parts too small to be an object, go to the part next to them.

    Parameters
    ----------
    mask : (H, W) bool
    depth : (H, W) float32
        Metres, 0 where missing.

    Raises
    ------
    InputError
        There is only one part, or too many.
    """
    _, grid = cv2.connectedComponents(link_grid(mask & (depth > 0), *joined(depth)), connectivity=4)
    labels = np.asarray(grid[::2, ::2], np.int64)
    counts = np.bincount(labels[mask], minlength=int(labels.max()) + 1)
    counts[0] = 0
    least = max(LEAST_PIXELS, LEAST_SHARE * int(mask.sum()))
    chosen = [int(k) for k in np.argsort(-counts, kind="stable") if counts[k] >= least]
    if len(chosen) < 2:
        raise InputError("the object is of one piece in depth", cause="draw a line across it")
    if len(chosen) > MOST_PARTS:
        raise InputError("the object falls into too many parts", got=len(chosen), expected=f"at most {MOST_PARTS}")
    own = mask & np.isin(labels, chosen)
    _, found = cv2.distanceTransformWithLabels(
        (~own).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    nearest = np.asarray(found, np.int64)
    part_of = np.zeros(int(nearest.max()) + 1, np.int64)
    part_of[nearest[own]] = labels[own]
    whose = part_of[nearest]
    return tuple(mask & (whose == k) for k in chosen)


def _unit(direction: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(direction))
    return direction / length if length > 0 else np.array([1.0, 0.0])


def _parts(mask: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    one, other = mask & ~inside, mask & inside
    if not one.any() or not other.any():
        raise InputError("the cut leaves one of both parts empty")
    return (one, other) if one.sum() >= other.sum() else (other, one)
