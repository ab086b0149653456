"""Registration of a depth camera to a colour camera: the warp, depth warped, outlines that show it, and its search.

A depth edge is the outline of a thing, and most outlines are edges of colour too, that run the same way. Where colour
and depth are of two cameras and are taken for one, the outlines of one picture miss those of the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from pipeline.geometry.camera import Camera, check_focals, intrinsics
from pipeline.geometry.frame import Frame
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class Registration:
    """The colour camera as the depth camera sees it."""

    fx: float  # Intrinsics of the colour camera, pixels
    fy: float
    cx: float
    cy: float
    # Added to a point of the depth camera's frame, gives it in the colour camera's, metres; both look the same way
    tx: float = 0.0
    ty: float = 0.0
    tz: float = 0.0

    def __post_init__(self) -> None:
        check_focals(self.fx, self.fy)

    @classmethod
    def none(cls, camera: Camera) -> Registration:
        """Identity: both cameras are one."""
        return cls(camera.fx, camera.fy, camera.cx, camera.cy)

    @property
    def t(self) -> np.ndarray:
        """Translation, (3,) float64."""
        return np.array([self.tx, self.ty, self.tz])

    def moved(self, across: float, down: float) -> Registration:
        """Copy with the principal point moved by pixels."""
        return replace(self, cx=self.cx + across, cy=self.cy + down)

    def after(self, first: Registration) -> Registration:
        """Compose with a first warp: of the depth camera, to the camera of this warp."""
        return replace(self, tx=self.tx + first.tx, ty=self.ty + first.ty, tz=self.tz + first.tz)

    def pixels(self, u: np.ndarray, v: np.ndarray, z: np.ndarray, camera: Camera) -> tuple[np.ndarray, ...]:
        """Column, row and depth in the colour camera, of the depth camera's pixels and depths, (N,) each."""
        far = z + self.tz
        x, y = (u - camera.cx) / camera.fx * z + self.tx, (v - camera.cy) / camera.fy * z + self.ty
        return self.fx * x / far + self.cx, self.fy * y / far + self.cy, far


def registered(depth: np.ndarray, camera: Camera, warp: Registration) -> tuple[np.ndarray, Camera]:
    """Register depth, (H, W) float32, metres, to the colour camera; the nearer of two surfaces hides the other.

    `camera` is the depth camera's, with its pose; the one that comes back is the colour camera. Depth is 0 where
    nothing falls.
    """
    v, u = np.nonzero(depth)
    columns, rows, z = warp.pixels(u.astype(np.float32), v.astype(np.float32), depth[v, u], camera)
    height, width = depth.shape
    inside = (z > 0) & (columns > -0.5) & (columns < width - 0.5) & (rows > -0.5) & (rows < height - 0.5)
    columns, rows, z = (part[inside] for part in (columns, rows, z))
    # The farthest first, so that the nearest is what stays; to the millimetre, which sorts ten times as fast.
    order = np.argsort(np.clip(65535 - z * 1000, 0, 65535).astype(np.uint16), kind="stable")
    out = np.zeros(depth.shape, np.float32)
    out[np.rint(rows[order]).astype(int), np.rint(columns[order]).astype(int)] = z[order]
    pose = camera.T_world_camera
    if pose is not None:
        pose = pose.copy()
        pose[:3, 3] -= pose[:3, :3] @ warp.t
    K = intrinsics(warp.fx, warp.fy, warp.cx, warp.cy)
    return _without_pinholes(out), replace(camera, K=K, T_world_camera=pose)


