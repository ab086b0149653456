"""Examined frames as read, and re-read with fixes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.datasets.base import Dataset, load_pose, scene_of
from pipeline.datasets.cameras import or_note
from pipeline.datasets.settings import Settings
from pipeline.geometry.camera import STANDARD, Camera, intrinsics, standard_poses
from pipeline.geometry.frame import Frame
from pipeline.geometry.outlines import Outlines
from pipeline.geometry.registration import Registration, registered
from pipeline.system.errors import InputError

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
    def outlines(self) -> Outlines:
        """Depth outlines of the frames."""
        return Outlines.of(self.frames)

    def mended(self, mend: Mapping[str, Any]) -> Seen:
        """Frames re-read with another fix; unreadable frames are left out."""
        scale = self.units / mend["depth_scale"] if self.units is not None and "depth_scale" in mend else 1.0
        shift = self.poses_at(mend["pose_shift"]) if "pose_shift" in mend else None
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
                found.append(replace(frame, depth=depth, camera=_with_up(camera, mend.get("up"))))
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
            pose = self._pose(ids[place]) if 0 <= place < len(ids) else None
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

    def _pose(self, frame_id: str) -> np.ndarray | None:
        if frame_id not in self._poses:
            self._poses[frame_id] = or_note([], "", load_pose, self.dataset, frame_id)
        return self._poses[frame_id]

    _poses: dict[str, np.ndarray | None] = field(default_factory=dict, repr=False)

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


def _with_up(camera: Camera, told: str | None) -> Camera:
    """Camera with a world up "world:X,Y,Z"."""
    T = camera.T_world_camera
    if told is None or T is None:
        return camera
    world = np.array([float(n) for n in told.partition(":")[2].split(",")])
    return camera.with_up(T[:3, :3].T @ world, "given")
