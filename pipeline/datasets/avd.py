"""Active Vision Dataset: scans of rooms by a robot, with instance boxes and the moves between images.

`<scan>/{jpg_rgb,high_res_depth}/`, `annotations.json`, `image_structs.mat`, `cameras.txt`; beside the
scans `instance_id_map.txt` and, in another layout, `camera_params/<scan>/cameras.txt`.
https://www.cs.unc.edu/~ammirato/active_vision_dataset_website
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import MOVES, DatasetFormat
from pipeline.datasets.cameras import Stated, inverse, one_file, or_note, rigid
from pipeline.datasets.files import as_floats, listing, numbered_lines, read_json, read_mat, readable
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.frame import Annotation
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent

FARTHEST_M = 7.0
"""Depth beyond this is left out: the sensor's far values are artefacts."""
DEFAULT_SIZE = (1920, 1080)
"""Width and height of the dataset's own images: the pixels that its boxes speak of where no camera file says more."""
SAME_SHAPE = 0.01
"""An image is a smaller copy of the camera's where their aspect ratios differ by less than this share."""
SCANS_KEPT = 4
"""How many scans' tables stay parsed in memory."""
RGB, REGISTERED_DEPTH = "01", "03"
"""How the names of the colour image and of the depth image registered to it end."""
SMALLEST_SIDE = 1.0
"""A box that is thinner than this inside the image, in pixels, shows nothing."""
LEVEL = 0.5
"""How clearly the cameras must agree on which way is up, -1..1. A level camera agrees by 1."""

SPLITS: dict[str, tuple[str, ...]] = {
    "test 1": ("Home_001_1", "Home_001_2", "Home_008_1"),
    "test 2": ("Home_003_1", "Home_003_2", "Office_001_1"),
    "test 3": ("Home_014_1", "Home_014_2", "Home_002_1"),
}
"""The scans that each of the three splits of the dataset's site tests on; it trains on the others."""


@dataclass(frozen=True)
class _Scan:
    """A scan: its folder and the files that are listed when it is opened."""

    folder: Path
    prefix: str  # How the ids of its frames begin
    images: Mapping[str, str]  # Names of the colour files by stem
    names: Mapping[int, str]  # Of the instances
    first: str  # Stem of the first frame, which carries the notes on the whole scan

    @property
    def camera_files(self) -> tuple[Path, Path]:
        folder = self.folder
        return folder / "cameras.txt", folder.parent / "camera_params" / folder.name / "cameras.txt"


@dataclass(frozen=True)
class AvdPoses:
    """Poses of an `image_structs.mat`."""

    registered: Mapping[str, tuple[np.ndarray, np.ndarray]]
    """mapping of str to (R, t): World-to-camera (3, 3) and (3,) metres by image name without its ending."""
    up: np.ndarray | None  # (3,) float64 or None: Against gravity in the world; None where the cameras do not agree

    def pose(self, stem: str) -> np.ndarray:
        """T_world_camera (4, 4), metres."""
        require(stem in self.registered, "the image is not registered")
        return inverse(rigid(*self.registered[stem]))


Tables = tuple[dict[str, Mapping[str, Any]], AvdPoses | None, tuple[str, ...]]
"""The annotations and the poses of a scan, and what is wrong with either."""


