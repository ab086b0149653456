"""Many items at once: those that a filter finds, accepted in one action; and how fast a person works."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta, tzinfo
from typing import Any

import numpy as np

from pipeline.corrections.journal.edits import Edits, judge_both_ways, judge_missing, set_status
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import FieldRef, object_ref
from pipeline.corrections.review.items import SETTLED, STATES, ItemKey, item_of
from pipeline.corrections.review.worklist import Worklist
from pipeline.system.errors import InputError, require

MOST = 1000
"""Items that one action settles: more would not have been looked at."""
REST = timedelta(minutes=5)
"""Who does nothing for longer has stopped working."""
FIRST = timedelta(seconds=30)
"""What the first label after a rest is counted to have taken."""


def status_ref(item: ItemKey) -> FieldRef:
    """Cell of the journal with an item's status."""
    if item.kind == "relation":
        return FieldRef("relation", item.frame, f"{item.a},{item.b}", f"{item.what}.status")
    if item.kind == "object":
        return object_ref(item.frame, item.a, "status")
    return FieldRef("expression", item.frame, item.what, "status")


def say_of_item(frame: EffectiveFrame, item: ItemKey, status: str, author: str) -> Edits:
    """Edits of a reviewer's word: "accepted", "rejected" or "unsure"; InputError for a rejected relation."""
    if item.kind == "object" and item.a < 0:
        return judge_missing(frame, item.what, status, author)
    ref = status_ref(item)
    if ref.kind == "relation":
        require(status != "rejected", "a relation is not rejected", expected="T, U or F")
        return judge_both_ways(frame, ref, status, author)
    return set_status(frame, ref, status, author=author)


def found_items(
    work: Worklist, words: Callable[[dict[str, Any]], str], kind: str | None = None, text: str = ""
) -> list[int]:
    """Places of open items of a kind, in order, with each word of a text in words, reasons or frame.

    `words`: what the label of a row of the queue says.
    """
    is_open = ~np.isin(work.codes, [STATES.index(s) for s in SETTLED]) & ~work.gone
    places = [k for k in np.flatnonzero(is_open).tolist() if kind in (None, work.keys[k].kind)]
    wanted = text.casefold().split()
    if not wanted:
        return places
    rows = work.queue.take(places).to_pylist()
    texts = (" ".join((words(row), row["frame"], *row["reasons"])).casefold() for row in rows)
    return [k for k, said in zip(places, texts, strict=True) if all(w in said for w in wanted)]


def accept_all(items: Collection[ItemKey], frame_of: Callable[[str], EffectiveFrame], author: str) -> Edits:
    """Edits of one action for all these items, of whatever frames; undo takes all of them back.

    Items that have gone since they were found are left out.

    Raises InputError: there are none, or more than a person can have looked at.
    """
    require(items, "no open item is found: there is nothing to accept")
    require(len(items) <= MOST, "too many items at once", got=len(items), expected=f"at most {MOST}: filter them")
    made: dict[FieldRef, Any] = {}
    problem: InputError | None = None
    for name, of_frame in grouped(items, lambda key: key.frame).items():
        frame = frame_of(name)
        for item in of_frame:
            try:
                made |= {e.ref: e for e in say_of_item(frame, item, "accepted", author)}
            except InputError as error:
                problem = error
    if not made and problem is not None:
        raise problem
    return tuple(made.values())


@dataclass(frozen=True)
class ReviewPace:
    """How fast a person worked today."""

    items: int
    """Items that were settled, each once."""
    minutes: float
    """Of work, without rests."""
    per_hour: float | None
    """What is accepted at once counts as one item; None before there are two."""

    def record(self) -> dict[str, Any]:
        """The pace as JSON."""
        return asdict(self)


def pace_of(events: Iterable[Event], author: str, now: datetime) -> ReviewPace:
    """Pace of a person on the day of `now` (with its time zone), undone work included."""
    zone: tzinfo | None = now.tzinfo
    today = [e for e in events if e.author == author and e.time.astimezone(zone).date() == now.date()]
    items = {
        (
            key.frame,
            key.kind,
            min(key.a, key.b if key.b is not None else key.a),
            max(key.a, -1 if key.b is None else key.b),
            "" if key.kind == "relation" else key.what,
            e.group,
        )
        for e in today
        if e.action == "edit" and (key := item_of(e.ref)) is not None
    }
    times = sorted({e.time for e in today})
    spent = timedelta()
    for before, after in zip([None, *times], times, strict=False):
        gap = None if before is None else after - before
        spent += FIRST if gap is None or gap > REST else gap
    hours = spent.total_seconds() / 3600
    actions = len({group for *_, group in items})
    return ReviewPace(len(items), round(60 * hours, 2), actions / hours if actions > 1 and hours > 0 else None)
