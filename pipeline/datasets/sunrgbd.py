"""SUN RGB-D's own folders: one a picture, with `image/`, `depth/`, `intrinsics.txt` and the tilt in `extrinsics/`."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from pipeline.datasets.assembly import make_frame, one_file, read_pair
from pipeline.datasets.base import DatasetFormat, unknown_frame
from pipeline.datasets.cameras import make_camera, nearest_rotation
from pipeline.datasets.files import listing, natural, read_matrix
from pipeline.datasets.images import COLOR_SUFFIXES
from pipeline.datasets.settings import Settings, unit_notes
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError

UNITS_PER_METRE = 1000.0
ROTATED_BITS = 3
LEVELS = 5
"""How deep frames lie at most: SUNRGBD/xtion/sun3ddata/<building>/<room>/<frame>."""

_SENSORS = {"kv1", "kv2", "realsense", "xtion"}
_SOURCES = {"b3dodata", "nyudata", "kinect2data", "align_kv2", "lg", "sa", "sh", "shr", "sun3ddata", "xtion_align_data"}
_SWAP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Takes SUN RGB-D's axes (x right, y forward, z up) to the camera frame (x right, y down, z forward)."""


def camera_from_upright(Rtilt: np.ndarray) -> np.ndarray:
    """(3, 3) rotation from SUN RGB-D's upright frame (z up, metres) to the camera frame.

    The dataset defines upright = Rtilt @ (x, z, -y) of the camera's x, y, z
    (its toolbox, read3dPoints.m); this is the inverse.

    Raises
    ------
    InputError
        Rtilt (3, 3) is no rotation.
    """
    return _SWAP @ nearest_rotation(Rtilt).T


class SunRgbdDataset:
    """Frames of id their folder's path below the opened one; the folder's own name where it is opened itself.

    The depth is that of `depth/`, as measured; `depth_bfx/`, whose holes were
    filled in, is read only where there is no `depth/`, with a note. The up
    vector comes from the tilt in `extrinsics/` (the newest file) and is
    declared. Annotation files are not read. Folders that are links are not
    followed below the opened one.
    """

    format = "sunrgbd"
    class_names: tuple[str, ...] = ()

    def __init__(self, root: Path, settings: Settings) -> None:
        self.root = root
        self._settings = settings
        if _is_frame(root):
            self._folders = {root.resolve().name: root}
        else:
            found = sorted(_frames_below(root, LEVELS), key=natural)
            self._folders = {name: root / name for name in found}
        self.frame_ids = tuple(self._folders)
        self.notes = unit_notes(settings, UNITS_PER_METRE, "SUN RGB-D's")

    def load(self, frame_id: str) -> Frame:
        """Decode one frame; see `Dataset.load`."""
        if frame_id not in self._folders:
            raise unknown_frame(self, frame_id)
        folder = self._folders[frame_id]
        notes: list[str] = []
        color = _only_image(folder / "image", COLOR_SUFFIXES, "colour")
        if (folder / "depth").is_dir():
            depth = _only_image(folder / "depth", (".png",), "depth")
        else:
            depth = _only_image(folder / "depth_bfx", (".png",), "depth")
            notes.append("depth/ is missing: depth_bfx/ is used, whose holes were filled in")
        pair = read_pair(color, depth, self._settings.depth_scale or UNITS_PER_METRE, rotated=ROTATED_BITS)
        size = (pair[1].shape[0], pair[1].shape[1])
        path = folder / "intrinsics.txt"
        K = None if self._settings.intrinsics is not None else read_matrix(path, 3, 3)
        camera = make_camera(K, size, None, self._settings, path)
        try:
            camera = camera.with_up(camera_from_upright(_tilt(folder / "extrinsics"))[:, 2], "declared")
        except InputError as error:
            notes.append(f"no up vector, extrinsics: {error.what}")
        return make_frame(frame_id, pair, camera, depth, notes=tuple(notes))


def _only_image(folder: Path, suffixes: tuple[str, ...], what: str) -> Path:
    if not folder.is_dir():
        raise InputError(f"the {what} file is missing", path=folder)
    names = [name for name in listing(folder)[1] if Path(name).suffix.lower() in suffixes]
    return one_file([folder / name for name in names], what, folder)


def _tilt(folder: Path) -> np.ndarray:
    """Rtilt (3, 3) from the newest file, which is named by its time; its fourth column is 0."""
    names = [name for name in listing(folder)[1] if name.endswith(".txt")]
    if not names:
        raise InputError("no file with the tilt", path=folder)
    return read_matrix(folder / names[-1], 3, 4)[:, :3]


def _entries(folder: Path) -> tuple[list[str], list[str]]:
    """Names of the folders, without links, and of the files; none where the folder may not be read."""
    folders: list[str] = []
    files: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.name)
                else:
                    files.append(entry.name)
    except OSError:
        return [], []
    return folders, files


def _is_frame(folder: Path) -> bool:
    return _looks_like_a_frame(folder, *_entries(folder))


def _looks_like_a_frame(folder: Path, folders: list[str], files: list[str]) -> bool:
    """Whether a folder is one picture of SUN RGB-D, perhaps a broken one.

    SUN3D's recordings have the same folders with many images in them, and other
    recordings have image/ and depth/ alone.
    """
    names = set(folders)
    if not names & {"extrinsics", "depth_bfx"}:
        return False
    parts = ("image" in names, bool(names & {"depth", "depth_bfx"}), "intrinsics.txt" in files)
    return sum(parts) >= 2 and len(_entries(folder / "image")[1]) <= 1


def _frames_below(root: Path, levels: int, prefix: str = "") -> list[str]:
    """Paths of the frames' folders below `root`, relative to it; what is a frame is not searched further."""
    found: list[str] = []
    for name in _entries(root)[0]:
        folder = root / name
        folders, files = _entries(folder)
        if _looks_like_a_frame(folder, folders, files):
            found.append(prefix + name)
        elif levels > 1 and folders:
            found += _frames_below(folder, levels - 1, f"{prefix}{name}/")
    return found


def _recognises(root: Path) -> bool:
    """A frame, a folder most of whose folders are frames, or the dataset's own tree by its names.

    Not any folder with a frame somewhere below: that may hold other datasets too.
    """
    if _is_frame(root):
        return True
    folders = _entries(root)[0]
    if 2 * sum(_is_frame(root / name) for name in folders) > len(folders):
        return True
    if root.resolve().name.lower() in _SENSORS | _SOURCES:
        return bool(_frames_below(root, LEVELS))
    named = [name for name in folders if name.lower() in _SENSORS]
    return any(_frames_below(root / name, LEVELS - 1) for name in named)


FORMAT = DatasetFormat(
    "sunrgbd",
    "sunrgbd: image/, depth/, intrinsics.txt and extrinsics/ here, in <frame>/ or below kv1/, kv2/, realsense/, xtion/",
    _recognises,
    SunRgbdDataset,
)
