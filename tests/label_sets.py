"""Label sets for tests: those of the demo, and ones with everything odd that a dataset can bring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.geometry import Box3D, encode_run_length, viewer_axes
from pipeline.labels import (
    MANIFEST_FILE,
    SCHEMA_VERSION,
    TABLES,
    LabelConfig,
    Labels,
    Manifest,
    SourceSpec,
    build_table,
    label_dataset,
    open_labels,
    write_table,
)
from pipeline.labels.reading import arrow_schema, content_hash
from pipeline.labels.schema import TableFile
from pipeline.language import PAIRWISE
from pipeline.system import pa

Vector = Sequence[float] | np.ndarray
WIDTH, HEIGHT = 64, 48
K = [60.0, 0.0, 31.5, 0.0, 61.5, 23.5, 0.0, 0.0, 1.0]

NASTY = (
    'mug "blue", large',
    "line\nbreak\ttab",
    "=SUM(A1:A9)",
    "Ünïcode 椅子",
    "potted 🪴 plant",
    "a\u2028b",
    "back\\slash",
    "DontCare",
    "x~2",
    "x",
    "{braces} %s",
    "<image>",
    "  spaced  ",
    "nul\x00inside",
    "-1 -1 -1 -1000",
)


def label_demo(folder: Path, frames: int = 12) -> Labels:
    """Labels of the first frames of the built-in dataset, of all of them by default; all relations."""
    label_dataset(SourceSpec("demo"), folder, LabelConfig(vocabulary="all"), limit=frames, frames_a_shard=4)
    return open_labels(folder)


def write_labels(folder: Path, rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> Labels:
    """A labels folder of given rows, checked against the schema; columns that a row lacks are null."""
    folder.mkdir(parents=True)
    files = {}
    for name in TABLES:
        columns = {c: [row.get(c) for row in rows.get(name, ())] for c in arrow_schema(name).names}
        table = build_table(name, columns)
        validate_rows(table, name)
        write_table(table, folder / f"{name}.parquet")
        files[name] = TableFile(
            file=f"{name}.parquet", rows=table.num_rows, content_hash=content_hash(table, name), sha256="0" * 64
        )
    manifest = Manifest(
        schema_version=SCHEMA_VERSION,
        tool="spatialviz",
        version="0",
        config={"relations": list(PAIRWISE)},
        config_hash="c",
        profile={"name": "test", "parameters": {}},
        profile_hash="p",
        selection={},
        dataset={"path": "/data/odd `name`", "options": {}, "format": "folder"},
        models={},
        seed=0,
        counts={"frames_usable": 0},
        warnings=[],
        tables=files,
        environment={},
        created="2025-01-02T03:04:05+00:00",
    )
    (folder / MANIFEST_FILE).write_text(manifest.model_dump_json(), encoding="utf-8")
    return open_labels(folder)


def tilted_up(pitch: float, roll: float) -> list[float]:
    """The up vector of a camera that looks down by `pitch` and leans by `roll`, radians."""
    up = np.array([np.sin(roll), -np.cos(roll) * np.cos(pitch), -np.cos(roll) * np.sin(pitch)])
    return up.tolist()


def upright_box(center: Vector, size: Vector, yaw: float, up: Sequence[float]) -> Box3D:
    """A box that stands level under gravity, in the camera frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    level = viewer_axes(np.array(up)).R_level_camera
    R = level.T @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return Box3D(np.array(center), R, np.array(size))


def frame_row(index: int, frame: str, **more: Any) -> dict[str, Any]:
    row = {
        "frame": frame,
        "frame_index": index,
        "scene": "s",
        "ok": True,
        "width": WIDTH,
        "height": HEIGHT,
        "K": K,
        "up": tilted_up(0.5, 0.1),
        "up_source": "declared",
        "rgb_hash": "r",
        "depth_hash": "d",
        "objects": 0,
        "notes": [],
    }
    return {**row, **more}


def object_row(frame: Mapping[str, Any], number: int, label: str, box: Box3D | None, **more: Any) -> dict[str, Any]:
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    x, y = (5 * number) % 40, (7 * number) % 30
    mask[y : y + 9, x : x + 12] = True
    mask[y + 2, x + 3] = False
    row: dict[str, Any] = {
        "frame": frame["frame"],
        "frame_index": frame["frame_index"],
        "object": number,
        "label": label,
        "score": 0.7,
        "bbox": [float(x), float(y), x + 12.0, y + 9.0],
        "mask": encode_run_length(mask),
        "mask_source": "annotation",
        "mask_pixels": int(mask.sum()),
        "points": 0,
        "kept": 0.0,
        "depth_missing": 1.0,
        "touches_border": False,
        "fallback": False,
        "yaw_confidence": 0.0,
        "estimator": "gravity",
        "occluded": 0.0,
        "usable": False,
        "reason": "fewer than 16 points",
    }
    if box is not None:
        seen = (box.corners @ viewer_axes(np.array(frame["up"])).matrix.T).astype(np.float64)
        row |= {
            "center": box.center.tolist(),
            "R": box.R.ravel().tolist(),
            "size": box.size.tolist(),
            "points": 90,
            "lo": seen.min(axis=0).tolist(),
            "hi": seen.max(axis=0).tolist(),
            "centroid": seen.mean(axis=0).tolist(),
            "kept": 0.9,
            "depth_missing": 0.1,
            "distance": float(box.center[2]),
            "usable": True,
            "reason": None,
        }
    return {**row, **more}


