"""Recordings of phones with a depth sensor: ARKitScenes, and `.r3d` captures of Record3D.

https://github.com/apple/ARKitScenes/blob/main/DATA.md, https://record3d.app
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar
from zipfile import BadZipFile, ZipFile

import cv2
import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import (
    Stated,
    flat_numbers,
    inverse,
    or_note,
    pose_from_quaternion,
    rigid,
    stated_in,
)
from pipeline.datasets.files import Blob, Part, as_floats, natural, numbered_lines, read_json, readable
from pipeline.datasets.folder import FolderDataset, SceneFolder
from pipeline.datasets.pairing import Pair, numbers, stem_of
from pipeline.datasets.reconstructions import OPENCV_OF_OPENGL
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.datasets.stamps import nearest
from pipeline.system.errors import as_input_error, extra_module, needed, require
from pipeline.system.safe_files import open_zip, parse_json

WITHIN_S = 0.005
"""How far the makers' own loader takes a pose from a frame's time."""
METADATA = "metadata.json"
COLOR, DEPTH, CAMERA, TRAJECTORY = "lowres_wide", "lowres_depth", "lowres_wide_intrinsics", "lowres_wide.traj"


class ArkitScenesDataset(FolderDataset):
    """Frames of a scan of ARKitScenes: `lowres_wide/`, `lowres_depth/` (mm), a `.pincam` for each, and the `.traj`. The
    trajectory is world-to-camera, and z is up in its world."""

    format = "arkitscenes"
    parts: ClassVar = {"color": COLOR, "depth": DEPTH, "camera": CAMERA}
    rule = DepthRule(1000.0, "ARKitScenes'")

    def __init__(self, root: Path, settings: Settings) -> None:
        self._notes: list[str] = []
        self._folder = _scan(root) or root
        self._path = or_note(self._notes, f"no camera pose, {TRAJECTORY}: ", _trajectory, self._folder / TRAJECTORY)
        super().__init__(root, settings)

    def _folders(self, root: Path) -> dict[str, Path]:
        return {"": self._folder}

    def _camera(self, scene: SceneFolder, pair: Pair) -> Stated:
        # Names of cameras may be a millisecond off.
        time = _time(pair)
        keys = ((f"{time + off:.3f}",) for off in (0, -0.001, 0.001))
        return scene.camera(next((key for key in keys if key in scene.cameras), pair.key))

    def _pose(self, scene: SceneFolder, pair: Pair, notes: list[str]) -> np.ndarray | None:
        notes += self._notes
        if self._path is None or not len(self._path):
            return None
        at = nearest(self._path[:, 0], _time(pair), WITHIN_S)
        if at is None:
            notes.append(f"no camera pose: {TRAJECTORY} has none within {1000 * WITHIN_S:g} ms")
            return None
        _, turn, t = np.split(self._path[at], (1, 4))
        return or_note(notes, "no camera pose: ", lambda: inverse(rigid(cv2.Rodrigues(turn)[0], t)))

    def _up(self, pose: np.ndarray | None) -> np.ndarray | None:
        return None if pose is None else pose[2, :3]


def _time(pair: Pair) -> float:
    name = pair.color_name or pair.depth_name or ""
    times = numbers(name)
    require(times, "the name of a frame has no time", got=name, expected="such as 40958756_77.234.png", path=pair.root)
    return float(times[-1])


def _trajectory(path: Path) -> np.ndarray:
    rows = [as_floats(line.split(), 7, path, f"line {n}") for n, line in numbered_lines(path)]
    return np.array(rows).reshape(-1, 7)


def _scan(root: Path) -> Path | None:
    """Folder of a scan: the root, or `<video>_frames` inside."""
    folders = (root, root / f"{root.resolve().name}_frames")
    return next((folder for folder in folders if {COLOR, DEPTH} <= set(readable(folder)[0])), None)


ARKITSCENES = DatasetFormat(
    "arkitscenes",
    f"arkitscenes: {COLOR}/, {DEPTH}/ and {TRAJECTORY}",
    lambda root: _scan(root) is not None,
    ArkitScenesDataset,
)


def _member(archive: Path, inside: str) -> bytes:
    """Read a file in an archive in place."""
    with as_input_error(
        "a member of the archive cannot be read", KeyError, BadZipFile, OSError, path=f"{archive}/{inside}"
    ):
        return _archive(archive).read(inside)


def _lzfse_depth(archive: Path, inside: str, size: tuple[int, int]) -> np.ndarray:
    """Decompress depth of Record3D: an LZFSE stream of float32 metres, NaN where nothing was measured."""
    lzfse = extra_module("lzfse", "depth of Record3D", "record3d")
    path = f"{archive}/{inside}"
    with as_input_error("depth that cannot be decompressed", Exception, got=str, path=path):
        data = lzfse.decompress(_member(archive, inside))
    width, height = size
    require(
        len(data) == 4 * width * height,
        "depth of another size than the recording says",
        got=f"{len(data)} bytes",
        expected=f"{width}x{height} floats",
        path=path,
    )
    return np.frombuffer(data, np.float32).reshape(height, width)


def _archive(path: Path) -> ZipFile:
    return _opened(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _opened(path: Path, written: int) -> ZipFile:
    """An open archive; `ZipFile` reads members from several threads."""
    return open_zip(path)


class Record3dDataset(Recording):
    """A capture of Record3D: `.r3d`, or its export to EXR and JPEG, with K, sizes and poses in its metadata.

    `rgbd/N.jpg` stands with `rgbd/N.depth` in the archive, `rgb/N.jpg` with `depth/N.exr` (metres) in the export. The
    poses are camera-to-world of OpenGL cameras in ARKit's world, whose y is up.
    """

    format = "record3d"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        colors, depths = self._in_archive(root) if root.is_file() else self._exported(root)
        stems = sorted(colors, key=natural)
        self._files = {stem: (k, colors[stem], depths[stem]) for k, stem in enumerate(stems) if stem in depths}
        require(self._files, "a capture without a frame of colour and depth", path=root)
        self.frame_ids = tuple(self._files)

    def _in_archive(self, root: Path) -> tuple[Mapping[str, Blob], Mapping[str, Blob]]:
        with as_input_error("not a Record3D capture", BadZipFile, KeyError, OSError, ValueError, got=str, path=root):
            names = _archive(root).namelist()
            table = parse_json(_archive(root).read("metadata"), root)
        self._table: Mapping[str, Any] = needed(table if isinstance(table, dict) else None, "no metadata", path=root)
        size = self._whole("dw"), self._whole("dh")
        inside = [name for name in names if name.startswith("rgbd/")]
        colors = {stem_of(n): Part(root, f"/{n}", partial(_member, root, n)) for n in inside if n.endswith(".jpg")}
        depths = [name for name in inside if name.endswith(".depth")]
        return colors, {stem_of(n): Part(root, f"/{n}", partial(_lzfse_depth, root, n, size)) for n in depths}

    def _exported(self, root: Path) -> tuple[Mapping[str, Blob], Mapping[str, Blob]]:
        self._table = read_json(root / METADATA)
        colors, depths = ({stem_of(n): root / part / n for n in readable(root / part)[1]} for part in ("rgb", "depth"))
        return colors, depths

    def _whole(self, key: str) -> int:
        return round(float(as_floats(self._table.get(key), 1, self.root, key)[0]))

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        index, color, depth = self._found(self._files, frame_id)
        poses = self._table.get("poses")
        pose = None
        if isinstance(poses, list) and index < len(poses):
            pose = or_note(notes, "no camera pose: ", self._pose, poses[index])
        up = None if pose is None else pose[1, :3]
        return Listed(color, depth, self._camera(index), pose, up=up)

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


def _is_record3d(root: Path) -> bool:
    if root.suffix.lower() == ".r3d" and root.is_file():
        return True
    folders, files = readable(root)
    if METADATA not in files or not {"rgb", "depth"} <= set(folders):
        return False
    table = or_note([], "", read_json, root / METADATA) or {}
    return {"K", "poses", "w", "h"} <= table.keys()


RECORD3D = DatasetFormat(
    "record3d", f"record3d: a .r3d capture, or rgb/, depth/ and {METADATA}", _is_record3d, Record3dDataset
)
