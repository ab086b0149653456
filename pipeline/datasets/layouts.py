"""Published layouts of folders: 7-Scenes, ScanNet, Redwood and Open3D, Picking Challenge, YCB-Video."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import NOTHING, Stated, inverse, or_note, pose_from_matrix, rigid
from pipeline.datasets.files import (
    as_floats,
    listing,
    numbered_lines,
    read_bytes,
    read_json,
    read_mat,
    read_matrix,
    readable,
)
from pipeline.datasets.folder import FolderDataset, SceneFolder
from pipeline.datasets.images import picture_size
from pipeline.datasets.pairing import Files, Key, Naming, Pair, files_in
from pipeline.datasets.recording import DepthRule
from pipeline.datasets.settings import Settings, camera_notes
from pipeline.system.errors import InputError, needed, require

UNREGISTERED = (
    "colour and depth of 7-Scenes are of two cameras, and are read as of one: `spatialviz doctor DATASET --apply` "
    "estimates the warp between them"
)
SEVEN_SCENES_CAMERA = (585.0, 585.0, 320.0, 240.0)
_IMAGE = re.compile(r"frame-[0-9]{1,12}\.(color|depth|pose)\.(png|jpg|jpeg|txt)")


class SevenScenesDataset(FolderDataset):
    """Frames in the folder itself (id `frame-000000`) or in `seq-XX` (id `seq-01/frame-000000`).

    A `camera-intrinsics.txt` in the opened folder, or beside the frames, wins over the format's own 585, 585, 320, 240,
    which is for 640x480 only. 7-Scenes promises no world axis that points up and carries no annotations.
    """

    format = "7-scenes"
    rule = DepthRule(1000.0, "7-Scenes' own", nothing=65535)
    documented = SEVEN_SCENES_CAMERA
    camera_file = "camera-intrinsics.txt or "

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        if any(self._camera_file(scene.files.root) is None for scene in self._scenes.values()):
            self.notes += camera_notes(settings, SEVEN_SCENES_CAMERA, "7-Scenes' own")
        if settings.registration is None:
            self.notes += (UNREGISTERED,)

    def _naming(self) -> Naming:
        return lambda name: (name.partition(".")[0],)

    def _folders(self, root: Path) -> dict[str, Path]:
        return {name: root / name for name in ("", *_sequences(root)) if _has_frames(root / name)}

    def _files(self, folder: Path) -> Files:
        found: dict[str, list[str]] = {}
        for name in listing(folder)[1]:
            if match := _IMAGE.fullmatch(name):
                found.setdefault(match[1], []).append(name)
        return Files(folder, True, found)

    def _camera(self, scene: SceneFolder, pair: Pair) -> Stated:
        path = self._camera_file(scene.files.root)
        return NOTHING if path is None else Stated(read_matrix(path, 3, 3), path=path)

    def _camera_file(self, folder: Path) -> Path | None:
        """Intrinsics file next to the frames of a folder, else in the root."""
        files = (parent / "camera-intrinsics.txt" for parent in (folder, self.root))
        return next((path for path in files if path.is_file()), None)


def _sequences(root: Path) -> list[str]:
    return [name for name in listing(root)[0] if re.fullmatch(r"seq-?[0-9]+", name)]


def _has_frames(folder: Path) -> bool:
    return any(_IMAGE.fullmatch(name) and not name.endswith(".txt") for name in listing(folder)[1])


SEVEN_SCENES = DatasetFormat(
    "7-scenes",
    "7-scenes: frame-XXXXXX.color.png (or .jpg) with .depth.png, here or in seq-XX/",
    lambda root: any(_has_frames(folder) for folder in (root, *(root / name for name in _sequences(root)))),
    SevenScenesDataset,
)


class ScanNetDataset(FolderDataset):
    """Frames of id N, the name of the colour file, as exported by SensReader; depth in millimetres, poses
    camera-to-world.

    The frame has the size and the intrinsics of the depth image. ScanNet's world is level only where a scan was
    axis-aligned afterwards, so that no up vector is declared.
    """

    format = "scannet"
    again = r"intrinsic/.*"
    rule = DepthRule(1000.0, "ScanNet's")
    parts: ClassVar = {"color": "color", "depth": "depth", "pose": "pose"}

    def _camera(self, scene: SceneFolder, pair: Pair) -> Stated:
        """Depth intrinsics, else the colour camera's for equal sizes."""
        folder = self.root / "intrinsic"
        path = folder / "intrinsic_depth.txt"
        if not path.is_file() and pair.color and pair.depth and picture_size(pair.color) == picture_size(pair.depth):
            path = folder / "intrinsic_color.txt"
        M = read_matrix(path, 4, 4)
        require(
            np.array_equal(M[3], (0, 0, 0, 1)) and not M[:3, 3].any(),
            "the intrinsics must be a 3x3 matrix in a 4x4 one whose other entries are those of the identity",
            got=f"last row {M[3].tolist()}, last column {M[:, 3].tolist()}",
            path=path,
        )
        return Stated(M[:3, :3], path=path)


