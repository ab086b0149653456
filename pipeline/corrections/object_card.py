"""Cards of labelled objects and expressions, field by field and where from; and the view of a frame's labels."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from pipeline.corrections.journal.edits import Edits, judge, set_answers, set_status, set_value
from pipeline.corrections.journal.effective_frame import EffectiveFrame, object_value
from pipeline.corrections.journal.field_refs import FieldRef, object_ref, same_value, shown_value
from pipeline.corrections.journal.replay import Origin, statuses_of_items
from pipeline.corrections.label_editor import EventLine, LabelEditor
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.scene import PairCard, labelled_box, pair_card
from pipeline.diagnosis.whatif.placement import BoxNumbers, box_numbers
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import decode_run_length
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.provenance import BOX_FITS
from pipeline.proposals.annotations import box_mask
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import needed, require
from pipeline.system.frozen import dataclass

FIELDS = ("label", "status", "mask", "bbox", "box")
"""What of an object can be corrected, in the order in which it is shown."""
Certainty = Literal["sure", "likely", "no"]
"""Whether an expression is true of an object: beyond doubt, with doubt, or not."""
CORRECTED_FIELDS = ("text", "targets", "acceptable", "ambiguous", "mark", "status")
"""The fields that a person may set."""


@dataclass(frozen=True)
class FieldLine:
    """Field of an object."""

    field: str
    value: Any
    text: str  # value in words
    automatic: str | None  # labeller's value in words
    origin: Origin
    version: int  # number of events
    settled: bool  # can be given back

    def record(self) -> dict[str, Any]:
        """JSON record."""
        return {
            "field": self.field,
            "value": self.value,
            "automatic": self.automatic,
            "origin": self.origin.source,
            "from": str(self.origin),
            "author": self.origin.author,
            "time": None if self.origin.time is None else self.origin.time.isoformat(),
            "reason": self.origin.reason or None,
            "version": self.version,
        }


@dataclass(frozen=True)
class ObjectCard:
    """Labelled object with the origin of each field."""

    frame: str
    number: int
    label: str
    stands: bool
    added_by: str  # "" for the labeller
    status: str | None
    statuses: dict[str, str]  # by reviewer
    concern: str  # why not asked for; "" where asked
    score: float
    mask_pixels: int
    points: int
    distance: float | None  # metres
    numbers: BoxNumbers | None
    fit: str  # of a box that nobody set, in words; else ""
    states: dict[str, int]  # counts of T, U and F
    expressions: int  # with it as answer or reference
    fields: tuple[FieldLine, ...]

    def line(self, field: str) -> FieldLine:
        """Line of a field."""
        return next(line for line in self.fields if line.field == field)

    def record(self) -> dict[str, Any]:
        """JSON record; box in the viewer's axes: right, forward, up, metres, and yaw in degrees."""
        n = self.numbers
        box = None if n is None else {"center": list(n.center), "size": list(n.size), "yaw": n.yaw}
        return {
            "frame": self.frame,
            "object": self.number,
            "label": self.label,
            "stands": self.stands,
            "added_by": self.added_by or None,
            "status": self.status,
            "said": self.statuses,
            "concern": self.concern or None,
            "score": self.score,
            "mask_pixels": self.mask_pixels,
            "points": self.points,
            "distance": self.distance,
            "box": box,
            "fit": self.fit or None,
            "relations": self.states,
            "expressions": self.expressions,
            "fields": {line.field: line.record() for line in self.fields},
        }


