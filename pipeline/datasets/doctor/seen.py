"""Examined frames as read and re-read with fixes, and landing of one posed view's depth on that of another.

A point of view A, lifted and moved into view B, lands where B measured the same depth, in front of it (B sees
through it: a contradiction), or behind it (B's surface hides it, or the pose is wrong). Only the share that lands
says anything.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cache, cached_property, partial
from typing import Any

import cv2
import numpy as np

from pipeline.datasets.base import Dataset, load_pose, scene_of
from pipeline.datasets.cameras import or_note
from pipeline.datasets.meant import as_meant
from pipeline.datasets.settings import MEANT, Settings
from pipeline.geometry.camera import STANDARD, Camera, intrinsics, standard_poses
from pipeline.geometry.frame import Frame
from pipeline.geometry.registration import Outlines, Registration, registered
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

BLOCKS = 3
"""Landings are counted in so many by so many blocks of each view, which are compared one by one."""
ALIKE, TEXTURED = 8.0, 6.0
"""A difference of brightness at which a point counts half, and the contrast from which on its brightness counts."""


@dataclass(frozen=True)
class Views:
    """Posed depth maps of one size, with lifted points and compared pairs."""

    depth: np.ndarray  # (F, H, W) float32, metres as read, 0 where missing
    K: np.ndarray  # (F, 3, 3) float64
    poses: np.ndarray  # (F, 4, 4) float64, T_world_camera as read
    pairs: np.ndarray  # (P, 2) int64, from view, to view
    u: np.ndarray  # (F, N) float32, columns of a grid of pixels of each view
    v: np.ndarray  # (F, N) float32, rows
    z: np.ndarray  # (F, N) float32, depth there, metres as read, 0 where missing
    # (F, H, W) float32 or None, brightness against its surroundings, of colour that a point must also land on
    detail: np.ndarray | None = None

    @classmethod
    def of(
        cls, depths: Sequence[np.ndarray], cameras: Sequence[Camera], pairs: np.ndarray, points: tuple[int, int]
    ) -> Views:
        """Build views of depth maps, (H, W) float32 each, and their cameras, with (rows, columns) points of each."""
        depth = np.stack(depths)
        height, width = depth.shape[1:]
        rows, columns = (
            ((np.arange(n) + 0.5) * size / n).astype(int) for n, size in zip(points, (height, width), strict=True)
        )
        v, u = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
        poses = np.stack([np.eye(4) if c.T_world_camera is None else c.T_world_camera for c in cameras])
        return cls(depth, np.stack([c.K for c in cameras]), poses, pairs, u, v, depth[:, v, u])

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.depth.shape[1], self.depth.shape[2]

    @cached_property
    def _lifted(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depths of the points, (P, N), blocks, (N, B), and points with a depth by block, (P, B) float64."""
        height, width = self.size
        block = (self.v * BLOCKS // height) * BLOCKS + self.u * BLOCKS // width
        one_hot = np.eye(BLOCKS * BLOCKS, dtype=np.float32)[block]
        per_view = (self.z > 0).astype(np.float32) @ one_hot
        first = self.pairs[:, 0]
        return self.z[first], one_hot, per_view[first]

    @cached_property
    def _own_detail(self) -> tuple[np.ndarray, np.ndarray]:
        """Detail at the points, (P, N), and its weight, 0 to 1."""
        assert self.detail is not None
        own = self.detail[:, self.v, self.u]
        first = self.pairs[:, 0]
        return own[first], (np.abs(own) / (np.abs(own) + TEXTURED))[first]

    def of_pairs(self, pairs: np.ndarray) -> Views:
        """Copy with other pairs."""
        return replace(self, pairs=pairs)


def detail_of(rgb: np.ndarray) -> np.ndarray:
    """Brightness of colour, (H, W, 3) uint8, against the surroundings, (H, W) float32: alike under another exposure."""
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 2.0)
    return grey - cv2.GaussianBlur(grey, (0, 0), 12.0)


