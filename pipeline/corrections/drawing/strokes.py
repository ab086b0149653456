"""Shapes as masks: a pixel belongs to one where its centre does; that of pixel (u, v) is (u + 0.5, v + 0.5)."""

from __future__ import annotations

import numpy as np

THINNEST = 0.7072
"""Radius of the thinnest stroke, pixels: wherever it is put down, the centre of a pixel is within reach."""


def stroke_mask(points: np.ndarray, radius: float, height: int, width: int) -> np.ndarray:
    """What a round brush covers on its way.

    Parameters
    ----------
    points : (N, 2) float
        x, y of its middle, pixels; one point is a disc.
    radius : float
        Pixels; at least `THINNEST`.

    Returns
    -------
    (H, W) bool
        Pixels whose centre is no further than `radius` from the line.
    """
    mask = np.zeros((height, width), np.bool_)
    radius = max(float(radius), THINNEST)
    line = np.asarray(points, np.float64).reshape(-1, 2)
    starts, ends = (line[:-1], line[1:]) if len(line) > 1 else (line, line)
    limit = np.array([width, height])
    low = np.clip(np.floor(np.minimum(starts, ends) - radius), 0, limit).astype(np.int64)
    high = np.clip(np.ceil(np.maximum(starts, ends) + radius), 0, limit).astype(np.int64)
    for (ax, ay), (bx, by), (x0, y0), (x1, y1) in zip(starts, ends, low, high, strict=True):
        if x1 <= x0 or y1 <= y0:
            continue
        x, y = np.arange(x0, x1) + (0.5 - ax), (np.arange(y0, y1) + (0.5 - ay))[:, None]
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        t = np.clip((x * dx + y * dy) / square, 0, 1) if square > 0 else 0.0
        mask[y0:y1, x0:x1] |= (x - t * dx) ** 2 + (y - t * dy) ** 2 <= radius * radius
    return mask


def polygon_mask(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """The inside of a polygon by the even-odd rule, each pixel by its centre.

    `cv2.fillPoly` would add the pixels that the outline touches.

    Parameters
    ----------
    points : (N, 2) float
        Corners x, y, pixels, in the picture or beyond it; the last is joined to the first.

    Returns
    -------
    (H, W) bool
    """
    a = np.asarray(points, np.float64).reshape(-1, 2)
    b = np.roll(a, -1, axis=0)
    rows = np.arange(height)[:, None] + 0.5
    row, edge = np.nonzero((a[:, 1] <= rows) != (b[:, 1] <= rows))
    (ax, ay), (bx, by) = a[edge].T, b[edge].T
    x = ax + (row + 0.5 - ay) * ((bx - ax) / (by - ay))
    first = np.clip(np.ceil(x - 0.5), 0, width).astype(np.int64)
    crossings = np.bincount(row * (width + 1) + first, minlength=height * (width + 1)).reshape(height, width + 1)
    return (np.cumsum(crossings[:, :width], axis=1) & 1).astype(np.bool_)


def rectangle_mask(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """(H, W) bool: the pixels between two opposite corners, x, y in pixels, in any order."""
    (x0, y0), (x1, y1) = np.sort(np.asarray(points, np.float64).reshape(2, 2), axis=0)
    return polygon_mask(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), height, width)
