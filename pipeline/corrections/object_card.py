"""What is known of a labelled object or an expression, field by field, where from, and how answers are changed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pipeline.corrections.journal.edits import Edits, judge, set_answers, set_status, set_value
from pipeline.corrections.journal.effective_frame import EffectiveFrame, object_value
from pipeline.corrections.journal.field_refs import FieldRef, object_ref, same_value, shown_value
from pipeline.corrections.journal.replay import Origin, statuses_of_items
from pipeline.corrections.scene import labelled_box
from pipeline.diagnosis.whatif.placement import BoxNumbers, box_numbers
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import needed, require

FIELDS = ("label", "status", "mask", "bbox", "box")
"""What of an object can be corrected, in the order in which it is shown."""
Certainty = Literal["sure", "likely", "no"]
"""Whether an expression is true of an object: beyond doubt, with doubt, or not."""
CORRECTED_FIELDS = ("text", "targets", "acceptable", "ambiguous", "mark", "status")
"""The fields that a person may set."""


@dataclass(frozen=True)
class FieldLine:
    """One field of an object.

    Attributes
    ----------
    field : str
        Of `FIELDS`.
    value : JSON value
    text : str
        The same in a few words.
    automatic : str or None
        What the labeller had, in a few words; None where it had no such object.
    origin : Origin
    version : int
        How many events it has.
    settled : bool
        It can be given back to the labeller.
    """

    field: str
    value: Any
    text: str
    automatic: str | None
    origin: Origin
    version: int
    settled: bool

    def record(self) -> dict[str, Any]:
        """As JSON."""
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
    """A labelled object.

    Attributes
    ----------
    frame : str
    number : int
    label : str
    stands : bool
        It was not rejected.
    added_by : str
        Who added it; "" where the labeller found it.
    status : str or None
        For all: "rejected", or what was said before judgements were each person's own.
    statuses : dict of str to str
        Status by reviewer.
    concern : str
        Why it is not asked for; "" where it is.
    score : float
    mask_pixels, points : int
    distance : float or None
        Metres.
    numbers : BoxNumbers or None
        Of its 3D box.
    states : dict of str to int
        How many of its relations, seen from it, are T, U and F.
    expressions : int
        How many have it as an answer or as their reference.
    fields : tuple of FieldLine
    """

    frame: str
    number: int
    label: str
    stands: bool
    added_by: str
    status: str | None
    statuses: dict[str, str]
    concern: str
    score: float
    mask_pixels: int
    points: int
    distance: float | None
    numbers: BoxNumbers | None
    states: dict[str, int]
    expressions: int
    fields: tuple[FieldLine, ...]

    def line(self, field: str) -> FieldLine:
        """Of that field."""
        return next(line for line in self.fields if line.field == field)

    def record(self) -> dict[str, Any]:
        """As JSON; the box's numbers are in the viewer's axes: right, forward, up, metres, and yaw in degrees."""
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
            "relations": self.states,
            "expressions": self.expressions,
            "fields": {line.field: line.record() for line in self.fields},
        }


def object_card(frame: EffectiveFrame, number: int) -> ObjectCard:
    """What the labels say of an object that stands, or was rejected.

    Raises
    ------
    InputError
        There is no such object.
    """
    row = needed(frame.object(number), f"frame {frame.frame} has no object {number}")
    box, viewer = labelled_box(row), viewer_of(frame)
    created = number not in frame.auto.objects
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
        _states(frame, number),
        sum(number == e["reference_object"] or number in e["acceptable"] for e in frame.expressions.values()),
        tuple(_line(frame, number, name) for name in FIELDS),
    )


def viewer_of(frame: EffectiveFrame) -> ViewerAxes | None:
    """The axes in which the frame's relations are judged; None where nothing says what is up."""
    up = frame.row["up"]
    return None if up is None else viewer_axes(np.array(up, np.float64), frame.row["up_source"] or "assumed")


def back_to_automatic(frame: EffectiveFrame, number: int, field: str, reason: str = "") -> Edits:
    """A field as the labeller had it; a 3D box as the object's points make it.

    Raises
    ------
    InputError
        There is no such object or field, the labeller had none, or nobody has changed it.
    """
    require(field in FIELDS, "an object has no such field", got=repr(field), expected=", ".join(FIELDS))
    line = object_card(frame, number).line(field)
    require(line.settled, f"nobody has changed the {field} of object {number}")
    default = {"status": "", "box": "as its points make it"}.get(field, "as the labeller had it")
    return set_value(frame, object_ref(frame.frame, number, field), _automatic(frame, number, field), reason or default)