def pair_row(frame: Mapping[str, Any], a: int, b: int, states: Mapping[str, int | None]) -> dict[str, Any]:
    row: dict[str, Any] = {"frame": frame["frame"], "frame_index": frame["frame_index"], "a": a, "b": b}
    for relation, state in states.items():
        row |= {relation: state, f"{relation}_margin": None if state is None else 0.1 * state}
    return {**row, "doubted": 0, "distance": 1 / 3 if None not in states.values() else None}


def hostile_labels(folder: Path) -> Labels:
    """Odd names and ids, objects without depth or mask, a broken frame, an empty one, nulls and doubts."""
    first = frame_row(0, 'sp ace/"q",\n#1', objects=len(NASTY), notes=["a\nb", "c,d"], T_world_camera=[0.1] * 16)
    broken = frame_row(
        1,
        "broken/1",
        ok=False,
        problem='unreadable "file"\n',
        width=0,
        height=0,
        K=None,
        up=None,
        up_source=None,
        rgb_hash=None,
        depth_hash=None,
    )
    empty = frame_row(2, "empty")
    last = frame_row(3, "椅/3", objects=3, up=[0.0, -1.0, 0.0], up_source="assumed")
    rng = np.random.default_rng(3)
    objects = []
    for number, name in enumerate(NASTY):
        box = upright_box(
            rng.uniform((-1, -1, 2), (1, 1, 4)), rng.uniform(0.1, 1.1, 3), rng.uniform(-3, 3), first["up"]
        )
        more: dict[str, Any] = {"instance": 7, "visible": 1 / 3} if number % 2 else {"mask": None}
        objects.append(object_row(first, number * 3, name, None if number % 4 == 3 else box, **more))
    leaning = Box3D(
        np.array([0.1, 0.2, 2.0]), np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]), np.array([1, 2, 3.0])
    )
    objects += [
        object_row(last, 0, "mug", upright_box((0, 0, 2), (0.2, 0.3, 0.4), 0.3, last["up"])),
        object_row(last, 4, "mug", leaning, estimator="pca", touches_border=True, exact_center=[1.0, 2.0, 3.0],
                   exact_R=np.eye(3).ravel().tolist(), exact_size=[1.0, 1.0, 1.0]),
        object_row(last, 9, "lamp", upright_box((1 / 3, 0.1, 3), (0.2, 0.3, 0.4), 1.0, last["up"]),
                   bbox=[0.1, 1 / 3, 40.7, 47.9]),
    ]  # fmt: skip
    pairs = []
    for frame, numbers in ((first, [3 * k for k in range(len(NASTY))]), (last, [0, 4, 9])):
        for a in numbers:
            for b in numbers:
                if a != b:
                    state = (a < b) - (a > b) if (a + b) % 2 == 0 else 0
                    pairs.append(pair_row(frame, a, b, {"left": state, "right": -state, "on": None if a else -1}))
    expression = {
        "frame": last["frame"],
        "frame_index": 3,
        "id": "00ff",
        "text": 'the "mug",\nleft 🪴 of\u2028the lamp',
        "target": "mug",
        "relation": "left",
        "reference": "lamp",
        "target_object": 0,
        "reference_object": 9,
        "targets": [0, 4],
        "acceptable": [0, 4],
        "ambiguous": True,
        "margin": 0.1,
        "judged_in": "viewer",
        "up_source": "assumed",
        "profile": "test",
    }
    sure = {
        **expression,
        "id": "01ff",
        "text": "lamp right of mug",
        "target": "lamp",
        "relation": "right",
        "reference": "mug",
        "target_object": 9,
        "reference_object": 4,
        "targets": [9],
        "acceptable": [9],
        "ambiguous": False,
    }
    rows = {
        "frames": [first, broken, empty, last],
        "objects": objects,
        "relations": pairs,
        "expressions": [expression, sure],
    }
    return write_labels(folder, rows)


def validate_rows(table: pa.Table, name: str) -> None:
    """Every row against its pydantic model."""
    for row in table.to_pylist():
        TABLES[name].model_validate(row)
