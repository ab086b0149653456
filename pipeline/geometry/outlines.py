"""Outlines of objects in depth, and their agreement with edges of colour, region by region.

A depth edge is the outline of a thing, and most outlines are edges of colour too, that run the same way. Where colour
and depth are of two cameras and are taken for one, the outlines of one picture miss those of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.registration import Registration

WIDE = 640
"""Distances in pixels are at this width of a picture."""
NEAR_PX = 2.0
"""An outline of depth counts half so far from an edge of colour."""
MOVED_PX = 8.0
"""What is registered falls where one picture is moved by so much."""
REGIONS = (3, 4)
"""Rows and columns of regions of a picture. Each counts as much as another, however many outlines it has."""
OUTLINES = 120
"""So many pixels of outlines are looked at in a region of a frame."""
LEAST_IN_REGION = 30
"""A region in which all frames together have fewer says nothing."""
STEP_M, STEP_SHARE = 0.015, 0.03
"""What is nearer than what is behind it by so much, metres and by share, is a step: a cup on a table, no noise."""
GAP_PX = 6
"""What is behind a thing is looked for so far across pixels without depth, which a projector's shadow leaves."""
SURFACE, LEAST_LONG = 5, 12
"""So many of the nine pixels about an outline are of its surface, and so many pixels long it is; else it is noise."""
WAYS = 4
OFF_WAY_DEG = 35.0
"""Edges count for an outline where their direction differs by less, from the middle of one of so many ways."""
EDGES = (30, 80)
AWAY_STEPS = 4.0
"""Distances from edges are kept in so many steps of a pixel."""


@dataclass(frozen=True)
class Outlines:
    """Depth outlines of frames of one size and camera, and distances of their pixels from edges of colour."""

    u: np.ndarray  # (N,) float64, columns of pixels on the nearer side of depth steps
    v: np.ndarray  # (N,) float64, rows
    z: np.ndarray  # (N,) float64, depth, metres
    frame: np.ndarray  # (N,) int64, index of the frame of each
    way: np.ndarray  # (N,) int64, index of the direction across the outline
    region: np.ndarray  # (N,) int64, index of the region of the picture that it lies in, row by row of `REGIONS`
    # (F, WAYS, H, W) uint8, quarters of a pixel to the nearest edge of colour of a direction, at a width of 640; at
    # most 255
    away: np.ndarray
    camera: Camera

    @classmethod
    def of(cls, frames: Sequence[Frame]) -> Outlines:
        """Find outlines in frames of one size and camera, at least one frame."""
        found = [np.stack(_outlines(frame.depth)).astype(float) for frame in frames]
        index = np.repeat(np.arange(len(frames)), [part.shape[1] for part in found])
        u, v, z, way, region = np.concatenate(found, axis=1)
        away = np.stack([_away(frame.rgb) for frame in frames])
        return cls(u, v, z, index, way.astype(int), region.astype(int), away, frames[0].camera)

    def near(self, warp: Registration, tolerance: float = NEAR_PX, every: int = 1) -> np.ndarray:
        """Nearness of each outline (or each `every`-th) to an edge of colour under a warp, (N,) 0..1; NaN outside."""
        columns, rows, far = warp.pixels(self.u[::every], self.v[::every], self.z[::every], self.camera)
        height, width = self.away.shape[2:]
        inside = (far > 0) & (columns > -0.5) & (columns < width - 0.5) & (rows > -0.5) & (rows < height - 0.5)
        u, v = (np.where(inside, np.rint(c), 0).astype(np.int32) for c in (columns, rows))
        away = self.away[self.frame[::every], self.way[::every], v, u] / np.float32(AWAY_STEPS * tolerance)
        return np.where(inside, 1 / (1 + away * away), np.nan)

    def above_chance(self, warp: Registration) -> np.ndarray:
        """Nearness above chance, (N,): less the nearness with the pictures moved by some pixels; 0 shows nothing."""
        px = MOVED_PX * self.away.shape[3] / WIDE
        ways = ((px, 0), (-px, 0), (0, px), (0, -px))
        moved = np.stack([self.near(warp.moved(*way)) for way in ways])
        inside = np.isfinite(moved)
        return self.near(warp) - np.where(inside, moved, 0).sum(axis=0) / np.maximum(inside.sum(axis=0), 1)

    def by_region(self, value: np.ndarray, every: int = 1) -> np.ndarray:
        """Mean by region, (R,), of a number of each outline, (N,), NaN left out; NaN for too few outlines."""
        known = np.isfinite(value)
        region, regions = self.region[::every][known], REGIONS[0] * REGIONS[1]
        count = np.bincount(region, minlength=regions)
        total = np.bincount(region, value[known], regions)
        return np.where(count * every >= LEAST_IN_REGION, total / np.maximum(count, 1), np.nan)

    def by_frame(self, value: np.ndarray) -> np.ndarray:
        """Mean by frame, (F,); NaN for too few outlines."""
        known = np.isfinite(value)
        count = np.bincount(self.frame[known], minlength=len(self.away))
        total = np.bincount(self.frame[known], value[known], len(self.away))
        return np.where(count >= LEAST_IN_REGION, total / np.maximum(count, 1), np.nan)