def judgements(frame: EffectiveFrame, number: int) -> dict[str, str]:
    """What reviewers say of an object: status by author."""
    return statuses_of_items(frame.statuses).get(("object", number, None, ""), {})


def bring_back(frame: EffectiveFrame, number: int, author: str, reason: str = "") -> Edits:
    """Have a rejected object stand again; what this person said of it is taken back with that.

    Raises
    ------
    InputError
        It is not rejected.
    """
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
    """Every column of an added object comes from its adding, until it is corrected; this one cannot be."""
    origin = frame.noted("objects", str(number), "frame")
    return "somebody" if origin is None else str(origin.author)


def _states(frame: EffectiveFrame, number: int) -> dict[str, int]:
    seen = frame.pairs.states[(frame.pairs.numbers[:, None] == number) & frame.pairs.present]
    return {name: int((seen == state).sum()) for name, state in (("T", T), ("U", U), ("F", F))}


@dataclass(frozen=True)
class ExpressionCard:
    """One expression, as it is now.

    Attributes
    ----------
    frame, id, text : str
    target, relation, reference : str
        What it asks for.
    target_object, reference_object : int
        Numbers of the labelled pair.
    targets, acceptable : tuple of int
        Numbers of the objects that it is true of: beyond doubt, and with the undecided ones.
    names : dict of int to str
        Classes of all these objects; of one that is gone, "".
    ambiguous : bool
    mark, status : str or None
    statuses : dict of str to str
        What each reviewer says of it.
    withdrawn : str
        Why it is left out of the labels; "" where it stands.
    origins : dict of str to Origin
        Of each of CORRECTED_FIELDS.
    versions : dict of str to int
    """

    frame: str
    id: str
    text: str
    target: str
    relation: str
    reference: str
    target_object: int
    reference_object: int
    targets: tuple[int, ...]
    acceptable: tuple[int, ...]
    names: dict[int, str]
    ambiguous: bool
    mark: str | None
    status: str | None
    statuses: dict[str, str]
    withdrawn: str
    origins: dict[str, Origin]
    versions: dict[str, int]

    def certainty(self, number: int) -> Certainty:
        """Whether it is true of an object."""
        return "sure" if number in self.targets else "likely" if number in self.acceptable else "no"

    def is_of(self, pair: Iterable[int]) -> bool:
        """Whether its labelled pair is these two objects, either way round."""
        return {self.target_object, self.reference_object} == set(pair)


def expression_cards(frame: EffectiveFrame, pair: Iterable[int] = ()) -> tuple[ExpressionCard, ...]:
    """All expressions of a frame: those of a pair of objects first, those that were left out last."""
    withdrawn = {w.id: w.reason for w in frame.withdrawn}
    statuses = statuses_of_items(frame.statuses)
    cards = [_card(frame, name, withdrawn.get(name, ""), statuses) for name in frame.sentences]
    chosen = tuple(pair)
    return tuple(sorted(cards, key=lambda c: (not c.is_of(chosen), bool(c.withdrawn))))


def expression_card(frame: EffectiveFrame, name: str) -> ExpressionCard:
    """One expression, by its id; InputError where the frame has no such expression."""
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
        frame.frame, name, row["text"], row["target"], row["relation"], row["reference"], row["target_object"],
        row["reference_object"], tuple(row["targets"]), tuple(row["acceptable"]),
        {n: "" if r is None else r["label"] for n, r in rows.items()}, bool(row["ambiguous"]),
        frame.marks.get(name), frame.statuses.get(refs["status"]), statuses.get(("expression", -1, None, name), {}),
        withdrawn,
        {field: frame.origin(ref) for field, ref in refs.items()},
        {field: frame.version(ref) for field, ref in refs.items()},
    )  # fmt: skip


def answers_with(card: ExpressionCard, number: int, certainty: Certainty) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The targets and the acceptable objects of an expression when one object is to be in, in doubt, or out."""
    targets = {*card.targets, number} if certainty == "sure" else {*card.targets} - {number}
    acceptable = {*card.acceptable} - {number} if certainty == "no" else {*card.acceptable, number}
    return tuple(sorted(targets)), tuple(sorted(acceptable | targets))


def set_answer(frame: EffectiveFrame, name: str, number: int, certainty: Certainty, reason: str = "") -> Edits:
    """Say of one object whether an expression is true of it; of what it is true else stays.

    Raises
    ------
    InputError
        No such expression or object, nothing would be changed, or no answer would be left.
    """
    card = expression_card(frame, name)
    require(card.certainty(number) != certainty, "it says so already", got=f"object {number}: {certainty}")
    return set_answers(frame, name, *answers_with(card, number, certainty), reason)
