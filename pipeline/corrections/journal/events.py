"""What goes into the journal and what comes back: edits, events, and the two ends that saving can have."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, TypeVar

from pipeline.corrections.journal.field_refs import LONGEST_TEXT, FieldRef, checked, plain_text, shown_value
from pipeline.system.errors import InputError, require

Action = Literal["edit", "undo", "redo"]
Thing = TypeVar("Thing")
Key = TypeVar("Key", bound=Hashable)
CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"


def grouped(things: Iterable[Thing], key: Callable[[Thing], Key]) -> dict[Key, list[Thing]]:
    """Things by what they have in common, in their order."""
    found: dict[Key, list[Thing]] = {}
    for thing in things:
        found.setdefault(key(thing), []).append(thing)
    return found


def new_ulid() -> str:
    """26 characters that sort by time of making: 48 bits of milliseconds and 80 random ones (github.com/ulid/spec)."""
    number = (time.time_ns() // 1_000_000) << 80 | int.from_bytes(os.urandom(10), "big")
    return "".join(CROCKFORD[(number >> shift) & 31] for shift in range(125, -5, -5))


@dataclass(frozen=True)
class Edit:
    """A change that someone wants to make to one cell.

    Attributes
    ----------
    ref : FieldRef
    before, after : JSON value
        What the person saw, and what it is to be.
    base : int
        The cell's version that the person saw; 0 is the automatic label.
    reason : str
    anchor : dict of str to list of float
        2D boxes of the automatic objects concerned, by number, as they were:
        labels made again may give their numbers to other things.
    """

    ref: FieldRef
    before: Any
    after: Any
    base: int = 0
    reason: str = ""
    anchor: dict[str, list[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "before", checked(self.ref, self.before) if self.before is not None else None)
        object.__setattr__(self, "after", checked(self.ref, self.after))
        require(
            not isinstance(self.base, bool) and isinstance(self.base, int) and self.base >= 0,
            "a version must be a number from 0 on",
            got=repr(self.base)[:60],
        )
        if self.reason:
            plain_text(self.reason, "a reason", LONGEST_TEXT)


@dataclass(frozen=True)
class Event:
    """One edit as it stands in the journal.

    Attributes
    ----------
    id : int
        Its place: events are numbered in the order in which they were saved.
    ulid : str
    author : str
    time : datetime
        UTC.
    ref : FieldRef
    before, after : JSON value
    base, version : int
        The cell's version that it was made on, and the one that it made.
    labels : str
        The automatic labels that it was made on, see `labels_version`.
    reason : str
    group : str
        What was done in one action has one group.
    action : str
        "edit", "undo" or "redo".
    undo_of : str or None
        ULID of the event that this one takes back: of an edit, of an undo where it is a redo.
    anchor : dict of str to list of float
    """

    id: int
    ulid: str
    author: str
    time: datetime
    ref: FieldRef
    before: Any
    after: Any
    base: int
    version: int
    labels: str
    reason: str
    group: str
    action: Action
    undo_of: str | None
    anchor: dict[str, list[float]]


@dataclass(frozen=True)
class Saved:
    """All edits of an action are in the journal, on the disk.

    Attributes
    ----------
    events : tuple of Event
        In the order of the edits.
    """

    events: tuple[Event, ...]

    @property
    def group(self) -> str:
        return self.events[0].group


@dataclass(frozen=True)
class Rival:
    """A cell that has changed since the person saw it.

    Attributes
    ----------
    edit : Edit
        What the person wanted.
    event : Event or None
        The newest event of that cell: who, when, to what. None where the person has seen more than there is.
    """

    edit: Edit
    event: Event | None

    def __str__(self) -> str:
        if self.event is None:
            return f"{self.edit.ref} has no version {self.edit.base}"
        when = self.event.time.strftime("%Y-%m-%d %H:%M:%S UTC")
        return (
            f"{self.edit.ref}: {self.event.author} made it {shown_value(self.edit.ref, self.event.after)} at {when}, "
            f"wanted {shown_value(self.edit.ref, self.edit.after)}"
        )


@dataclass(frozen=True)
class Conflict:
    """Nothing was saved, because cells have changed since the person saw them.

    Attributes
    ----------
    rivals : tuple of Rival
        At least one.
    edits : tuple of Edit
        All of the action, also those that nobody was in the way of.
    """

    rivals: tuple[Rival, ...]
    edits: tuple[Edit, ...] = ()


class NotSaved(InputError):
    """The journal could not be written; the edits are handed back, to be kept and tried again.

    Attributes
    ----------
    edits : tuple of Edit
        Empty for an undo or redo: those are asked for again.
    group : str
        To be given to `append`, or to `undo` and `redo` as `again`: what was saved in spite of the error is not saved
        twice.
    """

    def __init__(
        self, what: str, edits: Sequence[Edit], group: str, *, got: str, cause: str | None, path: str | None
    ) -> None:
        super().__init__(what, got=got, cause=cause, path=path)
        self.edits = tuple(edits)
        self.group = group


def who_and_what(event: Event) -> dict[str, Any]:
    """Who changed which field when, as JSON."""
    return {
        "id": event.id,
        "event": event.ulid,
        "author": event.author,
        "time": event.time.isoformat(),
        "kind": event.ref.kind,
        "frame": event.ref.frame,
        "key": event.ref.key,
        "field": event.ref.field,
    }


def event_record(event: Event) -> dict[str, Any]:
    """`journal --json`, a line an event."""
    return {
        **who_and_what(event),
        "before": event.before,
        "after": event.after,
        "base": event.base,
        "version": event.version,
        "labels": event.labels,
        "reason": event.reason,
        "group": event.group,
        "action": event.action,
        "undo_of": event.undo_of,
    }


def outcome_record(done: Saved | Conflict | None) -> dict[str, Any]:
    """What came of saving: {"saved": [events], "conflicts": [{"wanted", "there", "message"}]}."""
    saved = [event_record(e) for e in done.events] if isinstance(done, Saved) else []
    conflicts = [
        {
            "kind": r.edit.ref.kind,
            "frame": r.edit.ref.frame,
            "key": r.edit.ref.key,
            "field": r.edit.ref.field,
            "wanted": r.edit.after,
            "there": None if r.event is None else event_record(r.event),
            "message": str(r),
        }
        for r in (done.rivals if isinstance(done, Conflict) else ())
    ]
    return {"saved": saved, "conflicts": conflicts}
