"""The objects of a frame, their relations and its expressions after corrections: what people set, and what follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame, Setting, object_value
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import FieldRef, box_of, object_ref, same_value
from pipeline.corrections.journal.frame_rows import AT, BOX_COLUMNS, MATRICES, FrameRows, Pairs, Row
from pipeline.corrections.journal.replay import Origin, all_gone, another_thing, replay, standing
from pipeline.geometry.masks import decode_crop
from pipeline.labels.check.objects import clipped, projected
from pipeline.language.relation_names import INVERSE
from pipeline.relations.pair_measures import NOT_JUDGED, F, T

DERIVED = (
    "mask_pixels",
    "points",
    "kept",
    "depth_missing",
    "touches_border",
    "fallback",
    "distance",
    *BOX_COLUMNS,
    "yaw_confidence",
    "open_sides",
    "pca_center",
    "pca_R",
    "pca_size",
    "lo",
    "hi",
    "centroid",
    "occluded",
    "usable",
    "reason",
)
"""Columns that follow from an object's pixels."""
OF_BOX = (*BOX_COLUMNS, "yaw_confidence", "open_sides", "pca_center", "pca_R", "pca_size", "lo", "hi", "centroid")
"""Columns that follow from an object's 3D box."""


def correct_objects(frame: EffectiveFrame, said: Mapping[FieldRef, Sequence[Event]]) -> None:
    """Apply the events of objects, before lifting."""
    for number, refs in sorted(grouped(said, lambda ref: ref.numbers[0]).items()):
        frame.objects.pop(number, None)
        _correct_object(frame, number, {ref.field: said[ref] for ref in refs})
    frame.objects = dict(sorted(frame.objects.items()))


def _correct_object(frame: EffectiveFrame, number: int, fields: Mapping[str, Sequence[Event]]) -> None:
    auto, created = frame.auto, False
    row = auto.objects.get(number)
    if "exists" in fields:
        seed = frame.note(fields["exists"], replay(None, fields["exists"]))
        if seed.value is not None:
            frame.statuses[fields["exists"][0].ref] = seed.value
        if row is None and seed.value is not None and seed.event is not None:
            row, created = new_row(number, seed.value, auto, frame.setting), True
            frame.geometry[number] = seed.event
            if "box" in seed.value:
                frame.boxes[number] = seed.value["box"]
            for column in (c for c in row if c != "open_sides"):
                frame.put("objects", str(number), column, Origin.of("human", seed.event))
    if row is None:
        for name, events in fields.items():
            if name != "exists":
                frame.note(events, all_gone(None, events, f"there is no object {number} any more"))
        return
    row, refitted = dict(row), False
    for name in ("label", "mask", "bbox", "box", "status"):
        if name not in fields:
            continue
        events, was = fields[name], object_value(row, name)
        if not created and another_thing(events, {number: auto.objects[number]["bbox"]}) is not None:
            frame.note(events, all_gone(was, events, f"object {number} is another thing now"))
            continue
        # Automatic pixels that were only the 2D box follow from it.
        boxed = any(e.after is None for e in events) or (row["mask_source"] == "box" and "bbox" in fields)
        trusted = created or (name in ("bbox", "box") and refitted) or (name == "mask" and boxed)
        after = frame.note(events, replay(was, events, trusted=trusted, released_by_none=name == "box"))
        if after.event is None:
            continue
        if name == "box" and after.event.after is None:
            # Nobody's any more: it follows from the pixels, as every box does that nobody set.
            if row["mask"] is not None:
                frame.boxes.pop(number, None)
            continue
        if created or number in frame.geometry or not same_value(after.value, was):
            _set_field(frame, row, number, name, after.value, after.event)
        refitted |= name == "mask" or (name == "bbox" and row["mask_source"] == "box")
        for column in BOX_COLUMNS if name == "box" else (name,):
            automatic = None if created else auto.objects[number].get(column)
            frame.put("objects", str(number), column, Origin.of("human", after.event), automatic)
    rejected = frame.statuses.get(object_ref(auto.frame, number, "status")) == "rejected"
    (frame.left_out if rejected else frame.objects)[number] = row


