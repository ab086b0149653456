"""The history of one object, pair or expression: who changed what, from what to what, and what was taken back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef, shown_value
from pipeline.corrections.journal.undo import history


@dataclass(frozen=True)
class EventLine:
    """One edit.

    Attributes
    ----------
    event : Event
    undone : Event or None
        What took it back, where it was not brought back since.
    group : str
        The action that the one who looks may take back with it; "" where it is not theirs, or taken back already.
    waiting : bool
        It is not saved yet.
    """

    event: Event
    undone: Event | None
    group: str
    waiting: bool = False

    @property
    def change(self) -> tuple[str, str]:
        """From what to what, in words."""
        e = self.event
        return shown_value(e.cell, e.before), shown_value(e.cell, e.after)

    def record(self) -> dict[str, Any]:
        """As JSON."""
        before, after = self.change
        return {
            "event": self.event.ulid,
            "group": self.event.group,
            "author": self.event.author,
            "time": self.event.time.isoformat(),
            "field": self.event.cell.field,
            "key": self.event.cell.key,
            "before": before,
            "after": after,
            "reason": self.event.reason or None,
            "undone_by": None if self.undone is None else self.undone.author,
            "saved": not self.waiting,
        }


def about_object(cell: FieldRef, number: int) -> bool:
    """Whether a cell is one of an object's own."""
    return cell.kind == "object" and cell.numbers == (number,)


def about_pair(cell: FieldRef, a: int, b: int) -> bool:
    """Whether a cell is a relation of a pair, either way round."""
    return cell.kind == "relation" and set(cell.numbers) == {a, b}


def about_expression(cell: FieldRef, name: str) -> bool:
    """Whether a cell is one of an expression's."""
    return cell.kind == "expression" and cell.key == name


def event_lines(
    events: Sequence[Event],
    author: str,
    *,
    objects: Iterable[int] = (),
    pair: tuple[int, int] | None = None,
    expression: str | None = None,
    waiting: Iterable[str] = (),
) -> tuple[EventLine, ...]:
    """The edits of what is asked for, the newest first.

    Parameters
    ----------
    events : sequence of Event
        Of one frame, in the order of their saving.
    author : str
        Who looks.
    objects : iterable of int
    pair : tuple of int, optional
    expression : str, optional
    waiting : iterable of str
        Groups that are not saved yet.
    """
    numbers, unsaved = set(objects), set(waiting)
    mine = {members[0].group for members in history(e for e in events if e.author == author).done}
    root: dict[str, str] = {}
    newest: dict[str, Event] = {}
    for event in events:
        # An undo is of an edit or of a redo, a redo of an undo: in the end all are of one edit.
        taken = event.undo_of if event.action != "edit" else None
        root[event.ulid] = event.ulid if taken is None else root.get(taken, taken)
        newest[root[event.ulid]] = event

    def wanted(cell: FieldRef) -> bool:
        return (
            any(about_object(cell, n) for n in numbers)
            or (pair is not None and about_pair(cell, *pair))
            or (expression is not None and about_expression(cell, expression))
        )

    lines = []
    for event in events:
        if event.action == "edit" and wanted(event.cell):
            last = newest[event.ulid]
            undone, group = (last, "") if last.action == "undo" else (None, last.group)
            lines.append(EventLine(event, undone, group if group in mine else "", event.group in unsaved))
    return tuple(lines[::-1])