def _is_scannet(root: Path) -> bool:
    files = ("intrinsic_depth.txt", "intrinsic_color.txt")
    return {"color", "depth"} <= set(readable(root)[0]) and any(
        os.path.isfile(root / "intrinsic" / name) for name in files
    )


SCANNET = DatasetFormat(
    "scannet", "scannet: color/, depth/ and intrinsic/intrinsic_depth.txt", _is_scannet, ScanNetDataset
)


COLOR_FOLDERS = ("color", "image", "rgb")
CAMERA_FILES = ("camera_primesense.json", "camera_intrinsic.json", "intrinsics.json", "intrinsic.json")
TRAJECTORY = "trajectory.log"
CAMERA_FILE_BYTES = 64 * 1024
"""Open3D's camera files have some 300 bytes; what is larger is not read to find out."""
Layout = tuple[Path, str, str, Path | None, Path | None]
"""The folder of the pictures, its folders of colour and of depth, the camera file and the trajectory."""


class RedwoodDataset(FolderDataset):
    """Frames of id the colour file's stem; depth in millimetres, poses camera-to-world.

    The opened folder holds the images, or one folder that holds them. The camera file and the trajectory stand beside
    the images or in the opened folder; the camera file alone is also looked for one folder above the opened one, by its
    four names and nothing else. Block k of the trajectory is frame k where there are as many of both; else the blocks'
    own numbers are the files', where both begin at the same number.
    """

    format = "redwood"
    rule = DepthRule(1000.0, "Redwood's")

    def __init__(self, root: Path, settings: Settings) -> None:
        self._layout = needed(_redwood(root), "no colour and depth folders", path=root)
        super().__init__(root, settings)
        self._pose_notes: list[str] = []
        read = self._layout[-1], [pair.key for pair in self._scenes[""].pairs]
        self._poses = or_note(self._pose_notes, f"no camera pose, {TRAJECTORY}: ", _trajectory, *read) or {}

    def _folders(self, root: Path) -> dict[str, Path]:
        return {"": self._layout[0]}

    def _files(self, folder: Path) -> Files:
        roles = zip(("color", "depth"), self._layout[1:3], strict=True)
        return Files(folder, False, {role: files_in(folder, str(name), role) for role, name in roles})

    def _camera(self, scene: SceneFolder, pair: Pair) -> Stated:
        """Open3D's PinholeCameraIntrinsic, column-major."""
        path = self._layout[3]
        if path is None:
            return NOTHING
        table = read_json(path)
        for key in ("width", "height", "intrinsic_matrix"):
            require(key in table, f"{key} is missing", path=path)
        width, height = as_floats([table["width"], table["height"]], 2, path, "width and height")
        require(np.isfinite((width, height)).all(), "width and height: not numbers", got=(width, height), path=path)
        K = as_floats(table["intrinsic_matrix"], 9, path, "intrinsic_matrix").reshape(3, 3).T
        return Stated(K, (round(width), round(height)), path=path)

    def _pose(self, scene: SceneFolder, pair: Pair, notes: list[str]) -> np.ndarray | None:
        notes += self._pose_notes
        if pair.key in self._poses:
            return or_note(notes, f"no camera pose, {TRAJECTORY}: ", pose_from_matrix, self._poses[pair.key])
        if self._poses:
            notes.append(f"no camera pose: {TRAJECTORY} has none for this frame")
        return None


def _redwood(root: Path) -> Layout | None:
    """Parts of a recording in a folder or in the only folder of it that has images."""
    inside = [root] if _image_folders(root) else [root / name for name in listing(root)[0]]
    recordings = [(folder, *names) for folder in inside if (names := _image_folders(folder))]
    if len(recordings) != 1:
        return None
    folder, color, depth = recordings[0]
    above = root.resolve().parent if folder == root else root
    cameras = [parent / name for parent in dict.fromkeys((folder, root, above)) for name in CAMERA_FILES]
    logs = [parent / TRAJECTORY for parent in (folder, root)]
    camera = next((path for path in cameras if _is_camera_file(path)), None)
    return folder, color, depth, camera, next((path for path in logs if os.path.isfile(path)), None)


