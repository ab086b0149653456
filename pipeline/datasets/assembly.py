"""Putting decoded parts together into a Frame, with the file to blame in every error."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.datasets.cameras import pose_from_matrix
from pipeline.datasets.files import read_matrix
from pipeline.datasets.images import read_color, read_depth
from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Annotation, Frame
from pipeline.system.errors import InputError


def read_pair(
    color: Path, depth: Path, units_per_metre: float | None, nothing: int | None = None, rotated: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """A colour file and its depth file, (H, W, 3) uint8 and (H, W) float32 metres; see `read_depth`.

    Raises
    ------
    InputError
        Either is broken, or their sizes differ.
    """
    rgb = read_color(color)
    metres = read_depth(depth, units_per_metre, nothing, rotated)
    if rgb.shape[:2] != metres.shape:
        raise differ_in_size(rgb, metres, color, depth)
    return rgb, metres


def differ_in_size(rgb: np.ndarray, metres: np.ndarray, color: Path, depth: Path) -> InputError:
    """The error for a colour image and a depth image that do not belong together."""
    return InputError(
        "colour and depth differ in size",
        got=f"depth {metres.shape[1]}x{metres.shape[0]}",
        expected=f"{rgb.shape[1]}x{rgb.shape[0]} as {color.name}",
        cause="is this the raw depth and not the one registered to the colour image?",
        path=depth,
    )


def make_frame(
    frame_id: str,
    pair: tuple[np.ndarray, np.ndarray],
    camera: Camera,
    depth_path: Path,
    annotations: tuple[Annotation, ...] = (),
    notes: tuple[str, ...] = (),
) -> Frame:
    """A Frame; what it finds wrong is the depth, and is blamed on `depth_path`."""
    try:
        return Frame(frame_id, pair[0], pair[1], camera, annotations, notes)
    except InputError as error:
        raise InputError(str(error), path=depth_path) from error


def one_file(candidates: list[Path], what: str, where: Path) -> Path:
    """The only file of several possible ones.

    Raises
    ------
    InputError
        None is there, or more than one.
    """
    if not candidates:
        raise InputError(f"the {what} file is missing", path=where)
    if len(candidates) > 1:
        raise InputError(
            f"more than one {what} file", got=", ".join(path.name for path in candidates), path=where
        )
    return candidates[0]


def read_pose(path: Path, notes: list[str]) -> np.ndarray | None:
    """T_world_camera (4, 4) from a file of 4x4 numbers; an unusable one gives None and a note."""
    try:
        return pose_from_matrix(read_matrix(path, 4, 4))
    except InputError as error:
        notes.append(f"no camera pose, {path.name}: {error.what}")
        return None
