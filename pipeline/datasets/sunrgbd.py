"""SUN RGB-D: as published, and as exported by VoteNet's scripts.

Published: `image/`, `depth/`, `intrinsics.txt` and `extrinsics/`, a folder a picture. Exported: `image/`,
`depth/*.mat`, `calib/` and `label/` with named 3D boxes.
"""

from __future__ import annotations

import os
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import Stated, nearest_rotation, one_file, or_note
from pipeline.datasets.files import (
    Part,
    as_floats,
    listing,
    natural,
    numbered_lines,
    read_mat,
    read_matrix,
    readable,
)
from pipeline.datasets.images import picture_size
from pipeline.datasets.pairing import COLOR_SUFFIXES
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.frame import Annotation
from pipeline.system.errors import InputError, needed, require

UNITS_PER_METRE = 1000.0
ROTATED_BITS = 3
LEVELS = 5
"""How deep frames lie at most: SUNRGBD/xtion/sun3ddata/<building>/<room>/<frame>."""

_SENSORS = {"kv1", "kv2", "realsense", "xtion"}
_SOURCES = {"b3dodata", "nyudata", "kinect2data", "align_kv2", "lg", "sa", "sh", "shr", "sun3ddata", "xtion_align_data"}
_SWAP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Takes SUN RGB-D's axes (x right, y forward, z up) to the camera frame (x right, y down, z forward)."""


def camera_from_upright(Rtilt: np.ndarray) -> np.ndarray:
    """(3, 3) rotation from SUN RGB-D's upright frame (z up, metres) to the camera frame. The dataset defines upright =
    Rtilt @ (x, z, -y) of the camera's x, y, z (its toolbox, read3dPoints.m); this is the inverse."""
    return _SWAP @ nearest_rotation(Rtilt).T


class SunRgbdDataset(Recording):
    """Frames of id their folder's path below the opened one; the folder's own name where it is opened itself.

    The depth is that of `depth/`, as measured; `depth_bfx/`, whose holes were filled in, is read only where there is no
    `depth/`, with a note. The up vector comes from the tilt in `extrinsics/` (the newest file) and is declared.
    Annotation files are not read. Folders that are links are not followed below the opened one.
    """

    format = "sunrgbd"
    again = r"(.*/)?(depth_bfx|fullres)/.*"
    rule = DepthRule(UNITS_PER_METRE, "SUN RGB-D's", rotated=ROTATED_BITS)

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        if _is_frame(root):
            self._folders = {root.resolve().name: root}
        else:
            found = sorted(_frames_below(root, LEVELS), key=natural)
            self._folders = {name: root / name for name in found}
        self.frame_ids = tuple(self._folders)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        folder = self._found(self._folders, frame_id)
        color = _only_image(folder / "image", COLOR_SUFFIXES, "colour")
        if (folder / "depth").is_dir():
            depth = _only_image(folder / "depth", (".png",), "depth")
        else:
            depth = _only_image(folder / "depth_bfx", (".png",), "depth")
            notes.append("depth/ is missing: depth_bfx/ is used, whose holes were filled in")
        path = folder / "intrinsics.txt"
        K = None if self._settings.intrinsics is not None else read_matrix(path, 3, 3)
        up = or_note(
            notes, "no up vector, extrinsics: ", lambda: camera_from_upright(_tilt(folder / "extrinsics"))[:, 2]
        )
        return Listed(color, depth, Stated(K, path=path), up=up)


def _only_image(folder: Path, suffixes: tuple[str, ...], what: str) -> Path:
    require(folder.is_dir(), f"the {what} file is missing", path=folder)
    names = [name for name in listing(folder)[1] if Path(name).suffix.lower() in suffixes]
    return one_file([folder / name for name in names], what, folder)


def _tilt(folder: Path) -> np.ndarray:
    """Tilt Rtilt (3, 3) from the newest file; the fourth column is 0."""
    names = [name for name in listing(folder)[1] if name.endswith(".txt")]
    require(names, "no file with the tilt", path=folder)
    return read_matrix(folder / names[-1], 3, 4)[:, :3]


def _is_frame(folder: Path) -> bool:
    return _looks_like_a_frame(folder, *readable(folder, links=False))


