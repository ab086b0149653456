"""The JSON tables of one BOP scene and of the BOP models, checked, in metres.

https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.cameras import inverse, rigid
from pipeline.datasets.files import as_floats, listing, read_bytes, read_json
from pipeline.system.errors import InputError

MM = 1e-3


@dataclass(frozen=True)
class ObjectModel:
    """What `models_info.json` says of one object.

    Attributes
    ----------
    name : str or None
        The extra key `name`, which BOP itself does not have.
    center, size : (3,) float64 or None
        The exact axis-aligned box in the object's own frame, metres.
    """

    name: str | None
    center: np.ndarray | None
    size: np.ndarray | None


@dataclass(frozen=True)
class BopScene:
    """The three tables of a scene, each keyed by image number.

    Attributes
    ----------
    folder : Path
    camera : dict
        `scene_camera.json`.
    gt, gt_info : dict or None
        `scene_gt.json` and `scene_gt_info.json`; None where there is no such file.
    """

    folder: Path
    camera: Mapping[int, Any]
    gt: Mapping[int, Any] | None
    gt_info: Mapping[int, Any] | None


def read_images(path: Path) -> dict[int, Any]:
    """A table keyed by image number, in their order.

    Raises
    ------
    InputError
        Malformed JSON, or a key that is no plain number: a key becomes part of
        a file name, so "../1" must not pass.
    """
    images: dict[int, Any] = {}
    for key, value in read_json(path).items():
        if not re.fullmatch(r"[0-9]{1,12}", key):
            raise InputError(
                "an image number must be digits only",
                got=repr(key)[:60],
                expected='a key such as "20"',
                path=path,
            )
        if int(key) in images:
            raise InputError("an image number is listed twice", got=repr(key), path=path)
        images[int(key)] = value
    return dict(sorted(images.items()))


def read_scene(folder: Path) -> BopScene:
    """The tables of a scene folder.

    Raises
    ------
    InputError
        A table that is malformed, or no `scene_camera.json`.
    """
    optional: list[dict[int, Any] | None] = []
    for name in ("scene_gt.json", "scene_gt_info.json"):
        path = folder / name
        optional.append(read_images(path) if path.is_file() else None)
    return BopScene(folder, read_images(folder / "scene_camera.json"), *optional)


def read_camera(entry: Any, path: Path, image: int) -> tuple[np.ndarray, float]:
    """K (3, 3) and the depth units in one metre of one entry of `scene_camera.json`.

    Raises
    ------
    InputError
        Either is missing, not a number, or not finite.
    """
    if not isinstance(entry, Mapping):
        raise InputError(f"image {image}: a camera must be an object", got=type(entry).__name__, path=path)
    for key in ("cam_K", "depth_scale"):
        if key not in entry:
            raise InputError(f"image {image}: {key} is missing", path=path)
    K = as_floats(entry["cam_K"], 9, path, f"image {image}: cam_K").reshape(3, 3)
    scale = float(as_floats(entry["depth_scale"], 1, path, f"image {image}: depth_scale")[0])
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"image {image}: depth_scale must be positive", got=f"{scale:g}", path=path)
    return K, 1 / (scale * MM)


def read_pose(entry: Mapping[str, Any], path: Path) -> np.ndarray | None:
    """T_world_camera (4, 4) in metres, from the optional cam_R_w2c and cam_t_w2c; None without them.

    Raises
    ------
    InputError
        One of the two without the other, or no rigid motion.
    """
    if "cam_R_w2c" not in entry and "cam_t_w2c" not in entry:
        return None
    return inverse(_rigid_mm(entry, "cam_R_w2c", "cam_t_w2c", path))


def object_pose(entry: Mapping[str, Any], path: Path) -> np.ndarray:
    """T_camera_object (4, 4) in metres of one entry of `scene_gt.json`.

    Raises
    ------
    InputError
        A missing key, or no rigid motion.
    """
    return _rigid_mm(entry, "cam_R_m2c", "cam_t_m2c", path)


def _rigid_mm(entry: Mapping[str, Any], R_key: str, t_key: str, path: Path) -> np.ndarray:
    for key in (R_key, t_key):
        if key not in entry:
            raise InputError(f"{key} is missing", path=path)
    R = as_floats(entry[R_key], 9, path, R_key).reshape(3, 3)
    return rigid(R, as_floats(entry[t_key], 3, path, t_key) * MM)


def read_models(root: Path) -> dict[int, ObjectModel]:
    """The objects by number, from `models/models_info.json` and its variants (`models_eval`, ...).

    Where several folders speak of an object, `models` comes first and the
    others fill in what it leaves out.

    Raises
    ------
    InputError
        A malformed file.
    """
    models: dict[int, ObjectModel] = {}
    for folder in listing(root)[0]:
        path = root / folder / "models_info.json"
        if not re.fullmatch(r"models(_\w+)?", folder) or not path.is_file():
            continue
        for key, entry in read_json(path).items():
            if not re.fullmatch(r"[0-9]{1,12}", key) or not isinstance(entry, Mapping):
                raise InputError(f"model {key[:60]!r} is malformed", expected='"12": {...}', path=path)
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
    """The object numbers that occur in a scene's `scene_gt.json`.

    Matched rather than parsed: parsing every scene of a large dataset takes
    seconds, and a malformed scene is reported frame by frame anyway.
    """
    path = folder / "scene_gt.json"
    if not path.is_file():
        return set()
    try:
        data = read_bytes(path)
    except InputError:
        return set()
    return {int(number) for number in re.findall(rb'"obj_id"\s*:\s*([0-9]{1,12})', data)}
