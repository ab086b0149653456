"""COCO: instances, referring expressions as in RefCOCO, and the relations between annotations. Lossless.

`instances.json` is COCO's: `images`, `annotations`, `categories`. An image's id
is its `frame_index`; frames that cannot be used stand in `unusable_frames`
instead, so that no loader looks for them. Annotation ids count from 1 in the
order of the table `objects`. Masks are compressed run-length codes; an object
without a mask has its 2D box as a polygon. Beyond COCO's keys every image has
`spatialviz` (pose, up, hashes), and every annotation has `box3d` ({center, size,
R, frame: "camera"}, metres, R row by row), `extent` (lo, hi, centroid along the
viewer's right, up, forward) and `quality`. `attributes` repeats the object's
number, for tools that keep nothing else of ours.

`refs.json` is a list with the keys of RefCOCO's `refs(...).p`, and
`acceptable_ann_ids`, `target_ann_ids`, `reference_ann_id`, `relation`.

`relations.json` has, for each image, columns of equal length: annotations `a`
and `b`, `distance`, and state (1, 0, -1) and margin of each relation.

Where values come from, see `pipeline.labels.exports.base`: `info` has
`base` and `made_by`; annotations and refs have `status`, `provenance`, and refs
`mark`; of an image `spatialviz` has them, and `note`; of relations the image's
`statuses` and `provenance` list annotations `a` and `b` with each entry.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any, TextIO

from pipeline.labels.exports.base import (
    ExportFormat,
    ExportFrame,
    Job,
    JsonList,
    Provenance,
    Written,
    image_name,
    iterate_frames,
    json_line,
    label_names,
)
from pipeline.labels.frame_stream import table_batches
from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import text_file

_WORD = re.compile(r"[^\W_]+(?:['’-][^\W_]+)*")


def write_coco(job: Job) -> Written:
    """Write the three files, as streams."""
    manifest = job.labels.manifest
    categories = {name: k for k, name in enumerate(label_names(job.labels), start=1)}
    info = {
        "description": f"Auto-labels of {manifest.dataset.get('path')} by {manifest.tool} {manifest.version}",
        "version": manifest.schema_version,
        "date_created": manifest.created,
        "contributor": "",
        "url": "",
        "year": int(manifest.created[:4]) if manifest.created[:4].isdigit() else 0,
        "config_hash": manifest.config_hash,
        "profile_hash": manifest.profile_hash,
        "base": job.provenance.base,
        "made_by": job.provenance.made_by,
    }
    with (
        text_file(job.folder / "instances.json") as instances,
        text_file(job.folder / "refs.json") as refs_file,
        text_file(job.folder / "relations.json") as relations_file,
    ):
        listed = [{"id": i, "name": name, "supercategory": "object"} for name, i in categories.items()]
        instances.write(
            f'{{"info": {json_line(info)},\n"licenses": {json_line([{"id": 0, "name": "unknown", "url": ""}])},\n'
            f'"categories": {json_line(listed)},\n'
        )
        images = _write_frames(job, instances)
        instances.write('"annotations": ')
        annotations, refs = JsonList(instances), JsonList(refs_file)
        relations_file.write(f'{{"relations": {json_line(list(job.labels.relation_names))},\n"images": ')
        related = JsonList(relations_file)
        pairs, known = 0, job.provenance.known
        for rows in iterate_frames(job.labels, job.tell):
            ids = {row["object"]: annotations.length + 1 + k for k, row in enumerate(rows.objects)}
            require(
                len(ids) == len(rows.objects),
                f"frame {rows.frame['frame']}: two objects of one number",
                path=job.labels.root,
            )
            for row in rows.objects:
                found = _annotation(row, ids[row["object"]], categories, rows.frame)
                annotations.add(found | known("objects", rows.frame["frame"], str(row["object"])))
            for row in rows.expressions:
                refs.add(_ref(row, refs.length, ids, categories) | known("expressions", rows.frame["frame"], row["id"]))
            if rows.relations.num_rows:
                related.add(_relations(rows, ids) | _known_relations(job.provenance, rows, ids))
                pairs += rows.relations.num_rows
            job.copy_picture(rows)
        for items, file, end in (
            (annotations, instances, "}\n"),
            (refs, refs_file, "\n"),
            (related, relations_file, "}\n"),
        ):
            items.close()
            file.write(end)
    files = ("instances.json", "refs.json", "relations.json", *(("images/",) if job.images is not None else ()))
    rows = {"images": images, "annotations": annotations.length, "refs": refs.length, "pairs": pairs}
    return Written(files, {**rows, "categories": len(categories)})


def _write_frames(job: Job, file: TextIO) -> int:
    """The lists `images` and `unusable_frames`; the length of the first."""
    lengths = []
    for key, usable in (("images", True), ("unusable_frames", False)):
        file.write(f"{json.dumps(key)}: ")
        items = JsonList(file)
        for batch in table_batches(job.labels, "frames"):
            for row in batch.to_pylist():
                if row["ok"] == usable:
                    found = _image(row)
                    found["spatialviz"] |= job.provenance.known("frames", row["frame"], "")
                    items.add(found)
        items.close()
        file.write(",\n")
        lengths.append(items.length)
    return lengths[0]


def _image(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "id": row["frame_index"],
        "file_name": image_name(row["frame_index"]),
        "width": row["width"],
        "height": row["height"],
        "frame": row["frame"],
        "license": 0,
        "spatialviz": {key: row[key] for key in FRAME_KEYS},
    }


def _annotation(
    row: Mapping[str, Any], ann_id: int, categories: Mapping[str, int], frame: Mapping[str, Any]
) -> dict[str, Any]:
    x0, y0, x1, y1 = row["bbox"]
    mask = {"size": [frame["height"], frame["width"]], "counts": row["mask"]}
    return {
        "id": ann_id,
        "image_id": row["frame_index"],
        "category_id": categories[row["label"]],
        "bbox": [x0, y0, x1 - x0, y1 - y0],
        "area": row["mask_pixels"],
        "segmentation": [[x0, y0, x1, y0, x1, y1, x0, y1]] if row["mask"] is None else mask,
        "iscrowd": 0,
        "score": row["score"],
        "object": row["object"],
        "instance": row["instance"],
        "attributes": {"object": row["object"]},
        "bbox_xyxy": row["bbox"],
        **{key: _box(row, prefix) for key, prefix in BOXES.items()},
        "extent": {key: row[key] for key in EXTENT},
        "quality": {key: row[key] for key in QUALITY},
    }


def _box(row: Mapping[str, Any], prefix: str) -> dict[str, Any] | None:
    center, R, size = (row[f"{prefix}{key}"] for key in ("center", "R", "size"))
    if center is None and R is None and size is None:
        return None
    return {"center": center, "size": size, "R": R and [R[0:3], R[3:6], R[6:9]], "frame": "camera"}


def _ref(row: Mapping[str, Any], number: int, ids: Mapping[int, int], categories: Mapping[str, int]) -> dict[str, Any]:
    try:
        ann_id, reference = ids[row["target_object"]], ids[row["reference_object"]]
        targets, acceptable = ([ids[n] for n in row[key]] for key in ("targets", "acceptable"))
    except KeyError as error:
        raise InputError(f"expression {row['id']} is of object {error}, which frame {row['frame']} lacks") from error
    sent = " ".join(row["text"].lower().split())
    return {
        "ref_id": number,
        "ann_id": ann_id,
        "image_id": row["frame_index"],
        "category_id": categories.get(row["target"], 0),
        "file_name": image_name(row["frame_index"]),
        "split": "train",
        "sent_ids": [number],
        "sentences": [{"sent_id": number, "raw": row["text"], "sent": sent, "tokens": _WORD.findall(sent)}],
        "reference_ann_id": reference,
        "target_ann_ids": targets,
        "acceptable_ann_ids": acceptable,
        **{key: row[key] for key in EXPRESSION_KEYS},
    }


def _relations(rows: ExportFrame, ids: Mapping[int, int]) -> dict[str, Any]:
    found: dict[str, Any] = {"image_id": rows.index}
    for name in rows.relations.column_names:
        column = rows.relations.column(name)
        if name in ("frame", "frame_index") or column.null_count == len(column):
            continue
        found[name] = column.to_pylist() if column.null_count else column.to_numpy().tolist()
    for key in ("a", "b"):
        try:
            found[key] = [ids[n] for n in found[key]]
        except KeyError as error:
            raise InputError(f"a pair is of object {error}, which frame {rows.frame['frame']} lacks") from error
    return found


def _known_relations(provenance: Provenance, rows: ExportFrame, ids: Mapping[int, int]) -> dict[str, Any]:
    found: dict[str, list[dict[str, Any]]] = {"statuses": [], "provenance": []}
    frame = rows.frame["frame"]
    if frame not in provenance.frames.get("relations", ()):
        return found
    for a, b in zip(*(rows.relations.column(end).to_pylist() for end in ("a", "b")), strict=True):
        for name, entries in provenance.known("relations", frame, f"{a},{b}").items():
            found[name] += [{"a": ids[a], "b": ids[b], **entry} for entry in entries]
    return found


FRAME_KEYS = (
    "scene",
    "ok",
    "problem",
    "K",
    "T_world_camera",
    "up",
    "up_source",
    "rgb_hash",
    "depth_hash",
    "objects",
    "notes",
)
"""Columns of `frames` that an image keeps under `spatialviz`."""
BOXES = {"box3d": "", "exact_box3d": "exact_", "pca_box3d": "pca_"}
"""Boxes of an annotation, and the prefix of their columns."""
EXTENT = ("lo", "hi", "centroid")
QUALITY = (
    "mask_source",
    "points",
    "kept",
    "depth_missing",
    "touches_border",
    "fallback",
    "distance",
    "yaw_confidence",
    "estimator",
    "open_sides",
    "visible",
    "occluded",
    "usable",
    "reason",
)
EXPRESSION_KEYS = ("id", "target", "relation", "reference", "ambiguous", "margin", "judged_in", "up_source", "profile")
FORMAT = ExportFormat(write_coco, description="COCO instances, RefCOCO-like references, and relations; lossless")
