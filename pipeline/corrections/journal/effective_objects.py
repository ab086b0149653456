"""The objects of a frame and their relations after corrections: what people set, and what follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef, box_of, object_ref, same_value
from pipeline.corrections.journal.frame_rows import NO_STATE, FrameRows, Pairs, Setting
from pipeline.corrections.journal.replay import (
    Corrected,
    Origin,
    Origins,
    Replayed,
    all_gone,
    is_another,
    replay,
    standing,
)
from pipeline.geometry.masks import decode_crop
from pipeline.language.relation_names import INVERSE, PAIRWISE
from pipeline.relations.relations import F, T

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
    auto: FrameRows, refs: Mapping[FieldRef, Sequence[Event]], setting: Setting, origins: Origins
) -> CorrectedObjects:
    """Apply the corrections of objects; what follows from new pixels or a new box is left as it was.

    Parameters
    ----------
    auto : FrameRows
    refs : mapping of FieldRef to events
        Those of the frame.
    setting : Setting
    origins : Origins
        What people set is noted here.
    """
    found = CorrectedObjects()
    by_object: dict[int, dict[str, Sequence[Event]]] = {}
    for ref, events in refs.items():
        if ref.kind == "object":
            by_object.setdefault(ref.numbers[0], {})[ref.field] = events
    found.rows = {number: row for number, row in auto.objects.items() if number not in by_object}
    for number in sorted(by_object):
        _correct_object(number, by_object[number], auto, setting, origins, found)
    found.rows = dict(sorted(found.rows.items()))
    return found


def _correct_object(
    number: int,
    fields: Mapping[str, Sequence[Event]],
    auto: FrameRows,
    setting: Setting,
    origins: Origins,
    found: CorrectedObjects,
) -> None:
    def note(name: str, replayed: Replayed) -> Replayed:
        return found.note(object_ref(auto.frame, number, name), replayed)

    row, created = auto.objects.get(number), False
    if "exists" in fields:
        seed = note("exists", replay(None, fields["exists"]))
        if seed.value is not None:
            found.statuses[object_ref(auto.frame, number, "exists")] = seed.value
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
            _set_field(row, number, name, after.value, after.event, auto, found)
        refitted |= name == "mask" or (name == "bbox" and row["mask_source"] == "box")
        for column in BOX_COLUMNS if name == "box" else (name,):
            automatic = None if created else auto.objects[number].get(column)
            origins.put("objects", str(number), column, Origin.of("human", after.event), automatic)
    status = found.statuses.get(object_ref(auto.frame, number, "status"))
    (found.left_out if status == "rejected" else found.rows)[number] = row


def _from_bbox(row: Row, fields: Mapping[str, Sequence[Event]]) -> bool:
    """Whether an object's pixels were those of its 2D box when people set them, and so no automatic ones."""
    released = any(e.after is None for e in fields["mask"])
    return released or (row["mask_source"] == "box" and "bbox" in fields)


def _set_field(
    row: Row, number: int, name: str, value: Any, event: Event, auto: FrameRows, found: CorrectedObjects
) -> None:
    if name == "status":
        if value is not None:
            found.statuses[event.ref] = value
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


@dataclass(kw_only=True)
class CorrectedPairs(Corrected):
    """What became of a frame's relations.

    Attributes
    ----------
    pairs : Pairs
        Of the objects that stand and take part in relations.
    human : (N, N, 9) bool
        Cells that people set.
    stale : (N,) bool
        Objects whose relations do not follow from their geometry yet.
    changed : bool
        Anything differs from the automatic labels.
    """

    pairs: Pairs
    human: np.ndarray
    stale: np.ndarray
    changed: bool = False


def correct_pairs(
    auto: FrameRows,
    objects: CorrectedObjects,
    relifted: Pairs | None,
    refs: Mapping[FieldRef, Sequence[Event]],
    setting: Setting,
    origins: Origins,
) -> CorrectedPairs:
    """Apply corrections of relations, and those of objects as far as relations follow from them.

    Parameters
    ----------
    relifted : Pairs or None
        The relations of all standing objects judged anew, where the dataset was at hand.
    """
    related = [n for n, row in objects.rows.items() if not setting.config.is_background(row["label"])]
    pairs = auto.pairs.of_objects(related).copy()
    n = len(pairs.numbers)
    human, stale = np.zeros((n, n, len(PAIRWISE)), np.bool_), np.zeros(n, np.bool_)
    found = CorrectedPairs(pairs=pairs, human=human, stale=stale)
    found.changed = list(pairs.numbers) != list(auto.pairs.of_objects(auto.objects).numbers)
    _follow_geometry(found, auto, objects, relifted, setting, origins)
    judged = {ref: events for ref, events in refs.items() if ref.kind == "relation"}
    message: list[tuple[int, int, str, Event]] = []
    for ref in sorted(judged, key=lambda c: (c.key, c.field)):
        ruled_out = _ruled_out_before(ref, judged)
        _correct_relation(found, ref, judged[ref], auto, objects, setting, origins, message, ruled_out)
    for i, j, relation, event in message:
        _exclude(found, i, j, relation, event, setting, origins)
    return found


