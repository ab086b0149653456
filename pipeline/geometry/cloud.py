"""Point cloud of a frame as drawn: thinned, in bands of depth, a first part of the points evenly spread."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import flying_pixels
from pipeline.geometry.viewer import ViewerAxes

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


def cloud_of(frame: Frame, viewer: ViewerAxes, stride: int | None = None) -> Cloud:
    """Build the cloud of a frame from each `stride`-th row and column; by default at most MAX_POINTS points."""
    to_show = np.stack([viewer.right, viewer.forward, viewer.up])
    stride = stride or max(1, int(np.ceil(np.sqrt(frame.width * frame.height / MAX_POINTS))))
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
