"""A frame's corrected labels as objects in 3D, and as the cases that answers are judged by.

With what is known of a pair of objects, relation by relation, and where from.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef, box_of, relation_ref, same_value
from pipeline.corrections.journal.replay import Origin
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.lifting import LiftedObject, Quality
from pipeline.geometry.masks import decode_crop
from pipeline.labels.cases import HIT, Case, FrameCases, frame_cases
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.annotations import box_mask
from pipeline.relations.relations import U, letter
from pipeline.system.errors import require

# An edit changes one object of a frame; the pixels of the others are known already.
_crop = lru_cache(maxsize=256)(decode_crop)
_OF_THE_LABEL = ("text", "target", "reference", "targets", "acceptable")
_OF_THE_BOX = ("bbox", "mask", "box")


@lru_cache(maxsize=3)
def labelled_objects(frame: EffectiveFrame) -> tuple[SceneObject, ...]:
    """Standing objects by number, from their rows, without points."""
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
        int(mask.sum()),
        int(number("points", 0)),
        number("kept", 0.0),
        number("depth_missing", 0.0),
        bool(row["touches_border"]),
        number("distance", float("nan")),
        bool(row["fallback"]),
        row["mask_source"] or "box",
    )
    lo, hi = (np.full(3, np.nan) if row[k] is None else np.array(row[k], np.float64) for k in ("lo", "hi"))
    lifted = LiftedObject(
        np.empty((0, 3), np.float32), labelled_box(row), number("yaw_confidence", 0.0), lo, hi, None, quality
    )
    return SceneObject(row["object"], row["label"], number("score", 1.0), bbox, mask, lifted)


def effective_truth(frame: EffectiveFrame) -> FrameCases:
    """Cases of a frame and its objects, as `evaluation.cases.read_cases`; InputError for a rejected frame."""
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
        frame.frame,
        row["frame_index"],
        row["scene"],
        rows["objects"],
        relations,
        rows["expressions"],
        names,
        row["rgb_hash"],
    )


def effective_mark(frame: EffectiveFrame, expression: str, mark: str | None) -> str | None:
    """Mark of an expression now: BAD_LABEL, BAD_BOX or None.

    A mark of the labels before does not hold after a correction, or an acceptance, of the expression.
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
    """Reason why a rejected expression is not judged; None otherwise."""
    ref = FieldRef("expression", frame.frame, expression, "status")
    return (
        None if frame.statuses.get(ref) != "rejected" else f"the expression was rejected by {frame.origin(ref).author}"
    )


def answered_case(frame: EffectiveFrame, truth: FrameCases, case: Case, trace: Trace) -> Case:
    """Case by which an answer is judged, where a person set or accepted the targets: all are meant.

    The labelled pair becomes that of the answer, else stays, or becomes the first one's where no longer right.
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


ASKED_BEYOND_M = 0.1
"""A judgement that geometry contradicts by more metres than this is asked about before it is saved."""


@dataclass(frozen=True)
class RelationLine:
    """Relation of a pair."""

    relation: str
    state: int | None  # T (1), U (0), F (-1), or None
    margin: float | None  # metres, signed
    origin: Origin
    status: str | None
    version: int  # number of events

    def against(self, state: int) -> float:
        """Metres by which the rule's margin contradicts T or F; 0 for U."""
        return 0.0 if self.margin is None or state == U else max(0.0, -state * self.margin)

    def record(self) -> dict[str, Any]:
        """JSON record."""
        return {
            "relation": self.relation,
            "state": None if self.state is None else letter(self.state),
            "margin": self.margin,
            "origin": self.origin.source,
            "from": str(self.origin),
            "status": self.status,
            "version": self.version,
        }


@dataclass(frozen=True)
class PairCard:
    """Ordered pair "a RELATION b"."""

    frame: str
    a: int
    b: int
    names: tuple[str, str]  # classes
    distance: float | None  # metres
    lines: tuple[RelationLine, ...]  # in the order of PAIRWISE
    why_none: str = ""  # why no relation; "" where any

    def record(self) -> dict[str, Any]:
        """JSON record."""
        return {
            "frame": self.frame,
            "a": {"object": self.a, "label": self.names[0]},
            "b": {"object": self.b, "label": self.names[1]},
            "distance": self.distance,
            "relations": [line.record() for line in self.lines],
            "why_none": self.why_none or None,
        }


def pair_card(frame: EffectiveFrame, a: int, b: int) -> PairCard:
    """Describe two objects by the labels; InputError for no such object, or twice the same."""
    for number in (a, b):
        require(number in frame.objects, f"frame {frame.frame} has no object {number}")
    require(a != b, "an object has no relation to itself", got=a)
    names = frame.objects[a]["label"], frame.objects[b]["label"]
    pairs = frame.pairs
    i, j = pairs.index_of(a), pairs.index_of(b)
    if i is None or j is None:
        gone = a if i is None else b
        row = frame.objects[gone]
        return PairCard(frame.frame, a, b, names, None, (), f"{row['label']}·{gone}: {row['reason'] or 'not usable'}")
    refs = {relation: relation_ref(frame.frame, a, b, relation) for relation in frame.setting.relations}
    lines = tuple(
        RelationLine(
            relation,
            pairs.state(a, b, relation),
            _number(pairs.margins[i, j, PAIRWISE.index(relation)]),
            frame.origin(ref),
            frame.statuses.get(replace(ref, field=f"{relation}.status")),
            frame.version(ref),
        )
        for relation, ref in refs.items()
    )
    return PairCard(frame.frame, a, b, names, _number(pairs.distance[i, j]), lines)


def _number(value: Any) -> float | None:
    return None if np.isnan(value) else float(value)
