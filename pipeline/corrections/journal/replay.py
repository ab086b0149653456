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

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

import numpy as np

from pipeline.corrections.journal.events import Conflict, Edit, Event, Saved, grouped
from pipeline.corrections.journal.field_refs import OF_ALL, FieldRef, judged_item, judged_key, same_value, shown_value
from pipeline.corrections.journal.journal import Journal
from pipeline.geometry.boxes import iou_2d
from pipeline.system.arrow import pa
from pipeline.system.errors import require

ANCHOR_IOU = 0.5
"""An object's automatic 2D box must overlap by this much with what it was when it was corrected."""
Source = Literal["auto", "human", "recomputed", "stale"]
ORIGIN_FIELDS = ("table", "frame", "frame_index", "key", "column", "origin", "author", "time", "event", "reason", "was")


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


def standing_at(events: Sequence[Event]) -> list[tuple[Event, int]]:
    """The edits of a cell that were not taken back, in the order of their versions, each with the `id` of what made it
    stand.

    Only a cell's newest event can be taken back: so they are a stack.
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
    """The edits of a cell that were not taken back, in the order of their versions."""
    return [event for event, _ in standing_at(events)]


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
        now = shown_value(event.ref, value)
        if same_value(event.after, value):
            unapplied.append(Unapplied(event, "agreed", f"the labels say {now} by themselves now"))
        else:
            made_on = shown_value(event.ref, event.before)
            unapplied.append(Unapplied(event, "changed", f"it was made on {made_on}, and the labels say {now} now"))
    return Replayed(value, origin, events[-1].version if events else 0, tuple(unapplied))


def all_gone(automatic: Any, events: Sequence[Event], reason: str) -> Replayed:
    """A cell whose entity is no longer there: every edit that was not taken back is listed."""
    return Replayed(
        automatic,
        None,
        events[-1].version if events else 0,
        tuple(Unapplied(e, "gone", reason) for e in standing(events)),
    )


def is_another(anchor: dict[str, list[float]], number: int, bbox: Sequence[float]) -> bool:
    """Whether an object's number was given to another thing since an edit was anchored to it."""
    was = anchor.get(str(number))
    return was is not None and float(iou_2d(np.array([was]), np.array([bbox]))[0, 0]) < ANCHOR_IOU


def by_ref(events: Iterable[Event]) -> dict[FieldRef, list[Event]]:
    """Events of each cell, in the order of their versions."""
    return {ref: sorted(members, key=lambda e: e.version) for ref, members in grouped(events, lambda e: e.ref).items()}


def judgement_ref(frame: str, kind: str, a: int, b: int | None, what: str, author: str) -> FieldRef:
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


def statuses_of_items(statuses: Mapping[FieldRef, Any]) -> dict[tuple[str, int, int | None, str], dict[str, str]]:
    """The status that each author gives, by kind, a, b and what of the item (see `judgement_ref`).

    Parameters
    ----------
    statuses : mapping of FieldRef to JSON value
        Of an effective frame.
    """
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
    """A judgement after its events; it no longer applies where its item is gone or another thing.

    Parameters
    ----------
    boxes : mapping of int to list of float
        2D boxes of the automatic objects.
    objects, expressions : collection
        Numbers and ids of those that there are.
    """
    _, kind, _, _, what = judged_item(ref.key)
    if kind == "expression" and what not in expressions:
        return all_gone(None, events, "there is no such expression any more")
    for number in ref.numbers:
        if number not in objects:
            return all_gone(None, events, f"there is no object {number} any more")
        if number in boxes and any(is_another(e.anchor, number, boxes[number]) for e in events):
            return all_gone(None, events, f"object {number} is another thing now")
    return replay(None, events)


@dataclass(frozen=True)
class Origin:
    """Where a value comes from.

    Attributes
    ----------
    source : str
        "auto": the labeller. "human": a person set it. "recomputed": it follows
        from a correction of something else. "stale": it does not yet follow
        from one, because the dataset was not at hand.
    author : str or None
        Who made the correction.
    time : datetime or None
        UTC.
    event : str or None
        ULID of that correction.
    reason : str
    made_by : str
        Of "auto": the model and the rule profile.
    """

    source: Source
    author: str | None = None
    time: datetime | None = None
    event: str | None = None
    reason: str = ""
    made_by: str = ""

    @classmethod
    def of(cls, source: Source, event: Event) -> Origin:
        """The origin of what an event set, or of what follows from it."""
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
    """The table of provenance: one row a value that is not the labeller's; `was` is the labeller's value as JSON."""
    kinds = {"frame_index": pa.int32(), "time": pa.timestamp("us", "UTC")}
    return pa.schema([pa.field(name, kinds.get(name, pa.string())) for name in ORIGIN_FIELDS])


