"""Scenes of the MIT-Princeton Amazon Picking Challenge: frames named like 7-Scenes' with a single `cam.info.txt`.

https://github.com/andyzeng/apc-vision-toolbox
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.camera_files import Stated
from pipeline.datasets.cameras import or_note, pose_from_matrix
from pipeline.datasets.files import read_bytes
from pipeline.datasets.folder import FolderDataset, SceneFolder
from pipeline.datasets.pairing import Pair
from pipeline.datasets.recording import DepthRule
from pipeline.datasets.settings import Settings

INFO = "cam.info.txt"
COLOR_CAMERA = "color camera intrinsic matrix"


class ApcDataset(FolderDataset):
    """Frames of id `frame-000000`; depth registered to colour, tenths of a millimetre, bits rotated by three.

    `cam.info.txt` holds matrices under their titles: the colour camera's, and camera-to-world for each frame. The
    robot's world has z up.
    """

    format = "apc"
    rule = DepthRule(10000.0, "the Picking Challenge's", rotated=3)

    def __init__(self, root: Path, settings: Settings) -> None:
        self._info = read_titled(root / INFO)
        super().__init__(root, settings)

    def _camera(self, scene: SceneFolder, pair: Pair) -> Stated:
        K = self._info.get(COLOR_CAMERA)
        return Stated(None if K is None or K.shape != (3, 3) else K, path=self.root / INFO)

    def _pose(self, scene: SceneFolder, pair: Pair, notes: list[str]) -> np.ndarray | None:
        name = pair.stem.partition(".")[0]
        found = next((M for title, M in self._info.items() if title.endswith(name) and "world" in title), None)
        if found is None or found.shape != (4, 4):
            return None
        return or_note(notes, "no camera pose: ", pose_from_matrix, found)

    def _up(self, pose: np.ndarray | None) -> np.ndarray | None:
        return None if pose is None else pose[2, :3]


def read_titled(path: Path) -> dict[str, np.ndarray]:
    """Matrices under lines "# title", by title in small letters; other text is left out."""
    found: dict[str, np.ndarray] = {}
    for block in re.split(r"^#", read_bytes(path).decode(errors="replace"), flags=re.MULTILINE)[1:]:
        title, _, text = block.partition("\n")
        rows = [line.split() for line in text.splitlines() if line.strip()]
        try:
            matrix = np.array(rows, dtype=np.float64)
        except ValueError:
            continue
        if matrix.size:
            found[title.strip().lower()] = matrix
    return found


FORMAT = DatasetFormat(
    "apc", f"apc: frame-000000.color.png with .depth.png and {INFO}", lambda root: (root / INFO).is_file(), ApcDataset
)
