"""The floor of a frame: its height, and a grid of metres on it, by which lengths can be judged."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes

FLOOR_NOISE = 0.06


def over_floor(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Height above nearly all floor points, (N, 3), shown frame, between two corners.

    Depth is noisy: what lies in the floor itself shows as specks between its points.
    """
    floor, across = low[2], points[:, :2]
    near = (np.abs(points[:, 2] - floor) < FLOOR_NOISE) & ((across > low[:2]) & (across < high[:2])).all(axis=1)
    return float(np.percentile(points[near, 2], 98)) if near.any() else float(floor)


CELL, FINE = 1.0, 0.25
"""Distance of the grid's lines, metres."""
FLOOR_LOW, FLOOR_HIGH = 0.05, 0.1
"""Points so far below and above the lowest ones are of the floor, metres."""
GRID_LIFT = 0.008
"""The grid lies a little above the points of the floor, metres."""


def metre_grid(frame: Frame, viewer: ViewerAxes, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines of `grid_lines` on the floor of a frame, under nearly all of (N, 3) points, N > 0, shown frame."""
    low, high = np.percentile(points, [1, 99], axis=0)
    low[2] = high[2] = floor_height(frame, viewer, points)
    return grid_lines(low[:2], high[:2], over_floor(points, low, high) + GRID_LIFT)


def floor_height(frame: Frame, viewer: ViewerAxes, points: np.ndarray) -> float:
    """Height of the floor, metres along up from the camera: the annotated floor, else the lowest of (N, 3) points."""
    for annotation in frame.annotations:
        if annotation.label == "floor" and annotation.mask is not None:
            v, u = np.nonzero(annotation.mask & (frame.depth > 0))
            if len(v):
                return float(np.median(lift_pixels(frame.depth[v, u], frame.camera, v, u) @ viewer.up))
    heights = points[:, 2]
    lowest = np.percentile(heights, 1)
    near = heights[(heights > lowest - FLOOR_LOW) & (heights < lowest + FLOOR_HIGH)]
    return float(np.median(near))


def grid_lines(low: np.ndarray, high: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Lines of a grid, (N, 2, 3) float32 each: at whole metres, and fine ones between, over cells from low to high."""
    first, last = np.floor(low / CELL) * CELL, np.ceil(high / CELL) * CELL
    made = []
    for axis in (0, 1):
        steps = np.arange(round((last[axis] - first[axis]) / FINE) + 1)
        lines = np.full((len(steps), 2, 3), height, np.float32)
        lines[..., axis] = (first[axis] + steps * FINE)[:, None]
        lines[:, 0, 1 - axis], lines[:, 1, 1 - axis] = first[1 - axis], last[1 - axis]
        made.append((lines, steps % round(CELL / FINE) == 0))
    cells, fine = (np.concatenate([lines[whole == which] for lines, whole in made]) for which in (True, False))
    return cells, fine
