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
    """An action that could not be saved, kept until it can be.

    Attributes
    ----------
    edits : tuple of Edit
    author, group : str
        The group keeps an action from being saved twice.
    time : datetime
    problem : str
        Why it could not be saved.
    """

    edits: tuple[Edit, ...]
    author: str
    group: str
    time: datetime
    problem: str

    def events(self, first: int, labels: str) -> list[Event]:
        """As they will stand in the journal, numbered from `first` on."""
        return [
            Event(first + k, f"{self.group}-{k}", self.author, self.time, e.ref, e.before, e.after, e.base, e.base + 1,
                  labels, e.reason, self.group, "edit", None, e.anchor)
            for k, e in enumerate(self.edits)
        ]  # fmt: skip


class Unsaved:
    """What waits of everyone who corrects the same labels in one process. May be shared by threads."""

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[Waiting, ...]] = {}
        self._disputed: dict[str, tuple[Conflict, ...]] = {}
        self._lock = Lock()
        self._saving = Lock()

    @property
    def authors(self) -> tuple[str, ...]:
        """Everyone of whom something is not saved."""
        with self._lock:
            return tuple(sorted({a for kept in (self._waiting, self._disputed) for a, some in kept.items() if some}))

    def waiting(self, author: str) -> tuple[Waiting, ...]:
        """What an author's actions are that could not be saved, in the order in which they were made."""
        return self._waiting.get(author, ())

    def disputed(self, author: str) -> tuple[Conflict, ...]:
        """What an author has to decide, because others were faster."""
        return self._disputed.get(author, ())

    def keep(self, action: Waiting) -> None:
        """Keep an action until it is saved."""
        with self._lock:
            self._waiting[action.author] = (*self.waiting(action.author), action)

    def dispute(self, author: str, conflict: Conflict) -> None:
        """Keep an action until its author decides."""
        with self._lock:
            self._disputed[author] = (*self.disputed(author), conflict)

    def settle(self, author: str, conflict: Conflict) -> None:
        """A conflict was decided."""
        with self._lock:
            self._disputed[author] = tuple(c for c in self.disputed(author) if c is not conflict)

    def drop_last(self, author: str) -> Waiting | None:
        """Give up the newest action that waits; None where none does.

        Raises
        ------
        InputError
            It is being saved at this moment.
        """
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
        """Try again to save what waits of an author, oldest first, until one fails.

        What others have changed in the meantime is a conflict: it no longer
        waits, and its author has to decide. Later actions on the same fields
        were made on what is not saved now, and so are a part of it. Nothing is
        tried while another thread does. `saved` is told what was saved before
        it waits no longer.
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
        """The conflict of the first action that waits, with all that was made on it, from waiting to disputed.

        Their versions are those of fields as their author saw them: saved on
        their own, they could hit the version that somebody else has made.
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
    """What is not saved of an author, as lists of actions that `spatialviz correct` takes, one after the other.

    The fields of objects that are not in the journal yet follow them in a
    second list. What others were in the way of is in the last ones, to be told so again.
    """
    waiting = _merged(e for w in unsaved.waiting(author) for e in w.edits)
    new = {(e.ref.frame, n) for e in waiting if e.ref.field == "exists" for n in e.ref.numbers}
    later = [e for e in waiting if e.ref.field != "exists" and new & {(e.ref.frame, n) for n in e.ref.numbers}]
    lists = [[e for e in waiting if e not in later], later, *(_merged(c.edits) for c in unsaved.disputed(author))]
    return [
        [{"edit": "value", "frame": e.ref.frame, "kind": e.ref.kind, "key": e.ref.key, "field": e.ref.field,
          "to": e.after, "base": e.base, "reason": e.reason} for e in edits]
        for edits in lists if edits
    ]  # fmt: skip


def _merged(edits: Iterable[Edit]) -> tuple[Edit, ...]:
    """One edit a cell: from what was first seen to what was last wanted."""
    found: dict[FieldRef, Edit] = {}
    for edit in edits:
        first = found.get(edit.ref)
        found[edit.ref] = edit if first is None else replace(first, after=edit.after, reason=edit.reason)
    return tuple(found.values())


@dataclass(frozen=True)
class Dispute:
    """A field that somebody else was faster to change, with the fields of one's action that stand or fall with it.

    Attributes
    ----------
    edits : tuple of Edit
        What one wanted.
    rivals : tuple of Rival
        At least one.
    """

    edits: tuple[Edit, ...]
    rivals: tuple[Rival, ...]

    @property
    def ref(self) -> FieldRef:
        """The field that it is told by."""
        return self.rivals[0].edit.ref


def disputes(conflict: Conflict, setting: Setting) -> tuple[Dispute, ...]:
    """The disputed fields of an action: a relation with its inverse is one, and so are the answers of an expression."""
    groups = grouped(conflict.edits or tuple(r.edit for r in conflict.rivals), lambda e: _together(e.ref, setting))
    rivals = grouped(conflict.rivals, lambda r: _together(r.edit.ref, setting))
    return tuple(Dispute(tuple(members), tuple(rivals[key])) for key, members in groups.items() if key in rivals)


def decided(conflict: Conflict, frame: EffectiveFrame, mine: Collection[int]) -> tuple[Edit, ...]:
    """The edits that a person saves after all: what nobody disputes, and of the disputes those that `mine` numbers.

    They are made on what the person was shown: who changes it again meanwhile
    is in conflict again, and overwritten by nobody.

    Parameters
    ----------
    conflict : Conflict
    frame : EffectiveFrame
        As it is now.
    mine : collection of int
        Places in `disputes`.
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
