"""Recordings of phones with a depth sensor: ARKitScenes, and `.r3d` captures of Record3D.

https://github.com/apple/ARKitScenes/blob/main/DATA.md, https://record3d.app
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import cv2
import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.camera_files import Stated, flat_numbers, stated_in
from pipeline.datasets.cameras import inverse, or_note, pose_from_quaternion, rigid
from pipeline.datasets.files import as_floats, natural, numbered_lines, readable
from pipeline.datasets.folder import FolderDataset, Scene
from pipeline.datasets.pairing import Files, Pair, numbers
from pipeline.datasets.reconstructions import OPENCV_OF_OPENGL
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.system.errors import as_input_error, extra_module, needed, require

WITHIN_S = 0.005
"""How far the makers' own loader takes a pose from a frame's time."""
COLOR, DEPTH, CAMERA, TRAJECTORY = "lowres_wide", "lowres_depth", "lowres_wide_intrinsics", "lowres_wide.traj"


class ArkitScenesDataset(FolderDataset):
    """Frames of a scan of ARKitScenes: `lowres_wide/`, `lowres_depth/` (mm), a `.pincam` for each, and the `.traj`.

    The trajectory is world-to-camera, and z is up in its world.
    """

    format = "arkitscenes"
    rule = DepthRule(1000.0, "ARKitScenes'")

    def __init__(self, root: Path, settings: Settings) -> None:
        self._notes: list[str] = []
        path = _scan(root)[1] / TRAJECTORY
        self._path = or_note(self._notes, f"no camera pose, {TRAJECTORY}: ", _trajectory, path)
        super().__init__(root, settings)

    def _folders(self, root: Path) -> dict[str, Path]:
        return {"": _scan(root)[1]}

    def _files(self, folder: Path) -> Files:
        found = {role: [f"{n}/{f}" for f in readable(folder / n)[1]] for role, n in _PARTS.items()}
        return Files(folder, False, found)

    def _camera(self, scene: Scene, pair: Pair) -> Stated:
        # Names of cameras may be a millisecond off.
        time = _time(pair)
        keys = ((f"{time + off:.3f}",) for off in (0, -0.001, 0.001))
        return scene.camera(next((key for key in keys if key in scene.cameras), pair.key))

    def _pose(self, scene: Scene, pair: Pair, notes: list[str]) -> np.ndarray | None:
        notes += self._notes
        path, time = self._path, _time(pair)
        if path is None or not len(path):
            return None
        nearest = path[np.abs(path[:, 0] - time).argmin()]
        if abs(nearest[0] - time) > WITHIN_S:
            notes.append(f"no camera pose: {TRAJECTORY} has none within {1000 * WITHIN_S:g} ms")
            return None
        R = cv2.Rodrigues(nearest[1:4])[0]
        return or_note(notes, "no camera pose: ", lambda: inverse(rigid(R, nearest[4:7])))

    def _up(self, pose: np.ndarray | None) -> np.ndarray | None:
        return None if pose is None else pose[2, :3]


def _time(pair: Pair) -> float:
    return float(numbers(pair.color_name or pair.depth_name or "")[-1])


_PARTS = {"color": COLOR, "depth": DEPTH, "camera": CAMERA}


def _trajectory(path: Path) -> np.ndarray:
    rows = [as_floats(line.split(), 7, path, f"line {n}") for n, line in numbered_lines(path)]
    return np.stack(rows)


def _scan(root: Path) -> tuple[bool, Path]:
    """Whether there is a scan, and its folder: the opened one, or `<video>_frames` in it."""
    for folder in (root, root / f"{root.resolve().name}_frames"):
        if {COLOR, DEPTH} <= set(readable(folder)[0]):
            return True, folder
    return False, root


ARKITSCENES = DatasetFormat(
    "arkitscenes", f"arkitscenes: {COLOR}/, {DEPTH}/ and {TRAJECTORY}", lambda root: _scan(root)[0], ArkitScenesDataset
)


@dataclass(frozen=True)
class Member:
    """A file in an archive, read in place."""

    archive: Path
    inside: str

    @property
    def name(self) -> str:
        return self.inside.rpartition("/")[2]

    def __fspath__(self) -> str:
        return f"{self.archive}/{self.inside}"

    def read_bytes(self) -> bytes:
        with as_input_error("a member of the archive cannot be read", KeyError, BadZipFile, OSError, path=self):
            return _archive(self.archive).read(self.inside)


def _archive(path: Path) -> ZipFile:
    return _opened(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _opened(path: Path, written: int) -> ZipFile:
    """An open archive; `ZipFile` reads members from several threads."""
    return ZipFile(path)


@dataclass(frozen=True)
class LzfseDepth(Member):
    """Depth of Record3D: an LZFSE stream of float32 metres, NaN where nothing was measured."""

    size: tuple[int, int] = (0, 0)

    def pixels(self) -> np.ndarray:
        lzfse = extra_module("lzfse", "depth of Record3D", "record3d")
        with as_input_error("depth that cannot be decompressed", Exception, got=str, path=self):
            data = lzfse.decompress(self.read_bytes())
        width, height = self.size
        require(
            len(data) == 4 * width * height,
            "depth of another size than the recording says",
            got=f"{len(data)} bytes",
            expected=f"{width}x{height} floats",
            path=self,
        )
        return np.frombuffer(data, np.float32).reshape(height, width)


class Record3dDataset(Recording):
    """A `.r3d` capture: `rgbd/N.jpg` with `rgbd/N.depth`, and `metadata` with K, sizes and poses.

    The poses are camera-to-world of OpenGL cameras in ARKit's world, whose y is up.
    """

    format = "record3d"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        with as_input_error("not a Record3D capture", BadZipFile, KeyError, OSError, ValueError, got=str, path=root):
            names = set(_archive(root).namelist())
            table = json.loads(_archive(root).read("metadata"))
        self._table: Mapping[str, Any] = needed(table if isinstance(table, dict) else None, "no metadata", path=root)
        stems = (name[5:-4] for name in names if name.startswith("rgbd/") and name.endswith(".jpg"))
        self._ids = {stem: k for k, stem in enumerate(sorted(stems, key=natural)) if f"rgbd/{stem}.depth" in names}
        require(self._ids, "a capture without a frame of colour and depth", path=root)
        self.frame_ids = tuple(self._ids)
        self._size = self._whole("dw"), self._whole("dh")

    def _whole(self, key: str) -> int:
        return round(float(as_floats(self._table.get(key), 1, self.root, key)[0]))

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        index = self._found(self._ids, frame_id)
        color, depth = Member(self.root, f"rgbd/{frame_id}.jpg"), f"rgbd/{frame_id}.depth"
        poses = self._table.get("poses")
        pose = None
        if isinstance(poses, list) and index < len(poses):
            pose = or_note(notes, "no camera pose: ", self._pose, poses[index])
        up = None if pose is None else pose[1, :3]
        return Listed(color, LzfseDepth(self.root, depth, self._size), self._camera(index), pose, up=up)

    def _camera(self, index: int) -> Stated:
        size = self._whole("w"), self._whole("h")
        each = self._table.get("perFrameIntrinsicCoeffs")
        own = each[index] if isinstance(each, list) and index < len(each) else None
        if own is not None:
            return Stated(stated_in({"": as_floats(own, len(own), self.root)[:4]}).K, size, path=self.root)
        stated = stated_in({name: n for name, n in flat_numbers(dict(self._table)) if name == "K"})
        return Stated(stated.K, size, path=self.root)

    def _pose(self, values: Any) -> np.ndarray:
        qx, qy, qz, qw, *t = as_floats(values, 7, self.root, "a pose").tolist()
        return pose_from_quaternion(np.array([*t, qx, qy, qz, qw])) @ OPENCV_OF_OPENGL


RECORD3D = DatasetFormat(
    "record3d",
    "record3d: a .r3d capture",
    lambda root: root.suffix.lower() == ".r3d" and root.is_file(),
    Record3dDataset,
)
