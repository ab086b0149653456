"""Replaying the events of a field over its automatic label: what it is now, where from, and which no longer apply.

A corrected value is the label of all: who edits it must have seen who was there
before. A judgement ("I have looked at it, and it is T") is one person's word on
an item. Two people who judge one item independently write two fields, never the
same version of one; agreement is counted from these. No label follows from a
judgement. Where reviewers differ, `edits.settle` says the last word, in a field
that is nobody's own and is locked as any other.

Undo and redo are here too: each person's own actions, newest first, also after a
restart. Taking back is an event as well. An event is taken back onto the newest
version of its field where what was changed since was taken back itself.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, Literal

import numpy as np

from pipeline.corrections.journal.events import Conflict, Edit, Event, Saved, grouped
from pipeline.corrections.journal.field_refs import OF_ALL, FieldRef, judged_item, judged_key, same_value, shown_value
from pipeline.corrections.journal.journal import Journal
from pipeline.geometry.boxes import iou_2d
from pipeline.system.arrow import pa
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

ANCHOR_IOU = 0.5
"""An object's automatic 2D box must overlap by this much with what it was when it was corrected."""
Source = Literal["auto", "human", "recomputed", "stale"]
ORIGIN_FIELDS = ("table", "frame", "frame_index", "key", "column", "origin", "author", "time", "event", "reason", "was")


@dataclass(frozen=True)
class Unapplied:
    """Event without effect on the labels now.

    "gone": no such entity any more, or another one; "changed": the automatic label differs from what was corrected;
    "agreed": the automatic label equals the correction.
    """

    event: Event
    kind: Literal["gone", "changed", "agreed"]
    reason: str


@dataclass(frozen=True)
class Replayed:
    """Cell after its events; `event` is None where the automatic label stands."""

    value: Any
    event: Event | None  # that made it so
    version: int  # number of events, applied or not
    unapplied: tuple[Unapplied, ...]


def standing_at(events: Sequence[Event]) -> list[tuple[Event, int]]:
    """Standing edits of a cell, by version, each with the `id` of the reviving event.

    Only a cell's newest event can be taken back: a stack.
    """
    found: list[tuple[Event, int]] = []
    taken: dict[str, Event] = {}
    for event in events:
        if event.action == "edit" or event.undo_of is None:
            found.append((event, event.id))
        elif event.action == "undo" and found:
            taken[event.ulid] = found.pop()[0]
        elif event.undo_of in taken:
            found.append((taken[event.undo_of], event.id))
    return found


def standing(events: Sequence[Event]) -> list[Event]:
    """Standing edits of a cell, by version."""
    return [event for event, _ in standing_at(events)]


def replay(
    automatic: Any, events: Sequence[Event], *, trusted: bool = False, released_by_none: bool = False
) -> Replayed:
    """Apply the events of a cell to the automatic label, by version.

    An event applies where the value is what its author saw; others are listed, unless a later event settles the cell.
    `trusted` cells follow from other corrections, and are not compared. With `released_by_none`, None restores the
    automatic value.
    """
    value, origin, unapplied = automatic, None, []
    for event in standing(events):
        if trusted or same_value(event.before, value):
            value, origin, unapplied = event.after, event, []
            if released_by_none and event.after is None:
                value = automatic
            continue
        now = shown_value(event.ref, value)
        if same_value(event.after, value):
            unapplied.append(Unapplied(event, "agreed", f"the labels say {now} by themselves now"))
        else:
            made_on = shown_value(event.ref, event.before)
            unapplied.append(Unapplied(event, "changed", f"it was made on {made_on}, and the labels say {now} now"))
    return Replayed(value, origin, events[-1].version if events else 0, tuple(unapplied))


def all_gone(automatic: Any, events: Sequence[Event], reason: str) -> Replayed:
    """Cell of a lost entity: every standing edit is listed."""
    return Replayed(
        automatic,
        None,
        events[-1].version if events else 0,
        tuple(Unapplied(e, "gone", reason) for e in standing(events)),
    )


