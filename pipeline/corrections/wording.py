"""Corrections in words, with the classes of the objects instead of bare numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Event, Saved
from pipeline.corrections.journal.field_refs import FieldRef, box_of, judged_item, shown_value
from pipeline.corrections.unsaved import Waiting
from pipeline.geometry.boxes import Box3D
from pipeline.language.relation_names import MIRRORED, PHRASE
from pipeline.relations.relations import letter

FIELDS = {
    "targets": "sure answers", "acceptable": "answers", "label": "class", "bbox": "2D box", "box": "3D box",
    "mask": "pixels", "exists": "presence",
}  # fmt: skip
LONGEST = 48
SMALLEST_MOVE = 5e-4
"""Metres: less is not told of a box."""
SMALLEST_TURN = 0.05
"""Degrees."""


def said_object(number: int, frame: EffectiveFrame | None) -> str:
    """ "mug·3"; "object·3" where nothing is known of it."""
    row = None
    if frame is not None:
        row = frame.objects.get(number) or frame.left_out.get(number) or frame.auto.objects.get(number)
    return f"{'object' if row is None else row['label']}·{number}"


def said_sentence(name: str, frame: EffectiveFrame | None) -> str:
    """The words of an expression, in quotes; its id where nothing is known of it."""
    row = None if frame is None else frame.expression(name)
    if row is None:
        return f"expression {name}"
    text = row["text"]
    return f"“{text if len(text) <= LONGEST else f'{text[: LONGEST - 1]}…'}”"


def said_cell(cell: FieldRef, frame: EffectiveFrame | None) -> str:
    """A field in words."""
    field = FIELDS.get(cell.field, cell.field)
    if cell.kind == "review":
        return f"judgement of {_judged(cell, frame)}"
    if cell.kind == "relation":
        a, b = (said_object(n, frame) for n in cell.numbers)
        relation, _, status = cell.field.partition(".")
        return f"{status and 'status of '}{a} {PHRASE.get(relation, relation)} {b}"
    if cell.kind == "object":
        return f"{field} of {said_object(cell.numbers[0], frame)}"
    if cell.kind == "expression":
        return f"{field} of {said_sentence(cell.key, frame)}"
    return f"{field} of the {cell.kind}"


def said_value(cell: FieldRef, value: Any, frame: EffectiveFrame | None) -> str:
    """A value in words."""
    if cell.kind == "expression" and isinstance(value, list):
        return ", ".join(said_object(n, frame) for n in value) or "nothing"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if cell.kind == "object" and cell.field == "box":
        return "as its points make it" if value is None else "placed by hand"
    return shown_value(cell, value)


def said_event(event: Event, frame: EffectiveFrame | None) -> str:
    """What an event changed, or what somebody said of an item."""
    cell = event.cell
    if cell.kind == "review":
        if event.after is None:
            return f"{_judged(cell, frame)}: judgement withdrawn"
        value = event.after.get("value")
        state = "" if value is None else f" is {letter(value)}"
        return f"{_judged(cell, frame)}{state}: {event.after['status']}"
    if cell.kind == "object" and cell.field == "box" and event.before is not None and event.after is not None:
        return f"{said_cell(cell, frame)}: {_box_change(box_of(event.before), box_of(event.after))}"
    if cell.field == "exists" and event.before is None and event.after is not None:
        return shown_value(cell, event.after)
    before, after = (said_value(cell, value, frame) for value in (event.before, event.after))
    return f"{said_cell(cell, frame)}: {before} → {after}"


def _box_change(before: Box3D, after: Box3D) -> str:
    """What of a box a person changed; what stays is not told."""
    moved = float(np.linalg.norm(after.center - before.center))
    angle = np.rad2deg(np.arccos(np.clip((np.trace(before.R.T @ after.R) - 1) / 2, -1, 1)))
    parts = [f"moved {100 * moved:.1f} cm"] if moved >= SMALLEST_MOVE else []
    if np.abs(after.size - before.size).max() >= SMALLEST_MOVE:
        parts.append(" → ".join(" × ".join(f"{x:.3f}" for x in box.size) for box in (before, after)) + " m")
    if angle >= SMALLEST_TURN:
        parts.append(f"turned {angle:.1f}°")
    return ", ".join(parts) or "less than a millimetre"


def said_events(events: Sequence[Event], frame: EffectiveFrame | None) -> str:
    """What an action changed: its first change in words, and how many more there are.

    What follows for "b ... a" from what was said of "a ... b" is not counted.
    """
    changes = [e for e in events if e.before != e.after] or list(events)
    if not changes:
        return ""
    more = sum(not _mirrors(changes[0], e) for e in changes[1:])
    return said_event(changes[0], frame) + (f" (and {more} more)" if more else "")


def said_outcome(
    outcome: Saved | Conflict | Waiting | None, verb: str, frame: EffectiveFrame | None = None
) -> tuple[str, bool]:
    """What came of an action in words, and whether it was not done."""
    if isinstance(outcome, Saved):
        return f"{verb}: {said_events(outcome.events, frame)}", False
    if isinstance(outcome, Conflict):
        rival = outcome.rivals[0]
        who = "somebody" if rival.event is None else rival.event.author
        return f"not saved, {who} was faster: {said_cell(rival.edit.cell, frame)}", True
    if isinstance(outcome, Waiting) and verb == "taken back":
        return "taken back before it was saved", False
    if isinstance(outcome, Waiting):
        return "not saved yet: it is kept here, and saved as soon as the journal can be written", True
    return "", False


def _judged(cell: FieldRef, frame: EffectiveFrame | None) -> str:
    _, kind, a, b, what = judged_item(cell.key)
    if kind == "relation":
        return f"{said_object(a, frame)} {PHRASE.get(what, what)} {said_object(int(b or 0), frame)}"
    if kind == "object":
        return said_object(a, frame) if a >= 0 else "a place without a label"
    return said_sentence(what, frame)


def _mirrors(one: Event, other: Event) -> bool:
    first, second = _pair(one.cell), _pair(other.cell)
    if first is None or second is None:
        return False
    (a, b, relation), (c, d, mirrored) = first, second
    return (a, b) == (d, c) and mirrored == MIRRORED.get(relation)


def _pair(cell: FieldRef) -> tuple[int, int, str] | None:
    if cell.kind == "relation":
        a, b = cell.numbers
        return a, b, cell.field
    if cell.kind == "review":
        _, kind, a, b, what = judged_item(cell.key)
        if kind == "relation" and b is not None:
            return a, b, what
    return None
