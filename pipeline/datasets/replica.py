"""Replica as iMAP and NICE-SLAM publish it, https://github.com/cvg/nice-slam."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import NOTHING, Stated, read_stated
from pipeline.datasets.files import readable
from pipeline.datasets.folder import FolderDataset, SceneFolder
from pipeline.datasets.images import picture_size
from pipeline.datasets.pairing import Files, Naming, Pair, numbers
from pipeline.datasets.recording import DepthRule
from pipeline.datasets.settings import Settings, camera_notes
from pipeline.geometry.camera import intrinsics
from pipeline.system.errors import needed

RESULTS, TRAJECTORY, CAMERA = "results", "traj.txt", "cam_params.json"
_IMAGE = re.compile(r"(frame|depth)[0-9]{1,9}\.(jpg|jpeg|png)", re.IGNORECASE)
OWN_CAMERA, OWN_SIZE = (600.0, 600.0, 599.5, 339.5), (1200, 680)
"""Of `configs/Replica/replica.yaml`, for pictures of this size (width, height)."""


class ReplicaDataset(FolderDataset):
    """Frames of a room: `results/frameN.jpg` with `results/depthN.png`, and `traj.txt`, a 4x4 camera-to-world a line.

    `cam_params.json`, which states the camera and the depth's unit, stands in the room's folder or one above; without
    it both are those of the makers' configuration. The room's folder or `results/` itself is opened.
    """

    format = "replica"
    rule = DepthRule(6553.5, "Replica's")

    def __init__(self, root: Path, settings: Settings) -> None:
        self._results = needed(_results(root), "no results/ of Replica", path=root)
        self._path = next((path for path in _above(self._results, CAMERA)), None)
        self._stated = NOTHING if self._path is None else read_stated(self._path)
        super().__init__(root, settings)
        if self._stated.units_per_metre is not None:
            self.notes = tuple(note for note in self.notes if not note.startswith("the depth's unit"))
        if self._stated.K is None:
            self.notes += camera_notes(settings, OWN_CAMERA, "Replica's own")

    def _naming(self) -> Naming:
        return numbers

    def _folders(self, root: Path) -> dict[str, Path]:
        return {"": self._results}

    def _files(self, folder: Path) -> Files:
        names = [name for name in readable(folder)[1] if _IMAGE.fullmatch(name)]
        of = {role: [n for n in names if n.lower().startswith(start)] for role, start in _STARTS.items()}
        paths = [str(path.absolute()) for path in _above(folder, TRAJECTORY)]
        return Files(folder, True, {**of, "path": paths[:1]})

    def _camera(self, scene: SceneFolder, pair: Pair) -> Stated:
        if self._stated.K is not None or pair.color is None or picture_size(pair.color) != OWN_SIZE:
            return self._stated
        return Stated(intrinsics(*OWN_CAMERA), OWN_SIZE, self._stated.units_per_metre, self._path)

    @property
    def _known(self) -> bool:
        """See `FolderDataset._known`: the camera file states the unit too."""
        return False

    def _up(self, pose: np.ndarray | None) -> np.ndarray | None:
        """The z axis of Replica's world is up."""
        return None if pose is None else pose[2, :3]


_STARTS = {"color": "frame", "depth": "depth"}


def _results(root: Path) -> Path | None:
    for folder in (root / RESULTS, root):
        kinds = {match[1].lower() for name in readable(folder)[1] if (match := _IMAGE.fullmatch(name))}
        if kinds == {"frame", "depth"} and any(_above(folder, TRAJECTORY)):
            return folder
    return None


def _above(results: Path, name: str) -> list[Path]:
    """Files of this name in a room's folder, in `results/`, or one folder above the room, the nearest first."""
    room = results.resolve().parent if results.name in ("", ".") else results.parent
    return [path for folder in (results, room, room.resolve().parent) if (path := folder / name).is_file()]


REPLICA = DatasetFormat(
    "replica",
    f"replica: {RESULTS}/frame000000.jpg with {RESULTS}/depth000000.png and {TRAJECTORY}",
    lambda root: _results(root) is not None,
    ReplicaDataset,
)
