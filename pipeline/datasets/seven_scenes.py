"""Microsoft 7-Scenes: `frame-XXXXXX.{color,depth}.png` and `.pose.txt`, depth in millimetres."""

from __future__ import annotations

import re
from pathlib import Path

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.camera_files import Stated
from pipeline.datasets.cameras import one_file, read_pose
from pipeline.datasets.files import listing, read_matrix
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings, camera_notes

DEFAULT_INTRINSICS = (585.0, 585.0, 320.0, 240.0)
UNREGISTERED = (
    "colour and depth of 7-Scenes are of two cameras, and are read as of one: `spatialviz doctor DATASET --apply` "
    "estimates the warp between them"
)

_IMAGE = re.compile(r"(frame-[0-9]{1,12})\.(color|depth)\.(png|jpg|jpeg)")


class SevenScenesDataset(Recording):
    """Frames in the folder itself (id `frame-000000`) or in `seq-XX` (id `seq-01/frame-000000`).

    A `camera-intrinsics.txt` in the opened folder, or beside the frames, wins over the format's own 585, 585, 320, 240,
    which is for 640x480 only. 7-Scenes promises no world axis that points up and carries no annotations.
    """

    format = "7-scenes"
    rule = DepthRule(1000.0, "7-Scenes' own", nothing=65535)
    camera_file = "camera-intrinsics.txt or "

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._files: dict[str, dict[str, list[str]]] = {}
        for folder in ("", *_sequences(root)):
            for name in listing(root / folder)[1]:
                if match := _IMAGE.fullmatch(name):
                    frame_id = f"{folder}/{match[1]}" if folder else match[1]
                    kinds = self._files.setdefault(frame_id, {"color": [], "depth": []})
                    kinds[match[2]].append(name)
        self.frame_ids = tuple(self._files)
        folders = {frame_id.rpartition("/")[0] for frame_id in self.frame_ids}
        if any(_camera_file(root, root / folder) is None for folder in folders):
            self.notes += camera_notes(settings, DEFAULT_INTRINSICS, "7-Scenes' own")
        if settings.registration is None:
            self.notes += (UNREGISTERED,)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        files = self._found(self._files, frame_id)
        stem = self.root / frame_id
        color, depth = (
            one_file([stem.with_name(name) for name in files[kind]], told, stem.with_name(f"{stem.name}.{kind}.png"))
            for kind, told in (("color", "colour"), ("depth", "depth"))
        )
        pose_file = stem.with_name(f"{stem.name}.pose.txt")
        pose = read_pose(pose_file, notes) if pose_file.is_file() else None
        path = _camera_file(self.root, stem.parent)
        if path is None:
            return Listed(color, depth, pose=pose, documented=DEFAULT_INTRINSICS)
        K = None if self._settings.intrinsics is not None else read_matrix(path, 3, 3)
        return Listed(color, depth, Stated(K, path=path), pose)


def _camera_file(root: Path, folder: Path) -> Path | None:
    """Intrinsics file next to the frames of a folder, else in the root."""
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
