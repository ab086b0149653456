"""Reading a COCO export back into the tables."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.labels.exports.json_text import load_json
from pipeline.labels.tables import arrow_schema, build_table
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

FRAME_KEYS = (
    "scene", "ok", "problem", "K", "T_world_camera", "up", "up_source", "rgb_hash", "depth_hash", "objects", "notes",
)  # fmt: skip
"""Columns of `frames` that an image keeps under `spatialviz`."""

BOXES = {"box3d": "", "exact_box3d": "exact_", "pca_box3d": "pca_"}
"""Boxes of an annotation, and the prefix of their columns."""

EXTENT = ("lo", "hi", "centroid")
QUALITY = (
    "mask_source", "points", "kept", "depth_missing", "touches_border", "fallback", "distance", "yaw_confidence",
    "estimator", "visible", "occluded", "usable", "reason",
)  # fmt: skip
EXPRESSION_KEYS = ("id", "target", "relation", "reference", "ambiguous", "margin", "judged_in", "up_source", "profile")

BESIDE = ("image_id", "statuses", "provenance")
"""What an image has in `relations.json` that is no column of the table."""

Rows = list[dict[str, Any]]


def read_coco(root: Path) -> dict[str, pa.Table]:
    """The four tables of an export in COCO format.

    Raises
    ------
    InputError
        A file is missing, damaged, or lacks what the export wrote.
    """
    instances = load_json(root / "instances.json")
    refs, relations = load_json(root / "refs.json"), load_json(root / "relations.json")
    try:
        images = sorted(instances["images"] + instances["unusable_frames"], key=lambda image: image["id"])
        names = {image["id"]: image["frame"] for image in images}
        categories = {c["id"]: c["name"] for c in instances["categories"]}
        annotations = sorted(instances["annotations"], key=lambda a: a["id"])
        numbers = {a["id"]: a["object"] for a in annotations}
        rows: dict[str, Rows] = {
            "frames": [_frame(image) for image in images],
            "objects": [_object(a, names[a["image_id"]], categories) for a in annotations],
            "expressions": [_expression(ref, names[ref["image_id"]], numbers) for ref in refs],
        }
        tables = {name: _table(name, found) for name, found in rows.items()}
        pairs = _pairs(relations["images"], names, numbers)
    except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            "not a COCO export of labels", got=f"{type(error).__name__}: {error}", cause="was it edited?", path=root
        ) from error
    return {
        "frames": tables["frames"],
        "objects": tables["objects"],
        "relations": pairs,
        "expressions": tables["expressions"],
    }


def _frame(image: dict[str, Any]) -> dict[str, Any]:
    own = {"frame": image["frame"], "frame_index": image["id"], "width": image["width"], "height": image["height"]}
    return {**own, **{key: image["spatialviz"][key] for key in FRAME_KEYS}}


def _object(annotation: dict[str, Any], frame: str, categories: dict[int, str]) -> dict[str, Any]:
    segmentation = annotation["segmentation"]
    row = {
        "frame": frame,
        "frame_index": annotation["image_id"],
        "object": annotation["object"],
        "label": categories[annotation["category_id"]],
        "score": annotation["score"],
        "instance": annotation["instance"],
        "bbox": annotation["bbox_xyxy"],
        "mask": segmentation["counts"] if isinstance(segmentation, dict) else None,
        "mask_pixels": annotation["area"],
    }
    for key, prefix in BOXES.items():
        box = annotation[key] or {"center": None, "size": None, "R": None}
        R = box["R"]
        row |= {f"{prefix}center": box["center"], f"{prefix}size": box["size"]}
        row[f"{prefix}R"] = None if R is None else [x for line in R for x in line]
    row |= {key: annotation["extent"][key] for key in EXTENT}
    return row | {key: annotation["quality"][key] for key in QUALITY}


def _expression(ref: dict[str, Any], frame: str, numbers: dict[int, int]) -> dict[str, Any]:
    row = {
        "frame": frame,
        "frame_index": ref["image_id"],
        "text": ref["sentences"][0]["raw"],
        "target_object": numbers[ref["ann_id"]],
        "reference_object": numbers[ref["reference_ann_id"]],
        "targets": [numbers[n] for n in ref["target_ann_ids"]],
        "acceptable": [numbers[n] for n in ref["acceptable_ann_ids"]],
    }
    return row | {key: ref[key] for key in EXPRESSION_KEYS}


def _pairs(images: Iterable[dict[str, Any]], names: dict[int, str], numbers: dict[int, int]) -> pa.Table:
    import pyarrow as pa

    found = []
    for image in images:
        columns = {key: values for key, values in image.items() if key not in BESIDE}
        length = len(columns["a"])
        index = image["image_id"]
        columns |= {key: [numbers[n] for n in columns[key]] for key in ("a", "b")}
        found.append(
            build_table("relations", {"frame": [names[index]] * length, "frame_index": [index] * length, **columns})
        )
    return pa.concat_tables(found) if found else arrow_schema("relations").empty_table()


def _table(name: str, rows: Rows) -> pa.Table:
    if not rows:
        return arrow_schema(name).empty_table()
    return build_table(name, {column: [row[column] for row in rows] for column in arrow_schema(name).names})
