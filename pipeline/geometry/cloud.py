"""Point cloud of a frame as drawn (thinned, in bands of depth), viewpoints on it, and the metre grid of its floor."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.geometry.cleaning import flying_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.system.frozen import dataclass

MAX_POINTS = 320_000
BAND_RATIO = 1.3
"""Points are drawn in bands of depth, each with its own point size, so that near
and far surfaces look equally closed from the sensor."""
FAR = 12.0
SPAN = 64
"""More than the bands between a millimetre (-27) and FAR (9)."""


NEAREST_M, ASIDE, ASIDE_FROM_M = 0.05, 0.012, 0.3
"""A ray hits a point that lies beside it by up to this share of its distance, which counts as no less, metres."""


@dataclass(frozen=True, eq=False)
class CloudPart:
    """Points sent together: of one band of depth, either of the first cloud or of the rest."""

    first: bool  # Of the first cloud: one point in four, evenly spread
    at: slice  # Points of the cloud
    center: np.ndarray  # (3,) float32, shown frame, metres
    offsets: np.ndarray  # (M, 3) float16, from the centre, metres: to within 1 mm in a part that reaches less than 4 m
    size: float  # Point size, metres, once all points are drawn

    @property
    def name(self) -> str:
        """Name, unique among the parts of a cloud."""
        return f"{'first' if self.first else 'rest'}-{self.at.start}"


@dataclass(frozen=True, eq=False)
class Cloud:
    """The points of a frame."""

    v: np.ndarray  # (N,) int32, rows of pixels
    u: np.ndarray  # (N,) int32, columns
    points: np.ndarray  # (N, 3) float32, in the shown frame: x right, y forward, z up, metres
    parts: tuple[CloudPart, ...]  # Those of the first cloud come first

    @cached_property
    def middle(self) -> np.ndarray:
        """Median of the points, (3,), shown frame, metres; two metres ahead without any."""
        return np.median(self.points, axis=0) if len(self.points) else np.array([0.0, 2.0, 0.0])

    def painted(self, colors: np.ndarray) -> np.ndarray:
        """Colours of the points, (N, 3) uint8, from colours of the frame's pixels, (H, W, 3)."""
        return colors.reshape(-1, 3).take(self.v * colors.shape[1] + self.u, axis=0)

    def pixel_on_ray(self, origin: np.ndarray, direction: np.ndarray) -> tuple[int, int] | None:
        """Nearest surface pixel (u, v) close to a ray, (3,) each, shown frame; exact, since points are pixels."""
        offset = self.points - origin
        along = offset @ direction
        aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
        index = np.flatnonzero((along > NEAREST_M) & (aside < ASIDE * np.maximum(along, ASIDE_FROM_M)))
        if not len(index):
            return None
        best = index[np.argmin(along[index] + 3 * aside[index])]
        return int(self.u[best]), int(self.v[best])


def drawn_pixels(frame: Frame) -> np.ndarray:
    """Mask of drawn pixels, (H, W) bool: near enough, and not flying between two surfaces."""
    return (frame.depth > 0) & (frame.depth < FAR) & ~flying_pixels(frame.depth)


def stride_of(camera: Camera) -> int:
    """Step of rows and columns with at most MAX_POINTS points of a camera's picture."""
    return max(1, int(np.ceil(np.sqrt(camera.width * camera.height / MAX_POINTS))))


