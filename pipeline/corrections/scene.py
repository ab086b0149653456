"""A frame's corrected labels as objects in 3D, and as the cases that answers are judged by."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef, box_of, same_value
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.lifting import LiftedObject, Quality
from pipeline.geometry.masks import decode_crop
from pipeline.labels.cases import HIT, Case, FrameCases, frame_cases
from pipeline.proposals.annotations import box_mask
from pipeline.system.errors import require

# An edit changes one object of a frame; the pixels of the others are known already.
_crop = lru_cache(maxsize=256)(decode_crop)
_OF_THE_LABEL = ("text", "target", "reference", "targets", "acceptable")
_OF_THE_BOX = ("bbox", "mask", "box")


@lru_cache(maxsize=3)
def labelled_objects(frame: EffectiveFrame) -> tuple[SceneObject, ...]:
    """Everything that stands in a frame, in the order of the numbers; `id` is the object's number in the labels.

    Points are not read: what is known of an object is what its row says.
    """
    return tuple(_labelled(frame.objects[n], frame.size) for n in sorted(frame.objects))


def labelled_box(row: dict[str, Any]) -> Box3D | None:
    """The 3D box of a row of `objects` (camera frame); None where it has none."""
    if row["center"] is None or not np.isfinite(np.array(row["center"], np.float64)).all():
        return None
    with suppress(TypeError, ValueError):
        return box_of(row)
    return None


def _labelled(row: dict[str, Any], size: tuple[int, int]) -> SceneObject:
    bbox = np.array(row["bbox"], np.float32)
    if row["mask"] is None:
        mask = box_mask(bbox, *size)
    else:
        mask = np.zeros(size, np.bool_)
        _crop(size, row["mask"], f"object {row['object']}").paint(mask)

    def number(name: str, nothing: float) -> float:
        return nothing if row[name] is None else float(row[name])

    quality = Quality(
        int(mask.sum()), int(number("points", 0)), number("kept", 0.0), number("depth_missing", 0.0),
        bool(row["touches_border"]), number("distance", float("nan")), bool(row["fallback"]),
        row["mask_source"] or "box",
    )  # fmt: skip
    lo, hi = (np.full(3, np.nan) if row[k] is None else np.array(row[k], np.float64) for k in ("lo", "hi"))
    lifted = LiftedObject(
        np.empty((0, 3), np.float32), labelled_box(row), number("yaw_confidence", 0.0), lo, hi, "box", None, quality
    )
    return SceneObject(row["object"], row["label"], number("score", 1.0), bbox, mask, lifted)


def effective_truth(frame: EffectiveFrame) -> FrameCases:
    """The cases of a frame and its objects, as `evaluation.cases.read_cases` reads those of automatic labels.

    Raises
    ------
    InputError
        The frame was rejected: nothing is to be judged by it.
    """
    require(frame.stands, f"frame {frame.frame} was rejected: its labels are not to be used")
    rows = {
        name: {column: table.column(column).to_pylist() for column in table.column_names}
        for name, table in frame.tables().items()
    }
    names, relations = frame.setting.relations, rows["relations"]
    for name in names:
        # A relation that somebody took back has no state.
        relations[name] = [-1 if state is None else state for state in relations[name]]
    row = frame.row
    return frame_cases(
        frame.frame, row["frame_index"], row["scene"], rows["objects"], relations, rows["expressions"], names,
        row["rgb_hash"],
    )  # fmt: skip


def effective_mark(frame: EffectiveFrame, expression: str, mark: str | None) -> str | None:
    """BAD_LABEL, BAD_BOX or None: what people say of an expression now, where `mark` was said of the labels before.

    What was said of the labels before holds no longer where what it was said of
    has been corrected, or where a reviewer has accepted the expression.
    """
    if frame.version(FieldRef("expression", frame.frame, expression, "mark")):
        return frame.marks.get(expression)
    auto, now = frame.auto.expressions.get(expression), frame.expression(expression)
    if mark is None or auto is None or now is None:
        return mark
    if frame.statuses.get(FieldRef("expression", frame.frame, expression, "status")) in ("accepted", "corrected"):
        return None
    if mark == "BAD_LABEL":
        changed = not all(same_value(now[name], auto[name]) for name in _OF_THE_LABEL)
    else:
        cells = [FieldRef("object", frame.frame, str(now["target_object"]), name) for name in _OF_THE_BOX]
        changed = any(frame.origin(ref).source == "human" for ref in cells)
    return None if changed else mark


def withdrawn_by(frame: EffectiveFrame, expression: str) -> str | None:
    """Why there is nothing to judge an expression by: somebody rejected it. None where that is not so."""
    ref = FieldRef("expression", frame.frame, expression, "status")
    if frame.statuses.get(ref) != "rejected":
        return None
    return f"the expression was rejected by {frame.origin(ref).author}"


def answered_case(frame: EffectiveFrame, truth: FrameCases, case: Case, trace: Trace) -> Case:
    """The case by which an answer is judged, where a person has named the right targets of its expression or has
    accepted it with those that it has.

    They are all meant then, and not one of them alone: the labelled pair
    becomes that of the one that was answered, else it stays, or becomes that of
    the first one where its own target is no longer right.
    """
    targets, status = (FieldRef("expression", frame.frame, case.id, field) for field in ("targets", "status"))
    vouched = frame.origin(targets).source == "human" or frame.statuses.get(status) in ("accepted", "corrected")
    if not vouched or not len(case.strict):
        return case
    target = case.target_object if case.target_object in case.strict else int(case.strict[0])
    if trace.ranking is not None and trace.ranking.pairs:
        answer = trace.objects[trace.ranking.pairs[0].target].bbox
        overlap = iou_2d(np.array([answer], np.float64), truth.boxes[case.strict])[0]
        if overlap.max() >= HIT:
            target = int(case.strict[overlap.argmax()])
    if target == case.target_object:
        return case
    references = truth.acceptable_pairs(case)[target] & (np.arange(len(truth.labels)) != target)
    reference = case.reference_object
    if references.any() and not references[reference]:
        reference = int(np.flatnonzero(references)[0])
    return replace(case, target_object=target, reference_object=reference)
