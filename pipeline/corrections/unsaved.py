"""Actions that could not be saved yet, or that somebody else was in the way of: kept until they are saved or given up.

They belong to the process and to the author, not to a page: a page that is
loaded again finds them, and two pages of one author share them. Where two people
have changed the same fields, the second decides, field by field.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from datetime import datetime
from threading import Lock
from typing import Any

from pipeline.corrections.journal.effective_expressions import SETS
from pipeline.corrections.journal.effective_frame import EffectiveFrame, Setting
from pipeline.corrections.journal.events import Conflict, Edit, Event, Rival, Saved, grouped
from pipeline.corrections.journal.field_refs import FieldRef, shown_value
from pipeline.corrections.journal.journal import Journal
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError, require


@dataclass(frozen=True)
class Waiting:
    """Action kept until it can be saved."""

    edits: tuple[Edit, ...]
    author: str
    group: str  # keeps it from being saved twice
    time: datetime
    problem: str  # why not saved

    def events(self, first: int, labels: str) -> list[Event]:
        """Events as saved, numbered from `first`."""
        return [
            Event(
                first + k,
                f"{self.group}-{k}",
                self.author,
                self.time,
                e.ref,
                e.before,
                e.after,
                e.base,
                e.base + 1,
                labels,
                e.reason,
                self.group,
                "edit",
                None,
                e.anchor,
            )
            for k, e in enumerate(self.edits)
        ]


class Unsaved:
    """Waiting and disputed actions of all authors of a process; shared by threads."""

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[Waiting, ...]] = {}
        self._disputed: dict[str, tuple[Conflict, ...]] = {}
        self._lock = Lock()
        self._saving = Lock()

    @property
    def authors(self) -> tuple[str, ...]:
        """Authors with something unsaved."""
        with self._lock:
            return tuple(sorted({a for kept in (self._waiting, self._disputed) for a, some in kept.items() if some}))

    def waiting(self, author: str) -> tuple[Waiting, ...]:
        """Waiting actions of an author, in order."""
        return self._waiting.get(author, ())

    def disputed(self, author: str) -> tuple[Conflict, ...]:
        """Conflicts for an author to decide."""
        return self._disputed.get(author, ())

    def keep(self, action: Waiting) -> None:
        """Keep an action until saved."""
        with self._lock:
            self._waiting[action.author] = (*self.waiting(action.author), action)

    def dispute(self, author: str, conflict: Conflict) -> None:
        """Keep an action until the author decides."""
        with self._lock:
            self._disputed[author] = (*self.disputed(author), conflict)

    def settle(self, author: str, conflict: Conflict) -> None:
        """A conflict was decided."""
        with self._lock:
            self._disputed[author] = tuple(c for c in self.disputed(author) if c is not conflict)

    def drop_last(self, author: str) -> Waiting | None:
        """Give up the newest waiting action; None for no action; InputError during saving."""
        require(self._saving.acquire(timeout=1.0), "it is being saved at this moment", expected="try again")
        try:
            with self._lock:
                kept = self.waiting(author)
                self._waiting[author] = kept[:-1]
                return kept[-1] if kept else None
        finally:
            self._saving.release()

    def retry(
        self, author: str, journal: Callable[[], Journal], saved: Callable[[Saved], None] = lambda _: None
    ) -> tuple[Saved | Conflict | Waiting, ...]:
        """Save waiting actions of an author again, oldest first, until a failure.

        A conflict no longer waits: the author decides, with later actions on the same fields, which were made on it.
        Nothing is tried while another thread does. `saved` is called before an action stops waiting.
        """
        if not self._saving.acquire(blocking=False):
            return ()
        done: list[Saved | Conflict | Waiting] = []
        try:
            while self.waiting(author):
                first = self.waiting(author)[0]
                try:
                    outcome = journal().append(first.edits, first.author, group=first.group)
                except InputError as error:
                    self._replace(author, replace(first, problem=str(error)))
                    return (*done, self.waiting(author)[0])
                if isinstance(outcome, Conflict):
                    outcome = self._disputed_with_later(author, outcome)
                else:
                    saved(outcome)
                    self._replace(author, None)
                done.append(outcome)
        finally:
            self._saving.release()
        return tuple(done)

    def _disputed_with_later(self, author: str, conflict: Conflict) -> Conflict:
        """Move the first waiting action, with all later actions on the same fields, to the disputes.

        Saved alone, later versions could hit those of somebody else.
        """
        with self._lock:
            first, *rest = self.waiting(author)
            edits, left = list(conflict.edits or first.edits), []
            refs = {e.ref for e in edits}
            for action in rest:
                if refs.isdisjoint(e.ref for e in action.edits):
                    left.append(action)
                else:
                    edits += action.edits
                    refs |= {e.ref for e in action.edits}
            wanted = {e.ref: e for e in _merged(edits)}
            rivals = tuple(Rival(wanted[r.edit.ref], r.event) for r in conflict.rivals)
            whole = Conflict(rivals, tuple(wanted.values()))
            self._waiting[author] = tuple(left)
            self._disputed[author] = (*self.disputed(author), whole)
        return whole

    def _replace(self, author: str, first: Waiting | None) -> None:
        with self._lock:
            rest = self.waiting(author)[1:]
            self._waiting[author] = rest if first is None else (first, *rest)


def unsaved_actions(unsaved: Unsaved, author: str) -> list[list[dict[str, Any]]]:
    """Unsaved edits of an author as lists of actions for `spatialviz correct`, in order.

    Fields of new objects follow in a second list, disputes last.
    """
    waiting = _merged(e for w in unsaved.waiting(author) for e in w.edits)
    new = {(e.ref.frame, n) for e in waiting if e.ref.field == "exists" for n in e.ref.numbers}
    later = [e for e in waiting if e.ref.field != "exists" and new & {(e.ref.frame, n) for n in e.ref.numbers}]
    lists = [[e for e in waiting if e not in later], later, *(_merged(c.edits) for c in unsaved.disputed(author))]
    return [
        [
            {
                "edit": "value",
                "frame": e.ref.frame,
                "kind": e.ref.kind,
                "key": e.ref.key,
                "field": e.ref.field,
                "to": e.after,
                "base": e.base,
                "reason": e.reason,
            }
            for e in edits
        ]
        for edits in lists
        if edits
    ]


def _merged(edits: Iterable[Edit]) -> tuple[Edit, ...]:
    """Merge the edits of each cell."""
    found: dict[FieldRef, Edit] = {}
    for edit in edits:
        first = found.get(edit.ref)
        found[edit.ref] = edit if first is None else replace(first, after=edit.after, reason=edit.reason)
    return tuple(found.values())


def disputes(conflict: Conflict, setting: Setting) -> tuple[Conflict, ...]:
    """Disputed fields of an action: a relation goes with the inverse, and all answers of an expression together."""
    groups = grouped(conflict.edits or tuple(r.edit for r in conflict.rivals), lambda e: _together(e.ref, setting))
    rivals = grouped(conflict.rivals, lambda r: _together(r.edit.ref, setting))
    return tuple(Conflict(tuple(rivals[key]), tuple(members)) for key, members in groups.items() if key in rivals)


def decided(conflict: Conflict, frame: EffectiveFrame, mine: Collection[int]) -> tuple[Edit, ...]:
    """Edits to save after all: undisputed, and of the disputes numbered by `mine`.

    They are made on what the person was shown: another change is a conflict again.
    """
    found = disputes(conflict, frame.setting)
    disputed = {e.ref for d in found for e in d.edits}
    rivals = {r.edit.ref: r for d in found for r in d.rivals}
    wanted = (e for k, d in enumerate(found) if k in mine for e in d.edits)
    return (
        *(e for e in conflict.edits if e.ref not in disputed),
        *(_instead(e, rivals.get(e.ref), frame) for e in wanted),
    )


def _instead(edit: Edit, rival: Rival | None, frame: EffectiveFrame) -> Edit:
    if rival is None:
        return edit
    event, now = rival.event, frame.value(edit.ref)
    if event is None:
        return replace(edit, before=now, base=0)
    before = now if event.version == frame.version(edit.ref) else event.after
    over = f"instead of {event.author}'s {shown_value(edit.ref, event.after)}"
    return replace(edit, before=before, base=event.version, reason="; ".join(filter(None, (edit.reason, over))))


def _together(ref: FieldRef, setting: Setting) -> Any:
    if ref.kind == "expression" and ref.field in SETS:
        return ref.kind, ref.key, SETS
    if ref.kind == "relation" and ref.field in PAIRWISE:
        a, b = ref.numbers
        return ref.kind, min((a, b, ref.field), (b, a, setting.inverse(ref.field) or ref.field))
    return ref
