"""Undo and redo: each person's own actions, newest first, also after a restart. Taking back is an event as well.

An event is taken back onto the newest version of its field where what was
changed since was taken back itself.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from pipeline.corrections.journal.events import Conflict, Edit, Event, Saved, grouped
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.replay import standing
from pipeline.system.errors import require

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
    of_stack = (members[0].action == "undo") == (action == "redo")
    return of_stack and not any(e.ulid in taken[action] for e in members)


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
    edits = edits_back(journal, members)
    return journal.write(edits, author, action, group=again, undo_of=[e.ulid for e in members])


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
