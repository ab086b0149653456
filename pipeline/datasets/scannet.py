"""ScanNet as its SensReader exports it: `color/`, `depth/`, `pose/` and `intrinsic/`, one number a frame."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import Recording, differ_in_size, files_of, read_pose
from pipeline.datasets.files import paired_files, read_matrix
from pipeline.datasets.images import read_color, read_depth
from pipeline.datasets.settings import Settings, unit_notes
from pipeline.geometry.frame import Frame
from pipeline.system.errors import require

UNITS_PER_METRE = 1000.0
SAME_SHAPE = 0.02
"""Colour and depth are of one camera where their aspect ratios differ by less than this share.
ScanNet's own, 1296x968 and 640x480, differ by 0.4 %."""


class ScanNetDataset(Recording):
    """Frames of id N, the name of the colour file; depth in millimetres, poses camera-to-world.

    The frame has the size and the intrinsics of the depth image; a colour image
    of another size is resized to it, which is noted in the dataset's first
    frame. ScanNet's world is level only where a scan was axis-aligned
    afterwards, so that no up vector is declared.
    """

    format = "scannet"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._pairs = paired_files(root, ("color",), (".png",))
        self.frame_ids = tuple(self._pairs)
        self.notes = unit_notes(settings, UNITS_PER_METRE, "ScanNet's")

    def load(self, frame_id: str) -> Frame:
        """Decode one frame; see `Dataset.load`."""
        pair = self._found(self._pairs, frame_id)
        color, depth = files_of(
            pair, self.root, self.root / "color" / f"{frame_id}.jpg", self.root / "depth" / f"{frame_id}.png"
        )
        rgb = read_color(color)
        metres = read_depth(depth, self._settings.depth_scale or UNITS_PER_METRE)
        notes: list[str] = []
        height, width = metres.shape
        whole = rgb.shape[:2]
        if whole != metres.shape:
            if abs(whole[1] * height / (whole[0] * width) - 1) > SAME_SHAPE:
                raise differ_in_size(rgb, metres, color, depth)
            # OpenCV's average over areas becomes nearest-neighbour where the image grows.
            how = cv2.INTER_AREA if whole[0] > height else cv2.INTER_LINEAR
            rgb = cv2.resize(rgb, (width, height), interpolation=how)
            if frame_id == self.frame_ids[0]:
                notes.append(f"colour of {whole[1]}x{whole[0]} is resized to the depth's {width}x{height} everywhere")
        K, source = self._camera_matrix(whole == metres.shape)
        poses = self.root / "pose"
        pose = read_pose(poses / f"{frame_id}.txt", notes) if poses.is_dir() else None
        return self._frame(frame_id, (rgb, metres), K, pose, source, depth, notes=notes)

    def _camera_matrix(self, same_size: bool) -> tuple[np.ndarray | None, Path]:
        """The depth camera's intrinsics; the colour camera's where there is no other file and one size."""
        path = self.root / "intrinsic" / "intrinsic_depth.txt"
        if self._settings.intrinsics is not None:
            return None, path
        if not path.is_file() and same_size:
            path = self.root / "intrinsic" / "intrinsic_color.txt"
        M = read_matrix(path, 4, 4)
        require(
            np.array_equal(M[3], (0, 0, 0, 1)) and not M[:3, 3].any(),
            "the intrinsics must be a 3x3 matrix in a 4x4 one whose other entries are those of the identity",
            got=f"last row {M[3].tolist()}, last column {M[:, 3].tolist()}",
            path=path,
        )
        return M[:3, :3], path


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