def cloud_of(frame: Frame, viewer: ViewerAxes, stride: int | None = None) -> Cloud:
    """Build the cloud of a frame from each `stride`-th row and column; by default at most MAX_POINTS points."""
    to_show = np.stack([viewer.right, viewer.forward, viewer.up])
    stride = stride or stride_of(frame.camera)
    depth, keep = frame.depth[::stride, ::stride], drawn_pixels(frame)[::stride, ::stride]
    level = np.floor(np.log(np.maximum(depth, np.float32(1e-3))) * np.float32(1 / np.log(BAND_RATIO))).astype(np.int8)
    # Bands of the rest lie behind all of the first; eight bits are sorted by counting.
    level[1::2] += SPAN
    level[::2, 1::2] += SPAN
    pixels, group = np.flatnonzero(keep), level[keep]
    order = np.argsort(group, kind="stable")
    pixels, group = pixels[order].astype(np.int32), group[order]
    v, u = pixels // depth.shape[1], pixels % depth.shape[1]
    points = lift_pixels(depth.ravel()[pixels], frame.camera, v * stride, u * stride)
    points = cv2.transform(points[:, None], to_show.astype(np.float32))[:, 0] if len(points) else points
    starts = np.flatnonzero(np.diff(group, prepend=group[:1] - 1)) if len(group) else []
    size = 1.15 * stride / frame.camera.fx
    return Cloud(v * stride, u * stride, points, tuple(_part(points, group, int(a), size) for a in starts))


def _part(points: np.ndarray, group: np.ndarray, start: int, size: float) -> CloudPart:
    number = int(group[start])
    at = slice(start, int(np.searchsorted(group, number, side="right")))
    center = cv2.reduce(points[at], 0, cv2.REDUCE_MIN)[0] / 2 + cv2.reduce(points[at], 0, cv2.REDUCE_MAX)[0] / 2
    first = number < SPAN // 2
    size = float(BAND_RATIO ** (number - (0 if first else SPAN) + 0.6) * size)
    return CloudPart(first, at, center, (points[at] - center).astype(np.float16), size)


AROUND, NEAREST = 1.12, 0.55
"""A pair is seen from so much farther than would fill the view, and from no nearer than so many metres."""
TOOLS, LEGEND = 0.05, 0.08
"""Of the height of a view, at its top and its bottom: no pair is put under what stands there."""
LEAST_ROOM = 0.2
"""Of the width and the height of a view; in less no pair is shown."""
NEAREST_SPACINGS, NEAREST_BY_HAND = 300, 25
"""Nor from nearer than so many times the spacing of its points on a surface that faces the sensor: they then lie 3
pixels apart in a view 800 pixels high, and 6 on a surface at 60 degrees, the size that no point exceeds on the page. A
person may come as near as the second."""
TOWARD = np.array([-0.36, 0.84, -0.42])
"""Where one looks who sees all: from the right, above and behind the sensor."""
FITTING_FOV, TOP_FOV = float(np.deg2rad(44)), float(np.deg2rad(50))
Viewed = tuple[np.ndarray, np.ndarray, float]
"""Where the eye is, what it looks at ((3,) each, shown frame, metres), and how high its field of view is, radians."""


def viewpoint(
    kind: str,
    points: np.ndarray,
    to_show: np.ndarray,
    camera: Camera,
    aspect: float,
    about: np.ndarray | None = None,
    covered: tuple[float, float] = (0.0, 0.0),
) -> Viewed:
    """Viewpoint of a frame, by (N, 3) points and, for a pair, (M, 3) points `about`, shown frame, metres.

    `kind` is "sensor", "top", "pair", or another for all of the frame; without points it is always the sensor's.
    `to_show`, (3, 3), turns the camera frame into the shown frame; `aspect` is width over height of the view;
    `covered` are the shares of its width and height that something covers in its upper right corner.
    """
    if kind == "sensor" or not len(points):
        middle = np.median(points, axis=0) if len(points) else np.array([0.0, 2.0, 0.0])
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
        width, height = covered
        rooms = ((0.0, 0.0, 1.0, 1.0), (0.0, 0.0, 1 - width, 1.0), (0.0, height, 1.0, 1.0))
        rooms = [(x0, max(y0, TOOLS), x1, y1 - LEGEND) for x0, y0, x1, y1 in rooms]
        least = nearest_distance(about, camera)
        views = [fitting_viewpoint(about, aspect, room, least) for room in rooms if _roomy(room)]
        free = (v for v in views if not _covers(covered, about, v, aspect))
        return min(free, key=lambda v: float(np.linalg.norm(v[0] - v[1])), default=views[0])
    return fitting_viewpoint(points, aspect)


