"""Where a depth camera's pixels lie in the colour picture: the warp between the two, how it shows, and depth warped.

A depth edge is the outline of a thing, and most outlines are edges of colour too. Where both cameras are taken for one
and are not, the outlines of one picture miss those of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.geometry.camera import Camera, intrinsics
from pipeline.system.errors import require

NEAR_PX = 2.0
"""An outline of depth counts half so far from an edge of colour, at a width of 640 pixels."""
OUTLINES = 1500
"""So many pixels of outlines are looked at in a frame."""
STEP_M, STEP_SHARE = 0.08, 0.05
FOCALS = (0.86, 0.9, 0.94, 0.97, 1.0, 1.03, 1.06, 1.1, 1.15)
SHIFTS_M = (-0.05, -0.025, 0.0, 0.025, 0.05)
"""Where the search for a warp begins."""


@dataclass(frozen=True)
class Registration:
    """The colour camera as the depth camera sees it.

    Attributes
    ----------
    fx, fy, cx, cy : float
        Intrinsics of the colour camera, pixels.
    tx, ty, tz : float
        Added to a point of the depth camera's frame, gives it in the colour camera's, metres; both look the same way.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    tx: float = 0.0
    ty: float = 0.0
    tz: float = 0.0

    def __post_init__(self) -> None:
        require(self.fx > 0 and self.fy > 0, "focal lengths must be positive", got=f"fx={self.fx:g}, fy={self.fy:g}")

    @classmethod
    def none(cls, camera: Camera) -> Registration:
        """Both cameras are one."""
        return cls(camera.fx, camera.fy, camera.cx, camera.cy)

    @property
    def t(self) -> np.ndarray:
        """(3,) float64."""
        return np.array([self.tx, self.ty, self.tz])

    def pixels(self, u: np.ndarray, v: np.ndarray, z: np.ndarray, camera: Camera) -> tuple[np.ndarray, ...]:
        """Column, row and depth in the colour camera of the depth camera's pixels and depths, (N,) each."""
        far = z + self.tz
        x, y = (u - camera.cx) / camera.fx * z + self.tx, (v - camera.cy) / camera.fy * z + self.ty
        return self.fx * x / far + self.cx, self.fy * y / far + self.cy, far


def registered(depth: np.ndarray, camera: Camera, warp: Registration) -> tuple[np.ndarray, Camera]:
    """Depth as the colour camera would have measured it, and that camera.

    Parameters
    ----------
    depth : (H, W) float32
        Metres, of the depth camera.
    camera : Camera
        The depth camera's, with its pose.

    Returns
    -------
    depth : (H, W) float32
        0 where nothing falls. The nearer of two surfaces hides the other.
    camera : Camera
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
    """Depth whose single missing pixels inside a surface have the nearest depth around them."""
    missing = depth <= 0
    known = cv2.boxFilter((~missing).astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    nearest = cv2.erode(np.where(missing, np.float32(np.inf), depth), np.ones((3, 3), np.uint8))
    return np.where(missing & (known >= 6), nearest, depth).astype(np.float32)


@dataclass(frozen=True)
class Outlines:
    """The outlines of things in the depth of a frame, and how far each pixel of its colour is from an edge.

    Attributes
    ----------
    u, v, z : (N,) float64
        Pixels on the nearer side of depth steps, metres.
    away : (H, W) float32
        Pixels to the nearest edge of colour, at a width of 640.
    camera : Camera
    """

    u: np.ndarray
    v: np.ndarray
    z: np.ndarray
    away: np.ndarray
    camera: Camera

    @classmethod
    def of(cls, rgb: np.ndarray, depth: np.ndarray, camera: Camera) -> Outlines:
        """Those of a frame: colour (H, W, 3) uint8, depth (H, W) float32 metres."""
        behind = cv2.dilate(depth, np.ones((3, 3), np.uint8)) - depth
        v, u = np.nonzero((depth > 0) & (behind > np.maximum(STEP_M, STEP_SHARE * depth)))
        even = np.linspace(0, len(v) - 1, min(OUTLINES, len(v))).astype(int)
        v, u = v[even], u[even]
        grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (0, 0), 1.2)
        away = cv2.distanceTransform((cv2.Canny(grey, 30, 80) == 0).astype(np.uint8), cv2.DIST_L2, 3)
        return cls(u.astype(float), v.astype(float), depth[v, u].astype(float), away * 640 / depth.shape[1], camera)

    def near(self, warp: Registration) -> np.ndarray:
        """(N,) 0..1: how near each outline is to an edge of colour under a warp; 0 outside the picture."""
        columns, rows, far = warp.pixels(self.u, self.v, self.z, self.camera)
        height, width = self.away.shape
        inside = (far > 0) & (columns > -0.5) & (columns < width - 0.5) & (rows > -0.5) & (rows < height - 0.5)
        u, v = (np.where(inside, np.rint(c), 0).astype(int) for c in (columns, rows))
        return np.where(inside, 1 / (1 + (self.away[v, u] / NEAR_PX) ** 2), 0.0)


def agreement(frames: Sequence[Outlines], warp: Registration) -> float:
    """0..1: the share of the outlines of depth that lie on edges of colour."""
    return float(np.mean(np.concatenate([frame.near(warp) for frame in frames])))


def estimated(frames: Sequence[Outlines]) -> Registration:
    """The warp under which most outlines of depth lie on edges of colour, one for all frames."""
    told = Registration.none(frames[0].camera)
    starts = [
        replace(told, fx=told.fx * f, fy=told.fy * f, tx=tx, ty=ty)
        for f in FOCALS
        for tx in SHIFTS_M
        for ty in SHIFTS_M[1:-1]
    ]
    best = max(starts, key=lambda warp: agreement(frames, warp))
    value = agreement(frames, best)
    for step in (1.0, 0.5, 0.25, 0.12):
        for _ in range(8):
            share, metres, pixels = 0.01 * step, 0.01 * step, 4.0 * step
            near = [
                *(replace(best, fx=best.fx * (1 + way * share), fy=best.fy * (1 + way * share)) for way in (-1, 1)),
                *(replace(best, tx=best.tx + way * metres) for way in (-1, 1)),
                *(replace(best, ty=best.ty + way * metres) for way in (-1, 1)),
                *(replace(best, cx=best.cx + way * pixels, tx=best.tx - way * metres) for way in (-1, 1)),
                *(replace(best, cy=best.cy + way * pixels, ty=best.ty - way * metres) for way in (-1, 1)),
            ]
            scored = [(agreement(frames, warp), k) for k, warp in enumerate(near)]
            found, k = max(scored)
            if found <= value + 1e-4:
                break
            value, best = found, near[k]
    return best