def _follow_geometry(
    found: CorrectedPairs,
    auto: FrameRows,
    objects: CorrectedObjects,
    relifted: Pairs | None,
    setting: Setting,
    origins: Origins,
) -> None:
    """Relations of objects with another geometry, and of those that were background before."""
    pairs = found.pairs
    causes = dict(objects.geometry)
    for number, event in objects.renamed.items():
        was = auto.objects.get(number)
        if number not in causes and was is not None and setting.config.is_background(was["label"]):
            causes[number] = event
    moved = np.isin(pairs.numbers, list(causes))
    if not moved.any():
        return
    found.changed = True
    touched = (moved[:, None] | moved[None, :]) & ~np.eye(len(moved), dtype=np.bool_)
    before = pairs.copy()
    if relifted is not None:
        anew = relifted.of_objects(pairs.numbers)
        for name in ("present", "states", "margins", "distance", "doubted"):
            getattr(pairs, name)[touched] = getattr(anew, name)[touched]
    else:
        found.stale |= moved
    source = "stale" if relifted is None else "recomputed"
    columns = [k for k, r in enumerate(PAIRWISE) if r in setting.relations]
    for i, j in zip(*np.nonzero(touched & (pairs.present | before.present)), strict=True):
        a, b = int(pairs.numbers[i]), int(pairs.numbers[j])
        event = max((causes[x] for x in (a, b) if x in causes), key=lambda e: e.id)
        origin, key = Origin.of(source, event), f"{a},{b}"
        for k in columns:
            was = before.states[i, j, k]
            origins.put("relations", key, PAIRWISE[k], origin, None if was == NO_STATE else int(was))


def _correct_relation(
    found: CorrectedPairs,
    ref: FieldRef,
    events: Sequence[Event],
    auto: FrameRows,
    objects: CorrectedObjects,
    setting: Setting,
    origins: Origins,
    message: list[tuple[int, int, str, Event]],
    ruled_out: bool,
) -> None:
    a, b = ref.numbers
    i, j = found.pairs.index_of(a), found.pairs.index_of(b)
    relation = ref.field.removesuffix(".status")
    reason = None
    if relation not in setting.relations:
        reason = f"the labels do not hold {relation!r}"
    elif i is None or j is None or a == b:
        gone = next((x for x, at in ((a, i), (b, j)) if at is None), a)
        known = gone in objects.left_out or gone in objects.rows
        reason = f"object {gone} takes part in no relation" if known else f"there is no object {gone} any more"
    elif any(is_another(e.anchor, x, auto.objects[x]["bbox"]) for e in events for x in (a, b) if x in auto.objects):
        reason = "one of the two objects is another thing now"
    if reason is not None or i is None or j is None:
        found.note(ref, all_gone(None, events, str(reason)))
        return
    if ref.field != relation:
        after = found.note(ref, replay(None, events))
        if after.value is not None and after.event is not None:
            found.statuses[ref] = after.value
            origins.put("relations", ref.key, ref.field, Origin.of("human", after.event))
        return
    k = PAIRWISE.index(relation)
    was = found.pairs.state(a, b, relation)
    # Who saw F where another correction ruled out the labeller's T, did not see the automatic label.
    trusted = a in objects.geometry or b in objects.geometry or (ruled_out and was == T)
    after = found.note(ref, replay(was, events, trusted=trusted))
    if after.event is None:
        return
    _settle(found, i, j, k, after.value)
    found.human[i, j, k] = True
    message.append((i, j, relation, after.event))
    automatic = auto.pairs.state(a, b, relation)
    origins.put("relations", ref.key, relation, Origin.of("human", after.event), automatic)


def _ruled_out_before(ref: FieldRef, judged: Mapping[FieldRef, Sequence[Event]]) -> bool:
    """Whether a person had said what rules the cell's relation out (see `_exclude`) when it was corrected."""
    stands = standing(judged[ref])
    if ref.field not in INVERSE or not stands:
        return False
    (a, b), first = ref.numbers, stands[0]
    others = (FieldRef("relation", ref.frame, ref.key, INVERSE[ref.field]), replace(ref, key=f"{b},{a}"))
    return first.before == F and any(e.after == T and e.id < first.id for c in others for e in judged.get(c, ()))


def _settle(found: CorrectedPairs, i: int, j: int, k: int, state: int | None) -> None:
    """Set a cell. A margin whose sign says otherwise becomes 0: by geometry it is no better than undecided."""
    pairs = found.pairs
    found.changed |= pairs.states[i, j, k] != (NO_STATE if state is None else state)
    pairs.present[i, j] = True
    pairs.states[i, j, k] = NO_STATE if state is None else state
    margin = pairs.margins[i, j, k]
    agrees = (state == T and margin > 0) or (state == F and margin < 0)
    pairs.margins[i, j, k] = np.nan if state is None else margin if agrees else 0.0
    pairs.doubted[i, j] &= ~(1 << k)


def _exclude(
    found: CorrectedPairs, i: int, j: int, relation: str, event: Event, setting: Setting, origins: Origins
) -> None:
    """What a person said to hold rules out its opposite, and itself the other way round."""
    k, opposite = PAIRWISE.index(relation), INVERSE.get(relation)
    if found.pairs.states[i, j, k] != T or opposite is None:
        return
    for a, b, name in ((i, j, opposite), (j, i, relation)):
        at = PAIRWISE.index(name)
        if name not in setting.relations or found.human[a, b, at] or found.pairs.states[a, b, at] != T:
            continue
        _settle(found, a, b, at, F)
        key = f"{found.pairs.numbers[a]},{found.pairs.numbers[b]}"
        origins.put("relations", key, name, Origin.of("recomputed", event), T)