def mean_known(values: np.ndarray) -> float:
    """Mean without NaN; 0 without any."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else 0.0


def agreement(outlines: Outlines, warp: Registration) -> float:
    """Share, 0..1, of depth outlines on edges of colour under a warp, the mean over regions."""
    return mean_known(outlines.by_region(outlines.near(warp)))


def _outlines(depth: np.ndarray) -> tuple[np.ndarray, ...]:
    """Outlines of a depth map: u, v, z, direction and region, as many of each region."""
    v, u, z, angle = _depth_steps(depth)
    rows, columns = REGIONS
    region = v * rows // depth.shape[0] * columns + u * columns // depth.shape[1]
    kept = np.concatenate([_even(np.flatnonzero(region == k)) for k in range(rows * columns)])
    way = np.rint(angle * WAYS / np.pi).astype(int) % WAYS
    return u[kept], v[kept], z[kept], way[kept], region[kept]


def _even(indices: np.ndarray) -> np.ndarray:
    return indices[np.linspace(0, len(indices) - 1, min(OUTLINES, len(indices))).astype(int)]


def _depth_steps(depth: np.ndarray) -> tuple[np.ndarray, ...]:
    """Row, column, depth and direction across (radians) of the pixels on the nearer side of depth steps."""
    depth = cv2.medianBlur(depth, 5)
    gap = round(GAP_PX * depth.shape[1] / WIDE)
    beyond = cv2.dilate(depth, np.ones((2 * gap + 1,) * 2, np.uint8))
    filled = np.where(depth > 0, depth, beyond)
    step = np.maximum(STEP_M, STEP_SHARE * depth)
    outline = np.asarray((depth > 0) & (cv2.dilate(filled, np.ones((3, 3), np.uint8)) - depth > step))
    around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    outline &= sum(np.abs(np.roll(depth, way, (0, 1)) - depth) < step / 2 for way in around) >= SURFACE
    outline[[0, -1]] = outline[:, [0, -1]] = False
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(outline.astype(np.uint8))
    outline &= (
        np.asarray(stats)[:, cv2.CC_STAT_AREA][np.asarray(pieces, np.int64)] >= LEAST_LONG * depth.shape[1] / WIDE
    )
    v, u = np.nonzero(outline)
    # Only the step counts for its direction, however far what is behind it lies.
    behind = filled - cv2.erode(filled, np.ones((5, 5), np.uint8)) > step
    return v, u, depth[v, u], _angle(cv2.GaussianBlur(behind.astype(np.float32), (0, 0), 2.0), v, u)


def _angle(picture: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Direction across the edges of a picture (radians, 0..pi) at pixels."""
    across, down = (cv2.Sobel(picture, cv2.CV_32F, *way)[v, u] for way in ((1, 0), (0, 1)))
    return np.arctan2(down, across) % np.pi


def _away(rgb: np.ndarray) -> np.ndarray:
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (0, 0), 1.2)
    v, u = np.nonzero(cv2.Canny(grey, *EDGES))
    angle = _angle(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.0), v, u)
    found = []
    for way in range(WAYS):
        off = np.abs(angle - way * np.pi / WAYS)
        alike = np.minimum(off, np.pi - off) < np.deg2rad(OFF_WAY_DEG)
        no_edge = np.ones(grey.shape, np.uint8)
        no_edge[v[alike], u[alike]] = 0
        pixels = cv2.distanceTransform(no_edge, cv2.DIST_L2, 3) * (WIDE / rgb.shape[1])
        found.append(np.minimum(pixels * AWAY_STEPS, 255).astype(np.uint8))
    return np.stack(found)
