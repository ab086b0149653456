"""What goes into the journal and what comes back: edits, events, and the two ends that saving can have."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import field
from datetime import datetime
from typing import Any, Literal, TypeVar

from pipeline.corrections.journal.field_refs import LONGEST_TEXT, FieldRef, checked, plain_text, shown_value
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

Action = Literal["edit", "undo", "redo"]
Thing = TypeVar("Thing")
Key = TypeVar("Key", bound=Hashable)
CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"


def grouped(things: Iterable[Thing], key: Callable[[Thing], Key]) -> dict[Key, list[Thing]]:
    """Group by a key, in order."""
    found: dict[Key, list[Thing]] = {}
    for thing in things:
        found.setdefault(key(thing), []).append(thing)
    return found


def new_ulid() -> str:
    """Make 26 characters, sorted by time: 48 bits of milliseconds, 80 random bits (github.com/ulid/spec)."""
    number = (time.time_ns() // 1_000_000) << 80 | int.from_bytes(os.urandom(10), "big")
    return "".join(CROCKFORD[(number >> shift) & 31] for shift in range(125, -5, -5))


@dataclass(frozen=True)
class Edit:
    """Change of one cell that someone wants to make."""

    ref: FieldRef
    before: Any  # as the person saw it
    after: Any
    base: int = 0  # version that the person saw; 0: automatic
    reason: str = ""
    # 2D boxes of the automatic objects concerned, by number: numbers may move.
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
    """Edit as saved in the journal."""

    id: int  # ascending in the order of saving
    ulid: str  # The same for all copies of the journal, sorted by time
    author: str  # Who made it
    time: datetime  # UTC
    ref: FieldRef
    before: Any  # Value that the person saw
    after: Any  # Value from then on
    base: int  # version before; `version` is after
    version: int  # Of the field, after
    labels: str  # see `labels_version`
    reason: str  # As the person gave it
    group: str  # one an action
    action: Action  # edit, undo or redo
    undo_of: str | None  # ULID of the event taken back, of an undo for a redo
    anchor: dict[str, list[float]]  # 2D boxes of the automatic objects concerned, by number: numbers may move


@dataclass(frozen=True)
class Saved:
    """Saved events of an action, in the order of its edits, synced to disk."""

    events: tuple[Event, ...]

    @property
    def group(self) -> str:
        return self.events[0].group


@dataclass(frozen=True)
class Rival:
    """Newest event of a cell that changed since the person saw it; None where the edit's base does not exist yet."""

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
    """Action that was not saved because cells changed since the person saw them."""

    rivals: tuple[Rival, ...]  # at least one
    edits: tuple[Edit, ...] = ()  # all of the action


class NotSaved(InputError):
    """Error of a journal that cannot be written; hands the edits back.

    `edits` is empty for an undo or redo. `group` goes to `append`, or as `again` to `undo` and `redo`: an action that
    was saved in spite of the error is not saved twice.
    """

    def __init__(
        self, what: str, edits: Sequence[Edit], group: str, *, got: str, cause: str | None, path: str | None
    ) -> None:
        super().__init__(what, got=got, cause=cause, path=path)
        self.edits = tuple(edits)
        self.group = group


def who_and_what(event: Event) -> dict[str, Any]:
    """Author, time and cell of an event as JSON."""
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
    """Result of saving as JSON: {"saved": [events], "conflicts": [{"wanted", "there", "message"}]}."""
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
