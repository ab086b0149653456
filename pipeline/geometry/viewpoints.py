"""Viewpoints on a frame's points (the sensor's, from above, all or a pair in view), and the metre grid of its floor."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes

AROUND, NEAREST = 1.12, 0.55
"""A pair is seen from so much farther than would fill the view, and from no nearer than so many metres."""
TOWARD = np.array([-0.36, 0.84, -0.42])
"""Where one looks who sees all: from the right, above and behind the sensor."""
FITTING_FOV, TOP_FOV = float(np.deg2rad(44)), float(np.deg2rad(50))
Viewed = tuple[np.ndarray, np.ndarray, float]
"""Where the eye is, what it looks at ((3,) each, shown frame, metres), and how high its field of view is, radians."""


def viewpoint(
    kind: str, points: np.ndarray, to_show: np.ndarray, camera: Camera, aspect: float, about: np.ndarray | None = None
) -> Viewed:
    """Viewpoint of a frame, by (N, 3) points and, for a pair, (M, 3) points `about`, shown frame, metres.

    `kind` is "sensor", "top", "pair", or another for all of the frame; without points it is always the sensor's.
    `to_show`, (3, 3), turns the camera frame into the shown frame; `aspect` is width over height of the view.
    """
    middle = np.median(points, axis=0) if len(points) else np.array([0.0, 2.0, 0.0])
    if kind == "sensor" or not len(points):
        forward = to_show @ np.array([0.0, 0.0, 1.0])
        # The whole picture is in view, with a little air, whatever the shape of the page.
        tall, wide = camera.height / 2 / camera.fy, camera.width / 2 / camera.fx / aspect
        ahead = forward * float(np.linalg.norm(middle))
        return np.zeros(3) - forward * 0.01, ahead, float(2 * np.arctan(max(tall, wide) * 1.04))
    if kind == "top":
        low, high = np.percentile(points, [3, 97], axis=0)
        center, span = (low + high) / 2, float((high - low)[:2].max())
        return center + np.array([0.0, -0.02, span * 1.25]), center, TOP_FOV
    if kind == "pair" and about is not None:
        eye, look, fov = fitting_viewpoint(about, aspect)
        # What stands around the pair is in view, too.
        return look + (eye - look) * max(AROUND, NEAREST / max(float(np.linalg.norm(eye - look)), 1e-6)), look, fov
    return fitting_viewpoint(points, aspect)


def fitting_viewpoint(points: np.ndarray, aspect: float) -> Viewed:
    """Nearest viewpoint along TOWARD with nearly all of (N, 3) points in view, N > 0, shown frame."""
    center = np.percentile(points, [2, 98], axis=0).mean(axis=0)
    toward = TOWARD / np.linalg.norm(TOWARD)
    across = np.cross(toward, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(across, toward), toward])
    sample = points[:: max(1, len(points) // 4000)]
    tangent = np.tan(FITTING_FOV / 2)
    distance = 1.0
    for _ in range(4):
        x, y, z = ((sample - center) @ axes.T).T
        # A point is in view from as far away as its offset over the tangent, less its own depth.
        needed = np.maximum(np.abs(x) / (tangent * aspect), np.abs(y) / tangent) - z
        distance = max(float(np.percentile(needed, 99.3)) * 1.03, 0.2)
        seen = np.stack([x, y]) / np.maximum(distance + z, 0.05)
        shift = np.percentile(seen, [0.7, 99.3], axis=1).mean(axis=0) * distance
        center = center + axes[0] * shift[0] + axes[1] * shift[1]
    return center - toward * distance, center, FITTING_FOV


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
