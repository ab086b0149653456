"""Microsoft 7-Scenes: `frame-XXXXXX.{color,depth}.png` and `.pose.txt`, depth in millimetres."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import (
    Recording,
    known_intrinsics,
    one_file,
    read_pair,
    read_pose,
)
from pipeline.datasets.files import listing, read_matrix
from pipeline.datasets.settings import Settings, camera_notes, unit_notes
from pipeline.geometry.frame import Frame

UNITS_PER_METRE = 1000.0
NOTHING = 65535
DEFAULT_INTRINSICS = (585.0, 585.0, 320.0, 240.0)
UNREGISTERED = (
    "colour and depth of 7-Scenes are of two cameras, and are read as of one: `spatialviz doctor DATASET --apply` "
    "estimates the warp between them"
)

_IMAGE = re.compile(r"(frame-[0-9]{1,12})\.(color|depth)\.(png|jpg|jpeg)")


class SevenScenesDataset(Recording):
    """Frames in the folder itself (id `frame-000000`) or in `seq-XX` (id `seq-01/frame-000000`).

    A `camera-intrinsics.txt` in the opened folder, or beside the frames, wins
    over the format's own 585, 585, 320, 240, which is for 640x480 only. 7-Scenes
    promises no world axis that points up and carries no annotations.
    """

    format = "7-scenes"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._files: dict[str, dict[str, list[Path]]] = {}
        for folder in ("", *_sequences(root)):
            for name in listing(root / folder)[1]:
                if match := _IMAGE.fullmatch(name):
                    frame_id = f"{folder}/{match[1]}" if folder else match[1]
                    kinds = self._files.setdefault(frame_id, {"color": [], "depth": []})
                    kinds[match[2]].append(root / folder / name)
        self.frame_ids = tuple(self._files)
        self.notes = unit_notes(settings, UNITS_PER_METRE, "7-Scenes' own")
        if any(_camera_file(root, (root / frame_id).parent) is None for frame_id in self.frame_ids):
            self.notes += camera_notes(settings, DEFAULT_INTRINSICS, "7-Scenes' own")
        if settings.registration is None:
            self.notes += (UNREGISTERED,)

    def load(self, frame_id: str) -> Frame:
        """Decode one frame; see `Dataset.load`."""
        files = self._found(self._files, frame_id)
        stem = self.root / frame_id
        color = one_file(files["color"], "colour", stem.with_name(f"{stem.name}.color.png"))
        depth = one_file(files["depth"], "depth", stem.with_name(f"{stem.name}.depth.png"))
        pair = read_pair(color, depth, self._settings.depth_scale or UNITS_PER_METRE, NOTHING)
        notes: list[str] = []
        pose_file = stem.with_name(f"{stem.name}.pose.txt")
        pose = read_pose(pose_file, notes) if pose_file.is_file() else None
        K, source = self._camera_matrix(stem.parent, pair[1].shape, color)
        return self._frame(frame_id, pair, K, pose, source, depth, notes=notes)

    def _camera_matrix(self, folder: Path, size: Sequence[int], color: Path) -> tuple[np.ndarray | None, Path]:
        if self._settings.intrinsics is not None:
            return None, color
        path = _camera_file(self.root, folder)
        if path is not None:
            return read_matrix(path, 3, 3), path
        return known_intrinsics(DEFAULT_INTRINSICS, "7-Scenes'", size, "camera-intrinsics.txt or ", color), color


def _camera_file(root: Path, folder: Path) -> Path | None:
    """The intrinsics beside the frames of a folder, or else in the opened one."""
    files = (parent / "camera-intrinsics.txt" for parent in (folder, root))
    return next((path for path in files if path.is_file()), None)


def _sequences(root: Path) -> list[str]:
    return [name for name in listing(root)[0] if re.fullmatch(r"seq-?[0-9]+", name)]


def _recognises(root: Path) -> bool:
    folders = [root, *(root / name for name in _sequences(root))]
    return any(_IMAGE.fullmatch(name) for folder in folders for name in listing(folder)[1])


FORMAT = DatasetFormat(
    "7-scenes",
    "7-scenes: frame-XXXXXX.color.png (or .jpg) with .depth.png, here or in seq-XX/",
    _recognises,
    SevenScenesDataset,
)
