"""Registration of a depth camera to a colour camera: the warp between the two, and depth warped."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.geometry.camera import Camera, intrinsics
from pipeline.system.errors import require


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
        require(self.fx > 0 and self.fy > 0, "focal lengths must be positive", got=f"fx={self.fx:g}, fy={self.fy:g}")

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