@dataclass(frozen=True)
class Landing:
    """Outcome of the lifted points, by pair and block of its first view."""

    landed: np.ndarray  # (P, B) float64, sum over points of how nearly each landed on a surface, 0..1
    met: np.ndarray  # (P, B) float64, points that fell on a measured depth
    lifted: np.ndarray  # (P, B) float64, points that had a depth


def land(
    views: Views, K: np.ndarray, poses: np.ndarray, scale: float, tolerance: float, colour: bool = False
) -> Landing:
    """Lift, move and compare points with cameras K, (F, 3, 3), and poses T_world_camera, (F, 4, 4).

    `scale` is true depth by depth as read; `tolerance` the relative depth at which a point counts half. With `colour`
    a point with detail must also land on the same, where the views have it.
    """
    a, b = views.pairs[:, 0], views.pairs[:, 1]
    R_b = poses[b, :3, :3].transpose(0, 2, 1)
    R = (R_b @ poses[a, :3, :3]).astype(np.float32)
    # Depths stay as read, so that the scale acts on the way between the views alone.
    t = (np.einsum("pij,pj->pi", R_b, poses[a, :3, 3] - poses[b, :3, 3]) / scale).astype(np.float32)
    K = K.astype(np.float32)
    z, one_hot, lifted = views._lifted
    x = (views.u[None] - K[a, 0, 2, None]) / K[a, 0, 0, None] * z
    y = (views.v[None] - K[a, 1, 2, None]) / K[a, 1, 1, None] * z
    moved = [R[:, k, 0, None] * x + R[:, k, 1, None] * y + R[:, k, 2, None] * z + t[:, k, None] for k in range(3)]
    front = moved[2] > 1e-6
    safe = np.where(front, moved[2], 1.0)
    u = K[b, 0, 0, None] * moved[0] / safe + K[b, 0, 2, None]
    v = K[b, 1, 1, None] * moved[1] / safe + K[b, 1, 2, None]
    height, width = views.size
    inside = front & (z > 0) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    column, row = (np.where(inside, np.rint(c), 0).astype(np.int32) for c in (u, v))
    other = views.depth[b[:, None], row, column]
    met = inside & (other > 0)
    off = (moved[2] - other) / np.where(met, tolerance * other, 1.0)
    near = np.where(met, 1 / (1 + off * off), 0.0)
    if colour and views.detail is not None:
        (own, textured), there = views._own_detail, views.detail[b[:, None], row, column]
        near *= 1 - textured + textured / (1 + ((own - there) / ALIKE) ** 2)
    return Landing(near.astype(np.float32) @ one_hot, met.astype(np.float32) @ one_hot, lifted)


SAME_UP = 1e-3