class AvdDataset(Recording):
    """Frames of id the image's name without its ending; of several scans `Home_001_1/000110000010101`.

    The opened folder is a scan or holds scans. The camera is plain pinhole: what `cameras.txt` has beyond that are
    fisheye coefficients, whose effect is within 1 %. Depth beyond `FARTHEST_M` is left out. Boxes are 2D; an
    annotation's `instance` is the dataset's number. Poses and the up vector come from `image_structs.mat`. Images that
    annotations.json lists and that are not there are broken frames.
    """

    format = "avd"
    rule = DepthRule(1000.0, "AVD's", farthest=FARTHEST_M)
    one_size = True

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._tables: Recent[Path, Tables] = Recent(SCANS_KEPT)
        self._index: dict[str, tuple[_Scan, str]] = {}
        labels: dict[int, str] = {}
        for folder, prefix in _scan_folders(root):
            # What is unusable is told when a frame is loaded.
            listed = or_note([], "", read_annotations, folder / "annotations.json") or {}
            images, names = _images(folder / "jpg_rgb", RGB), _names(folder)
            stems = sorted({*images, *listed, *_images(folder / "high_res_depth", REGISTERED_DEPTH)})
            scan = _Scan(folder, prefix, images, names, stems[0] if stems else "")
            self._index.update({prefix + stem: (scan, stem) for stem in stems})
            instances: set[int] = set().union(*map(instances_of, listed.values()))
            labels.update({instance: label_of(instance, names) for instance in instances})
        self.frame_ids = tuple(self._index)
        self.class_names = tuple(dict.fromkeys(labels[i] for i in sorted(labels)))

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        scan, stem = self._found(self._index, frame_id)
        annotations, poses, problems = self._tables.get(scan.folder, partial(_read_tables, scan.folder))
        notes += problems
        of_scan = notes if stem == scan.first else []
        if not scan.names:
            of_scan.append("instance_id_map.txt is missing: the instances are named by their numbers everywhere")
        jpg = scan.folder / "jpg_rgb"
        color = one_file([jpg / scan.images[stem]] if stem in scan.images else [], "colour", jpg / f"{stem}.jpg")
        depth = scan.folder / "high_res_depth" / f"{stem.removesuffix(RGB)}{REGISTERED_DEPTH}.png"
        stated = self._stated(scan, of_scan)
        pose = None if poses is None else or_note(notes, "no camera pose: ", poses.pose, stem)
        if poses is not None and poses.up is None:
            notes.append("no up vector: the cameras of this scan do not agree on one")
        up = None if pose is None or poses is None or poses.up is None else pose[:3, :3].T @ poses.up
        entry = annotations.get(stem)
        if entry is None and annotations:
            notes.append("no entry in annotations.json")
        annotate = partial(read_boxes, entry or {}, scan.names, stated.size or DEFAULT_SIZE)
        return Listed(color, depth, stated, pose, annotate, up)

    def _stated(self, scan: _Scan, notes: list[str]) -> Stated:
        """Camera of a scan. A broken file matters only where the settings do not give the intrinsics."""
        path = next((path for path in scan.camera_files if path.is_file()), None)
        if path is None:
            return Stated(path=scan.camera_files[0])
        if self._settings.intrinsics is None:
            return read_camera(path, notes)
        return or_note([], "", read_camera, path, notes) or Stated(path=path)

    def moves(self, frame_id: str) -> dict[str, str]:
        """Frame ids by possible move of the robot; see `base.moves`. A pointer to an image that is not there is left
        out."""
        scan, stem = self._found(self._index, frame_id)
        entry = self._tables.get(scan.folder, partial(_read_tables, scan.folder))[0].get(stem, {})
        found = {move: image_stem(entry.get(move)) for move in MOVES}
        return {move: scan.prefix + to for move, to in found.items() if to is not None and to in scan.images}

    def splits(self) -> dict[str, tuple[str, ...]]:
        """Test frames of each split of the site, for the scans present; see `SPLITS`."""
        entries = self._index.items()
        found = {
            split: tuple(frame_id for frame_id, (scan, _) in entries if scan.folder.name in scans)
            for split, scans in SPLITS.items()
        }
        return {split: ids for split, ids in found.items() if ids}


def _read_tables(folder: Path) -> Tables:
    notes: list[str] = []
    annotations = or_note(notes, "no annotations, annotations.json: ", read_annotations, folder / "annotations.json")
    poses = or_note(notes, "no camera pose, image_structs.mat: ", read_poses, folder / "image_structs.mat")
    return annotations or {}, poses, tuple(notes)


def image_stem(name: Any, ending: str = RGB) -> str | None:
    """The 15 digits of the colour image of an image such as "000110000010101.jpg"; None for any other name. `ending`:
    How the names of such images end."""
    match = re.fullmatch(rf"([0-9]{{13}}){ending}\.(?:jpe?g|png)", name, re.ASCII) if isinstance(name, str) else None
    return match[1] + RGB if match else None


def _images(folder: Path, ending: str) -> dict[str, str]:
    """Names of the images in a folder by the stem of their colour image."""
    found = {image_stem(name, ending): name for name in (listing(folder)[1] if folder.is_dir() else ())}
    return {stem: name for stem, name in found.items() if stem is not None}


