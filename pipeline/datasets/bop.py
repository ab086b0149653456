"""BOP: scenes with instance masks, object poses and cameras.

`<root>/<scene>/{rgb,depth,mask_visib}/`, `scene_camera.json`, `scene_gt.json`,
`scene_gt_info.json`, and `<root>/models/models_info.json`; lengths in millimetres.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.bop_scene import (
    BopScene,
    ObjectModel,
    annotated_objects,
    object_pose,
    read_camera,
    read_images,
    read_models,
    read_pose,
    read_scene,
)
from pipeline.datasets.cameras import Recording, one_file, or_note, read_pair
from pipeline.datasets.files import COLOR_SUFFIXES, as_floats, listing
from pipeline.datasets.images import read_mask
from pipeline.datasets.settings import Settings
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Annotation, Frame
from pipeline.system.errors import InputError

SCENES_KEPT = 8
"""How many scenes' tables stay parsed in memory."""


class BopDataset(Recording):
    """Frames of id `<scene>/<image:06d>`, the scene being its folder's own name.

    The opened folder may be a dataset, one of its splits, a dataset of splits
    (`test/000001`; with more than one split the id begins with the split's
    name), or a single scene. Class names and exact boxes come from a `models`
    folder inside the opened one; without it the classes are `obj_000012`.
    """

    format = "bop"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._models: dict[int, ObjectModel] = read_models(root)
        self._scenes: dict[str, BopScene] = {}
        self._folders = _scene_folders(root)
        gray = [f for f in self._folders.values() if (f / "gray").is_dir() and not (f / "rgb").is_dir()]
        if gray and len(gray) == len(self._folders):
            raise InputError("grey-scale images only", expected="a folder rgb/ with colour images", path=gray[0])
        self._class_names: tuple[str, ...] | None = None
        self._place: dict[str, tuple[str, int]] = {}
        for scene, folder in self._folders.items():
            for image in read_images(folder / "scene_camera.json"):
                self._place[f"{scene}/{image:06d}"] = (scene, image)
        self.frame_ids = tuple(self._place)

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes that are annotated anywhere, in the order of their object numbers."""
        if self._class_names is None:
            numbers: set[int] = set()
            for folder in self._folders.values():
                numbers |= annotated_objects(folder)
            self._class_names = tuple(dict.fromkeys(self._label(number) for number in sorted(numbers)))
        return self._class_names

    def load(self, frame_id: str) -> Frame:
        """Decode one frame; see `Dataset.load`."""
        return self._load(frame_id, annotated=True)

    def load_picture(self, frame_id: str) -> Frame:
        """The same without annotations: their masks are most of what there is to decode."""
        return self._load(frame_id, annotated=False)

    def _load(self, frame_id: str, annotated: bool) -> Frame:
        name, image = self._found(self._place, frame_id)
        scene = self._scene(name)
        table = scene.folder / "scene_camera.json"
        if image not in scene.camera:
            raise InputError(f"image {image} is no longer listed", path=table)
        entry, settings = scene.camera[image], self._settings
        K, units_per_metre = read_camera(entry, table, image)
        color = _image(scene.folder / "rgb", image, COLOR_SUFFIXES)
        depth = _image(scene.folder / "depth", image, (".png", ".tif", ".tiff"))
        pair = read_pair(color, depth, settings.depth_scale or units_per_metre)
        notes: list[str] = []
        pose = or_note(notes, "no camera pose: ", read_pose, entry, table)
        annotations = self._annotations(scene, image, pair[1].shape, notes) if annotated else ()
        return self._frame(frame_id, pair, K, pose, table, depth, annotations, notes)

    def _scene(self, name: str) -> BopScene:
        scene = self._scenes.get(name)
        if scene is None:
            scene = read_scene(self._folders[name])
            while len(self._scenes) >= SCENES_KEPT:
                self._scenes.pop(next(iter(self._scenes)), None)
            self._scenes[name] = scene
        return scene

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
        if not isinstance(entries, list):
            raise InputError(f"image {image}: a list was expected", got=type(entries).__name__, path=path)
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
        T = or_note(remarks, "no 3D box, ", object_pose, entry, path)
        return None if T is None else Box3D(T[:3, :3] @ model.center + T[:3, 3], T[:3, :3], model.size)


def _extent(
    mask_path: Path | None, info: Mapping[str, Any], size: tuple[int, ...], info_path: Path, remarks: list[str]
) -> tuple[np.ndarray, np.ndarray | None]:
    """The box (4,) and the mask of one annotation; the box is the mask's own where there is one.

    Raises
    ------
    InputError
        Nothing visible is left, so that the annotation must be dropped.
    """
    if mask_path is not None and not mask_path.is_file():
        remarks.append(f"the mask {mask_path.name} is missing")
        mask_path = None
    if mask_path is None:
        if "bbox_visib" not in info:
            raise InputError("neither a mask nor a bbox_visib")
        x, y, w, h = as_floats(info["bbox_visib"], 4, info_path, "bbox_visib")
        if not (np.isfinite([x, y, w, h]).all() and w > 0 and h > 0):
            raise InputError("an empty bbox_visib")
        return np.array([x, y, x + w, y + h]), None
    try:
        mask = read_mask(mask_path)
    except InputError as error:
        raise InputError(f"a broken mask, {error.what}, {mask_path.name}") from error
    if mask.shape != size:
        raise InputError(f"the mask {mask_path.name} is {mask.shape[1]}x{mask.shape[0]}, not {size[1]}x{size[0]}")
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    if w == 0:
        raise InputError("empty mask")
    return np.array([x, y, x + w, y + h]), mask


def _visible(info: Mapping[str, Any]) -> float | None:
    share = info.get("visib_fract")
    if isinstance(share, bool) or not isinstance(share, (int, float)) or not 0 <= share <= 1 + 1e-6:
        return None
    return min(float(share), 1.0)


def _image(folder: Path, image: int, suffixes: tuple[str, ...]) -> Path:
    candidates = [folder / f"{image:06d}{suffix}" for suffix in suffixes]
    return one_file([path for path in candidates if path.is_file()], folder.name, candidates[0])


def _scene_folders(root: Path) -> dict[str, Path]:
    """The scene folders by the name they have in a frame's id."""
    if _is_scene(root):
        return {root.resolve().name: root}
    folders = listing(root)[0]
    scenes = {name: root / name for name in folders if _is_scene(root / name)}
    if scenes:
        return scenes
    splits: dict[str, dict[str, Path]] = {}
    for split in folders:
        try:
            names = listing(root / split)[0]
        except InputError:  # A folder that may not be read is no split.
            continue
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
