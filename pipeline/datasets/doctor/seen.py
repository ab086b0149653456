"""The frames of a recording that are looked at, as they are read and as they would be with a mend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.datasets.base import Dataset, load_pose, scene_of
from pipeline.datasets.cameras import or_note
from pipeline.datasets.settings import Settings
from pipeline.geometry.camera import Camera, intrinsics
from pipeline.geometry.frame import Frame
from pipeline.geometry.outlines import Outlines
from pipeline.geometry.pose_convention import STANDARD, standard_poses
from pipeline.geometry.registration import Registration, registered
from pipeline.system.errors import InputError

SAME_UP = 1e-3


@dataclass(frozen=True, eq=False)
class Seen:
    """Frames of one size, with what mends them so far.

    Attributes
    ----------
    dataset : Dataset
    frames : tuple of Frame
        As they are read with `mends`.
    units : float or None
        Depth units in a metre as read, None where unknown.
    settings : Settings
        What is declared already.
    mends : dict
        What was mended, as `write_settings` takes it, but relative to what is declared: poses and their shift of those
        that were read, a registration of the frames as they were.
    """

    dataset: Dataset
    frames: tuple[Frame, ...]
    units: float | None
    settings: Settings = field(default_factory=Settings)
    mends: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def scenes(self) -> list[str]:
        """The scene of each frame."""
        return [scene_of(self.dataset, frame.id) for frame in self.frames]

    @cached_property
    def intrinsics(self) -> np.ndarray | None:
        """(3, 3) those of all frames; None where they differ, or are of the colour that depth is warped to."""
        first = self.frames[0].camera.K
        alike = all(np.allclose(frame.camera.K, first) for frame in self.frames)
        return first if alike and not self.settings.registration else None

    @cached_property
    def outlines(self) -> Outlines:
        """Those of the depth of the frames."""
        return Outlines.of(self.frames)

    def mended(self, mend: Mapping[str, Any]) -> Seen:
        """The frames as they are read with one more mend; a frame that cannot be read with it is left out."""
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
        """(F, 4, 4) poses that stand so many places later in the scene of each frame, NaN where there is none."""
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
        """{scene: its frames in order, and the place of each}, of the scenes that are looked at."""
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
        """{scene: (3,) up of its world}, where that is what its frames' declared up comes of."""
        found: dict[str, list[np.ndarray]] = {}
        for frame, scene in zip(self.frames, self.scenes, strict=True):
            up, T = frame.camera.up, frame.camera.T_world_camera
            if up is not None and T is not None:
                found.setdefault(scene, []).append(T[:3, :3] @ up)
        return {scene: ups[0] for scene, ups in found.items() if np.ptp(ups, axis=0).max() < SAME_UP}

    def _upright(self, k: int, camera: Camera) -> Camera:
        """The camera with the up that its world declares, by its pose."""
        up, T = self.world_up.get(self.scenes[k]), camera.T_world_camera
        if up is None or camera.up is None:
            return camera
        if T is None:
            return replace(camera, up=None, up_source=None)
        return replace(camera, up=T[:3, :3].T @ up)


def _with_up(camera: Camera, told: str | None) -> Camera:
    """The camera with an up of the world that is told as "world:X,Y,Z"."""
    T = camera.T_world_camera
    if told is None or T is None:
        return camera
    world = np.array([float(n) for n in told.partition(":")[2].split(",")])
    return camera.with_up(T[:3, :3].T @ world, "given")