def read_camera(path: Path, notes: list[str]) -> Stated:
    """The first camera of a `cameras.txt`: id, model, width, height, fx fy cx cy, d1 d2 d3 d4. The last four are
    OpenCV's fisheye coefficients; they are left out, with a note, and never read as Brown's k1 k2 p1 p2."""
    lines = numbered_lines(path)
    require(lines, "no camera is listed", path=path)
    number, line = lines[0]
    words = line.split()
    require(
        len(words) in (8, 12),
        f"line {number}: a wrong count",
        got=f"{len(words)} words",
        expected="id model width height fx fy cx cy d1 d2 d3 d4",
        path=path,
    )
    values = as_floats(words[2:], len(words) - 2, path, f"line {number}")
    width, height, fx, fy, cx, cy = values[:6].tolist()
    whole = np.isfinite(values).all() and width == int(width) and height == int(height)
    require(
        whole and min(width, height, fx, fy) > 0,
        f"line {number}: no camera has these numbers",
        got=line[:100],
        path=path,
    )
    if values[6:].any():
        numbers = ", ".join(f"{v:.3g}" for v in values[6:])
        notes.append(f"a plain pinhole camera is used everywhere: its fisheye distortion ({numbers}) is left out")
    if len(lines) > 1:
        notes.append(f"cameras.txt lists {len(lines)} cameras: the first is used everywhere")
    return Stated(intrinsics(fx, fy, cx, cy), (int(width), int(height)), path=path)


def _names(folder: Path) -> dict[int, str]:
    """The instances' names, from the folder of the scans or from the scan's own."""
    paths = (folder.parent / "instance_id_map.txt", folder / "instance_id_map.txt")
    return next((read_names(path) for path in paths if path.is_file()), {})


def read_names(path: Path) -> dict[int, str]:
    """The instances of an `instance_id_map.txt` by number: `name id` a line."""
    names: dict[int, str] = {}
    for number, line in numbered_lines(path):
        words = line.rsplit(maxsplit=1)
        require(
            len(words) == 2 and re.fullmatch(r"[0-9]{1,9}", words[1], re.ASCII),
            f"line {number} must be a name and a number",
            got=repr(line[:60]),
            path=path,
        )
        require(int(words[1]) not in names, f"line {number}: an instance is listed twice", got=words[1], path=path)
        names[int(words[1])] = words[0]
    return names


def read_annotations(path: Path) -> dict[str, Mapping[str, Any]]:
    """Entries of an `annotations.json` by image name without ending. Keys that are no names of colour images are left
    out, and so never become part of a path."""
    stems = {image_stem(name): entry for name, entry in read_json(path).items()}
    return {stem: e if isinstance(e, Mapping) else {} for stem, e in stems.items() if stem is not None}


def instances_of(entry: Mapping[str, Any]) -> set[int]:
    """Instances annotated in an image."""
    boxes = entry.get("bounding_boxes")
    return {row[4] for row in boxes if _is_box(row)} if isinstance(boxes, list) else set()


def label_of(instance: int, names: Mapping[int, str]) -> str:
    """Name of an instance, else "instance_NUMBER"."""
    return names.get(instance) or f"instance_{instance}"


