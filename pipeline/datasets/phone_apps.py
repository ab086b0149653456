"""Recordings of apps for phones with a depth sensor: Stray Scanner, Polycam's raw data.

https://github.com/strayrobots/scanner/blob/main/docs/format.md, https://github.com/PolyCam/polyform
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import NOTHING, Stated, or_note, pose_from_matrix, stated_in
from pipeline.datasets.files import Blob, Part, as_floats, natural, read_json, read_matrix, readable
from pipeline.datasets.images import picture_size
from pipeline.datasets.pairing import COLOR_SUFFIXES, numbers, stem_of
from pipeline.datasets.reconstructions import OPENCV_OF_OPENGL
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.datasets.trajectories import Trajectory, read_trajectory
from pipeline.datasets.video import open_video
from pipeline.system.errors import needed, require

MATRIX, ODOMETRY, VIDEO, DEPTH = "camera_matrix.csv", "odometry.csv", "rgb.mp4", "depth"
DEPTH_ENDS = (".png", ".npy")
"""Depth of Stray Scanner is PNG, and NPY in its first versions."""


class StrayDataset(Recording):
    """A recording of Stray Scanner: `depth/N.png` (mm), colour as `rgb.mp4` or unpacked to `rgb/N.jpg`, the colour's
    `camera_matrix.csv`, and `odometry.csv`, camera-to-world of OpenCV cameras, as its makers' own viewer reads them.

    Frame N has picture N of the video. Where pictures were unpacked from 1 on and depth counts from 0, they belong
    together in order.
    """

    format = "stray-scanner"
    rule = DepthRule(1000.0, "Stray Scanner's")
    again = r"rgb\.mp4"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._colors, self._size = self._pictures(root)
        names = [name for name in readable(root / DEPTH)[1] if name.lower().endswith(DEPTH_ENDS) and numbers(name)]
        depths = {numbers(name)[-1]: f"{DEPTH}/{name}" for name in names}
        shift = self._shift(depths) if self._colors else 0
        self._frames = {
            stem_of(name): (number, str(int(float(number)) + shift), root / name) for number, name in depths.items()
        }
        self.frame_ids = tuple(self._frames)
        require(self.frame_ids, "a recording without depth", path=root / DEPTH)
        self._problems: list[str] = []
        path = or_note(self._problems, f"no camera pose, {ODOMETRY}: ", read_trajectory, root / ODOMETRY)
        rows = path and or_note(
            self._problems, "no camera pose: ", path.rows_of, [n for n, *_ in self._frames.values()]
        )
        self._path: Trajectory | None = path if rows else None
        self._rows = dict(zip(self.frame_ids, rows or (), strict=False))

    def _pictures(self, root: Path) -> tuple[dict[str, str], tuple[int, int] | None]:
        """Unpacked pictures by number, none where they are in the video; and their size."""
        names = [f"rgb/{n}" for n in readable(root / "rgb")[1] if n.lower().endswith(COLOR_SUFFIXES) and numbers(n)]
        if names:
            return {numbers(name)[-1]: name for name in names}, picture_size(root / names[0])
        return {}, open_video(root / VIDEO).size

    def _shift(self, depths: dict[str, str]) -> int:
        if len(depths) != len(self._colors):
            return 0
        first, other = (min(int(float(n)) for n in table) for table in (depths, self._colors))
        if first == other:
            return 0
        self.notes += (f"pictures count from {other} and depth from {first}: they belong together in order",)
        return other - first

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        _, number, depth = self._found(self._frames, frame_id)
        notes += self._problems
        color: Blob = Part(self.root / VIDEO, f" picture {number}", partial(self._decode, int(number)))
        if self._colors:
            name = needed(self._colors.get(number), f"picture {number} is missing", path=self.root / "rgb")
            color = self.root / name
        row, pose = self._rows.get(frame_id), None
        if self._path is not None:
            pose = None if row is None else or_note(notes, f"no camera pose, {ODOMETRY}: ", self._path.pose, row)
            notes += [f"no camera pose: {ODOMETRY} has none for this frame"] if row is None else []
        path = self.root / MATRIX
        stated = NOTHING if self._settings.intrinsics else Stated(read_matrix(path, 3, 3), self._size, path=path)
        return Listed(color, depth, stated, pose)

    def _decode(self, number: int) -> np.ndarray:
        return open_video(self.root / VIDEO).picture(number)


def _is_stray(root: Path) -> bool:
    folders, files = readable(root)
    return {MATRIX, ODOMETRY} <= set(files) and DEPTH in folders and (VIDEO in files or "rgb" in folders)


STRAY = DatasetFormat(
    "stray-scanner", f"stray-scanner: {DEPTH}/, {MATRIX}, {ODOMETRY}, and {VIDEO} or rgb/", _is_stray, StrayDataset
)


class PolycamDataset(Recording):
    """Raw data of Polycam, `keyframes/`: frames by time stamp, the corrected pictures and cameras where there are any.

    Depth is in millimetres and smaller than the pictures; a camera's `t_ij` is camera-to-world of ARKit: cameras of
    OpenGL's axes in a world whose y is up.
    """

    format = "polycam"
    rule = DepthRule(1000.0, "Polycam's")
    again = r"keyframes/(images|cameras)/.*"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        folder = needed(_keyframes(root), "no keyframes of Polycam", path=root)
        corrected = {"corrected_images", "corrected_cameras"} <= set(readable(folder)[0])
        kinds = [f"{'corrected_' if corrected else ''}{kind}" for kind in ("images", "cameras")]
        self._parts = [
            {stem_of(name): folder / part / name for name in readable(folder / part)[1]} for part in (*kinds, "depth")
        ]
        self.frame_ids = tuple(sorted(self._parts[0], key=natural))
        require(self.frame_ids, "a capture without pictures", path=folder / kinds[0])
        if not corrected:
            self.notes += ("without corrected pictures and cameras: the poses are ARKit's own, and lenses distort",)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        color, camera, depth = (part.get(frame_id) for part in self._parts)
        color = self._found(self._parts[0], frame_id) if color is None else color
        depth = depth if self._settings.estimated else needed(depth, "the depth file is missing", path=color)
        table = read_json(needed(camera, "the camera file is missing", path=color))
        stated = stated_in({key: as_floats(table.get(key), 1, color, key) for key in ("fx", "fy", "cx", "cy")})
        size = stated_in({key: as_floats(table.get(key), 1, color, key) for key in ("width", "height")}).size
        pose = or_note(notes, "no camera pose: ", _arkit_pose, table, camera)
        return Listed(color, depth, Stated(stated.K, size, path=camera), pose, up=None if pose is None else pose[1, :3])


def _arkit_pose(table: dict[str, Any], path: Path) -> np.ndarray:
    values = as_floats([table.get(f"t_{i}{j}") for i in range(3) for j in range(4)], 12, path, "t_ij")
    return pose_from_matrix(np.append(values, [0, 0, 0, 1]).reshape(4, 4)) @ OPENCV_OF_OPENGL


def _keyframes(root: Path) -> Path | None:
    """Folder of the keyframes: in the capture's folder, or this itself."""
    folders = (root / "keyframes", root)
    wanted = {"depth", "images", "cameras"}, {"depth", "corrected_images", "corrected_cameras"}
    return next((f for f in folders for names in wanted if names <= set(readable(f)[0]) and _has_cameras(f)), None)


def _has_cameras(folder: Path) -> bool:
    """Test whether the first camera file has Polycam's matrix."""
    parts = ("corrected_cameras", "cameras")
    files = [folder / part / name for part in parts for name in readable(folder / part)[1][:1]]
    table = or_note([], "", read_json, files[0]) if files and os.path.isfile(files[0]) else None
    return table is not None and {"fx", "t_00", "t_23"} <= table.keys()


POLYCAM = DatasetFormat(
    "polycam",
    "polycam: keyframes/ with images/, cameras/ (t_00 ... t_23) and depth/",
    lambda root: _keyframes(root) is not None,
    PolycamDataset,
)
