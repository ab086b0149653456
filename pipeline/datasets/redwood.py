"""Redwood and Open3D: `color/` (or `image/`) and `depth/` with Open3D's camera file and `trajectory.log`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.camera_files import Stated
from pipeline.datasets.cameras import or_note, pose_from_matrix
from pipeline.datasets.files import as_floats, listing, numbered_lines, read_bytes, read_json, readable
from pipeline.datasets.pairing import Key, image_files, paired_files
from pipeline.datasets.recording import DepthRule, Listed, Recording, files_of
from pipeline.datasets.settings import Settings
from pipeline.system.errors import InputError, needed, require

COLOR_FOLDERS = ("color", "image", "rgb")
DEPTH_FOLDERS = ("depth",)
CAMERA_FILES = ("camera_primesense.json", "camera_intrinsic.json", "intrinsics.json", "intrinsic.json")
TRAJECTORY = "trajectory.log"
CAMERA_FILE_BYTES = 64 * 1024
"""Open3D's camera files have some 300 bytes; what is larger is not read to find out."""


@dataclass(frozen=True)
class _Layout:
    """Paths of a recording's parts."""

    frames: Path
    camera: Path | None
    trajectory: Path | None


class RedwoodDataset(Recording):
    """Frames of id the colour file's stem; depth in millimetres, poses camera-to-world.

    The opened folder holds the images, or one folder that holds them. The camera file and the trajectory stand beside
    the images or in the opened folder; the camera file alone is also looked for one folder above the opened one, by its
    four names and nothing else. Block k of the trajectory is frame k where there are as many of both; else the blocks'
    own numbers are the files', where both begin at the same number.
    """

    format = "redwood"
    rule = DepthRule(1000.0, "Redwood's")

    def __init__(self, root: Path, settings: Settings) -> None:
        layout = needed(_layout(root), "no colour and depth folders", path=root)
        super().__init__(root, settings)
        self._camera_file = layout.camera
        require(
            layout.camera is not None or settings.intrinsics is not None or settings.browse,
            "the camera is not known",
            expected=f"{' or '.join(CAMERA_FILES)}, or --intrinsics fx,fy,cx,cy",
            path=root,
        )
        self._pairs = paired_files(layout.frames, COLOR_FOLDERS, (".png",), DEPTH_FOLDERS)
        self.frame_ids = tuple(self._pairs)
        self._pose_notes: list[str] = []
        read = (layout.trajectory, [pair.key for pair in self._pairs.values()])
        self._poses = or_note(self._pose_notes, f"no camera pose, {TRAJECTORY}: ", _poses, *read) or {}

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        files = self._found(self._pairs, frame_id)
        color, depth = files_of(files, self.root)
        notes += self._pose_notes
        pose = None
        if files.key in self._poses:
            pose = or_note(notes, f"no camera pose, {TRAJECTORY}: ", pose_from_matrix, self._poses[files.key])
        elif self._poses:
            notes.append(f"no camera pose: {TRAJECTORY} has none for this frame")
        path = self._camera_file
        if self._settings.intrinsics is not None or path is None:
            return Listed(color, depth, Stated(path=path), pose)
        return Listed(color, depth, _stated(path), pose)


def _layout(root: Path) -> _Layout | None:
    """Parts of a recording in a folder; None without images."""
    frames = root
    if not _has_images(root):
        inside = [root / name for name in listing(root)[0]]
        recordings = [folder for folder in inside if _has_images(folder)]
        if len(recordings) != 1:
            return None
        frames = recordings[0]
    folders = list(dict.fromkeys((frames, root)))
    above = root.resolve().parent if frames == root else root
    cameras = [folder / name for folder in dict.fromkeys((*folders, above)) for name in CAMERA_FILES]
    logs = [folder / TRAJECTORY for folder in folders]
    return _Layout(
        frames,
        next((path for path in cameras if _is_camera_file(path)), None),
        next((path for path in logs if os.path.isfile(path)), None),
    )


def _has_images(folder: Path) -> bool:
    names = {name.lower() for name in readable(folder)[0]}
    return bool(names.intersection(COLOR_FOLDERS)) and bool(names.intersection(DEPTH_FOLDERS))


def _is_camera_file(path: Path) -> bool:
    """Test whether a file has Open3D intrinsics; errors in them appear on loading."""
    try:
        return path.stat().st_size <= CAMERA_FILE_BYTES and b"intrinsic_matrix" in read_bytes(path)
    except (OSError, InputError):
        return False


def _stated(path: Path) -> Stated:
    """Open3D PinholeCameraIntrinsic, column-major; InputError where malformed."""
    table = read_json(path)
    for key in ("width", "height", "intrinsic_matrix"):
        require(key in table, f"{key} is missing", path=path)
    width, height = as_floats([table["width"], table["height"]], 2, path, "width and height")
    K = as_floats(table["intrinsic_matrix"], 9, path, "intrinsic_matrix").reshape(3, 3).T
    return Stated(K, (round(width), round(height)), path=path)


def _poses(path: Path | None, keys: list[Key]) -> dict[Key, np.ndarray]:
    """The 4x4 matrices of a trajectory by frame, not yet checked to be poses; none without a trajectory. A block is a
    line of three whole numbers, of which the first counts the frames, and four lines of a camera-to-world matrix."""
    if path is None:
        return {}
    lines = numbered_lines(path)
    require(
        not (len(lines) % 5), "the last block is not whole", got=f"{len(lines)} lines", expected="5 a frame", path=path
    )
    blocks: dict[int, np.ndarray] = {}
    for start in range(0, len(lines), 5):
        number, header = lines[start]
        words = header.split()
        require(
            len(words) == 3 and all(word.isdecimal() and len(word) <= 12 for word in words),
            f"line {number} does not begin a block of three whole numbers",
            path=path,
        )
        require(int(words[0]) not in blocks, f"line {number} repeats frame {words[0]}", path=path)
        rows = [as_floats(text.split(), 4, path, f"line {n}") for n, text in lines[start + 1 : start + 5]]
        blocks[int(words[0])] = np.stack(rows)
    if len(blocks) == len(keys):
        return dict(zip(keys, (blocks[n] for n in sorted(blocks)), strict=True))
    if all(len(key) == 1 and key[0].isdecimal() for key in keys):
        frame = {int(key[0]): key for key in keys}
        # Files may count from 1 and blocks from 0; only the same first number says that they agree.
        if min(frame) == min(blocks):
            return {key: blocks[n] for n, key in frame.items() if n in blocks}
    raise InputError(f"{len(blocks)} poses for {len(keys)} frames", path=path)


def _recognises(root: Path) -> bool:
    # A recording with poses of the plain kind is the plain reader's, which reads them.
    if os.path.isfile(root / "pose.txt") or os.path.isdir(root / "pose"):
        return False
    layout = _layout(root)
    if layout is None:
        return False
    marks = [path for path in (layout.camera, layout.trajectory) if path is not None]
    # A folder of several datasets may hold one recording; only its own files make it the recording's.
    if not marks or (layout.frames != root and all(path.parent != root for path in marks)):
        return False
    return or_note([], "", image_files, layout.frames, DEPTH_FOLDERS, (".png",), "depth") is not None


FORMAT = DatasetFormat(
    "redwood",
    f"redwood: color/ or image/ with depth/, and {CAMERA_FILES[0]}, intrinsics.json or {TRAJECTORY}",
    _recognises,
    RedwoodDataset,
)
