"""A whole synthetic dataset: rooms, views, and the files of BOP scenes, put in place only when complete."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.synthetic.layout import Room
from pipeline.synthetic.raycast import pose_of, silhouette
from pipeline.synthetic.render import RenderedFrame, choose_views, render_view
from pipeline.synthetic.rooms import make_room
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.plugins import versions_of
from pipeline.system.whole_files import temporary_folder
from pipeline.system.worker_pool import results_of

ROOMS_A_SEED = 1_000_000
"""Room i of dataset seed s has the room seed s * ROOMS_A_SEED + i, so datasets never share a room."""

SMALLEST_SIDE = 16


@dataclass(frozen=True)
class RenderReport:
    """Summary of a rendering.

    Attributes
    ----------
    objects : int
        Annotated instances, summed over frames.
    classes : tuple of str
        Class names that are annotated somewhere, sorted.
    """

    out: Path
    frames: int
    rooms: int
    objects: int
    classes: tuple[str, ...]
    seconds: float


def render_dataset(
    out: Path,
    *,
    rooms: int = 4,
    views: int = 3,
    seed: int = 0,
    width: int = 640,
    height: int = 480,
    progress: Callable[[int, int], None] | None = None,
    workers: int = 1,
) -> RenderReport:
    """Render annotated RGB-D rooms in BOP format.

    Parameters
    ----------
    out : Path
        Folder to make; it may exist if it is empty.
    rooms, views : int
        Rooms, and frames of each.
    seed : int
        Equal arguments give byte-identical files, whatever `workers`.
    width, height : int
        Pixels.
    progress : callable, optional
        Called with (frames done, frames in all) after each room.
    workers : int
        Processes, each of which renders whole rooms; with more than one the calling script must be importable (`if
        __name__ == "__main__"`): they are spawned. Hence one by default.

    Raises
    ------
    InputError
        `out` is not empty, or an argument makes no sense.
    MissingExtra
        embreex is not installed.
    """
    out = Path(out)
    _check(out, rooms, views, seed, width, height, workers)
    started = time.perf_counter()
    with temporary_folder(out) as partial:
        jobs = [(partial / f"{k + 1:06d}", seed * ROOMS_A_SEED + k, views, width, height) for k in range(rooms)]
        records: list[SceneRecord] = []
        for record in results_of(_render_room, jobs, workers):
            records.append(record)
            if progress is not None:
                progress(views * len(records), views * rooms)
        models = {key: info for record in records for key, info in record.models.items()}
        numbers = {key: k + 1 for k, key in enumerate(models)}
        for job, record in zip(jobs, records, strict=True):
            write_scene(job[0], record, numbers)
        write_json(partial / "models" / "models_info.json", {str(numbers[key]): models[key] for key in models})
        command = (
            f"spatialviz render OUT --rooms {rooms} --views {views} --seed {seed} --width {width} --height {height}"
        )
        (partial / "spatialviz.toml").write_text(_declaration(command, seed), encoding="utf-8")
        if out.exists():
            out.rmdir()
        os.replace(partial, out)
    objects = sum(len(entries) for record in records for entries in record.gt.values())
    classes = tuple(sorted({str(info["name"]) for info in models.values()}))
    return RenderReport(out, rooms * views, rooms, objects, classes, time.perf_counter() - started)


def _check(out: Path, rooms: int, views: int, seed: int, width: int, height: int, workers: int) -> None:
    for name, value in (("rooms", rooms), ("views", views), ("workers", workers)):
        require(value >= 1, f"{name} must be at least 1", got=value)
    require(seed >= 0, "a seed must not be negative", got=seed)
    require(
        min(width, height) >= SMALLEST_SIDE,
        "the picture is too small",
        got=f"{width}x{height}",
        expected=f"at least {SMALLEST_SIDE} pixels a side",
    )
    require(
        not (out.exists() and not out.is_dir()),
        "the output is a file",
        expected="a folder that is empty or does not exist",
        path=out,
    )
    require(
        not (out.is_dir() and any(out.iterdir())),
        "the output folder is not empty",
        expected="a folder that is empty or does not exist",
        cause="is an earlier rendering in it?",
        path=out,
    )


Job = tuple[Path, int, int, int, int]


def _render_room(job: Job) -> SceneRecord:
    """Render the views of a room."""
    folder, room_seed, views, width, height = job
    record = SceneRecord()
    room = make_room(room_seed)
    cameras = choose_views(room, views, np.random.default_rng([room_seed, 11]), width, height)
    for k, camera in enumerate(cameras):
        frame = render_view(room, camera, np.random.default_rng([room_seed, 13, k]))
        write_frame(folder, k, room, frame, record)
    return record


def _declaration(command: str, seed: int) -> str:
    """Text of the dataset's `spatialviz.toml`: z is up, and the generator."""
    tool = versions_of("spatialviz").get("spatialviz", "unknown")
    return (
        'name = "spatialviz synthetic rooms"\n'
        "world_up = [0, 0, 1]\n\n"
        "[generator]\n"
        'tool = "spatialviz render"\n'
        f"version = {json.dumps(tool)}\n"
        f"seed = {seed}\n"
        f"command = {json.dumps(command)}\n"
    )


DEPTH_SCALE = 0.5
"""Millimetres a depth unit. Below the noise at every distance, and up to 32 m fit into 16 bits."""
LEAST_PIXELS = 30
"""An instance with fewer visible pixels is left out of the frame."""
JPEG_QUALITY = 92


@dataclass
class SceneRecord:
    """JSON content of a scene; objects are keyed by model."""

    camera: dict[str, dict[str, Any]] = field(default_factory=dict)
    gt: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    gt_info: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    """The contents of the scene's three JSON files by image number."""
    models: dict[str, dict[str, Any]] = field(default_factory=dict)
    """By model key, in order of appearance: the entry of models_info.json."""


def write_frame(folder: Path, image: int, room: Room, frame: RenderedFrame, record: SceneRecord) -> None:
    """Write images and masks of a frame into the scene's folder and extend `record`."""
    for name in ("rgb", "depth", "mask_visib"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    units = np.rint(frame.depth * (1000 / DEPTH_SCALE)).astype(np.uint16)
    _write(folder / "rgb" / f"{image:06d}.jpg", frame.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    _write(folder / "depth" / f"{image:06d}.png", units, [cv2.IMWRITE_PNG_COMPRESSION, 5])
    T_camera_world = np.linalg.inv(pose_of(frame.camera))
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
    """Write JSON with a line per image or model, in BOP's layout."""
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
    # OpenCV's own writing does not say why it cannot.
    path.write_bytes(cv2.imencode(path.suffix, image, options)[1].tobytes())
