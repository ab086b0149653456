"""Posed pictures of scene reconstructions: nerfstudio's `transforms.json`, COLMAP's models.

https://docs.nerf.studio/quickstart/data_conventions.html, https://colmap.github.io/format.html
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import (
    NOTHING,
    Stated,
    flat_numbers,
    inverse,
    or_note,
    pose_from_matrix,
    pose_from_quaternion,
    stated_in,
)
from pipeline.datasets.colmap_binary import read_cameras, read_images
from pipeline.datasets.files import as_floats, goes_up, leaves, name_inside, numbered_lines, read_json, readable
from pipeline.datasets.frame_poses import OPENCV_OF_OPENGL
from pipeline.datasets.images import INTEGER_DEPTH_SUFFIXES, picture_size
from pipeline.datasets.pairing import choose_naming, files_in_roles, role_of
from pipeline.datasets.recording import DepthRule, Listed, Recording
from pipeline.datasets.settings import OR_ESTIMATED, Settings
from pipeline.geometry.camera import intrinsics
from pipeline.system.errors import InputError, needed, require

TRANSFORMS = "transforms.json"
INTEGER_DEPTH = "integer_depth_scale"
MOST_KEYS = 1000
"""Beside the frames: each frame has them."""
MODEL_FOLDERS = (
    "",
    "sparse",
    "sparse/0",
    "colmap/sparse/0",
    "colmap/sparse",
    "colmap/text",
    "colmap_text",
    "dense/sparse",
    "dense/0/sparse",
    "distorted/sparse/0",
)
DEPTH_MAPS = "stereo/depth_maps"
DENSE = ("", "dense", "dense/0")
"""Where a dense workspace of COLMAP may be: what `image_undistorter` makes, with pictures and a model of its own."""
FOCALS = {"SIMPLE_PINHOLE": 1, "SIMPLE_RADIAL": 1, "RADIAL": 1, "SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 1}
"""How many focal lengths a camera model of COLMAP has, where it is not two; then cx cy and the lens follow."""


class PosedPicture(NamedTuple):
    """An entry of a picture list: files relative to the dataset, with what reads its camera and its pose."""

    color: str
    depth: str | None
    camera: Callable[[Path], Stated]  # Of the colour file
    pose: Callable[[], np.ndarray] | None  # T_world_camera (4, 4)


class PosedPictures(Recording):
    """Base of posed picture lists: the id is the picture's name; depth is named, or paired by name."""

    source: Path
    lens = False
    """Whether the cameras have a distortion that is left out."""

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._entries = self._list()
        require(self._entries, "a list of pictures without one", path=self.source)
        self.frame_ids = tuple(self._entries)
        entries = self._entries.values()
        require(
            settings.estimated or any(entry.depth is not None for entry in entries),
            f"{len(self._entries)} posed pictures without depth",
            expected=f"a folder depth/ with a file of the same name or number for each, {OR_ESTIMATED}",
            path=self.source,
        )
        integer = any(e.depth is not None and e.depth.lower().endswith(INTEGER_DEPTH_SUFFIXES) for e in entries)
        # Cameras are read one by one, when their pictures are.
        self._ask_for(f"{len(self._entries)} posed pictures with depth", Stated(np.eye(3)), not integer)
        if self.lens:
            self.notes += ("lens distortion is left out: each camera is taken for a plain pinhole",)

    def _list(self) -> dict[str, PosedPicture]:
        """Pictures by frame id (subclasses)."""
        raise NotImplementedError

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        entry = self._found(self._entries, frame_id)
        color, depth = self.root / entry.color, None if entry.depth is None else self.root / entry.depth
        if not self._settings.estimated:
            depth = needed(depth, "the depth file is missing", path=color)
        stated = NOTHING if self._settings.intrinsics is not None else entry.camera(color)
        pose = None if entry.pose is None else or_note(notes, "no camera pose: ", entry.pose)
        return Listed(color, depth, stated, pose)

    def _with_depths(self, entries: dict[str, PosedPicture]) -> dict[str, PosedPicture]:
        """Entries with the depth file of the same number or name."""
        depths = files_in_roles(self.root, "depth")
        if not depths:
            return entries
        naming = choose_naming([entry.color for entry in entries.values()], depths)
        known = {naming(name): name for name in depths}
        return {frame_id: entry._replace(depth=known.get(naming(entry.color))) for frame_id, entry in entries.items()}