def another_thing(events: Sequence[Event], boxes: Mapping[int, Sequence[float]]) -> int | None:
    """Object whose number was given to another thing since an edit was anchored; None for none.

    `boxes` are the 2D boxes of automatic objects.
    """
    for number, bbox in boxes.items():
        name = str(number)
        for event in events:
            was = event.anchor.get(name, bbox)
            if was != bbox and float(iou_2d(np.array([was]), np.array([bbox]))[0, 0]) < ANCHOR_IOU:
                return number
    return None


def by_ref(events: Iterable[Event]) -> dict[FieldRef, list[Event]]:
    """Events of each cell, by version."""
    return {ref: sorted(members, key=lambda e: e.version) for ref, members in grouped(events, lambda e: e.ref).items()}


def judgement_ref(frame: str, kind: str, a: int, b: int | None, what: str, author: str) -> FieldRef:
    """Cell of a judgement of an item, or, by OF_ALL, of a settlement; InputError for no such item.

    `a` and `b` are the objects of a pair; an object and None, -1 for a missing one; -1 and None of an expression.
    `what` is the relation, the expression's id, "" of an object, or the place of a missing one.
    """
    name = author.strip()
    return FieldRef("review", frame, judged_key(name, kind, a, b, what), "settled" if name == OF_ALL else "said")


def statuses_of_items(statuses: Mapping[FieldRef, Any]) -> dict[tuple[str, int, int | None, str], dict[str, str]]:
    """Status by author of each judged (kind, a, b, what); see `judgement_ref`."""
    found: dict[tuple[str, int, int | None, str], dict[str, str]] = {}
    for ref, value in statuses.items():
        if ref.kind == "review" and ref.field == "said":
            author, kind, a, b, what = judged_item(ref.key)
            found.setdefault((kind, a, b, what), {})[author] = value["status"]
    return {item: dict(sorted(message.items())) for item, message in found.items()}


def replayed_judgement(
    ref: FieldRef,
    events: Sequence[Event],
    boxes: Mapping[int, Any],
    objects: Collection[int],
    expressions: Collection[str],
) -> Replayed:
    """Judgement after the events; without effect on a lost or other item.

    `boxes` are 2D boxes of automatic objects, `objects` and `expressions` those present.
    """
    _, kind, _, _, what = judged_item(ref.key)
    if kind == "expression" and what not in expressions:
        return all_gone(None, events, "there is no such expression any more")
    for number in ref.numbers:
        if number not in objects:
            return all_gone(None, events, f"there is no object {number} any more")
    other = another_thing(events, {n: boxes[n] for n in ref.numbers if n in boxes})
    if other is not None:
        return all_gone(None, events, f"object {other} is another thing now")
    return replay(None, events)


@dataclass(frozen=True)
class Origin:
    """Origin of a value: "auto" (labeller), "human", "recomputed" from another correction, "stale" for want of the
    dataset.
    """

    source: Source
    author: str | None = None
    time: datetime | None = None  # UTC
    event: str | None = None  # ULID
    reason: str = ""
    made_by: str = ""  # of "auto": model and rule profile

    @classmethod
    def of(cls, source: Source, event: Event) -> Origin:
        """Origin of an event's value, or of a consequence."""
        return cls(source, event.author, event.time, event.ulid, event.reason)

    def __str__(self) -> str:
        if self.source == "auto":
            return f"auto ({self.made_by})" if self.made_by else "auto"
        when = "" if self.time is None else self.time.strftime(" %Y-%m-%d %H:%M:%S UTC")
        if self.source == "human":
            return f"{self.author}{when}"
        verb = "recomputed from" if self.source == "recomputed" else "stale since"
        return f"{verb} {self.author}'s correction{when}"


def provenance_schema() -> pa.Schema:
    """Schema of provenance: a row a value of other origin than the labeller; `was` is the labeller's value as JSON."""
    kinds = {"frame_index": pa.int32(), "time": pa.timestamp("us", "UTC")}
    return pa.schema([pa.field(name, kinds.get(name, pa.string())) for name in ORIGIN_FIELDS])


