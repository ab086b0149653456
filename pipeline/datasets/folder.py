"""Any other recording: a folder of colour, a folder of depth, perhaps poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import (
    Recording,
    files_of,
    or_note,
    pose_from_matrix,
    pose_from_quaternion,
    read_pair,
)
from pipeline.datasets.files import (
    COLOR_SUFFIXES,
    Key,
    Naming,
    as_floats,
    choose_naming,
    image_files,
    listing,
    numbered_lines,
    pair_files,
    read_matrix,
    twice,
)
from pipeline.datasets.images import DEPTH_SUFFIXES, INTEGER_DEPTH_SUFFIXES
from pipeline.datasets.settings import FILE_NAME, Settings
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError, require

COLOR_FOLDERS = ("color", "colour", "rgb", "image", "images")
DEPTH_FOLDERS = ("depth",)


@dataclass(frozen=True)
class _PoseText:
    """Where a pose stands: a file of its own, or a line of `pose.txt`."""

    path: Path
    line: str | None = None

    def read(self) -> np.ndarray:
        if self.line is None:
            return pose_from_matrix(read_matrix(self.path, 4, 4))
        values = as_floats(self.line.replace(",", " ").split(), 7, self.path, "tx ty tz qx qy qz qw")
        return pose_from_quaternion(values)


class FolderDataset(Recording):
    """Colour and depth files paired by the number in their names; the id is the colour file's stem.

    Poses come from `pose/N.txt` (a 4x4 matrix) or `pose.txt` (a line
    tx ty tz qx qy qz qw a frame), both camera-to-world. Lines belong to the
    frames in order where there are as many, and otherwise line N to number N.
    """

    format = "folder"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        colors = image_files(root, COLOR_FOLDERS, COLOR_SUFFIXES, "colour")
        depths = image_files(root, DEPTH_FOLDERS, DEPTH_SUFFIXES, "depth")
        _ask_for_the_missing(root, depths, settings)
        naming = choose_naming(colors, depths)
        self._pairs = {pair.stem: pair for pair in pair_files(naming, colors, depths)}
        self.frame_ids = tuple(self._pairs)
        if settings.depth_scale is None:
            self.notes = ("floating-point depth is taken for metres: --depth-scale UNITS_PER_METRE tells another unit",)
        self._poses, self._pose_problem = _poses(root, naming, [pair.key for pair in self._pairs.values()])

    def load(self, frame_id: str) -> Frame:
        """Decode one frame; see `Dataset.load`."""
        pair = self._found(self._pairs, frame_id)
        color, depth = files_of(pair, self.root)
        images = read_pair(color, depth, self._settings.depth_scale)
        notes: list[str] = [] if self._pose_problem is None else [f"no camera pose: {self._pose_problem}"]
        pose_text = self._poses.get(pair.key)
        pose = None if pose_text is None else or_note(notes, "no camera pose: ", pose_text.read)
        return self._frame(frame_id, images, None, pose, color, depth, notes=notes)


def _ask_for_the_missing(root: Path, depths: list[Path], settings: Settings) -> None:
    missing: list[str] = []
    if settings.intrinsics is None:
        missing.append("--intrinsics fx,fy,cx,cy")
    if settings.depth_scale is None and any(path.suffix.lower() in INTEGER_DEPTH_SUFFIXES for path in depths):
        missing.append("--depth-scale UNITS_PER_METRE")
    require(
        not missing,
        "this recording does not say what its camera is",
        expected=" and ".join(missing),
        cause=f"give it on the command line or keep it in {FILE_NAME} beside the data",
        path=root,
    )


def _poses(root: Path, naming: Naming, keys: list[Key]) -> tuple[dict[Key, _PoseText], str | None]:
    """Where each frame's pose stands, and why there are none although there is a file."""
    if (root / "pose").is_dir():
        files = [root / "pose" / name for name in listing(root / "pose")[1] if name.lower().endswith(".txt")]
        if files:
            if same := twice(naming, files):
                return {}, f"pose/ has {same} for one frame"
            return {naming(path): _PoseText(path) for path in files}, None
    path = root / "pose.txt"
    if not path.is_file():
        return {}, None
    try:
        lines = [line for _, line in numbered_lines(path)]
    except InputError as error:
        return {}, f"pose.txt: {error.what}"
    if len(lines) == len(keys):
        return {key: _PoseText(path, line) for key, line in zip(keys, lines, strict=True)}, None
    if all(len(key) == 1 and key[0].isdecimal() and 1 <= int(key[0]) <= len(lines) for key in keys):
        return {key: _PoseText(path, lines[int(key[0]) - 1]) for key in keys}, None
    return {}, f"pose.txt has {len(lines)} lines for {len(keys)} frames"


def _recognises(root: Path) -> bool:
    names = {name.lower() for name in listing(root)[0]}
    return bool(names.intersection(COLOR_FOLDERS)) and bool(names.intersection(DEPTH_FOLDERS))


FORMAT = DatasetFormat(
    "folder",
    "folder: color/, rgb/ or image/ with depth/, files paired by number",
    _recognises,
    FolderDataset,
)