class NerfstudioDataset(PosedPictures):
    """Pictures of `transforms.json`: camera-to-world poses of OpenGL cameras, depth in millimetres. Its world has z up
    by the makers' convention, which reconstructions keep only roughly: it is not declared. The file may stand in a
    folder of the opened one and name pictures in another."""

    format = "nerfstudio"
    rule = DepthRule(1000.0, "nerfstudio's")

    def _list(self) -> dict[str, PosedPicture]:
        self.source = self.root / (_transforms(self.root) or TRANSFORMS)
        table = read_json(self.source)
        frames = table.get("frames")
        if not isinstance(frames, list):
            raise InputError("a list of frames is missing", path=self.source)
        shared = {key: value for key, value in table.items() if key != "frames"}
        require(len(shared) <= MOST_KEYS, f"{len(shared)} names beside the frames", path=self.source)
        found: dict[str, PosedPicture] = {}
        elsewhere = False
        for number, frame in enumerate(frames):
            path = frame.get("file_path") if isinstance(frame, Mapping) else None
            require(isinstance(path, str), f"frame {number} names no file", path=self.source)
            color = os.path.normpath(self._inside(f"{path}", number))
            elsewhere |= leaves(f"{path}") and not goes_up(f"{path}")
            stem, suffix = os.path.splitext(os.path.basename(color))
            color = color if suffix else f"{color}.png"
            depth = next((frame[key] for key in ("depth_file_path", "depth_path") if frame.get(key)), None)
            depth = None if depth is None else self._inside(str(depth), number)
            own = {k: v for k, v in frame.items() if k not in ("transform_matrix", "file_path", "depth_file_path")}
            frame_id = stem if stem not in found else f"{os.path.basename(os.path.dirname(color))}/{stem}"
            table = {**shared, **own}
            self.lens |= any(table.get(key) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
            T = frame.get("transform_matrix")
            pose = None if T is None else partial(_opengl_pose, T, self.source)
            found[frame_id] = PosedPicture(color, depth, partial(_nerfstudio_camera, table, self.source), pose)
        units = _integer_depth({**shared, **next((f for f in frames if isinstance(f, Mapping)), {})}, self.source)
        if units is not None and self._settings.depth_scale is None:
            # The maker's own unit is for files that state none.
            self.notes = (f"the depth's unit is that of {INTEGER_DEPTH}, {units:g} to a metre of the poses",)
        if elsewhere:
            self.notes += (f"absolute paths of {TRANSFORMS} are looked for in this folder by their last parts",)
        return found if any(entry.depth for entry in found.values()) else self._with_depths(found)

    def _inside(self, name: str, number: int) -> str:
        """A file as `transforms.json` names it, relative to the opened folder; InputError where it lies outside."""
        place = os.path.relpath(self.source.parent, self.root)
        if not goes_up(name):
            return os.path.join(place, name_inside(name, self.source, number))
        whole = os.path.normpath(os.path.join(place, name.replace("\\", "/")))
        above = "" if whole.startswith("../..") else f", or the folder above both opened: {self.root.resolve().parent}"
        require(
            not goes_up(whole),
            f"frame {number} names a file outside the dataset, above its folder",
            got=repr(name[:80]),
            expected=f"pictures in the opened folder{above}",
            path=self.source,
        )
        return name_inside(whole, self.root / TRANSFORMS, number)


def _transforms(root: Path) -> str | None:
    """Path of `transforms.json` relative to a folder: in it, or in the only folder of it that has one, where that names
    pictures outside its own."""
    if os.path.isfile(root / TRANSFORMS):
        return TRANSFORMS
    inside = [f"{name}/{TRANSFORMS}" for name in readable(root)[0] if os.path.isfile(root / name / TRANSFORMS)]
    frames = (or_note([], "", read_json, root / inside[0]) or {}).get("frames") if len(inside) == 1 else None
    first = frames[0] if isinstance(frames, list) and frames else None
    return inside[0] if isinstance(first, Mapping) and goes_up(str(first.get("file_path"))) else None


def _integer_depth(table: Mapping[str, Any], source: Path) -> float | None:
    """Depth units in a metre of the poses by `integer_depth_scale`, what a stored whole number is multiplied with; see
    https://github.com/NVlabs/instant-ngp/blob/master/docs/nerf_dataset_tips.md."""
    scale = table.get(INTEGER_DEPTH)
    if scale is None:
        return None
    (value,) = as_floats(scale, 1, source, INTEGER_DEPTH)
    require(0 < value < np.inf, f"{INTEGER_DEPTH} must be positive", got=value, path=source)
    return 1 / float(value)


def _nerfstudio_camera(table: Mapping[str, Any], source: Path, picture: Path) -> Stated:
    return replace(_pinhole_of(table, source, picture), units_per_metre=_integer_depth(table, source))


def _pinhole_of(table: Mapping[str, Any], source: Path, picture: Path) -> Stated:
    stated = stated_in(dict(flat_numbers(table)), source)
    size = stated.size or picture_size(picture)
    if stated.K is not None:
        return half_pixel(stated.K, size, source)
    angle = table.get("camera_angle_x")
    if size is None or not isinstance(angle, int | float) or not 0 < angle < math.pi:
        return Stated(path=source)
    focal = size[0] / 2 / math.tan(angle / 2)
    return half_pixel(intrinsics(focal, focal, size[0] / 2, size[1] / 2), size, source)


def _opengl_pose(pose: Any, source: Path) -> np.ndarray:
    return pose_from_matrix(as_floats(pose, 16, source, "transform_matrix").reshape(4, 4) @ OPENCV_OF_OPENGL)


class ColmapDataset(PosedPictures):
    """Pictures of a COLMAP model, `cameras` and `images` as `.txt` or `.bin`; their poses are world-to-camera.

    The length of the model's unit is whatever the reconstruction took it for: the poses are right up to scale. Without
    a folder of depth it is that of the dense workspace, `stereo/depth_maps/NAME.geometric.bin` or `.photometric.bin`,
    in the model's unit; see https://colmap.github.io/format.html, *Dense Reconstruction*.
    """

    format = "colmap"
    again = r"(.*/)?(cameras|images|points3D|rigs|frames|project)\.(bin|txt|ini|ply)|(dense/(0/)?)?stereo/.*\.(cfg|bin)"

    def _list(self) -> dict[str, PosedPicture]:
        folder = needed(_model(self.root), "no COLMAP model", path=self.root)
        self._dense = _workspace(self.root)
        cameras: dict[str, Sequence[str]] = {}
        if (folder / "images.txt").is_file():
            self.source = folder / "images.txt"
            for _, line in numbered_lines(folder / "cameras.txt"):
                number, *words = line.split()
                cameras[number] = words
            # The picture's line and its points' line take turns, and the points' may be empty.
            lines = [line.split() for _, line in numbered_lines(self.source)]
            pictures = [
                words for words in lines if len(words) >= 10 and not words[9].lstrip("-").replace(".", "").isdigit()
            ]
        else:
            self.source = folder / "images.bin"
            cameras |= read_cameras(folder / "cameras.bin")
            pictures = read_images(self.source)
        found: dict[str, PosedPicture] = {}
        for words in pictures:
            name = name_inside(" ".join(words[9:]), self.source, 0)
            color = os.path.join(self._folder(name), name)
            stem = os.path.splitext(os.path.basename(color))[0]
            frame_id = stem if stem not in found else name
            camera = partial(_colmap_camera, cameras.get(words[8]), self.source)
            found[frame_id] = PosedPicture(
                color, self._map(name), camera, partial(_colmap_pose, words[1:8], self.source)
            )
        self.lens = any(len(words) > 3 and not words[0].endswith("PINHOLE") for words in cameras.values())
        entries = dict(sorted(found.items()))
        what = "poses' scale is" if self._dense is None else "scale of poses and depth is"
        self.notes += (f"the {what} the reconstruction's own, which need not be metres",)
        if self._dense is None:
            return self._with_depths(entries)
        self.rule = DepthRule(1.0, "the model's")
        return entries

    def _map(self, name: str) -> str | None:
        """The depth map of a picture in the dense workspace, relative to the dataset."""
        start = os.path.join(self._dense or "", DEPTH_MAPS, name)
        maps = (f"{start}.{kind}.bin" for kind in ("geometric", "photometric"))
        return None if self._dense is None else next((m for m in maps if os.path.isfile(self.root / m)), None)

    def _folder(self, name: str) -> str:
        """Folder of a picture, relative to the dataset."""
        folders = ("images", "color", "rgb", "")
        places = [os.path.join(self._dense or "", folder) for folder in folders]
        return next((place for place in places if os.path.isfile(self.root / place / name)), places[0])


def _colmap_camera(camera: Sequence[str] | None, source: Path, picture: Path) -> Stated:
    words = needed(camera, "a picture of an unknown camera", path=source)
    model, *text = words
    values = as_floats(text, len(text), source, "a camera")
    focals = FOCALS.get(model, 2)
    require(len(values) >= focals + 4, "a camera without intrinsics", got=" ".join(words)[:60], path=source)
    width, height, *rest = values.tolist()
    K = intrinsics(rest[0], rest[focals - 1], rest[focals], rest[focals + 1])
    return half_pixel(K, stated_in({"w": np.array([width]), "h": np.array([height])}).size, source)


def _colmap_pose(words: Sequence[str], source: Path) -> np.ndarray:
    qw, qx, qy, qz, *t = as_floats(words, 7, source, "a pose").tolist()
    return inverse(pose_from_quaternion(np.array([*t, qx, qy, qz, qw])))


def half_pixel(K: np.ndarray, size: tuple[int, int] | None, path: Path) -> Stated:
    """Shift intrinsics by half a pixel: from corner-based pixels to centre-based pixels."""
    K = K.copy()
    K[:2, 2] -= 0.5
    return Stated(K, size, path=path)


def _workspace(root: Path) -> str | None:
    """The dense workspace in a folder, relative to it; None where there is none, or a folder of depth beside it."""
    if any(role_of(folder)[0] == "depth" for folder in readable(root)[0]):
        return None
    return next((place for place in DENSE if os.path.isdir(root / place / DEPTH_MAPS)), None)


def _model(root: Path) -> Path | None:
    """Folder of the model, first of the dense workspace, whose pictures and cameras are its own."""
    folders = [root / name for name in (os.path.join(_workspace(root) or "", "sparse"), *MODEL_FOLDERS)]
    kinds = ({"cameras.txt", "images.txt"}, {"cameras.bin", "images.bin"})
    return next((f for f in folders for names in kinds if names <= set(readable(f)[1])), None)


NERFSTUDIO = DatasetFormat(
    "nerfstudio",
    f"nerfstudio: {TRANSFORMS} with depth files",
    lambda root: _transforms(root) is not None,
    NerfstudioDataset,
)
COLMAP = DatasetFormat(
    "colmap",
    "colmap: cameras.txt and images.txt, or both as .bin, here or in sparse/0/, with images/ and depth/",
    lambda root: _model(root) is not None,
    ColmapDataset,
)
