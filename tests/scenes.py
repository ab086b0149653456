"""Scenes of known geometry, seen by casting rays at planes and boxes: exact depth, exact masks, nothing rendered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.geometry import Annotation, Box3D, Camera, Frame, ViewerAxes, intrinsics, viewer_axes


@dataclass(frozen=True)
class Plane:
    """All x with normal . x = offset, in the level frame (right, down, forward), metres."""

    normal: tuple[float, float, float]
    offset: float


@dataclass(frozen=True)
class Seen:
    """What the rays met.

    Attributes
    ----------
    depth : (H, W) float32
        Metres along z, 0 where nothing was met.
    ids : (H, W) int64
        The number of the box, after them that of the plane; -1 for nothing.
    boxes : tuple of Box3D
        The boxes in the camera frame.
    """

    depth: np.ndarray
    ids: np.ndarray
    boxes: tuple[Box3D, ...]


def camera_of(width: int = 320, height: int = 240, focal: float = 280.0) -> Camera:
    return Camera(intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2), width, height)


def up_of(pitch: float, roll: float = 0.0) -> np.ndarray:
    """The up vector of a camera that looks `pitch` degrees down and is rolled, in the camera frame."""
    p, r = np.deg2rad(pitch), np.deg2rad(roll)
    level = np.array([0.0, -np.cos(p), -np.sin(p)])
    turn = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1.0]])
    return turn @ level


def upright(center: ArrayLike, size: ArrayLike, yaw: float = 0.0) -> Box3D:
    """A box on its base in the level frame (right, down, forward), turned by `yaw` degrees."""
    a = np.deg2rad(yaw)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return Box3D(np.array(center, float), R, np.array(size, float))


def rigid_into_camera(viewer: ViewerAxes) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = viewer.R_level_camera.T
    return T


def cast(camera: Camera, boxes: Sequence[Box3D], planes: Sequence[Plane], viewer: ViewerAxes) -> Seen:
    """Cast a ray through each pixel's centre; boxes and planes are given in the level frame."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u, float)])
    depth = np.full((camera.height, camera.width), np.inf)
    ids = np.full(depth.shape, -1)
    T = rigid_into_camera(viewer)
    seen = tuple(b.transformed(T) for b in boxes)
    with np.errstate(divide="ignore", invalid="ignore"):
        for number, box in enumerate(seen):
            window = _window(box, camera)
            enter, leave = np.full_like(depth[window], -np.inf), np.full_like(depth[window], np.inf)
            for axis, half in zip(box.R.T, box.size / 2, strict=True):
                origin, direction = -box.center @ axis, np.tensordot(axis, rays[(slice(None), *window)], 1)
                low, high = (-half - origin) / direction, (half - origin) / direction
                enter, leave = np.fmax(enter, np.minimum(low, high)), np.fmin(leave, np.maximum(low, high))
            hit = (enter <= leave) & (enter > 0) & (enter < depth[window])
            depth[window][hit], ids[window][hit] = enter[hit], number
        for number, plane in enumerate(planes, start=len(boxes)):
            z = plane.offset / np.tensordot(viewer.R_level_camera.T @ np.array(plane.normal), rays, 1)
            hit = (z > 0) & (z < depth)
            depth[hit], ids[hit] = z[hit], number
    return Seen(np.where(np.isfinite(depth), depth, 0).astype(np.float32), ids, seen)


def _window(box: Box3D, camera: Camera) -> tuple[slice, slice]:
    """Rows and columns outside of which no ray meets the box."""
    x, y, z = box.corners.T
    if z.min() <= 0:
        return slice(None), slice(None)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    rows, columns = (slice(max(int(a.min()) - 1, 0), max(int(a.max()) + 2, 0)) for a in (v, u))
    return rows, columns


def frame_of(
    boxes: Sequence[Box3D],
    labels: Sequence[str],
    *,
    pitch: float = 20.0,
    roll: float = 0.0,
    floor: float | None = 1.2,
    camera: Camera | None = None,
    name: str = "scene/0",
) -> Frame:
    """A frame whose annotations are the visible pixels of the boxes, with the up vector declared."""
    viewer = viewer_axes(up_of(pitch, roll))
    camera = (camera or camera_of()).with_up(viewer.up, "declared")
    seen = cast(camera, boxes, [] if floor is None else [Plane((0, 1, 0), floor)], viewer)
    found = []
    for k, (label, box) in enumerate(zip(labels, seen.boxes, strict=True)):
        mask = seen.ids == k
        v, u = np.nonzero(mask)
        assert len(v), f"{label} cannot be seen"
        bbox = np.array([u.min(), v.min(), u.max() + 1, v.max() + 1], np.float32)
        found.append(Annotation(k, label, bbox, mask, box))
    rgb = np.random.default_rng(len(boxes)).integers(0, 256, (*seen.depth.shape, 3)).astype(np.uint8)
    return Frame(name, rgb, seen.depth, camera, tuple(found))


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else Q[:, [1, 0, 2]]


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


def solid(box: Box3D) -> np.ndarray:
    """The corners in an order that does not depend on how the axes are named."""
    corners = np.round(box.corners, 7) + 0.0
    return corners[np.lexsort(corners.T)]


def filled_cloud(box: Box3D, rng: np.random.Generator, n: int = 20_000) -> np.ndarray:
    """(n, 3) points evenly inside a box."""
    return box.center + (rng.uniform(-0.5, 0.5, (n, 3)) * box.size) @ box.R.T
