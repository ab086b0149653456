"""What reviewers say of labels, each in a cell of their own, so that no judgement gets in the way of another's.

A corrected value is the label of all: who edits it must have seen who was there
before. A judgement ("I have looked at it, and it is T") is one person's word on
an item. Two people who judge one item independently write two cells, never the
same version of one; agreement is counted from these. No label follows from a
judgement. Where reviewers differ, `edits.settle` says the last word, in a cell
that is nobody's own and is locked as any other.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import OF_ALL, FieldRef, judged_item, judged_key
from pipeline.corrections.journal.replay import Replayed, all_gone, is_another, replay


def judgement_cell(frame: str, kind: str, a: int, b: int | None, what: str, author: str) -> FieldRef:
    """The cell of what someone says of an item, or, by OF_ALL, of what settles it.

    Parameters
    ----------
    kind : str
        "relation", "object" or "expression".
    a, b : int
        Numbers of the objects of a pair; of an object its own and None, -1 where one may be missing; of an
        expression -1 and None.
    what : str
        The relation, or the expression's id; of an object empty, and where one may be missing the place.
    author : str

    Raises
    ------
    InputError
        There is no such item.
    """
    name = author.strip()
    return FieldRef("review", frame, judged_key(name, kind, a, b, what), "settled" if name == OF_ALL else "said")


def said_of_items(statuses: Mapping[FieldRef, Any]) -> dict[tuple[str, int, int | None, str], dict[str, str]]:
    """The status that each author gives, by kind, a, b and what of the item (see `judgement_cell`).

    Parameters
    ----------
    statuses : mapping of Cell to JSON value
        Of an effective frame.
    """
    found: dict[tuple[str, int, int | None, str], dict[str, str]] = {}
    for cell, value in statuses.items():
        if cell.kind == "review" and cell.field == "said":
            author, kind, a, b, what = judged_item(cell.key)
            found.setdefault((kind, a, b, what), {})[author] = value["status"]
    return {item: dict(sorted(said.items())) for item, said in found.items()}


def replayed_judgement(
    cell: FieldRef,
    events: Sequence[Event],
    boxes: Mapping[int, Any],
    objects: Collection[int],
    expressions: Collection[str],
) -> Replayed:
    """A judgement after its events; it no longer applies where its item is gone or another thing.

    Parameters
    ----------
    boxes : mapping of int to list of float
        2D boxes of the automatic objects.
    objects, expressions : collection
        Numbers and ids of those that there are.
    """
    _, kind, _, _, what = judged_item(cell.key)
    if kind == "expression" and what not in expressions:
        return all_gone(None, events, "there is no such expression any more")
    for number in cell.numbers:
        if number not in objects:
            return all_gone(None, events, f"there is no object {number} any more")
        if number in boxes and any(is_another(e.anchor, number, boxes[number]) for e in events):
            return all_gone(None, events, f"object {number} is another thing now")
    return replay(None, events)