def object_card(frame: EffectiveFrame, number: int) -> ObjectCard:
    """Describe a standing or rejected object; InputError for no such object."""
    row = needed(frame.object(number), f"frame {frame.frame} has no object {number}")
    box, viewer = labelled_box(row), viewer_of(frame)
    created = number not in frame.auto.objects
    own = box is not None and frame.origin(object_ref(frame.frame, number, "box")).source != "human"
    return ObjectCard(
        frame.frame,
        number,
        row["label"],
        number in frame.objects,
        _added_by(frame, number) if created else "",
        frame.statuses.get(object_ref(frame.frame, number, "status")),
        judgements(frame, number),
        row["reason"] or "",
        float(row["score"]),
        int(row["mask_pixels"]),
        int(row["points"] or 0),
        row["distance"],
        None if box is None or viewer is None else box_numbers(box, viewer),
        BOX_FITS[row["estimator"]] if own else "",
        _states(frame, number),
        sum(number == e["reference_object"] or number in e["acceptable"] for e in frame.expressions.values()),
        tuple(_line(frame, number, name) for name in FIELDS),
    )


def viewer_of(frame: EffectiveFrame) -> ViewerAxes | None:
    """Axes in which the frame's relations are judged; None without an up vector."""
    up = frame.row["up"]
    return None if up is None else viewer_axes(np.array(up, np.float64), frame.row["up_source"] or "assumed")


def back_to_automatic(frame: EffectiveFrame, number: int, field: str, reason: str = "") -> Edits:
    """Give a field back to the labeller; a 3D box to the object's points; InputError for nothing to give back."""
    require(field in FIELDS, "an object has no such field", got=repr(field), expected=", ".join(FIELDS))
    line = object_card(frame, number).line(field)
    require(line.settled, f"nobody has changed the {field} of object {number}")
    default = {"status": "", "box": "as its points make it"}.get(field, "as the labeller had it")
    return set_value(frame, object_ref(frame.frame, number, field), _automatic(frame, number, field), reason or default)


def judgements(frame: EffectiveFrame, number: int) -> dict[str, str]:
    """Status of an object by reviewer."""
    return statuses_of_items(frame.statuses).get(("object", number, None, ""), {})


def bring_back(frame: EffectiveFrame, number: int, author: str, reason: str = "") -> Edits:
    """Bring back a rejected object, with this person's judgement; InputError where not rejected."""
    require(number in frame.left_out, f"object {number} is not rejected")
    ref = object_ref(frame.frame, number, "status")
    own = judge(frame, ref, None, author, reason) if author in judgements(frame, number) else ()
    return (*own, *set_status(frame, ref, None, reason))


def _automatic(frame: EffectiveFrame, number: int, field: str) -> Any:
    return None if field in ("status", "box") else object_value(frame.auto.objects[number], field)


def _line(frame: EffectiveFrame, number: int, field: str) -> FieldLine:
    ref = object_ref(frame.frame, number, field)
    value, origin = frame.value(ref), frame.origin(ref)
    auto = frame.auto.objects.get(number)
    was = None if auto is None else object_value(auto, field)
    text = "unreviewed" if field == "status" and value is None else shown_value(ref, value)
    known = auto is not None or field in ("status", "box")
    settled = known and frame.version(ref) > 0 and origin.source == "human"
    settled = settled and (field == "box" or not same_value(value, _automatic(frame, number, field)))
    automatic = None if auto is None else "unreviewed" if field == "status" else shown_value(ref, was)
    return FieldLine(field, value, text, automatic, origin, frame.version(ref), settled)


def _added_by(frame: EffectiveFrame, number: int) -> str:
    """Author of an added object."""
    origin = frame.noted("objects", str(number), "frame")
    return "somebody" if origin is None else str(origin.author)


def _states(frame: EffectiveFrame, number: int) -> dict[str, int]:
    seen = frame.pairs.states[(frame.pairs.numbers[:, None] == number) & frame.pairs.present]
    return {name: int((seen == state).sum()) for name, state in (("T", T), ("U", U), ("F", F))}


