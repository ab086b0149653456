"""BOP: scenes with instance masks, object poses and cameras.

`<root>/<scene>/{rgb,depth,mask_visib}/`, `scene_camera.json`, `scene_gt.json`, `scene_gt_info.json`, and
`<root>/models/models_info.json`; lengths in millimetres in the files, in metres here.
https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import inverse, one_file, or_note, read_pair, rigid
from pipeline.datasets.files import as_floats, listing, read_bytes, read_json, readable
from pipeline.datasets.images import read_mask
from pipeline.datasets.pairing import COLOR_SUFFIXES
from pipeline.datasets.recording import Recording
from pipeline.datasets.settings import Settings
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.masks import mask_box
from pipeline.system.errors import InputError, require
from pipeline.system.recent import Recent

SCENES_KEPT = 8
"""How many scenes' tables stay parsed in memory."""


class BopDataset(Recording):
    """Frames of id `<scene>/<image:06d>`; the scene is the folder's name.

    The opened folder may be a dataset, one of its splits, a dataset of splits (`test/000001`; with more than one split
    the id begins with the split's name), or a single scene. Class names and exact boxes come from a `models` folder
    inside the opened one; without it the classes are `obj_000012`.
    """

    format = "bop"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._models: dict[int, ObjectModel] = read_models(root)
        self._scenes: Recent[str, BopScene] = Recent(SCENES_KEPT)
        self._folders = _scene_folders(root)
        gray = [f for f in self._folders.values() if (f / "gray").is_dir() and not (f / "rgb").is_dir()]
        if gray and len(gray) == len(self._folders):
            raise InputError("grey-scale images only", expected="a folder rgb/ with colour images", path=gray[0])
        self._index = {
            f"{scene}/{image:06d}": (scene, image)
            for scene, folder in self._folders.items()
            for image in read_images(folder / "scene_camera.json")
        }
        self.frame_ids = tuple(self._index)

    @cached_property
    def _class_names(self) -> tuple[str, ...]:
        """Annotated classes, in the order of object numbers."""
        numbers: set[int] = set().union(*map(annotated_objects, self._folders.values()))
        return tuple(dict.fromkeys(self._label(number) for number in sorted(numbers)))

    @property
    def class_names(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Annotated classes, read on first use."""
        return self._class_names

    def load(self, frame_id: str) -> Frame:
        """Decode a frame; see `Dataset.load`."""
        return self._load(frame_id, annotated=True)

    def load_picture(self, frame_id: str) -> Frame:
        """Decode a frame without annotations."""
        return self._load(frame_id, annotated=False)

    def _load(self, frame_id: str, annotated: bool) -> Frame:
        name, image = self._found(self._index, frame_id)
        scene = self._scenes.get(name, lambda: read_scene(self._folders[name]))
        table = scene.folder / "scene_camera.json"
        require(image in scene.camera, f"image {image} is no longer listed", path=table)
        entry, settings = scene.camera[image], self._settings
        K, units_per_metre = read_camera(entry, table, image)
        color = _image(scene.folder / "rgb", image, COLOR_SUFFIXES)
        depth = _image(scene.folder / "depth", image, (".png", ".tif", ".tiff"))
        pair = read_pair(color, depth, settings.depth_scale or units_per_metre)
        notes: list[str] = []
        pose = or_note(notes, "no camera pose: ", read_pose, entry, table)
        annotations = self._annotations(scene, image, pair[1].shape, notes) if annotated else ()
        return self._frame(frame_id, pair, K, pose, table, depth, annotations, notes)

    def _label(self, number: int) -> str:
        model = self._models.get(number)
        return (model.name if model else None) or f"obj_{number:06d}"

    def _annotations(
        self, scene: BopScene, image: int, size: tuple[int, ...], notes: list[str]
    ) -> tuple[Annotation, ...]:
        if scene.gt is None:
            return ()
        path = scene.folder / "scene_gt.json"
        if image not in scene.gt:
            notes.append("no entry in scene_gt.json")
            return ()
        entries = scene.gt[image]
        require(isinstance(entries, list), f"image {image}: a list was expected", got=type(entries).__name__, path=path)
        infos = scene.gt_info.get(image) if scene.gt_info is not None else None
        if infos is not None and (not isinstance(infos, list) or len(infos) != len(entries)):
            notes.append(f"scene_gt_info.json is ignored: its list does not match the {len(entries)} objects")
            infos = None
        has_masks = (scene.folder / "mask_visib").is_dir()
        found: list[Annotation] = []
        for index, entry in enumerate(entries):
            number = entry.get("obj_id") if isinstance(entry, Mapping) else None
            if not isinstance(number, int) or isinstance(number, bool) or number < 0:
                notes.append(f"annotation {index}: no obj_id")
                continue
            info = infos[index] if infos is not None and isinstance(infos[index], Mapping) else {}
            mask_path = scene.folder / "mask_visib" / f"{image:06d}_{index:06d}.png" if has_masks else None
            label = self._label(number)
            remarks: list[str] = []
            box = self._box(entry, self._models.get(number), path, remarks)
            try:
                bbox, mask = _extent(mask_path, info, size, scene.folder / "scene_gt_info.json", remarks)
                found.append(Annotation(index, label, bbox, mask, box, _visible(info)))
            except InputError as error:
                remarks = [error.what]
            notes.extend(f"annotation {index} ({label}): {what}" for what in remarks)
        return tuple(found)

    @staticmethod
    def _box(entry: Mapping[str, Any], model: ObjectModel | None, path: Path, remarks: list[str]) -> Box3D | None:
        """The exact box in the camera frame: center = R (min + size / 2) + t."""
        if model is None or model.center is None or model.size is None:
            return None
        T = or_note(remarks, "no 3D box, ", _rigid_mm, entry, "cam_R_m2c", "cam_t_m2c", path)
        return None if T is None else Box3D(T[:3, :3] @ model.center + T[:3, 3], T[:3, :3], model.size)


def _extent(
    mask_path: Path | None, info: Mapping[str, Any], size: tuple[int, ...], info_path: Path, remarks: list[str]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Box (4,) and mask of an annotation; the box is the mask's where a mask exists."""
    if mask_path is not None and not mask_path.is_file():
        remarks.append(f"the mask {mask_path.name} is missing")
        mask_path = None
    if mask_path is None:
        require("bbox_visib" in info, "neither a mask nor a bbox_visib")
        x, y, w, h = as_floats(info["bbox_visib"], 4, info_path, "bbox_visib")
        require((np.isfinite([x, y, w, h]).all() and w > 0 and h > 0), "an empty bbox_visib")
        return np.array([x, y, x + w, y + h]), None
    try:
        mask = read_mask(mask_path)
    except InputError as error:
        raise InputError(f"a broken mask, {error.what}, {mask_path.name}") from error
    require(
        mask.shape == size, f"the mask {mask_path.name} is {mask.shape[1]}x{mask.shape[0]}, not {size[1]}x{size[0]}"
    )
    require(mask.any(), "empty mask")
    return np.array(mask_box(mask)), mask


def _visible(info: Mapping[str, Any]) -> float | None:
    share = info.get("visib_fract")
    if isinstance(share, bool) or not isinstance(share, (int, float)) or not 0 <= share <= 1 + 1e-6:
        return None
    return min(float(share), 1.0)


def _image(folder: Path, image: int, suffixes: tuple[str, ...]) -> Path:
    candidates = [folder / f"{image:06d}{suffix}" for suffix in suffixes]
    return one_file([path for path in candidates if path.is_file()], folder.name, candidates[0])


def _scene_folders(root: Path) -> dict[str, Path]:
    """Scene folders by prefix of the frame ids."""
    if _is_scene(root):
        return {root.resolve().name: root}
    folders = listing(root)[0]
    scenes = {name: root / name for name in folders if _is_scene(root / name)}
    if scenes:
        return scenes
    splits: dict[str, dict[str, Path]] = {}
    for split in folders:
        names = readable(root / split)[0]
        if any(name.startswith("models") for name in names):
            # It names its own objects, so it is a dataset beside others and no split of this one.
            continue
        inside = {name: root / split / name for name in names if _is_scene(root / split / name)}
        if inside:
            splits[split] = inside
    if len(splits) == 1:
        return next(iter(splits.values()))
    return {f"{split}/{name}": path for split, inside in splits.items() for name, path in inside.items()}


def _is_scene(folder: Path) -> bool:
    return os.path.isfile(folder / "scene_camera.json")


FORMAT = DatasetFormat(
    "bop",
    "bop: scene_camera.json with rgb/ and depth/, here, in <scene>/ or in <split>/<scene>/",
    lambda root: bool(_scene_folders(root)),
    BopDataset,
)


MM = 1e-3


@dataclass(frozen=True)
class ObjectModel:
    """An object of `models_info.json`."""

    name: str | None  # The extra key `name`, which BOP itself does not have
    center: np.ndarray | None
    size: np.ndarray | None  # (3,) float64 or None: The exact axis-aligned box in the object's own frame, metres


@dataclass(frozen=True)
class BopScene:
    """The three tables of a scene, each keyed by image number."""

    folder: Path
    camera: Mapping[int, Any]  # `scene_camera.json`
    gt: Mapping[int, Any] | None
    gt_info: Mapping[int, Any] | None  # `scene_gt.json` and `scene_gt_info.json`; None where there is no such file


def read_images(path: Path) -> dict[int, Any]:
    """A table keyed by image number, in their order."""
    images: dict[int, Any] = {}
    for key, value in read_json(path).items():
        require(
            re.fullmatch(r"[0-9]{1,12}", key),
            "an image number must be digits only",
            got=repr(key)[:60],
            expected='a key such as "20"',
            path=path,
        )
        require(int(key) not in images, "an image number is listed twice", got=repr(key), path=path)
        images[int(key)] = value
    return dict(sorted(images.items()))


def read_scene(folder: Path) -> BopScene:
    """The tables of a scene folder."""
    optional = (folder / name for name in ("scene_gt.json", "scene_gt_info.json"))
    gt, gt_info = (read_images(path) if path.is_file() else None for path in optional)
    return BopScene(folder, read_images(folder / "scene_camera.json"), gt, gt_info)


def read_camera(entry: Any, path: Path, image: int) -> tuple[np.ndarray, float]:
    """Intrinsics K (3, 3) and depth units per metre of an entry of `scene_camera.json`."""
    require(
        isinstance(entry, Mapping), f"image {image}: a camera must be an object", got=type(entry).__name__, path=path
    )
    for key in ("cam_K", "depth_scale"):
        require(key in entry, f"image {image}: {key} is missing", path=path)
    K = as_floats(entry["cam_K"], 9, path, f"image {image}: cam_K").reshape(3, 3)
    scale = float(as_floats(entry["depth_scale"], 1, path, f"image {image}: depth_scale")[0])
    require(
        (np.isfinite(scale) and scale > 0), f"image {image}: depth_scale must be positive", got=f"{scale:g}", path=path
    )
    return K, 1 / (scale * MM)


def read_pose(entry: Mapping[str, Any], path: Path) -> np.ndarray | None:
    """Pose T_world_camera (4, 4) in metres, from the optional cam_R_w2c and cam_t_w2c; else None."""
    if "cam_R_w2c" not in entry and "cam_t_w2c" not in entry:
        return None
    return inverse(_rigid_mm(entry, "cam_R_w2c", "cam_t_w2c", path))


def _rigid_mm(entry: Mapping[str, Any], R_key: str, t_key: str, path: Path) -> np.ndarray:
    for key in (R_key, t_key):
        require(key in entry, f"{key} is missing", path=path)
    R = as_floats(entry[R_key], 9, path, R_key).reshape(3, 3)
    return rigid(R, as_floats(entry[t_key], 3, path, t_key) * MM)


def read_models(root: Path) -> dict[int, ObjectModel]:
    """Objects by number, from `models/models_info.json` and variants (`models_eval`, ...). Where several folders speak
    of an object, `models` comes first and the others fill in what it leaves out."""
    models: dict[int, ObjectModel] = {}
    for folder in listing(root)[0]:
        path = root / folder / "models_info.json"
        if not re.fullmatch(r"models(_\w+)?", folder) or not path.is_file():
            continue
        for key, entry in read_json(path).items():
            require(
                re.fullmatch(r"[0-9]{1,12}", key) and isinstance(entry, Mapping),
                f"model {key[:60]!r} is malformed",
                expected='"12": {...}',
                path=path,
            )
            found, known = _model(entry), models.get(int(key), ObjectModel(None, None, None))
            exact = known if known.size is not None else found
            models[int(key)] = ObjectModel(known.name or found.name, exact.center, exact.size)
    return models


def _model(entry: Mapping[str, Any]) -> ObjectModel:
    name = entry.get("name")
    name = name.strip() if isinstance(name, str) else None
    keys = [f"{kind}_{axis}" for kind in ("min", "size") for axis in "xyz"]
    try:
        values = np.array([entry[key] for key in keys], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        return ObjectModel(name or None, None, None)
    low, size = values[:3] * MM, values[3:] * MM
    if not np.isfinite(values).all() or (size <= 0).any():
        return ObjectModel(name or None, None, None)
    return ObjectModel(name or None, low + size / 2, size)


def annotated_objects(folder: Path) -> set[int]:
    """Object numbers in a scene's `scene_gt.json`. Matched rather than parsed: parsing every scene of a large dataset
    takes seconds, and a malformed scene is reported frame by frame anyway."""
    path = folder / "scene_gt.json"
    if not path.is_file():
        return set()
    try:
        data = read_bytes(path)
    except InputError:
        return set()
    return {int(number) for number in re.findall(rb'"obj_id"\s*:\s*([0-9]{1,12})', data)}
