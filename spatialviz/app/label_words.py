"""Fields of labels and their values in words, with the classes of the objects instead of bare numbers."""

from __future__ import annotations

from typing import Any

from pipeline.journal.cells import Cell, shown_value
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Event
from pipeline.relations import PHRASE

FIELDS = {
    "targets": "sure answers", "acceptable": "answers", "label": "class", "bbox": "2D box", "box": "3D box",
    "exists": "presence",
}  # fmt: skip
LONGEST = 48


def said_object(number: int, frame: EffectiveFrame | None) -> str:
    """ "mug·3"; "object·3" where nothing is known of it."""
    row = None if frame is None else frame.objects.get(number) or frame.left_out.get(number)
    return f"{'object' if row is None else row['label']}·{number}"


def said_cell(cell: Cell, frame: EffectiveFrame | None) -> str:
    """A field in words."""
    field = FIELDS.get(cell.field, cell.field)
    if cell.kind == "relation":
        a, b = (said_object(n, frame) for n in cell.numbers)
        relation, _, status = cell.field.partition(".")
        return f"{status and 'status of '}{a} {PHRASE.get(relation, relation)} {b}"
    if cell.kind == "object":
        return f"{field} of {said_object(cell.numbers[0], frame)}"
    row = None if frame is None or cell.kind != "expression" else frame.expression(cell.key)
    if row is not None:
        text = row["text"]
        return f"{field} of “{text if len(text) <= LONGEST else f'{text[: LONGEST - 1]}…'}”"
    return f"{field} of the {cell.kind}"


def said_value(cell: Cell, value: Any, frame: EffectiveFrame | None) -> str:
    """A value in words."""
    if cell.kind == "expression" and isinstance(value, list):
        return ", ".join(said_object(n, frame) for n in value) or "nothing"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return shown_value(cell, value)


def said_event(event: Event, frame: EffectiveFrame | None) -> str:
    """What an event changed."""
    before, after = (said_value(event.cell, value, frame) for value in (event.before, event.after))
    return f"{said_cell(event.cell, frame)}: {before} → {after}"


def said_events(events: tuple[Event, ...], frame: EffectiveFrame | None) -> str:
    """What an action changed: its first change in words, and how many more there are."""
    changes = [e for e in events if e.before != e.after] or list(events)
    more = len(changes) - 1
    return said_event(changes[0], frame) + (f" (and {more} more)" if more else "")
