"""Active Vision Dataset: scans of rooms by a robot, with instance boxes and the moves between images.

`<scan>/{jpg_rgb,high_res_depth}/`, `annotations.json`, `image_structs.mat`, `cameras.txt`; beside the
scans `instance_id_map.txt` and, in another layout, `camera_params/<scan>/cameras.txt`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.datasets.avd_scan import (
    DEFAULT_SIZE,
    REGISTERED_DEPTH,
    RGB,
    AvdCamera,
    AvdPoses,
    image_stem,
    instances_of,
    label_of,
    read_annotations,
    read_boxes,
    read_camera,
    read_names,
    read_poses,
)
from pipeline.datasets.base import MOVES, DatasetFormat
from pipeline.datasets.cameras import one_file, or_note, read_pair
from pipeline.datasets.files import listing, readable
from pipeline.datasets.recording import Recording
from pipeline.datasets.settings import Settings, unit_notes
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError, require
from pipeline.system.recent import Recent

UNITS_PER_METRE = 1000.0
FARTHEST_M = 7.0
"""Depth beyond this is left out: the sensor's far values are artefacts."""
SAME_SHAPE = 0.01
"""An image is a smaller copy of the camera's where their aspect ratios differ by less than this share."""
SCANS_KEPT = 4
"""How many scans' tables stay parsed in memory."""

SPLITS: dict[str, tuple[str, ...]] = {
    "test 1": ("Home_001_1", "Home_001_2", "Home_008_1"),
    "test 2": ("Home_003_1", "Home_003_2", "Office_001_1"),
    "test 3": ("Home_014_1", "Home_014_2", "Home_002_1"),
}
"""The scans that each of the three splits of the dataset's site tests on; it trains on the others."""


@dataclass(frozen=True)
class _Scan:
    """A scan's folder, images by name without ending, and the prefix of its frame ids."""

    folder: Path
    name: str
    prefix: str
    images: Mapping[str, str]
    names: Mapping[int, str]
    first: str

    @property
    def camera_files(self) -> tuple[Path, ...]:
        return (
            self.folder / "cameras.txt",
            self.folder.parent / "camera_params" / self.name / "cameras.txt",
        )


@dataclass(frozen=True)
class _Tables:
    """Annotations and poses of a scan, each with the reason where missing."""

    annotations: Mapping[str, Mapping[str, Any]]
    poses: AvdPoses | None
    problems: tuple[str, ...]


class AvdDataset(Recording):
    """Frames of id the image's name without its ending; of several scans `Home_001_1/000110000010101`.

    The opened folder is a scan or holds scans. The camera is plain pinhole: what `cameras.txt` has beyond that are
    fisheye coefficients, whose effect is within 1 %. Depth beyond `FARTHEST_M` is left out. Boxes are 2D; an
    annotation's `instance` is the dataset's number. Poses and the up vector come from `image_structs.mat`. Images that
    annotations.json lists and that are not there are broken frames.
    """

    format = "avd"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._tables: Recent[str, _Tables] = Recent(SCANS_KEPT)
        self._scans: dict[str, _Scan] = {}
        self._index: dict[str, tuple[str, str]] = {}
        labels: dict[int, str] = {}
        for name, folder, prefix in _scan_folders(root):
            listed, instances = _listed(folder)
            images = _images(folder / "jpg_rgb")
            stems = sorted(set(images) | listed | _depths(folder / "high_res_depth"))
            names = _names(folder)
            self._scans[name] = _Scan(folder, name, prefix, images, names, stems[0] if stems else "")
            self._index.update({prefix + stem: (name, stem) for stem in stems})
            labels.update({instance: label_of(instance, names) for instance in instances})
        self.frame_ids = tuple(self._index)
        self.notes = unit_notes(settings, UNITS_PER_METRE, "AVD's")
        self.class_names: tuple[str, ...] = tuple(dict.fromkeys(labels[i] for i in sorted(labels)))

    def load(self, frame_id: str) -> Frame:
        """Decode a frame; see `Dataset.load`."""
        scan, stem = self._stem(frame_id)
        tables = self._tables.get(scan.name, lambda: _read_tables(scan))
        first = stem == scan.first
        notes: list[str] = list(tables.problems)
        jpg = scan.folder / "jpg_rgb"
        color = one_file([jpg / scan.images[stem]] if stem in scan.images else [], "colour", jpg / f"{stem}.jpg")
        depth = scan.folder / "high_res_depth" / f"{stem.removesuffix(RGB)}{REGISTERED_DEPTH}.png"
        rgb, metres = read_pair(color, depth, self._settings.depth_scale or UNITS_PER_METRE)
        metres[metres > FARTHEST_M] = 0
        height, width = metres.shape
        own, path = self._camera(scan)
        annotated = DEFAULT_SIZE if own is None else (own.width, own.height)
        require(
            abs(width * annotated[1] / (height * annotated[0]) - 1) <= SAME_SHAPE,
            "the image has another shape than the camera's",
            got=f"{width}x{height}",
            expected=f"{annotated[0]}x{annotated[1]} or a smaller copy of all of it",
            path=color,
        )
        if first:
            notes += _remarks(scan, own, annotated, (width, height))
        pose, up = None, None
        if tables.poses is not None:
            pose = or_note(notes, "no camera pose: ", tables.poses.pose, stem)
            if tables.poses.up is None:
                notes.append("no up vector: the cameras of this scan do not agree on one")
            elif pose is not None:
                up = pose[:3, :3].T @ tables.poses.up
        K = None if own is None else own.resized(width, height)
        entry = tables.annotations.get(stem)
        if entry is None and tables.annotations:
            notes.append("no entry in annotations.json")
        annotations = () if entry is None else read_boxes(entry, scan.names, annotated, (width, height), notes)
        return self._frame(frame_id, (rgb, metres), K, pose, path, depth, annotations, notes, up)

    def moves(self, frame_id: str) -> dict[str, str]:
        """Frame ids by possible move of the robot; see `base.moves`. A pointer to an image that is not there is left
        out."""
        scan, stem = self._stem(frame_id)
        entry = self._tables.get(scan.name, lambda: _read_tables(scan)).annotations.get(stem, {})
        found = {move: image_stem(entry.get(move)) for move in MOVES}
        return {move: scan.prefix + to for move, to in found.items() if to is not None and to in scan.images}

    def splits(self) -> dict[str, tuple[str, ...]]:
        """Test frames of each split of the site, for the scans present; see `SPLITS`."""
        entries = self._index.items()
        found = {
            split: tuple(frame_id for frame_id, (scan, _) in entries if scan in scans)
            for split, scans in SPLITS.items()
        }
        return {split: ids for split, ids in found.items() if ids}

    def _stem(self, frame_id: str) -> tuple[_Scan, str]:
        name, stem = self._found(self._index, frame_id)
        return self._scans[name], stem

    def _camera(self, scan: _Scan) -> tuple[AvdCamera | None, Path]:
        """Camera of the scan and the file to blame; None without a file or where the settings give the intrinsics. A
        broken file matters only where no person told them."""
        path = next((path for path in scan.camera_files if path.is_file()), None)
        if path is None:
            return None, scan.camera_files[0]
        try:
            return read_camera(path), path
        except InputError:
            if self._settings.intrinsics is None:
                raise
            return None, path