def _set_field(frame: EffectiveFrame, row: Row, number: int, name: str, value: Any, event: Event) -> None:
    if name == "status":
        if value is not None:
            frame.statuses[event.ref] = value
        return
    if name == "label":
        frame.renamed[number] = event
    if name == "bbox":
        frame.human_bbox.add(number)
    if name == "box":
        frame.boxes[number] = value
        row.update({column: None if value is None else value[column] for column in BOX_COLUMNS})
        row["open_sides"] = None
    else:
        row[name] = value
    if name == "mask":
        row["mask_source"] = "box" if value is None else "human"
        row["bbox"], row["mask_pixels"] = mask_facts(value, frame.auto) if value is not None else (row["bbox"], 0)
    if name in ("mask", "box") or (name == "bbox" and row["mask_source"] == "box"):
        frame.geometry[number] = max(event, frame.geometry.get(number, event), key=lambda e: e.id)


def mask_facts(code: str, auto: FrameRows) -> tuple[list[float], int]:
    """Bounding rectangle and pixel count of a mask; InputError for another size."""
    crop = decode_crop((auto.row["height"], auto.row["width"]), code, f"a mask of frame {auto.frame}")
    return [float(x) for x in crop.box], int(crop.mask.sum())


def new_row(number: int, seed: Mapping[str, Any], auto: FrameRows, setting: Setting) -> Row:
    """Row of an added object, before lifting."""
    mask, box = seed.get("mask"), seed.get("box")
    bbox, pixels = seed.get("bbox"), 0
    if mask is not None:
        around, pixels = mask_facts(mask, auto)
        bbox = around if bbox is None else bbox
    if bbox is None:
        # The rectangle around the box in the picture; the whole picture without intrinsics.
        height, width, K = (auto.row[name] for name in ("height", "width", "K"))
        bbox = [0.0, 0.0, float(width), float(height)]
        if K is not None:
            corners = box_of(box).corners
            (seen,) = clipped(projected(corners[None], np.array(K).reshape(3, 3)), (height, width))
            bbox = seen.tolist() if seen[2] > seen[0] and seen[3] > seen[1] else bbox
    values = {column: None if box is None else box[column] for column in BOX_COLUMNS}
    return {
        "frame": auto.frame,
        "frame_index": auto.index,
        "object": number,
        "label": seed["label"],
        "score": 1.0,
        "instance": seed.get("instance"),
        "bbox": bbox,
        "mask": mask,
        "mask_source": "human" if mask is not None else "box3d" if box is not None else "box",
        "mask_pixels": pixels,
        "points": 0,
        "kept": 0.0,
        "depth_missing": 0.0,
        "touches_border": False,
        "fallback": False,
        "distance": None,
        **values,
        "yaw_confidence": 0.0,
        "estimator": setting.config.lift.box,
        "open_sides": None,
        "pca_center": None,
        "pca_R": None,
        "pca_size": None,
        "lo": None,
        "hi": None,
        "centroid": None,
        "exact_center": None,
        "exact_R": None,
        "exact_size": None,
        "visible": None,
        "occluded": 0.0,
        "usable": False,
        "reason": "not lifted yet",
    }


def relate_objects(frame: EffectiveFrame, relifted: Pairs | None) -> None:
    """Set the relations of the standing objects before any correction of a relation.

    `relifted` are those of all standing objects judged anew; None without the dataset.
    """
    auto, background = frame.auto, frame.setting.config.is_background
    pairs = auto.pairs.of_objects([n for n, row in frame.objects.items() if not background(row["label"])])
    newly = {n: e for n, e in frame.renamed.items() if n in auto.objects and background(auto.objects[n]["label"])}
    frame.moved = {**newly, **frame.geometry}
    moved = np.isin(pairs.numbers, list(frame.moved))
    frame.related = pairs
    frame.stale = moved & (relifted is None)
    if not moved.any() or relifted is None:
        return
    frame.related, anew = pairs.copy(), relifted.of_objects(pairs.numbers)
    touched = (moved[:, None] | moved[None, :]) & ~np.eye(len(moved), dtype=np.bool_)
    for name in MATRICES:
        getattr(frame.related, name)[touched] = getattr(anew, name)[touched]