@dataclass(frozen=True)
class ExpressionCard:
    """Expression as it is now."""

    frame: str
    id: str
    text: str
    target: str
    relation: str
    reference: str
    target_object: int
    reference_object: int
    targets: tuple[int, ...]  # true of, beyond doubt
    acceptable: tuple[int, ...]  # with undecided ones
    names: dict[int, str]  # classes by number; "" for a lost one
    ambiguous: bool
    mark: str | None
    status: str | None
    statuses: dict[str, str]  # by reviewer
    withdrawn: str  # reason; "" where it stands
    origins: dict[str, Origin]  # by CORRECTED_FIELDS

    def certainty(self, number: int) -> Certainty:
        """Truth of the expression for an object."""
        return "sure" if number in self.targets else "likely" if number in self.acceptable else "no"

    def is_of(self, pair: Iterable[int]) -> bool:
        """True for the labelled pair, either way round."""
        return {self.target_object, self.reference_object} == set(pair)


def expression_order(frame: EffectiveFrame, pair: Iterable[int] = ()) -> tuple[str, ...]:
    """Ids of a frame's expressions: of the pair first, withdrawn last."""
    chosen, withdrawn = set(pair), {w.id for w in frame.withdrawn}

    def place(name: str) -> tuple[bool, bool]:
        row = frame.expression(name) or {}
        return {row.get("target_object"), row.get("reference_object")} != chosen, name in withdrawn

    return tuple(sorted(frame.sentences, key=place))


def expression_cards(
    frame: EffectiveFrame, pair: Iterable[int] = (), names: Collection[str] | None = None
) -> tuple[ExpressionCard, ...]:
    """Expressions of a frame in this order, by default all: of the pair first, withdrawn last."""
    withdrawn = {w.id: w.reason for w in frame.withdrawn}
    statuses = statuses_of_items(frame.statuses)
    order = expression_order(frame, pair) if names is None else names
    return tuple(_card(frame, name, withdrawn.get(name, ""), statuses) for name in order)


def expression_card(frame: EffectiveFrame, name: str) -> ExpressionCard:
    """Expression by id; InputError for no such id."""
    require(name in frame.sentences, f"frame {frame.frame} has no such expression", got=repr(name)[:60])
    withdrawn = next((w.reason for w in frame.withdrawn if w.id == name), "")
    return _card(frame, name, withdrawn, statuses_of_items(frame.statuses))


def _card(
    frame: EffectiveFrame, name: str, withdrawn: str, statuses: dict[tuple[str, int, int | None, str], dict[str, str]]
) -> ExpressionCard:
    row = frame.expression(name)
    assert row is not None
    refs = {field: FieldRef("expression", frame.frame, name, field) for field in CORRECTED_FIELDS}
    rows = {
        n: frame.object(n)
        for n in dict.fromkeys([row["target_object"], row["reference_object"], *row["targets"], *row["acceptable"]])
    }
    return ExpressionCard(
        frame.frame,
        name,
        row["text"],
        row["target"],
        row["relation"],
        row["reference"],
        row["target_object"],
        row["reference_object"],
        tuple(row["targets"]),
        tuple(row["acceptable"]),
        {n: "" if r is None else r["label"] for n, r in rows.items()},
        bool(row["ambiguous"]),
        frame.marks.get(name),
        frame.statuses.get(refs["status"]),
        statuses.get(("expression", -1, None, name), {}),
        withdrawn,
        {field: frame.origin(ref) for field, ref in refs.items()},
    )