Turn = Literal["undo", "redo"]
PAGE = 16
"""Events that are read at first to know what may be taken back."""


@dataclass(frozen=True)
class History:
    """Actions that a person may take back and bring back, newest last."""

    done: tuple[tuple[Event, ...], ...]
    undone: tuple[tuple[Event, ...], ...]


def history(events: Iterable[Event]) -> History:
    """Replay the actions of a person: an edit ends all redo."""
    done: list[tuple[Event, ...]] = []
    undone: list[tuple[Event, ...]] = []
    for members in actions_of(events):
        first = members[0]
        if first.action == "edit":
            done.append(members)
            undone.clear()
            continue
        stack, other = (done, undone) if first.action == "undo" else (undone, done)
        stack[:] = [taken for taken in stack if all(e.ulid != first.undo_of for e in taken)]
        other.append(members)
    return History(tuple(done), tuple(undone))


def actions_of(events: Iterable[Event]) -> list[tuple[Event, ...]]:
    """Group events by action, in the order of their saving."""
    return [tuple(members) for members in grouped(events, lambda e: e.group).values()]


def undo(
    journal: Journal, author: str, *, group: str | None = None, again: str | None = None
) -> Saved | Conflict | None:
    """Take back a person's newest action, or the action of a group; None where nothing is left.

    `again` is `NotSaved.group` on a retry. Conflict, and nothing changed, where a cell has a standing later edit.
    InputError for no such action; NotSaved as `Journal.append`.
    """
    return _take_back(journal, author, "undo", group, again)


def redo(
    journal: Journal, author: str, *, group: str | None = None, again: str | None = None
) -> Saved | Conflict | None:
    """Bring back the action taken back last; as `undo`, by the group of the undo."""
    return _take_back(journal, author, "redo", group, again)


def newest(journal: Journal, author: str, action: Turn) -> tuple[Event, ...] | None:
    """Action for `undo`, the last of `history(...).done`, or for `redo`.

    Read from the newest events alone: what came before them was not taken back by any other.
    """
    size = PAGE
    while True:
        page = journal.events(author=author, last=size)
        # Of the oldest action there may be more.
        events = page if len(page) < size else [e for e in page if e.group != page[0].group]
        stack = _stack(events, action)
        ended = action == "redo" and any(e.action == "edit" for e in events)
        if stack or ended or len(page) < size:
            return stack[-1] if stack else None
        size *= 4


def _stack(events: Iterable[Event], action: Turn) -> tuple[tuple[Event, ...], ...]:
    found = history(events)
    return found.done if action == "undo" else found.undone


def _of_group(journal: Journal, author: str, action: Turn, group: str) -> tuple[Event, ...]:
    """Action of a group; InputError where neither undo nor redo applies."""
    members = journal.events(author=author, group=group)
    since = journal.events(author=author, after=members[0].id - 1) if members else ()
    require(members in _stack(since, action), f"{author} has no action of this group to {action}", got=repr(group))
    return members


def _take_back(
    journal: Journal, author: str, action: Turn, group: str | None, again: str | None
) -> Saved | Conflict | None:
    if again is not None and (saved := journal.events(group=again)):
        return Saved(saved)
    members = newest(journal, author, action) if group is None else _of_group(journal, author, action, group)
    if members is None:
        return None
    return journal.write(edits_back(journal, members), author, action, group=again, undo_of=[e.ulid for e in members])


def edits_back(journal: Journal, members: Sequence[Event]) -> list[Edit]:
    """Edits for taking events back, or for reviving undone events.

    A cell must stand as right after the event; else the edit is based on the event's own version: a conflict.
    """
    edits = []
    for event in members:
        ref = event.ref
        events = journal.events(kind=ref.kind, frame=ref.frame, key=ref.key, field=ref.field)
        unchanged = standing(events) == standing([e for e in events if e.id <= event.id])
        base = events[-1].version if unchanged else event.version
        edits.append(
            Edit(ref, before=event.after, after=event.before, base=base, reason=event.reason, anchor=event.anchor)
        )
    return edits