Turn = Literal["undo", "redo"]
Taken = defaultdict[str, set[str | None]]
"""What later actions took back ("undo") and brought back ("redo"): ULIDs of the first event of each."""
PAGE = 32
"""Events that are read at first to know what may be taken back."""


@dataclass(frozen=True)
class History:
    """What a person may take back and bring back, the newest last.

    Attributes
    ----------
    done, undone : tuple of tuple of Event
        Actions, each as its events.
    """

    done: tuple[tuple[Event, ...], ...]
    undone: tuple[tuple[Event, ...], ...]


def history(events: Iterable[Event]) -> History:
    """The actions of one person, replayed: an edit ends what could be brought back."""
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
    """Events by action, in the order of their saving."""
    return [tuple(members) for members in grouped(events, lambda e: e.group).values()]


def undo(
    journal: Journal, author: str, *, group: str | None = None, again: str | None = None
) -> Saved | Conflict | None:
    """Take back a person's newest action, or the one of a group.

    Parameters
    ----------
    journal : Journal
    author : str
    group : str, optional
        Of the action to take back.
    again : str, optional
        `NotSaved.group`, where this is another try: what was taken back after all is not followed by the next.

    Returns
    -------
    Saved, Conflict or None
        None where there is nothing to take back; Conflict where one of its
        cells was edited since, and that still stands: then nothing is changed.

    Raises
    ------
    InputError
        The person has no such action.
    NotSaved
        As `Journal.append`.
    """
    return _take_back(journal, author, "undo", group, again)


def redo(
    journal: Journal, author: str, *, group: str | None = None, again: str | None = None
) -> Saved | Conflict | None:
    """Bring back what a person took back last; as `undo`, whose group it names."""
    return _take_back(journal, author, "redo", group, again)


def newest(journal: Journal, author: str, action: Turn) -> tuple[Event, ...] | None:
    """The action that `undo` would take back, the last of `history(...).done`, or that `redo` would bring back.

    It is known from as few events as tell it, from the newest on: an action is
    on the stack unless a later one took it back. So what is read is what was
    done since, and not all that ever was.
    """
    taken: Taken = defaultdict(set)
    for members in _newest_first(journal, author):
        if _stands(members, action, taken):
            return members
        if action == "redo" and members[0].action == "edit":
            return None
        taken[members[0].action].add(members[0].undo_of)
    return None


def _stands(members: tuple[Event, ...], action: Turn, taken: Taken) -> bool:
    """Whether it is of the stack that the action takes from, and no later one has taken it already."""
    return (members[0].action == "undo") == (action == "redo") and not any(e.ulid in taken[action] for e in members)


def _newest_first(journal: Journal, author: str) -> Iterator[tuple[Event, ...]]:
    """A person's actions, the newest first, read in pages that grow."""
    size, before = PAGE, None
    held: tuple[Event, ...] = ()
    while True:
        page = journal.events(author=author, before=before, last=size)
        whole = actions_of([*page, *held])
        if len(page) == size:
            # Of the oldest action there may be more on the next page.
            held, before = whole.pop(0), page[0].id
        yield from reversed(whole)
        if len(page) < size:
            return
        size = min(2 * size, 64 * PAGE)


def _of_group(journal: Journal, author: str, action: Turn, group: str) -> tuple[Event, ...]:
    """The action of a group, where it can be taken or brought back."""
    members = journal.events(author=author, group=group)
    later = actions_of(journal.events(author=author, after=members[-1].id)) if members else []
    taken: Taken = defaultdict(set)
    for found in later:
        taken[found[0].action].add(found[0].undo_of)
    cleared = action == "redo" and any(found[0].action == "edit" for found in later)
    require(
        members and not cleared and _stands(members, action, taken),
        f"{author} has no action of this group to {action}",
        got=repr(group),
    )
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
    """The edits that take events back, or bring them back where they are undos.

    An event may be taken back where its cell stands as it stood right after
    it: nobody has changed it since, or all that was changed since was taken
    back. Elsewhere the edit is based on the event's own version, and so is a
    conflict when it is written.
    """
    edits = []
    for event in members:
        ref = event.ref
        events = journal.events(kind=ref.kind, frame=ref.frame, key=ref.key, field=ref.field)
        unchanged = standing(events) == standing([e for e in events if e.id <= event.id])
        base = events[-1].version if unchanged else event.version
        edits.append(Edit(ref, before=event.after, after=event.before, base=base, reason=event.reason,
                          anchor=event.anchor))  # fmt: skip
    return edits