def answers_with(card: ExpressionCard, number: int, certainty: Certainty) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The targets and the acceptable objects of an expression when one object is to be in, in doubt, or out."""
    targets = {*card.targets, number} if certainty == "sure" else {*card.targets} - {number}
    acceptable = {*card.acceptable} - {number} if certainty == "no" else {*card.acceptable, number}
    return tuple(sorted(targets)), tuple(sorted(acceptable | targets))


def set_answer(frame: EffectiveFrame, name: str, number: int, certainty: Certainty, reason: str = "") -> Edits:
    """Set the truth of an expression for an object; InputError for no such id, no change, or no answer left."""
    card = expression_card(frame, name)
    require(card.certainty(number) != certainty, "it says so already", got=f"object {number}: {certainty}")
    return set_answers(frame, name, *answers_with(card, number, certainty), reason)


LISTED = 8
"""Expressions listed around the selected one: those of the chosen pair come first."""


@dataclass(frozen=True)
class LabelView:
    """Labels of the shown frame, and what of them is selected."""

    frame: EffectiveFrame
    card: PairCard | None = None
    relation: str | None = None  # settled by the keys T, U and F
    item: ItemKey | None = None  # of the review queue
    expression: str | None = None  # id
    asked: tuple[int, ...] = ()  # places of the chosen pair, else of the selected object
    about: tuple[int, ...] = ()  # pair whose expressions are listed first
    order: tuple[str, ...] = ()  # of all expressions, by id
    expressions: tuple[ExpressionCard, ...] = ()  # at most LISTED of them, with the selected one
    history: tuple[EventLine, ...] = ()
    author: str = ""

    @property
    def sentence(self) -> ExpressionCard | None:
        """Selected expression."""
        return next((c for c in self.expressions if c.id == self.expression), None)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Standing objects in the order of display."""
        return tuple(sorted(self.frame.objects))

    def number(self, place: int | None) -> int | None:
        """Object at a place; None for none."""
        return None if place is None else dict(enumerate(self.numbers)).get(place)

    def place(self, number: int) -> int | None:
        """Place of an object."""
        numbers = self.numbers
        return numbers.index(number) if number in numbers else None

    def places(self, *numbers: int) -> tuple[int, ...] | None:
        """Places of objects; None for any rejected object."""
        found = tuple(place for place in map(self.place, numbers) if place is not None)
        return found if len(found) == len(numbers) else None

    @property
    def relations(self) -> list[str]:
        """Relations on the pair's card."""
        return [] if self.card is None else [line.relation for line in self.card.lines]

    def detailed(self, editor: LabelEditor, places: tuple[int, ...] | None, selected: int | None) -> LabelView:
        """Add card, expressions and history of the chosen pair and object, given by places."""
        ends = None if places is None else (self.numbers[places[0]], self.numbers[places[1]])
        pair = None if ends is None or ends[0] == ends[1] else ends
        found, number = (
            replace(self, card=None if pair is None else pair_card(self.frame, *pair)),
            self.number(selected),
        )
        relation = self.relation if self.relation in found.relations else next(iter(found.relations), None)
        about = self.about if pair is None or (self.sentence is not None and self.sentence.is_of(pair)) else pair
        objects = () if number is None else (number,)
        order = expression_order(self.frame, about)
        at = order.index(self.expression) if self.expression in order else 0
        start = max(0, min(at - LISTED // 2, len(order) - LISTED))
        history = editor.history(self.frame.frame, objects=objects, pair=pair, expression=self.expression)
        return replace(
            found,
            relation=relation,
            asked=places[:2] if places else () if selected is None else (selected,),
            about=about,
            order=order,
            expressions=expression_cards(self.frame, names=order[start : start + LISTED]),
            history=history,
            author=editor.author,
        )

    def as_labelled(self, number: int, size: tuple[int, int]) -> tuple[np.ndarray, Box3D | None] | None:
        """Mask (H, W) bool and 3D box (camera frame) by the labeller; None if unchanged, or added by a person."""
        before, after = self.frame.auto.objects.get(number), self.frame.objects[number]
        if before is None or all(before[name] == after[name] for name in ("mask", "bbox", "center", "R", "size")):
            return None
        bbox, line = np.array(before["bbox"], np.float32), before["mask"]
        return box_mask(bbox, *size) if line is None else decode_run_length(size, line), labelled_box(before)


def paired(pair: tuple[int, ...] | None, selected: int | None, before: int | None) -> tuple[int, ...] | None:
    """Pair after a selection: the selected object, and the object before."""
    if selected is None or (pair is not None and selected in pair):
        return pair
    other = next((i for i in (before, *(pair or ())) if i not in (None, selected)), None)
    return None if other is None else (selected, other)
