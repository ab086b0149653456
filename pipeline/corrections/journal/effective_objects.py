"""The objects of a frame after their corrections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef, box_of, object_cell, same_value
from pipeline.corrections.journal.frame_rows import FrameRows, Setting
from pipeline.corrections.journal.replay import (
    Corrected,
    Origin,
    Origins,
    Replayed,
    all_gone,
    is_another,
    replay,
)
from pipeline.geometry.run_length import decode_crop

Row = dict[str, Any]
BOX_COLUMNS = ("center", "R", "size")
DERIVED = (
    "mask_pixels", "points", "kept", "depth_missing", "touches_border", "fallback", "distance", *BOX_COLUMNS,
    "yaw_confidence", "pca_center", "pca_R", "pca_size", "lo", "hi", "centroid", "occluded", "usable", "reason",
)  # fmt: skip
"""Columns that follow from an object's pixels."""
OF_BOX = (*BOX_COLUMNS, "yaw_confidence", "pca_center", "pca_R", "pca_size", "lo", "hi", "centroid")
"""Columns that follow from an object's 3D box."""


@dataclass(kw_only=True)
class CorrectedObjects(Corrected):
    """What became of a frame's objects.

    Attributes
    ----------
    rows : dict of int to dict
        Those that stand, by number.
    left_out : dict of int to dict
        Those that people rejected.
    geometry : dict of int to Event
        Objects whose pixels or box a person set, and the newest such event.
    boxes : dict of int to JSON value
        3D boxes that people set.
    human_bbox : set of int
        Objects whose 2D box a person set.
    renamed : dict of int to Event
        Objects with another class.
    """

    rows: dict[int, Row] = field(default_factory=dict)
    left_out: dict[int, Row] = field(default_factory=dict)
    geometry: dict[int, Event] = field(default_factory=dict)
    boxes: dict[int, Any] = field(default_factory=dict)
    human_bbox: set[int] = field(default_factory=set)
    renamed: dict[int, Event] = field(default_factory=dict)


def correct_objects(
    auto: FrameRows, cells: Mapping[FieldRef, Sequence[Event]], setting: Setting, origins: Origins
) -> CorrectedObjects:
    """Apply the corrections of objects; what follows from new pixels or a new box is left as it was.

    Parameters
    ----------
    auto : FrameRows
    cells : mapping of Cell to events
        Those of the frame.
    setting : Setting
    origins : Origins
        What people set is noted here.
    """
    found = CorrectedObjects()
    by_object: dict[int, dict[str, Sequence[Event]]] = {}
    for cell, events in cells.items():
        if cell.kind == "object":
            by_object.setdefault(cell.numbers[0], {})[cell.field] = events
    found.rows = {number: row for number, row in auto.objects.items() if number not in by_object}
    for number in sorted(by_object):
        _correct(number, by_object[number], auto, setting, origins, found)
    found.rows = dict(sorted(found.rows.items()))
    return found


def _correct(
    number: int,
    fields: Mapping[str, Sequence[Event]],
    auto: FrameRows,
    setting: Setting,
    origins: Origins,
    found: CorrectedObjects,
) -> None:
    def note(name: str, replayed: Replayed) -> Replayed:
        return found.note(object_cell(auto.frame, number, name), replayed)

    row, created = auto.objects.get(number), False
    if "exists" in fields:
        seed = note("exists", replay(None, fields["exists"]))
        if seed.value is not None:
            found.statuses[object_cell(auto.frame, number, "exists")] = seed.value
        if row is None and seed.value is not None and seed.event is not None:
            row, created = new_row(number, seed.value, auto, setting), True
            found.geometry[number] = seed.event
            if "box" in seed.value:
                found.boxes[number] = seed.value["box"]
            for column in row:
                origins.put("objects", str(number), column, Origin.of("human", seed.event))
    if row is None:
        for name, events in fields.items():
            if name != "exists":
                note(name, all_gone(None, events, f"there is no object {number} any more"))
        return
    row, refitted = dict(row), False
    for name in ("label", "mask", "bbox", "box", "status"):
        if name not in fields:
            continue
        events, was = fields[name], object_value(row, name)
        if not created and any(is_another(e.anchor, number, auto.objects[number]["bbox"]) for e in events):
            note(name, all_gone(was, events, f"object {number} is another thing now"))
            continue
        trusted = created or (name in ("bbox", "box") and refitted) or (name == "mask" and _from_bbox(row, fields))
        after = note(name, replay(was, events, trusted=trusted, released_by_none=name == "box"))
        if after.event is None:
            continue
        if name == "box" and after.event.after is None:
            # Nobody's any more: it follows from the pixels, as every box does that nobody set.
            if row["mask"] is not None:
                found.boxes.pop(number, None)
            continue
        if created or number in found.geometry or not same_value(after.value, was):
            _set(row, number, name, after.value, after.event, auto, found)
        refitted |= name == "mask" or (name == "bbox" and row["mask_source"] == "box")
        for column in BOX_COLUMNS if name == "box" else (name,):
            automatic = None if created else auto.objects[number].get(column)
            origins.put("objects", str(number), column, Origin.of("human", after.event), automatic)
    status = found.statuses.get(object_cell(auto.frame, number, "status"))
    (found.left_out if status == "rejected" else found.rows)[number] = row


