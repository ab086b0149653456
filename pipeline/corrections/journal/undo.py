"""Undo and redo: each person's own actions, newest first, also after a restart. Taking back is an event as well."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from pipeline.corrections.journal.events import Conflict, Edit, Event, Saved
from pipeline.corrections.journal.journal import Journal
from pipeline.system.errors import InputError

Turn = Literal["undo", "redo"]
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
    groups: dict[str, list[Event]] = {}
    for event in events:
        groups.setdefault(event.group, []).append(event)
    of_event = {event.ulid: group for group, members in groups.items() for event in members}
    done: list[str] = []
    undone: list[str] = []
    for group, members in groups.items():
        first = members[0]
        if first.action == "edit":
            done.append(group)
            undone.clear()
            continue
        source = of_event.get(str(first.undo_of))
        stack, other = (done, undone) if first.action == "undo" else (undone, done)
        if source in stack:
            stack.remove(source)
        other.append(group)
    return History(*(tuple(tuple(groups[g]) for g in stack) for stack in (done, undone)))


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


def next_undo(journal: Journal, author: str) -> tuple[Event, ...] | None:
    """The action that `undo` would take back, the last of `history(...).done`, from as few events as tell it.

    From the newest on: an action is on the stack unless a later one took it
    back. So what is read is what was done since, and not all that ever was.
    """
    return _newest(journal, author, "undo")


def next_redo(journal: Journal, author: str) -> tuple[Event, ...] | None:
    """The action that `redo` would bring back, the last of `history(...).undone`; as `next_undo`."""
    return _newest(journal, author, "redo")


def _newest(journal: Journal, author: str, action: Turn) -> tuple[Event, ...] | None:
    taken = _Taken()
    for members in _newest_first(journal, author):
        if taken.stands(members, action):
            return members
        if action == "redo" and members[0].action == "edit":
            return None
        taken.note(members)
    return None


class _Taken:
    """What later actions took back (by undo) and brought back (by redo): ULIDs of the first event of each."""

    def __init__(self) -> None:
        self._by: dict[str, set[str]] = {"undo": set(), "redo": set()}

    def note(self, members: tuple[Event, ...]) -> None:
        first = members[0]
        if first.action != "edit" and first.undo_of is not None:
            self._by[first.action].add(first.undo_of)

    def stands(self, members: tuple[Event, ...], action: Turn) -> bool:
        """Whether it is of the stack that the action takes from, and no later one has taken it already."""
        of_stack = (members[0].action == "undo") == (action == "redo")
        return of_stack and not any(e.ulid in self._by[action] for e in members)


def _newest_first(journal: Journal, author: str) -> Iterator[tuple[Event, ...]]:
    """A person's actions, the newest first, read in pages that grow."""
    size, before = PAGE, None
    held: list[Event] = []
    while True:
        page = journal.events(author=author, before=before, last=size)
        events = [*page, *held]
        groups: dict[str, list[Event]] = {}
        for event in events:
            groups.setdefault(event.group, []).append(event)
        whole = list(groups.values())
        if len(page) == size:
            # Of the oldest action there may be more on the next page.
            held, before = whole.pop(0), page[0].id
        for members in reversed(whole):
            yield tuple(members)
        if len(page) < size:
            return
        size = min(2 * size, 64 * PAGE)


def _of_group(journal: Journal, author: str, action: Turn, group: str) -> tuple[Event, ...]:
    """The action of a group, where it can be taken or brought back."""
    members = journal.events(author=author, group=group)
    taken = _Taken()
    cleared = False
    later: dict[str, list[Event]] = {}
    for event in journal.events(author=author, after=members[-1].id) if members else ():
        later.setdefault(event.group, []).append(event)
    for found in later.values():
        taken.note(tuple(found))
        cleared |= action == "redo" and found[0].action == "edit"
    if not members or cleared or not taken.stands(members, action):
        raise InputError(f"{author} has no action of this group to {action}", got=repr(group))
    return members


def _take_back(
    journal: Journal, author: str, action: Turn, group: str | None, again: str | None
) -> Saved | Conflict | None:
    saved = () if again is None else journal.events(group=again)
    if saved:
        return Saved(saved)
    members = _newest(journal, author, action) if group is None else _of_group(journal, author, action, group)
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
        cell = event.cell
        events = journal.events(kind=cell.kind, frame=cell.frame, key=cell.key, field=cell.field)
        base = event.version
        if events and standing_after(events, events[-1].id) == standing_after(events, event.id):
            base = events[-1].version
        edits.append(Edit(cell, before=event.after, after=event.before, base=base, reason=event.reason,
                          anchor=event.anchor))  # fmt: skip
    return edits


def standing_after(events: Iterable[Event], last: int) -> list[str]:
    """ULIDs of the edits of a cell that stood after the event numbered `last`, the newest at the end."""
    found: list[str] = []
    root: dict[str, str] = {}
    for event in events:
        if event.id > last:
            break
        if event.action == "edit" or event.undo_of is None:
            root[event.ulid] = event.ulid
            found.append(event.ulid)
            continue
        root[event.ulid] = root.get(event.undo_of, event.undo_of)
        if event.action == "redo":
            found.append(root[event.ulid])
        elif found and found[-1] == root[event.ulid]:
            found.pop()
    return found