def read_boxes(
    entry: Mapping[str, Any],
    names: Mapping[int, str],
    annotated: tuple[int, int],
    shape: tuple[int, int],
    notes: list[str],
) -> tuple[Annotation, ...]:
    """Annotated instances of an image of `shape` (height, width), in its pixels. `annotated` (width, height): Of the
    image that the boxes speak of."""
    height, width = shape
    require(
        abs(width * annotated[1] / (height * annotated[0]) - 1) <= SAME_SHAPE,
        "the image has another shape than the camera's",
        got=f"{width}x{height}",
        expected=f"{annotated[0]}x{annotated[1]} or a smaller copy of all of it",
    )
    rows = entry.get("bounding_boxes", [])
    if not isinstance(rows, list):
        notes.append("no annotations, bounding_boxes is no list")
        return ()
    scale = np.array([width / annotated[0], height / annotated[1]] * 2)
    found: list[Annotation] = []
    for index, row in enumerate(rows):
        if not _is_box(row):
            notes.append(f"annotation {index}: not xmin, ymin, xmax, ymax, instance, difficulty")
            continue
        instance = row[4]
        label = label_of(instance, names)
        bbox = np.array(row[:4], np.float64) * scale
        clipped = np.clip(bbox, 0, np.array([width, height] * 2, np.float64))
        if min(clipped[2:] - clipped[:2]) < min(SMALLEST_SIDE, *scale[:2]):
            notes.append(f"annotation {index} ({label}): an empty box is left out, {row[:4]}")
            continue
        if (clipped != bbox).any():
            notes.append(f"annotation {index} ({label}): the box is clipped to the image, {row[:4]}")
        if names and instance not in names:
            notes.append(f"annotation {index}: instance {instance} has no name")
        difficulty = row[5] if len(row) == 6 else None
        found.append(Annotation(index, label, clipped, instance=instance, difficulty=difficulty))
    return tuple(found)


def _is_box(row: Any) -> bool:
    """Four numbers, an instance and perhaps a difficulty; JSON has true, NaN and endless numbers too."""
    if not isinstance(row, list) or len(row) not in (5, 6):
        return False
    kinds = all(type(v) in (int, float) for v in row[:4]) and all(type(v) is int for v in row[4:])
    return kinds and all(abs(v) < 1e9 for v in row)


def read_poses(path: Path) -> AvdPoses:
    """Poses of a scan, and the up direction of the world.

    The height axis of that world is y; which of its ends is up differs from reconstruction to reconstruction. The
    robot's cameras are level within a few degrees, so that it is the end that agrees, over all images, with the
    opposite of the camera's own y: the mean of R[1, 1] has its sign.
    """
    table = read_mat(path, "image_structs", "scale")
    structs, scale = np.asarray(table.get("image_structs")), np.asarray(table.get("scale", ()))
    fields = set(structs.dtype.names or ())
    require({"image_name", "R", "t"} <= fields, "no image_structs with image_name, R and t", path=path)
    require(
        scale.size == 1 and scale.dtype.kind in "fiu" and 0 < scale.item() < np.inf,
        "scale must be one positive number",
        got=str(scale.ravel()[:3].tolist()),
        path=path,
    )
    registered: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for record in structs.ravel():
        name = np.asarray(record["image_name"])
        stem = image_stem(str(name.ravel()[0])) if name.size == 1 and name.dtype.kind == "U" else None
        R, t = _floats(record["R"], 9), _floats(record["t"], 3)
        if stem is not None and R is not None and t is not None:
            registered[stem] = R.reshape(3, 3), t * (scale.item() / 1000)
    lean = float(np.mean([R[1, 1] for R, _ in registered.values()])) if registered else 0.0
    return AvdPoses(registered, None if not abs(lean) >= LEVEL else np.array([0.0, -np.sign(lean), 0.0]))


def _floats(value: Any, count: int) -> np.ndarray | None:
    array = np.asarray(value)
    if array.size != count or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        return None
    return np.ascontiguousarray(array, np.float64).ravel()


def _is_scan(folder: Path) -> bool:
    return os.path.isdir(folder / "jpg_rgb") and (
        os.path.isdir(folder / "high_res_depth") or os.path.isfile(folder / "annotations.json")
    )


def _scan_folders(root: Path) -> list[tuple[Path, str]]:
    """(folder, how the frames' ids begin) of each scan."""
    if _is_scan(root):
        return [(root.resolve(), "")]
    return [(root.resolve() / name, f"{name}/") for name in listing(root)[0] if _is_scan(root / name)]


def _recognises(root: Path) -> bool:
    """Recognise a scan, or a folder of scans with the dataset's own files or little else."""
    if _is_scan(root):
        return True
    folders = readable(root)[0]
    scans = sum(_is_scan(root / name) for name in folders)
    marked = os.path.isfile(root / "instance_id_map.txt") or os.path.isdir(root / "camera_params")
    return scans > 0 and (marked or 2 * scans > len(folders))


FORMAT = DatasetFormat(
    "avd",
    "avd: jpg_rgb/ with high_res_depth/ or annotations.json, here or in <scan>/",
    _recognises,
    AvdDataset,
)