def _remarks(scan: _Scan, own: AvdCamera | None, annotated: tuple[int, int], size: tuple[int, int]) -> list[str]:
    """Remarks on the whole scan, for the first frame."""
    notes: list[str] = []
    if not scan.names:
        notes.append("instance_id_map.txt is missing: the instances are named by their numbers everywhere")
    if own is not None and any(own.fisheye):
        numbers = ", ".join(f"{v:.3g}" for v in own.fisheye)
        notes.append(f"a plain pinhole camera is used everywhere: its fisheye distortion ({numbers}) is left out")
    if own is not None and own.others:
        notes.append(f"cameras.txt lists {own.others + 1} cameras: the first is used everywhere")
    if size != annotated:
        notes.append(
            f"images of {size[0]}x{size[1]}: the camera and the boxes of {annotated[0]}x{annotated[1]} "
            "are scaled to them everywhere"
        )
    return notes


def _read_tables(scan: _Scan) -> _Tables:
    problems: list[str] = []
    annotations = or_note(
        problems, "no annotations, annotations.json: ", read_annotations, scan.folder / "annotations.json"
    )
    poses = or_note(problems, "no camera pose, image_structs.mat: ", read_poses, scan.folder / "image_structs.mat")
    return _Tables(annotations or {}, poses, tuple(problems))


def _listed(folder: Path) -> tuple[set[str], set[int]]:
    """Images and instances of a scan's annotations; none where unreadable."""
    # What is unusable is told when a frame is loaded.
    table = or_note([], "", read_annotations, folder / "annotations.json") or {}
    return set(table), set().union(*map(instances_of, table.values()))


def _names(folder: Path) -> dict[int, str]:
    """The instances' names, from the folder of the scans or from the scan's own."""
    for path in (folder.parent / "instance_id_map.txt", folder / "instance_id_map.txt"):
        if path.is_file():
            return read_names(path)
    return {}


def _images(folder: Path) -> dict[str, str]:
    found = {image_stem(name): name for name in listing(folder)[1]}
    return {stem: name for stem, name in found.items() if stem is not None}


def _depths(folder: Path) -> set[str]:
    """Colour images with a registered depth image in the scan."""
    if not folder.is_dir():
        return set()
    ending = f"{REGISTERED_DEPTH}.png"
    names = [name.removesuffix(ending) for name in listing(folder)[1] if name.endswith(ending)]
    found = {image_stem(f"{name}{RGB}.jpg") for name in names}
    return {stem for stem in found if stem is not None}


def _is_scan(folder: Path) -> bool:
    return os.path.isdir(folder / "jpg_rgb") and (
        os.path.isdir(folder / "high_res_depth") or os.path.isfile(folder / "annotations.json")
    )


def _scan_folders(root: Path) -> list[tuple[str, Path, str]]:
    """(name, folder, how the frames' ids begin) of each scan."""
    if _is_scan(root):
        folder = root.resolve()
        return [(folder.name, folder, "")]
    names = [name for name in listing(root)[0] if _is_scan(root / name)]
    return [(name, root.resolve() / name, f"{name}/") for name in names]


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
