"""Poses from files, checked, and a dataset with its poses shifted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pipeline.datasets.base import ChangedFrames, Dataset, load_picture, load_pose, scene_of
from pipeline.geometry.camera import rotations
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError, require

Value = TypeVar("Value")
ROUNDING = 1e-2
"""How far from a rotation a printed rotation matrix may be through rounding alone."""


def nearest_rotation(R: np.ndarray) -> np.ndarray:
    """Nearest rotation to a rounded matrix, by SVD (orthogonal Procrustes). `R` (3, 3) float."""
    R = np.asarray(R, dtype=np.float64)
    require(np.isfinite(R).all(), "a rotation with inf or NaN")
    deviation = float(np.abs(R @ R.T - np.eye(3)).max())
    require(
        deviation < ROUNDING and np.linalg.det(R) >= 0,
        "not a rotation",
        got=lambda: f"det {np.linalg.det(R):.3g}, {deviation:.2g} from orthonormal",
        cause="is the matrix scaled or left-handed?",
    )
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt


def rigid(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The (4, 4) float64 transform of a (rounded) rotation (3, 3) and a translation (3,), metres."""
    t = np.asarray(t, dtype=np.float64)
    require(np.isfinite(t).all(), "a position with inf or NaN")
    T = np.eye(4)
    T[:3, :3] = nearest_rotation(R)
    T[:3, 3] = t
    return T


def inverse(T: np.ndarray) -> np.ndarray:
    """The inverse of a rigid (4, 4) transform."""
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def pose_from_matrix(T: np.ndarray) -> np.ndarray:
    """A checked (4, 4) T_world_camera from a 4x4 matrix as printed in a file."""
    require(np.isfinite(T).all(), "inf or NaN, the tracker was lost")
    require(np.abs(T[3] - (0, 0, 0, 1)).max() <= 1e-6, "the last row is not 0 0 0 1", got=T[3].tolist())
    return rigid(T[:3, :3], T[:3, 3])


def pose_from_quaternion(values: np.ndarray) -> np.ndarray:
    """T_world_camera (4, 4) from tx ty tz qx qy qz qw (7,), metres. The quaternion may be rounded."""
    require(np.isfinite(values).all(), "inf or NaN, the tracker was lost")
    length = float(np.linalg.norm(values[3:]))
    require(abs(length - 1) <= ROUNDING, "the quaternion does not have length 1", got=f"{length:.3g}")
    return rigid(rotations(values[3:] / length), values[:3])


def nearest(times: np.ndarray, time: float, within: float) -> int | None:
    """Index of the nearest of many times, seconds; None where none is near enough."""
    found = int(np.abs(times - time).argmin()) if len(times) else -1
    return found if found >= 0 and abs(float(times[found]) - time) <= within else None


def one_file(candidates: list[Path], what: str, where: Path) -> Path:
    """Single file among several candidates."""
    require(candidates, f"the {what} file is missing", path=where)
    require(
        len(candidates) <= 1, f"more than one {what} file", got=", ".join(path.name for path in candidates), path=where
    )
    return candidates[0]


def or_note(notes: list[str], what: str, read: Callable[..., Value], *given: Any) -> Value | None:
    """Call `read` on the arguments; where unusable, None and a note beginning with `what`."""
    try:
        return read(*given)
    except InputError as error:
        notes.append(f"{what}{error.what}")
        return None


class ShiftedPoses(ChangedFrames):
    """A dataset with the poses of frames `shift` places later in the scene; see `Settings.pose_shift`."""

    def __init__(self, inner: Dataset, shift: int) -> None:
        super().__init__(inner)
        self.shift = shift
        scenes: dict[str, list[str]] = {}
        for frame_id in inner.frame_ids:
            scenes.setdefault(scene_of(inner, frame_id), []).append(frame_id)
        self._others = {
            frame_id: ids[k + shift] if 0 <= k + shift < len(ids) else None
            for ids in scenes.values()
            for k, frame_id in enumerate(ids)
        }

    def load_pose(self, frame_id: str) -> np.ndarray | None:
        """See `base.load_pose`."""
        other = self._others[frame_id]
        return None if other is None else load_pose(self.inner, other)

    def changed(self, frame: Frame) -> Frame:
        """Frame with the pose of the shifted frame, and the declared up of this pose."""
        own, other = frame.camera, self._others[frame.id]
        notes, pose, up, source = frame.notes, None, None, None
        if other is None:
            notes = (*notes, f"no camera pose: there is no frame {self.shift:+d} places on, where it would be")
        else:
            that = load_picture(self.inner, other).camera
            pose, up, source = that.T_world_camera, that.up, that.up_source
        if "declared" not in (own.up_source, source):
            up, source = own.up, own.up_source
        return replace(frame, camera=replace(own, T_world_camera=pose, up=up, up_source=source), notes=notes)