def _roomy(room: tuple[float, float, float, float]) -> bool:
    x0, y0, x1, y1 = room
    return min(x1 - x0, y1 - y0) > LEAST_ROOM


def _covers(covered: tuple[float, float], points: np.ndarray, view: Viewed, aspect: float) -> bool:
    """True where any of (N, 3) points is under what covers the upper right corner of a view."""
    eye, _, fov = view
    x, y, z = (_AXES @ (points - eye).T) / np.array([[aspect], [1.0], [1 / np.tan(fov / 2)]])
    return bool(((x / z > 1 - 2 * covered[0]) & (y / z > 1 - 2 * covered[1])).any())


def _axes(toward: np.ndarray) -> np.ndarray:
    """Right, up and ahead, (3, 3), of a view that is level."""
    toward = toward / np.linalg.norm(toward)
    across = np.cross(toward, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(across, toward), toward])


_AXES = _axes(TOWARD)


def nearest_distance(points: np.ndarray, camera: Camera) -> float:
    """Nearest distance, metres, at which the surface around (N, 3) points from the camera is seen as closed."""
    return max(NEAREST, NEAREST_SPACINGS * spacing_at(points, camera))


def spacing_at(points: np.ndarray, camera: Camera) -> float:
    """Median spacing, metres, of a cloud's points around (N, 3) points from the camera, on surfaces that face it."""
    return stride_of(camera) * float(np.median(np.linalg.norm(points, axis=1))) / camera.fx


WHOLE = (0.0, 0.0, 1.0, 1.0)


def fitting_viewpoint(
    points: np.ndarray,
    aspect: float,
    room: tuple[float, float, float, float] = WHOLE,
    least: float | None = None,
) -> Viewed:
    """Nearest viewpoint along TOWARD with nearly all of (N, 3) points in a part of the view, N > 0, shown frame.

    `room`: x0, y0, x1, y1 of that part, shares of the view from its upper left; `least`: a distance that is kept,
    metres, with some air around the points.
    """
    sample = points[:: max(1, len(points) // 4000)]
    # Both along the axes of the view.
    center, sample = _AXES @ _percentiles(sample.T, 2, 98).mean(axis=1), sample @ _AXES.T
    tangent = np.tan(FITTING_FOV / 2)
    x0, y0, x1, y1 = room
    wide, tall = tangent * aspect * (x1 - x0), tangent * (y1 - y0)
    distance = 1.0
    for _ in range(4):
        x, y, z = (sample - center).T
        # A point is in view from as far away as its offset over the tangent, less its own depth.
        needed = np.maximum(np.abs(x) / wide, np.abs(y) / tall) - z
        distance = max(float(_percentiles(needed, 99.3)[0]) * 1.03, 0.2)
        seen = np.stack([x, y]) / np.maximum(distance + z, 0.05)
        center[:2] += _percentiles(seen, 0.7, 99.3).mean(axis=1) * distance
    distance = distance if least is None else max(AROUND * distance, least)
    # The middle of the points comes to the middle of that part.
    center[:2] -= distance * tangent * np.array([aspect * (x0 + x1 - 1), 1 - y0 - y1])
    return (center - [0, 0, distance]) @ _AXES, center @ _AXES, FITTING_FOV


def _percentiles(values: np.ndarray, *wanted: float) -> np.ndarray:
    """(..., P) percentiles along the last axis, as of `np.percentile`, which takes longer for a few values."""
    ordered, at = np.sort(values, axis=-1), np.array(wanted) / 100 * (values.shape[-1] - 1)
    low, share = at.astype(int), at % 1
    above = ordered[..., np.minimum(low + 1, values.shape[-1] - 1)]
    return ordered[..., low] * (1 - share) + above * share


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
