"""Replaying the events of a cell over its automatic label: what it is now, and which events no longer apply."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef, same_value, shown_value
from pipeline.geometry.boxes import iou_2d

ANCHOR_IOU = 0.5
"""An object's automatic 2D box must overlap by this much with what it was when it was corrected."""


@dataclass(frozen=True)
class Unapplied:
    """An event that says nothing of the labels as they are now.

    Attributes
    ----------
    event : Event
    kind : str
        "gone": its object, pair or expression is no longer there, or is another one. "changed": the automatic label
        is no longer what was corrected. "agreed": the automatic label says by now what it was corrected to.
    reason : str
    """

    event: Event
    kind: Literal["gone", "changed", "agreed"]
    reason: str


@dataclass(frozen=True)
class Replayed:
    """A cell after its events.

    Attributes
    ----------
    value : JSON value
    event : Event or None
        What made it so; None where it is the automatic label.
    version : int
        How many events the cell has, applied or not.
    unapplied : tuple of Unapplied
    """

    value: Any
    event: Event | None
    version: int
    unapplied: tuple[Unapplied, ...]


def standing(events: Sequence[Event]) -> list[Event]:
    """The edits of a cell that were not taken back, in the order of their versions.

    Only a cell's newest event can be taken back: so they are a stack.
    """
    found: list[Event] = []
    taken: dict[str, Event] = {}
    for event in events:
        if event.action == "edit" or event.undo_of is None:
            found.append(event)
        elif event.action == "undo" and found:
            taken[event.ulid] = found.pop()
        elif event.undo_of in taken:
            found.append(taken[event.undo_of])
    return found


def replay(
    automatic: Any, events: Sequence[Event], *, trusted: bool = False, released_by_none: bool = False
) -> Replayed:
    """Apply the events of a cell to its automatic label, in the order of their versions.

    An event applies where the value is what its author saw. What does not
    apply is listed, unless a later event settles the cell. `trusted` cells
    follow from other corrections: what their authors saw is not to be compared
    with the automatic label. With `released_by_none` a value of None is none: the
    cell is the automatic one again.
    """
    value, origin, unapplied = automatic, None, []
    for event in standing(events):
        if trusted or same_value(event.before, value):
            value, origin, unapplied = event.after, event, []
            if released_by_none and event.after is None:
                value = automatic
            continue
        now = shown_value(event.cell, value)
        if same_value(event.after, value):
            unapplied.append(Unapplied(event, "agreed", f"the labels say {now} by themselves now"))
        else:
            made_on = shown_value(event.cell, event.before)
            unapplied.append(Unapplied(event, "changed", f"it was made on {made_on}, and the labels say {now} now"))
    return Replayed(value, origin, events[-1].version if events else 0, tuple(unapplied))


def all_gone(automatic: Any, events: Sequence[Event], reason: str) -> Replayed:
    """A cell whose entity is no longer there: every edit that was not taken back is listed."""
    unapplied = tuple(Unapplied(e, "gone", reason) for e in standing(events))
    return Replayed(automatic, None, events[-1].version if events else 0, unapplied)


def is_another(anchor: dict[str, list[float]], number: int, bbox: Sequence[float]) -> bool:
    """Whether an object's number was given to another thing since an edit was anchored to it."""
    was = anchor.get(str(number))
    return was is not None and float(iou_2d(np.array([was]), np.array([bbox]))[0, 0]) < ANCHOR_IOU


def by_cell(events: Iterable[Event]) -> dict[FieldRef, list[Event]]:
    """Events of each cell, in the order of their versions."""
    found: dict[FieldRef, list[Event]] = {}
    for event in events:
        found.setdefault(event.cell, []).append(event)
    return {cell: sorted(members, key=lambda e: e.version) for cell, members in found.items()}
