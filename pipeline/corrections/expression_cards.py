"""What is known of the expressions of a frame, field by field, and how their answers are changed by hand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from pipeline.corrections.journal.edits import Edits, set_answers
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.journal.judgements import said_of_items
from pipeline.corrections.journal.origins import Origin
from pipeline.system.errors import InputError

Doubt = Literal["sure", "likely", "no"]
"""Whether an expression is true of an object: beyond doubt, with doubt, or not."""
CORRECTED_FIELDS = ("text", "targets", "acceptable", "ambiguous", "mark", "status")
"""The fields that a person may set."""


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
        Numbers of the objects that it is true of: beyond doubt, and with the doubtful ones.
    names : dict of int to str
        Classes of all these objects; of one that is gone, "".
    ambiguous : bool
    mark, status : str or None
    said : dict of str to str
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
    said: dict[str, str]
    withdrawn: str
    origins: dict[str, Origin]
    versions: dict[str, int]

    def doubt(self, number: int) -> Doubt:
        """Whether it is true of an object."""
        return "sure" if number in self.targets else "likely" if number in self.acceptable else "no"

    def is_of(self, pair: Iterable[int]) -> bool:
        """Whether its labelled pair is these two objects, either way round."""
        return {self.target_object, self.reference_object} == set(pair)

    def record(self) -> dict[str, Any]:
        """As JSON."""

        def listed(numbers: tuple[int, ...]) -> list[dict[str, Any]]:
            return [{"object": n, "label": self.names[n] or None} for n in numbers]

        return {
            "frame": self.frame,
            "expression": self.id,
            "text": self.text,
            "target": {"object": self.target_object, "label": self.target},
            "relation": self.relation,
            "reference": {"object": self.reference_object, "label": self.reference},
            "targets": listed(self.targets),
            "acceptable": listed(self.acceptable),
            "ambiguous": self.ambiguous,
            "mark": self.mark,
            "status": self.status,
            "said": self.said,
            "withdrawn": self.withdrawn or None,
            "origin": {name: origin.source for name, origin in self.origins.items()},
            "from": {name: str(origin) for name, origin in self.origins.items()},
            "versions": dict(self.versions),
        }


def expression_cards(frame: EffectiveFrame, pair: Iterable[int] = ()) -> tuple[ExpressionCard, ...]:
    """All expressions of a frame: those of a pair of objects first, those that were left out last."""
    withdrawn = {w.id: w.reason for w in frame.withdrawn}
    said = said_of_items(frame.statuses)
    cards = [_card(frame, name, withdrawn.get(name, ""), said) for name in frame.auto.expressions]
    chosen = tuple(pair)
    return tuple(sorted(cards, key=lambda c: (not c.is_of(chosen), bool(c.withdrawn))))


def expression_card(frame: EffectiveFrame, name: str) -> ExpressionCard:
    """One expression, by its id; InputError where the frame has no such expression."""
    if name not in frame.auto.expressions:
        raise InputError(f"frame {frame.frame} has no such expression", got=repr(name)[:60])
    withdrawn = next((w.reason for w in frame.withdrawn if w.id == name), "")
    return _card(frame, name, withdrawn, said_of_items(frame.statuses))


def expression_records(frame: EffectiveFrame) -> list[dict[str, Any]]:
    """All expressions of a frame as JSON."""
    return [card.record() for card in expression_cards(frame)]


def _card(
    frame: EffectiveFrame, name: str, withdrawn: str, said: dict[tuple[str, int, int | None, str], dict[str, str]]
) -> ExpressionCard:
    row = frame.expression(name)
    assert row is not None
    cells = {field: FieldRef("expression", frame.frame, name, field) for field in CORRECTED_FIELDS}
    numbers = dict.fromkeys([row["target_object"], row["reference_object"], *row["targets"], *row["acceptable"]])
    rows = {n: frame.objects.get(n) or frame.left_out.get(n) for n in numbers}
    return ExpressionCard(
        frame.frame, name, row["text"], row["target"], row["relation"], row["reference"], row["target_object"],
        row["reference_object"], tuple(row["targets"]), tuple(row["acceptable"]),
        {n: "" if r is None else r["label"] for n, r in rows.items()}, bool(row["ambiguous"]),
        frame.marks.get(name), frame.statuses.get(cells["status"]), said.get(("expression", -1, None, name), {}),
        withdrawn,
        {field: frame.origin(cell) for field, cell in cells.items()},
        {field: frame.version(cell) for field, cell in cells.items()},
    )  # fmt: skip


def answers_with(card: ExpressionCard, number: int, doubt: Doubt) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The targets and the acceptable objects of an expression when one object is to be in, in doubt, or out."""
    targets, acceptable = set(card.targets) - {number}, set(card.acceptable) - {number}
    if doubt == "sure":
        targets.add(number)
    if doubt != "no":
        acceptable.add(number)
    return tuple(sorted(targets)), tuple(sorted(acceptable | targets))


def set_answer(frame: EffectiveFrame, name: str, number: int, doubt: Doubt, reason: str = "") -> Edits:
    """Say of one object whether an expression is true of it; of what it is true else stays.

    Raises
    ------
    InputError
        No such expression or object, nothing would be changed, or no answer would be left.
    """
    card = expression_card(frame, name)
    if card.doubt(number) == doubt:
        raise InputError("it says so already", got=f"object {number}: {doubt}")
    return set_answers(frame, name, *answers_with(card, number, doubt), reason)