def correct_pairs(
    frame: EffectiveFrame, said: Mapping[FieldRef, Sequence[Event]], came: Sequence[Event] | None
) -> None:
    """Apply the events of relations and of their statuses; where only `came` are new, to their pairs alone."""
    judged = {(ref.key, ref.field): events for ref, events in said.items()}
    if came is None:
        frame.pairs = frame.related.copy()
    else:
        both = {e.ref.numbers for e in came if e.ref.kind == "relation"}
        both |= {numbers[::-1] for numbers in both}
        keys = {f"{a},{b}" for a, b in both}
        judged = {at: events for at, events in judged.items() if at[0] in keys}
        frame.forget("relations", keys)
        frame.pairs = frame.pairs.copy() if both else frame.pairs
        for i, j in ((frame.pairs.index_of(a), frame.pairs.index_of(b)) for a, b in both):
            for name in MATRICES if i is not None and j is not None else ():
                getattr(frame.pairs, name)[i, j] = getattr(frame.related, name)[i, j]
    human: dict[tuple[int, int, str], Event] = {}
    for key, field in sorted(judged):
        _correct_relation(frame, judged, key, field, human)
    for (i, j, relation), event in human.items():
        opposite = INVERSE.get(relation)
        if frame.pairs.states[i, j, AT[relation]] != T or opposite is None:
            continue
        # What a person said to hold rules out its opposite, and itself the other way round.
        for a, b, name in ((i, j, opposite), (j, i, relation)):
            ruled_out = frame.pairs.states[a, b, AT[name]] == T and (a, b, name) not in human
            if ruled_out and name in frame.setting.relations:
                _settle(frame, a, b, AT[name], F)
                key = f"{frame.pairs.numbers[a]},{frame.pairs.numbers[b]}"
                frame.put("relations", key, name, Origin.of("recomputed", event), T)


Judged = Mapping[tuple[str, str], Sequence[Event]]
"""Events of relations and their statuses by key and field."""


def _correct_relation(
    frame: EffectiveFrame, judged: Judged, key: str, field: str, human: dict[tuple[int, int, str], Event]
) -> None:
    """Apply the events of a relation or a status; a person's value is entered in `human`."""
    events, boxes, pairs = judged[key, field], frame.auto.objects, frame.pairs
    a, b = events[0].ref.numbers
    i, j = pairs.index_of(a), pairs.index_of(b)
    relation = field.removesuffix(".status")
    reason = None
    if relation not in frame.setting.relations:
        reason = f"the labels do not hold {relation!r}"
    elif i is None or j is None or a == b:
        gone = next((x for x, at in ((a, i), (b, j)) if at is None), a)
        known = gone in frame.left_out or gone in frame.objects
        reason = f"object {gone} takes part in no relation" if known else f"there is no object {gone} any more"
    elif another_thing(events, {n: boxes[n]["bbox"] for n in (a, b) if n in boxes}) is not None:
        reason = "one of the two objects is another thing now"
    if reason is not None or i is None or j is None:
        frame.note(events, all_gone(None, events, str(reason)))
        return
    if field != relation:
        after = frame.note(events, replay(None, events))
        frame.statuses.pop(events[0].ref, None)
        if after.value is not None and after.event is not None:
            frame.statuses[events[0].ref] = after.value
            frame.put("relations", key, field, Origin.of("human", after.event))
        return
    was = pairs.state(a, b, relation)
    # Who saw F where another correction ruled out the labeller's T, did not see the automatic label.
    trusted = a in frame.geometry or b in frame.geometry or (was == T and _ruled_out_before(judged, key, field))
    after = frame.note(events, replay(was, events, trusted=trusted))
    if after.event is not None:
        _settle(frame, i, j, AT[relation], after.value)
        human[i, j, relation] = after.event
        frame.put("relations", key, relation, Origin.of("human", after.event), frame.auto.pairs.state(a, b, relation))


def _ruled_out_before(judged: Judged, key: str, relation: str) -> bool:
    """True where a person had already ruled the relation out (see `correct_pairs`) at the correction."""
    stands = standing(judged[key, relation])
    if relation not in INVERSE or not stands:
        return False
    first, others = stands[0], ((key, INVERSE[relation]), (",".join(reversed(key.split(","))), relation))
    return first.before == F and any(e.after == T and e.id < first.id for c in others for e in judged.get(c, ()))


def _settle(frame: EffectiveFrame, i: int, j: int, k: int, state: int | None) -> None:
    """Set a state; a margin of the other sign becomes 0."""
    pairs, now = frame.pairs, NOT_JUDGED if state is None else state
    pairs.present[i, j], pairs.states[i, j, k] = True, now
    margin = pairs.margins[i, j, k]
    agrees = (state == T and margin > 0) or (state == F and margin < 0)
    pairs.margins[i, j, k] = np.nan if state is None else margin if agrees else 0.0
    pairs.doubted[i, j] &= ~(1 << k)