@dataclass(frozen=True, eq=False)
class Seen:
    """Frames of equal size, with the fixes so far."""

    dataset: Dataset
    frames: tuple[Frame, ...]  # As they are read with `mends`
    units: float | None  # Depth units in a metre as read, None where unknown
    settings: Settings = field(default_factory=Settings)  # What is declared already
    mends: Mapping[str, Any] = field(default_factory=dict)
    """What was mended, as `write_settings` takes it, but relative to what is declared: poses and their shift of those
    that were read, a registration of the frames as they were."""

    @cached_property
    def scenes(self) -> list[str]:
        """The scene of each frame."""
        return [scene_of(self.dataset, frame.id) for frame in self.frames]

    @cached_property
    def intrinsics(self) -> np.ndarray | None:
        """Common intrinsics (3, 3) of all frames; None where different, or of the warped colour camera."""
        first = self.frames[0].camera.K
        alike = all(np.allclose(frame.camera.K, first) for frame in self.frames)
        return first if alike and not self.settings.registration else None

    @cached_property
    def median_depth(self) -> float:
        """Median of the depths as read, metres."""
        return float(np.median(np.concatenate([frame.depth[frame.depth > 0][::16] for frame in self.frames])))

    @cached_property
    def outlines(self) -> Outlines:
        """Depth outlines of the frames."""
        return Outlines.of(self.frames)

    def mended(self, mend: Mapping[str, Any]) -> Seen:
        """Frames re-read with another fix; unreadable frames are left out."""
        scale = self.units / mend["depth_scale"] if self.units is not None and "depth_scale" in mend else 1.0
        shift = self.poses_at(mend["pose_shift"]) if "pose_shift" in mend else None
        meant = {key: value for key, value in mend.items() if key in (*MEANT, "depth_nothing")}
        found = []
        for k, frame in enumerate(self.frames):
            camera, T = frame.camera, frame.camera.T_world_camera
            if shift is not None:
                T = shift[k] if np.isfinite(shift[k]).all() else None
            pose = None if T is None else standard_poses(T, mend.get("poses", STANDARD))
            K = intrinsics(*mend["intrinsics"]) if "intrinsics" in mend else camera.K
            depth = frame.depth if scale == 1 else frame.depth * np.float32(scale)
            camera = self._upright(k, replace(camera, K=K, T_world_camera=pose))
            if "registration" in mend:
                depth, camera = registered(depth, camera, Registration(*mend["registration"]))
            try:
                changed = replace(frame, depth=depth, camera=_with_up(camera, mend.get("up")))
                found.append(as_meant(changed, meant, None if self.units is None else self.units / scale))
            except InputError:
                continue
        units = mend.get("depth_scale", self.units)
        return replace(self, frames=tuple(found) or self.frames, units=units, mends={**self.mends, **mend})

    def poses_at(self, shift: int) -> np.ndarray:
        """Poses (F, 4, 4) of frames so many places later in the scene, NaN where missing."""
        out = np.full((len(self.frames), 4, 4), np.nan)
        for k, frame in enumerate(self.frames):
            ids, index = self._order[self.scenes[k]]
            place = index[frame.id] + shift + self.mends.get("pose_shift", 0)
            pose = self._poses(ids[place]) if 0 <= place < len(ids) else None
            if pose is not None:
                out[k] = standard_poses(pose, self.mends.get("poses", STANDARD))
        return out

    @cached_property
    def _order(self) -> dict[str, tuple[list[str], dict[str, int]]]:
        """Frames by scene in order, with their places."""
        found: dict[str, list[str]] = {scene: [] for scene in self.scenes}
        for frame_id in self.dataset.frame_ids:
            if (scene := scene_of(self.dataset, frame_id)) in found:
                found[scene].append(frame_id)
        return {scene: (ids, {frame_id: k for k, frame_id in enumerate(ids)}) for scene, ids in found.items()}

    @cached_property
    def _poses(self) -> Callable[[str], np.ndarray | None]:
        """Pose of any frame of the dataset, read once."""
        return cache(partial(or_note, [], "", load_pose, self.dataset))

    @cached_property
    def world_up(self) -> dict[str, np.ndarray]:
        """World up (3,) by scene, where the frames' declared up comes from the world."""
        found: dict[str, list[np.ndarray]] = {}
        for frame, scene in zip(self.frames, self.scenes, strict=True):
            up, T = frame.camera.up, frame.camera.T_world_camera
            if up is not None and T is not None:
                found.setdefault(scene, []).append(T[:3, :3] @ up)
        return {scene: ups[0] for scene, ups in found.items() if np.ptp(ups, axis=0).max() < SAME_UP}

    def _upright(self, k: int, camera: Camera) -> Camera:
        """Camera with the world's declared up, by pose."""
        up, T = self.world_up.get(self.scenes[k]), camera.T_world_camera
        if up is None or camera.up is None:
            return camera
        if T is None:
            return replace(camera, up=None, up_source=None)
        return replace(camera, up=T[:3, :3].T @ up)


def _with_up(camera: Camera, declared: str | None) -> Camera:
    """Camera with a world up "world:X,Y,Z"."""
    T = camera.T_world_camera
    if declared is None or T is None:
        return camera
    world = np.array([float(n) for n in declared.partition(":")[2].split(",")])
    return camera.with_up(T[:3, :3].T @ world, "given")