def _image_folders(folder: Path) -> tuple[str, str] | None:
    """Names of the only folder of colour and of the folder of depth."""
    names = readable(folder)[0]
    colors = [name for name in names if name.lower() in COLOR_FOLDERS]
    depths = [name for name in names if name.lower() == "depth"]
    return (colors[0], depths[0]) if colors and depths else None


def _is_camera_file(path: Path) -> bool:
    """Test whether a file has Open3D intrinsics; errors in them appear on loading."""
    small = path.is_file() and path.stat().st_size <= CAMERA_FILE_BYTES
    return small and b"intrinsic_matrix" in (or_note([], "", read_bytes, path) or b"")


def _trajectory(path: Path | None, keys: Sequence[Key]) -> dict[Key, np.ndarray]:
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


def _is_redwood(root: Path) -> bool:
    # A recording with poses of the plain kind is the plain reader's, which reads them.
    if os.path.isfile(root / "pose.txt") or os.path.isdir(root / "pose"):
        return False
    layout = _redwood(root)
    if layout is None:
        return False
    folder, _, depth, *files = layout
    marks = [path for path in files if path is not None]
    # A folder of several datasets may hold one recording; only its own files make it the recording's.
    if not marks or (folder != root and all(path.parent != root for path in marks)):
        return False
    return any(name.lower().endswith(".png") for name in readable(folder / depth)[1])


REDWOOD = DatasetFormat(
    "redwood",
    f"redwood: color/ or image/ with depth/, and {CAMERA_FILES[0]}, intrinsics.json or {TRAJECTORY}",
    _is_redwood,
    RedwoodDataset,
)


INFO = "cam.info.txt"
COLOR_CAMERA = "color camera intrinsic matrix"


class ApcDataset(FolderDataset):
    """Scenes of the MIT-Princeton Amazon Picking Challenge, https://github.com/andyzeng/apc-vision-toolbox.

    Frames of id `frame-000000`; depth registered to colour, tenths of a millimetre, bits rotated by three.

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


APC = DatasetFormat(
    "apc", f"apc: frame-000000.color.png with .depth.png and {INFO}", lambda root: (root / INFO).is_file(), ApcDataset
)


OBJECTS = (
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "011_banana",
    "019_pitcher_base",
    "021_bleach_cleanser",
    "024_bowl",
    "025_mug",
    "035_power_drill",
    "036_wood_block",
    "037_scissors",
    "040_large_marker",
    "051_large_clamp",
    "052_extra_large_clamp",
    "061_foam_brick",
)
"""Its classes in the order of their numbers, from 1; `image_sets/classes.txt` has the same."""


class YcbVideoDataset(FolderDataset):
    """YCB-Video as distributed, https://rse-lab.cs.washington.edu/projects/posecnn/.

    Frames of id `000001`, or `0001/000001` in the folder of all videos; the label picture gives masks and names.

    Intrinsics and the depth's unit stand in `-meta.mat`, and the camera's pose as world-to-camera; the objects' poses
    there are of models that are not beside them, so that they give no boxes.
    """

    format = "ycb-video"
    again = r"(.*/)?[0-9]+-box\.txt"
    names: ClassVar = {number: name[4:].replace("_", " ") for number, name in enumerate(OBJECTS, start=1)}

    def _folders(self, root: Path) -> dict[str, Path]:
        return _videos(root)

    def _pose(self, scene: SceneFolder, pair: Pair, notes: list[str]) -> np.ndarray | None:
        if pair.key not in scene.cameras:
            return None
        path = scene.files.root / scene.cameras[pair.key]

        def read() -> np.ndarray | None:
            found = read_mat(path, "rotation_translation_matrix").get("rotation_translation_matrix")
            if found is None:
                return None
            M = as_floats(found, 12, path, "rotation_translation_matrix").reshape(3, 4)
            return inverse(rigid(M[:, :3], M[:, 3]))

        return or_note(notes, "no camera pose: ", read)


def _videos(root: Path) -> dict[str, Path]:
    if _is_video(root):
        return {"": root}
    data = root / "data" if (root / "data").is_dir() else root
    return {name: data / name for name in readable(data)[0] if _is_video(data / name)}


def _is_video(folder: Path) -> bool:
    """Test whether the first files of a folder are a YCB-Video frame."""
    ends = {name.partition("-")[2] for name in readable(folder)[1][:12]}
    return {"depth.png", "label.png", "meta.mat"} <= ends


YCB_VIDEO = DatasetFormat(
    "ycb-video",
    "ycb-video: 000001-color.png, -depth.png, -label.png and -meta.mat, here or in <video>/",
    lambda root: bool(_videos(root)),
    YcbVideoDataset,
)