def _without_pinholes(depth: np.ndarray) -> np.ndarray:
    """Fill single missing pixels inside a surface with the nearest depth around."""
    missing = depth <= 0
    known = cv2.boxFilter((~missing).astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    nearest = cv2.erode(np.where(missing, np.float32(np.inf), depth), np.ones((3, 3), np.uint8))
    return np.where(missing & (known >= 6), nearest, depth).astype(np.float32)


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
        # Without any edge OpenCV's distance is the largest float.
        pixels = np.minimum(cv2.distanceTransform(no_edge, cv2.DIST_L2, 3), sum(grey.shape))
        found.append(np.minimum(pixels * (WIDE / rgb.shape[1] * AWAY_STEPS), 255).astype(np.uint8))
    return np.stack(found)


FOCALS = (0.76, 0.8, 0.84, 0.88, 0.92, 0.96, 1.0, 1.04, 1.08, 1.13, 1.18, 1.24, 1.3)
SHIFTS_M = (-0.06, -0.03, 0.0, 0.03, 0.06)
"""Where the search begins: focal lengths of the colour camera by the depth camera's, and shifts, metres."""
MOST_FOCAL, MOST_M, MOST_CENTER = 1.4, 0.12, 0.1
"""And its bound: a focal length so many times as long or short, metres aside, and a principal point that is off by a
share of the width."""
EVERY = 3
"""Of the outlines, where the search begins."""
BEGUN = 6
"""So many of the beginnings are followed."""
LOOKING = ((2.0, 3 * NEAR_PX, EVERY), (1.0, 2 * NEAR_PX, EVERY))
SETTLING = ((0.5, NEAR_PX, 1), (0.25, NEAR_PX, 1), (0.12, NEAR_PX, 1))
"""Steps in hundredths and centimetres, the tolerance at each, pixels, and how many of the outlines are left out."""


@dataclass(frozen=True)
class WarpEstimate:
    """A warp found by the search."""

    warp: Registration
    bounded: bool  # It lies at the bound of what is searched, so that it is none


def estimate_warp(
    outlines: Outlines, regions: np.ndarray | None = None, near: Registration | None = None
) -> WarpEstimate:
    """Estimate the warp with most outlines of depth on edges of colour, region by region; one for all frames.

    Of `regions`, (R,) bool, all count by default; the search starts at no warp and `near`, by default everywhere.
    """
    identity = Registration.none(outlines.camera)
    own = {(near, every): outlines.near(identity, near, every) for _, near, every in (*LOOKING, *SETTLING)}

    def gain(warp: Registration, tolerance: float, every: int) -> float:
        # What leaves the picture is taken to lie as it did.
        gained = np.nan_to_num(outlines.near(warp, tolerance, every) - own[tolerance, every])
        by_region = outlines.by_region(gained, every)
        return mean_known(by_region if regions is None else by_region[regions])

    starts = [
        replace(identity, fx=identity.fx * f, fy=identity.fy * f, tx=tx, ty=ty)
        for f in FOCALS
        for tx in SHIFTS_M
        for ty in SHIFTS_M[1:-1]
    ]
    begun = [identity, near] if near else sorted(starts, key=lambda warp: -gain(warp, *LOOKING[0][1:]))[:BEGUN]
    climbed = [_climbed(warp, gain, LOOKING) for warp in begun]
    best = _climbed(max(climbed, key=lambda warp: gain(warp, *LOOKING[-1][1:])), gain, SETTLING)
    center = max(abs(best.cx - identity.cx), abs(best.cy - identity.cy)) / outlines.away.shape[3]
    focal = abs(np.log(best.fx / identity.fx)) / np.log(MOST_FOCAL)
    aside = max(abs(best.tx), abs(best.ty)) / MOST_M
    return WarpEstimate(best, bool(max(focal, aside, center / MOST_CENTER) >= 1))


def _climbed(
    best: Registration,
    gain: Callable[[Registration, float, int], float],
    levels: Sequence[tuple[float, float, int]],
) -> Registration:
    """Climb to the nearest optimum, by steps and tolerances that become finer."""
    for step, tolerance, every in levels:
        share, metres, pixels = 0.01 * step, 0.01 * step, 4.0 * step
        value = gain(best, tolerance, every)
        for _ in range(8):
            near = [
                *(replace(best, fx=best.fx * (1 + way * share), fy=best.fy * (1 + way * share)) for way in (-1, 1)),
                *(replace(best, tx=best.tx + way * metres) for way in (-1, 1)),
                *(replace(best, ty=best.ty + way * metres) for way in (-1, 1)),
                *(best.moved(way * pixels, 0) for way in (-1, 1)),
                *(best.moved(0, way * pixels) for way in (-1, 1)),
                *(replace(best.moved(way * pixels, 0), tx=best.tx - way * metres) for way in (-1, 1)),
                *(replace(best.moved(0, way * pixels), ty=best.ty - way * metres) for way in (-1, 1)),
            ]
            found, k = max((gain(warp, tolerance, every), k) for k, warp in enumerate(near))
            if found <= value + 1e-4:
                break
            value, best = found, near[k]
    return best