def _looks_like_a_frame(folder: Path, folders: list[str], files: list[str]) -> bool:
    """Test for the layout of a single SUN RGB-D picture, perhaps broken. SUN3D's recordings have the same folders with
    many images in them, and other recordings have image/ and depth/ alone."""
    names = set(folders)
    if not names & {"extrinsics", "depth_bfx"}:
        return False
    parts = ("image" in names, bool(names & {"depth", "depth_bfx"}), "intrinsics.txt" in files)
    return sum(parts) >= 2 and len(readable(folder / "image", links=False)[1]) <= 1


def _frames_below(root: Path, levels: int, prefix: str = "") -> list[str]:
    """Relative paths of frame folders below `root`; frames are not searched further."""
    found: list[str] = []
    for name in readable(root, links=False)[0]:
        folder = root / name
        folders, files = readable(folder, links=False)
        if _looks_like_a_frame(folder, folders, files):
            found.append(prefix + name)
        elif levels > 1 and folders:
            found += _frames_below(folder, levels - 1, f"{prefix}{name}/")
    return found


def _recognises(root: Path) -> bool:
    """Recognise a frame, a folder of mostly frames, or the dataset's own tree. Not any folder with a frame somewhere
    below: that may hold other datasets too."""
    if _is_frame(root):
        return True
    folders = readable(root, links=False)[0]
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


FOLDER = "sunrgbd_trainval"
LABEL_FOLDERS = ("label", "label_v1")
OFF_PIXEL = 0.1
"""How far, in pixels, a point may project from a pixel's centre; rounding explains a few thousandths."""


