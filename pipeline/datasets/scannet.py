"""ScanNet as exported by SensReader: `color/`, `depth/`, `pose/` and `intrinsic/`, a number per frame."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.camera_files import Stated
from pipeline.datasets.cameras import read_pose
from pipeline.datasets.files import read_matrix
from pipeline.datasets.images import picture_size
from pipeline.datasets.pairing import paired_files
from pipeline.datasets.recording import DepthRule, Listed, Recording, files_of
from pipeline.datasets.settings import Settings
from pipeline.system.errors import require


class ScanNetDataset(Recording):
    """Frames of id N, the name of the colour file; depth in millimetres, poses camera-to-world.

    The frame has the size and the intrinsics of the depth image; a colour image of another size is resized to it, which
    is noted in the dataset's first frame. ScanNet's world is level only where a scan was axis-aligned afterwards, so
    that no up vector is declared.
    """

    format = "scannet"

    rule = DepthRule(1000.0, "ScanNet's")

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._pairs = paired_files(root, ("color",), (".png",))
        self.frame_ids = tuple(self._pairs)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        pair = self._found(self._pairs, frame_id)
        color, depth = files_of(
            pair, self.root, self.root / "color" / f"{frame_id}.jpg", self.root / "depth" / f"{frame_id}.png"
        )
        poses = self.root / "pose"
        pose = read_pose(poses / f"{frame_id}.txt", notes) if poses.is_dir() else None
        return Listed(color, depth, self._camera(color, depth), pose)

    def _camera(self, color: Path, depth: Path) -> Stated:
        """Depth intrinsics, else the colour camera's for equal sizes."""
        path = self.root / "intrinsic" / "intrinsic_depth.txt"
        if self._settings.intrinsics is not None:
            return Stated(path=path)
        if not path.is_file() and picture_size(color) == picture_size(depth):
            path = self.root / "intrinsic" / "intrinsic_color.txt"
        M = read_matrix(path, 4, 4)
        require(
            np.array_equal(M[3], (0, 0, 0, 1)) and not M[:3, 3].any(),
            "the intrinsics must be a 3x3 matrix in a 4x4 one whose other entries are those of the identity",
            got=f"last row {M[3].tolist()}, last column {M[:, 3].tolist()}",
            path=path,
        )
        return Stated(M[:3, :3], path=path)


def _recognises(root: Path) -> bool:
    files = ("intrinsic_depth.txt", "intrinsic_color.txt")
    return (
        os.path.isdir(root / "color")
        and os.path.isdir(root / "depth")
        and any(os.path.isfile(root / "intrinsic" / name) for name in files)
    )


FORMAT = DatasetFormat(
    "scannet",
    "scannet: color/, depth/ and intrinsic/intrinsic_depth.txt",
    _recognises,
    ScanNetDataset,
)
