"""BOP: scenes with instance masks, object poses and cameras.

`<root>/<scene>/{rgb,depth,mask_visib}/`, `scene_camera.json`, `scene_gt.json`, `scene_gt_info.json`, and
`<root>/models/models_info.json`; lengths in millimetres in the files, in metres here.
https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import Stated, inverse, one_file, or_note, rigid
from pipeline.datasets.files import as_floats, listing, read_bytes, read_json, readable
from pipeline.datasets.images import read_held_mask
from pipeline.datasets.pairing import COLOR_SUFFIXES
from pipeline.datasets.recording import Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Annotation
from pipeline.geometry.masks import PictureMask
from pipeline.system.errors import InputError, needed, require
from pipeline.system.recent import Recent

TABLES_BYTES = 16 << 20
"""Bytes of the files of scenes' tables that stay parsed; parsed they take some seven times as many."""
MM = 1e-3
Model = tuple[str | None, Box3D | None]
"""The extra key `name`, which BOP itself does not have, and the exact box in the object's own frame, metres."""
NO_MODEL: Model = None, None


class BopDataset(Recording):
    """Frames of id `<scene>/<image:06d>`; the scene is the folder's name.

    The opened folder may be a dataset, one of its splits, a dataset of splits (`test/000001`; with more than one split
    the id begins with the split's name), or a single scene. Class names and exact boxes come from a `models` folder
    inside the opened one; without it the classes are `obj_000012`.
    """

    format = "bop"
    many_masks = True
    again = r"(.*/)?(scene_gt(_info)?\.json|mask(_visib)?/.*)"
    one_size = True

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._models = read_models(root)
        self._tables: Recent[Path, dict[int, Any]] = Recent(TABLES_BYTES, os.path.getsize)
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

    @property
    def class_names(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Annotated classes, read on first use."""
        return self._class_names

    @cached_property
    def _class_names(self) -> tuple[str, ...]:
        """Annotated classes, in the order of object numbers."""
        numbers: set[int] = set().union(*map(annotated_objects, self._folders.values()))
        return tuple(dict.fromkeys(self._label(number) for number in sorted(numbers)))

    def _table(self, path: Path) -> dict[int, Any]:
        return self._tables.get(path, partial(read_images, path))

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        name, image = self._found(self._index, frame_id)
        folder = self._folders[name]
        table = folder / "scene_camera.json"
        entry = needed(self._table(table).get(image), f"image {image} is no longer listed", path=table)
        stated = read_camera(entry, table, image)
        color = _image(folder / "rgb", image, COLOR_SUFFIXES)
        depth = _image(folder / "depth", image, (".png", ".tif", ".tiff"))
        pose = or_note(notes, "no camera pose: ", read_pose, entry, table)
        return Listed(color, depth, stated, pose, partial(self._annotations, folder, image))

    def _label(self, number: int) -> str:
        return self._models.get(number, NO_MODEL)[0] or f"obj_{number:06d}"

    def _annotations(self, folder: Path, image: int, size: tuple[int, ...], notes: list[str]) -> tuple[Annotation, ...]:
        path, info_path = folder / "scene_gt.json", folder / "scene_gt_info.json"
        if not path.is_file():
            return ()
        entries = self._table(path).get(image)
        if entries is None:
            notes.append("no entry in scene_gt.json")
            return ()
        require(isinstance(entries, list), f"image {image}: a list was expected", got=type(entries).__name__, path=path)
        infos = self._table(info_path).get(image) if info_path.is_file() else None
        if infos is not None and (not isinstance(infos, list) or len(infos) != len(entries)):
            notes.append(f"scene_gt_info.json is ignored: its list does not match the {len(entries)} objects")
            infos = None
        masks = folder / "mask_visib"
        has_masks = masks.is_dir()
        found: list[Annotation] = []
        poses = _all_rigid_mm(entries, path) if self._models else None
        for index, entry in enumerate(entries):
            number = entry.get("obj_id") if isinstance(entry, Mapping) else None
            if not isinstance(number, int) or isinstance(number, bool) or number < 0:
                notes.append(f"annotation {index}: no obj_id")
                continue
            info = infos[index] if infos is not None and isinstance(infos[index], Mapping) else {}
            mask_path = masks / f"{image:06d}_{index:06d}.png" if has_masks else None
            label = self._label(number)
            remarks: list[str] = []
            pose = None if poses is None else poses[index]
            box = _box(entry, self._models.get(number, NO_MODEL)[1], path, remarks, pose)
            try:
                extent = _extent(mask_path, info, size, info_path, remarks)
                if isinstance(extent, PictureMask):
                    found.append(Annotation.of_mask(index, label, extent, box=box, visible=_visible(info)))
                else:
                    found.append(Annotation(index, label, extent, box=box, visible=_visible(info)))
            except InputError as error:
                remarks = [error.what]
            notes.extend(f"annotation {index} ({label}): {what}" for what in remarks)
        return tuple(found)


def _box(
    entry: Mapping[str, Any], box: Box3D | None, path: Path, remarks: list[str], T: np.ndarray | None
) -> Box3D | None:
    """The exact box of an object in the camera frame; `T` is the entry's pose where it was read with the others'."""
    if box is not None and T is None:
        T = or_note(remarks, "no 3D box, ", _rigid_mm, entry, *_POSE, path)
    return None if box is None or T is None else box.transformed(T)


_POSE = "cam_R_m2c", "cam_t_m2c"


def _all_rigid_mm(entries: Sequence[Any], path: Path) -> np.ndarray | None:
    """Poses of all objects, (N, 4, 4); None where one is none: each then says for itself what is wrong with it."""
    try:
        told = [[entry[key] for entry in entries] for key in _POSE]
        if not entries or any(len(own) != size for kind, size in zip(told, (9, 3), strict=True) for own in kind):
            return None
        R, t = (as_floats([*chain(*kind)], size * len(entries), path) for kind, size in zip(told, (9, 3), strict=True))
        return rigid(R.reshape(-1, 3, 3), t.reshape(-1, 3) * MM)
    except (InputError, KeyError, TypeError):
        return None


def _extent(
    mask_path: Path | None, info: Mapping[str, Any], size: tuple[int, ...], info_path: Path, remarks: list[str]
) -> PictureMask | np.ndarray:
    """Mask of an annotation, or its box (4,) without one."""
    why: list[str] = []
    mask = None if mask_path is None else or_note(why, "a broken mask, ", read_held_mask, mask_path)
    if mask is None and mask_path is not None and not mask_path.is_file():
        remarks.append(f"the mask {mask_path.name} is missing")
        mask_path = None
    if mask_path is None:
        require("bbox_visib" in info, "neither a mask nor a bbox_visib")
        x, y, w, h = as_floats(info["bbox_visib"], 4, info_path, "bbox_visib")
        require((np.isfinite([x, y, w, h]).all() and w > 0 and h > 0), "an empty bbox_visib")
        return np.array([x, y, x + w, y + h])
    mask = needed(mask, f"{''.join(why)}, {mask_path.name}")
    if mask.size != size:
        raise InputError(f"the mask {mask_path.name} is {mask.size[1]}x{mask.size[0]}, not {size[1]}x{size[0]}")
    require(mask.crop.mask.size, "empty mask")
    return mask


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
    # A folder with models names its own objects: it is a dataset beside others, and no split of this one.
    names = {split: readable(root / split)[0] for split in folders}
    splits = [split for split in folders if not any(name.startswith("models") for name in names[split])]
    inside = {(split, name): root / split / name for split in splits for name in names[split]}
    found = {key: path for key, path in inside.items() if _is_scene(path)}
    several = len({split for split, _ in found}) > 1
    return {f"{split}/{name}" if several else name: path for (split, name), path in found.items()}


def _is_scene(folder: Path) -> bool:
    return os.path.isfile(folder / "scene_camera.json")


FORMAT = DatasetFormat(
    "bop",
    "bop: scene_camera.json with rgb/ and depth/, here, in <scene>/ or in <split>/<scene>/",
    lambda root: bool(_scene_folders(root)),
    BopDataset,
)


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


def read_camera(entry: Any, path: Path, image: int) -> Stated:
    """Intrinsics and depth units of an entry of `scene_camera.json`."""
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
    return Stated(K, units_per_metre=1 / (scale * MM), path=path)


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


def read_models(root: Path) -> dict[int, Model]:
    """Objects by number, from `models/models_info.json` and variants (`models_eval`, ...). Where several folders speak
    of an object, `models` comes first and the others fill in what it leaves out."""
    models: dict[int, Model] = {}
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
            name, box = models.get(int(key), NO_MODEL)
            own = entry.get("name")
            name = name or (own.strip() if isinstance(own, str) else None)
            models[int(key)] = name or None, box or or_note([], "", _model_box, entry, path)
    return models


def _model_box(entry: Mapping[str, Any], path: Path) -> Box3D:
    """Exact axis-aligned box of an object in its own frame; InputError where unknown or empty."""
    low, size = (
        as_floats([entry.get(f"{kind}_{axis}") for axis in "xyz"], 3, path, kind) * MM for kind in ("min", "size")
    )
    require((size > 0).all(), "an empty box")
    return Box3D(low + size / 2, np.eye(3), size)


def annotated_objects(folder: Path) -> set[int]:
    """Object numbers in a scene's `scene_gt.json`. Matched rather than parsed: parsing every scene of a large dataset
    takes seconds, and a malformed scene is reported frame by frame anyway."""
    data = or_note([], "", read_bytes, folder / "scene_gt.json") or b""
    return {int(number) for number in re.findall(rb'"obj_id"\s*:\s*([0-9]{1,12})', data)}
