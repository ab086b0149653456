"""How far behind an object other surfaces are seen beside it: no thing reaches through the wall behind it.

Depth shows fronts. How deep a thing is behind its front is bounded by what is seen just beyond its outline.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.geometry.camera import Camera
from pipeline.geometry.normals import surface_step
from pipeline.geometry.viewer import ViewerAxes

LINES = 32
"""Rows (columns) of a mask that are looked at, evenly spread."""
STEPS = np.array([2, 3, 4, 5, 6, 7, 8, 10, 12, 15])
"""Pixels beyond the mask at which the depth is looked at, at an image width of 640: masks are a little wrong."""
LEAST_M, MOST_M = -0.5, 2.0
NEAR_PERCENT = 10.0
NOTHING_BEHIND = np.array([MOST_M, MOST_M, 0.0])
"""Of an object beside which nothing farther is seen, or of which that is not known."""

_RIGHT, _DOWN, _LEFT, _UP = range(4)
_STEP = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])

Outlined = tuple[np.ndarray, np.ndarray, int, int]
"""A mask and those of its pixels that the cleaning kept, (h, w) bool, in a rectangle, and its x0 and y0."""


def clearances(
    masks: Sequence[Outlined], backs: Sequence[float], depth: np.ndarray, camera: Camera, viewer: ViewerAxes
) -> np.ndarray:
    """How far behind each object other surfaces are.

    Beside each row's ends and above each column's of a mask the farthest of a few pixels is looked at; not below:
    there the floor comes nearer.

    Parameters
    ----------
    masks : sequence of Outlined
    backs : sequence of float
        The farthest that is seen of each object along the viewer's forward, metres.
    depth : (H, W) float32
        Metres.

    Returns
    -------
    (N, 3) float64
        10th percentile and median over these lines of how much farther forward the surface beyond is than the
        object's back, metres from LEAST_M to MOST_M, and the share of the lines that have one.
    """
    found = np.tile(NOTHING_BEHIND, (len(masks), 1))
    turns = round(np.arctan2(viewer.right[1], viewer.right[0]) / (np.pi / 2))
    below = (_DOWN + turns) % 4
    parts = [_lines(*mask, below) for mask in masks]
    if not sum(len(part) for part in parts):
        return found
    side, u, v, kept_u, kept_v = np.concatenate(parts).T
    height, width = depth.shape
    steps = np.unique(np.maximum(np.rint(STEPS * (max(height, width) / 640)), 1).astype(np.int64))
    du, dv = _STEP[side].T
    us, vs = u[:, None] + du[:, None] * steps, v[:, None] + dv[:, None] * steps
    inside = (us >= 0) & (us < width) & (vs >= 0) & (vs < height)
    seen = np.where(inside, depth[np.clip(vs, 0, height - 1), np.clip(us, 0, width - 1)], 0)
    z = depth[kept_v, kept_u]
    seen = np.where(seen > (z + surface_step(z))[:, None], seen, 0)
    # The farthest: flying pixels hang between the object and what is behind it.
    line, step = np.arange(len(side)), seen.argmax(axis=1)
    z, u, v = seen[line, step], us[line, step], vs[line, step]
    ray = (u - camera.cx) / camera.fx * viewer.forward[0] + (v - camera.cy) / camera.fy * viewer.forward[1]
    forward = np.where(z > 0, z * (ray + viewer.forward[2]), np.nan)
    ends = np.cumsum([len(part) for part in parts])
    for k, (part, back) in enumerate(zip(np.split(forward, ends[:-1]), backs, strict=True)):
        far = part[np.isfinite(part)] - back
        if len(far) and np.isfinite(back):
            near, middle = np.percentile(np.clip(far, LEAST_M, MOST_M), [NEAR_PERCENT, 50])
            found[k] = near, middle, len(far) / len(part)
    return found


def _lines(inside: np.ndarray, kept: np.ndarray, x0: int, y0: int, below: int) -> np.ndarray:
    """(L, 5) int64 of the ends of a mask's lines, but those below: side, last pixel u, v, last kept pixel u, v."""
    parts = [np.zeros((0, 5), np.int64)]
    for turned in (False, True):
        mask, clean = (inside.T, kept.T) if turned else (inside, kept)
        rows = np.flatnonzero(clean.any(axis=1))
        if not len(rows):
            continue
        if len(rows) > LINES:
            rows = rows[np.linspace(0, len(rows) - 1, LINES).astype(np.int64)]
        mask, clean, last = mask[rows], clean[rows], mask.shape[1] - 1
        ends = (
            (_DOWN if turned else _RIGHT, last - mask[:, ::-1].argmax(axis=1), last - clean[:, ::-1].argmax(axis=1)),
            (_UP if turned else _LEFT, mask.argmax(axis=1), clean.argmax(axis=1)),
        )
        for side, x, kept_x in ends:
            if side != below:
                columns = (
                    (rows + x0, x + y0, rows + x0, kept_x + y0)
                    if turned
                    else (x + x0, rows + y0, kept_x + x0, rows + y0)
                )
                parts.append(np.stack([np.full(len(rows), side), *columns], axis=1))
    return np.concatenate(parts)
