"""Rendered frames as a BOP scene: images, masks, poses, visibility, and the models' exact boxes."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.datasets.synthetic.layout import Room
from pipeline.datasets.synthetic.raycast import silhouette
from pipeline.datasets.synthetic.render import RenderedFrame

DEPTH_SCALE = 0.5
"""Millimetres a depth unit. Below the noise at every distance, and up to 32 m fit into 16 bits."""

LEAST_PIXELS = 30
"""An instance with fewer visible pixels is left out of the frame."""

JPEG_QUALITY = 92


@dataclass
class SceneRecord:
    """What is to be written about a scene beside its images; objects are still named by their model's key.

    Attributes
    ----------
    camera, gt, gt_info : dict
        The contents of the scene's three JSON files by image number.
    models : dict
        By model key, in order of appearance: the entry of models_info.json.
    """

    camera: dict[str, dict[str, Any]] = field(default_factory=dict)
    gt: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    gt_info: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    models: dict[str, dict[str, Any]] = field(default_factory=dict)


def write_frame(folder: Path, image: int, room: Room, frame: RenderedFrame, record: SceneRecord) -> None:
    """Write the images and masks of one frame into the scene's folder and note the rest in `record`."""
    for name in ("rgb", "depth", "mask_visib"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    units = np.rint(frame.depth * (1000 / DEPTH_SCALE)).astype(np.uint16)
    _write(folder / "rgb" / f"{image:06d}.jpg", frame.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    _write(folder / "depth" / f"{image:06d}.png", units, [cv2.IMWRITE_PNG_COMPRESSION, 5])
    pose = frame.camera.T_world_camera
    assert pose is not None
    T_camera_world = np.linalg.inv(pose)
    key = str(image)
    record.camera[key] = {
        "cam_K": _numbers(frame.camera.K),
        "depth_scale": DEPTH_SCALE,
        "cam_R_w2c": _numbers(T_camera_world[:3, :3]),
        "cam_t_w2c": _numbers(1000 * T_camera_world[:3, 3]),
    }
    record.gt[key], record.gt_info[key] = [], []
    counts = np.bincount(frame.instances[frame.instances >= 0], minlength=len(room.instances))
    for k, index in enumerate(np.flatnonzero(counts >= LEAST_PIXELS)):
        instance = room.instances[index]
        T = T_camera_world @ instance.T_world_model
        model = instance.model
        record.models.setdefault(model.key, _model_info(model.label, model.low, model.high))
        record.gt[key].append(
            {"obj_id": model.key, "cam_R_m2c": _numbers(T[:3, :3]), "cam_t_m2c": _numbers(1000 * T[:3, 3])}
        )
        mask = frame.instances == index
        record.gt_info[key].append(_visibility(room, int(index), frame, mask))
        _write(
            folder / "mask_visib" / f"{image:06d}_{k:06d}.png",
            mask.astype(np.uint8) * 255,
            [cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_BILEVEL, 1],
        )


def write_scene(folder: Path, record: SceneRecord, numbers: dict[str, int]) -> None:
    """Write the scene's three JSON files; `numbers` maps model keys to obj_id."""
    gt = {
        image: [{**entry, "obj_id": numbers[entry["obj_id"]]} for entry in entries]
        for image, entries in record.gt.items()
    }
    for name, content in (("scene_camera", record.camera), ("scene_gt", gt), ("scene_gt_info", record.gt_info)):
        write_json(folder / f"{name}.json", content)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """One line an image or model, as BOP's own files are laid out."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ",\n".join(f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in content.items())
    path.write_text("{\n" + lines + "\n}\n", encoding="utf-8")


def _model_info(label: str, low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    size = high - low
    names = [f"{kind}_{axis}" for kind in ("min", "size") for axis in "xyz"]
    values = np.round(1000 * np.concatenate([low, size]), 3).tolist()
    return {
        "name": label,
        "diameter": round(1000 * float(np.linalg.norm(size)), 3),
        **dict(zip(names, values, strict=True)),
    }


def _visibility(room: Room, index: int, frame: RenderedFrame, mask: np.ndarray) -> dict[str, Any]:
    h, w = mask.shape
    step, v, u = silhouette(room, index, frame.camera)
    inside = (v >= 0) & (v < h) & (u >= 0) & (u < w)
    seen = int(mask[v[inside], u[inside]].sum())
    visible = int(mask.sum())
    whole = max(len(v) * step * step, visible)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    # A sampled silhouette can miss a thing a few pixels wide.
    fraction = seen / len(v) if step > 1 and len(v) else visible / whole
    return {
        "bbox_visib": _xywh(rows, columns),
        "bbox_obj": _xywh(v, u) if len(v) else _xywh(rows, columns),
        "px_count_all": whole,
        "px_count_valid": int((frame.depth[mask] > 0).sum()),
        "px_count_visib": visible,
        "visib_fract": round(min(1.0, fraction), 4),
    }


def _xywh(rows: np.ndarray, columns: np.ndarray) -> list[int]:
    x, y = int(columns.min()), int(rows.min())
    return [x, y, int(columns.max()) - x + 1, int(rows.max()) - y + 1]


def _numbers(array: np.ndarray) -> list[float]:
    return [round(float(x), 9) for x in np.asarray(array).ravel()]


def _write(path: Path, image: np.ndarray, options: list[int]) -> None:
    if not cv2.imwrite(str(path), image, options):
        raise OSError(f"could not write {path}")