class SunRgbdVoteNetDataset(Recording):
    """Frames of id the image's stem, with the file's own boxes and up vector.

    The depth image is rebuilt exactly from the list of points. The export counts pixels from 1, so that 1 is taken off
    the principal point and off the corner of each 2D box. Boxes are given in the camera frame. The opened folder is
    `sunrgbd_trainval` or holds it.
    """

    format = "sunrgbd-votenet"
    again = r"depth/\d+\.mat"
    one_size = True

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._folder = _folder(root) or root
        self._labels = next((p for n in LABEL_FOLDERS if (p := self._folder / n).is_dir()), None)
        images = {Path(name).stem for name in listing(self._folder / "image")[1] if name.endswith(".jpg")}
        clouds = {Path(name).stem for name in listing(self._folder / "depth")[1] if name.endswith(".mat")}
        self.frame_ids = tuple(sorted(images | clouds, key=natural))
        self._known = {frame_id: frame_id for frame_id in self.frame_ids}

    @cached_property
    def _class_names(self) -> tuple[str, ...]:
        """Class names in the label files, sorted."""
        paths = [] if self._labels is None else [self._labels / n for n in listing(self._labels)[1]]
        # What is unusable is told when the frame is loaded.
        lines = [line for path in paths for _, line in or_note([], "", numbered_lines, path) or ()]
        return tuple(sorted({line.split(maxsplit=1)[0] for line in lines}))

    @property
    def class_names(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Annotated classes, read on first use."""
        return self._class_names

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        self._found(self._known, frame_id)
        color = self._folder / "image" / f"{frame_id}.jpg"
        calib = self._folder / "calib" / f"{frame_id}.txt"
        R_camera_upright, K = _calibration(calib)
        cloud = self._folder / "depth" / f"{frame_id}.mat"
        depth = Part(cloud, "", partial(_depth_image, cloud, R_camera_upright, K, color))
        annotate = partial(self._annotations, frame_id, R_camera_upright)
        return Listed(color, depth, Stated(K, path=calib), None, annotate, R_camera_upright[:, 2])

    def _annotations(
        self, frame_id: str, R_camera_upright: np.ndarray, size: tuple[int, int], notes: list[str]
    ) -> tuple[Annotation, ...]:
        if self._labels is None:
            return ()
        path = self._labels / f"{frame_id}.txt"
        if path.is_file() and path.stat().st_size == 0:
            return ()  # The export writes an empty file for a picture without boxes.

        def read(index: int, line: str) -> Annotation:
            name, *words = line.split()
            return _annotation(index, name, as_floats(words, 12, path, name), R_camera_upright)

        lines = or_note(notes, f"no labels, {path.name}: ", numbered_lines, path)
        found = [
            or_note(notes, f"annotation {index} ({line.split()[0]}), line {number}: ", read, index, line)
            for index, (number, line) in enumerate(lines or ())
        ]
        return tuple(a for a in found if a is not None)


def _calibration(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The rotation from the upright to the camera frame, and K for pixels counted from 0."""
    lines = numbered_lines(path)
    require(len(lines) == 2, "a calibration must have two lines", got=len(lines), expected="Rtilt, then K", path=path)
    Rtilt, K = (as_floats(line.split(), 9, path, f"line {number}").reshape(3, 3).T for number, line in lines)
    try:
        R = camera_from_upright(Rtilt)
    except InputError as error:
        raise InputError(f"the tilt in line {lines[0][0]}: {error}", path=path) from error
    require(
        np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0 and not K[0, 1] and K[2].tolist() == [0, 0, 1],
        "not the intrinsics of a camera, column by column",
        got=np.round(K.T.ravel(), 3).tolist(),
        path=path,
    )
    return R, intrinsics(K[0, 0], K[1, 1], K[0, 2] - 1, K[1, 2] - 1)


def _points(path: Path) -> np.ndarray:
    """Points (N, 3) float64 of the list `instance`, upright, metres; non-finite points are left out."""
    table = read_mat(path, "instance").get("instance")
    if not isinstance(table, np.ndarray) or table.ndim != 2 or table.shape[1] < 3 or table.dtype.kind not in "fiu":
        raise InputError(
            "the file has no list of points",
            got=None if table is None else f"{table.dtype} {table.shape}",
            expected="a matrix `instance` of x y z r g b a line",
            path=path,
        )
    points = table[:, :3].astype(np.float64)
    return points[np.isfinite(points).all(axis=1)]


def _depth_image(path: Path, R_camera_upright: np.ndarray, K: np.ndarray, color: Path) -> np.ndarray:
    """Depth (H, W) float32 metres of a picture, rebuilt from a list of upright points."""
    points = _points(path) @ R_camera_upright.T
    width, height = needed(picture_size(color), "the picture's size is not known", path=color)
    points = points[points[:, 2] > 0]
    require(len(points), "no point lies in front of the camera", path=path)
    u = K[0, 0] * points[:, 0] / points[:, 2] + K[0, 2]
    v = K[1, 1] * points[:, 1] / points[:, 2] + K[1, 2]
    column, row = np.round(u), np.round(v)
    off = float(max(np.abs(u - column).max(), np.abs(v - row).max()))
    require(
        off <= OFF_PIXEL,
        "the points do not project to pixels",
        got=f"{off:.2g} pixels off",
        expected=f"at most {OFF_PIXEL:g}",
        cause="is the calibration that of another picture?",
        path=path,
    )
    require(
        column.min() >= 0 and row.min() >= 0 and column.max() < width and row.max() < height,
        "points lie outside the image",
        got=f"columns {column.min():g} to {column.max():g}, rows {row.min():g} to {row.max():g}",
        expected=f"an image of {width}x{height}",
        path=path,
    )
    depth = np.full(height * width, np.inf, np.float32)
    np.minimum.at(depth, row.astype(np.int64) * width + column.astype(np.int64), points[:, 2].astype(np.float32))
    depth[np.isinf(depth)] = 0
    return depth.reshape(height, width)


def _annotation(index: int, name: str, values: np.ndarray, R_camera_upright: np.ndarray) -> Annotation:
    """Annotation of a line: 2D box x y w h, centroid, half sizes w l h, orientation x y; upright frame, metres. The
    second half size lies along the orientation, the first across it, the third along z."""
    require(np.isfinite(values).all(), "inf or NaN")
    x, y, w, h = values[:4]
    require(w > 0 and h > 0, "an empty 2D box")
    length = float(np.hypot(values[10], values[11]))
    require(length >= 1e-6, "no orientation")
    ox, oy = values[10:] / length
    R_upright_box = np.array([[oy, ox, 0.0], [-ox, oy, 0.0], [0.0, 0.0, 1.0]])
    box = Box3D(R_camera_upright @ values[4:7], R_camera_upright @ R_upright_box, 2 * values[7:10])
    return Annotation(index, name, np.array([x - 1, y - 1, x - 1 + w, y - 1 + h]), box=box)


def _folder(root: Path) -> Path | None:
    for folder in (root, root / FOLDER):
        whole = all(os.path.isdir(folder / name) for name in ("calib", "image", "depth"))
        if whole and any(name.endswith(".mat") for name in readable(folder / "depth")[1]):
            return folder
    return None


VOTENET_FORMAT = DatasetFormat(
    "sunrgbd-votenet",
    f"sunrgbd-votenet: image/, depth/*.mat and calib/, here or in {FOLDER}/",
    lambda root: _folder(root) is not None,
    SunRgbdVoteNetDataset,
)