def _from_bbox(row: Row, fields: Mapping[str, Sequence[Event]]) -> bool:
    """Whether an object's pixels were those of its 2D box when people set them, and so no automatic ones."""
    released = any(e.after is None for e in fields["mask"])
    return released or (row["mask_source"] == "box" and "bbox" in fields)


def _set(
    row: Row, number: int, name: str, value: Any, event: Event, auto: FrameRows, found: CorrectedObjects
) -> None:
    if name == "status":
        if value is not None:
            found.statuses[event.cell] = value
        return
    if name == "label":
        found.renamed[number] = event
    if name == "bbox":
        found.human_bbox.add(number)
    if name == "box":
        found.boxes[number] = value
        for column in BOX_COLUMNS:
            row[column] = None if value is None else value[column]
    else:
        row[name] = value
    if name == "mask":
        row["mask_source"] = "box" if value is None else "human"
        row["bbox"], row["mask_pixels"] = mask_facts(value, auto) if value is not None else (row["bbox"], 0)
    if name in ("mask", "box") or (name == "bbox" and row["mask_source"] == "box"):
        found.geometry[number] = max(event, found.geometry.get(number, event), key=lambda e: e.id)


def mask_facts(code: str, auto: FrameRows) -> tuple[list[float], int]:
    """The rectangle around a mask, and how many pixels it has; InputError where it is of another size."""
    crop = decode_crop((auto.row["height"], auto.row["width"]), code, f"a mask of frame {auto.frame}")
    return [float(x) for x in crop.box], int(crop.mask.sum())


def object_value(row: Row, name: str) -> Any:
    """The value of an object's cell in a row of the table `objects`."""
    if name == "box":
        return None if row["center"] is None else {column: row[column] for column in BOX_COLUMNS}
    return None if name in ("status", "exists") else row[name]


def new_row(number: int, seed: Mapping[str, Any], auto: FrameRows, setting: Setting) -> Row:
    """The row of an object that a person added, before it is lifted."""
    mask, box = seed.get("mask"), seed.get("box")
    bbox, pixels = seed.get("bbox"), 0
    if mask is not None:
        around, pixels = mask_facts(mask, auto)
        bbox = around if bbox is None else bbox
    if bbox is None:
        bbox = projected_box(box_of(box).corners, auto.row)
    values = {column: None if box is None else box[column] for column in BOX_COLUMNS}
    return {
        "frame": auto.frame, "frame_index": auto.index, "object": number, "label": seed["label"], "score": 1.0,
        "instance": None, "bbox": bbox, "mask": mask, "mask_source": "human" if mask is not None else
        "box3d" if box is not None else "box", "mask_pixels": pixels, "points": 0, "kept": 0.0, "depth_missing": 0.0,
        "touches_border": False, "fallback": False, "distance": None, **values, "yaw_confidence": 0.0,
        "estimator": setting.config.lift.box, "pca_center": None, "pca_R": None, "pca_size": None, "lo": None,
        "hi": None, "centroid": None, "exact_center": None, "exact_R": None, "exact_size": None, "visible": None,
        "occluded": 0.0, "usable": False, "reason": "not lifted yet",
    }  # fmt: skip


def projected_box(corners: Any, frame: Row) -> list[float]:
    """The rectangle in the picture around the corners of a 3D box; the whole picture where it cannot be known."""
    import numpy as np

    from pipeline.labels.check.objects import clipped, projected

    size = frame["height"], frame["width"]
    whole = [0.0, 0.0, float(size[1]), float(size[0])]
    if frame["K"] is None:
        return whole
    (box,) = clipped(projected(corners[None], np.array(frame["K"]).reshape(3, 3)), size)
    return box.tolist() if box[2] > box[0] and box[3] > box[1] else whole


def unusable(row: Row, setting: Setting) -> str | None:
    """Why an object is not asked for, by its row; as `labels.labelling` has it of what it lifted."""
    config = setting.config
    if config.is_background(row["label"]):
        return "background"
    if row["mask_pixels"] < config.min_pixels:
        return f"fewer than {config.min_pixels} pixels"
    if row["points"] < config.min_points:
        return f"fewer than {config.min_points} points"
    return "too small to clean" if row["fallback"] else None
