"""Undo and redo: each person's own actions, newest first, also after a restart. Taking back is an event as well."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pipeline.errors import InputError
from pipeline.journal.events import Conflict, Event, Saved
from pipeline.journal.journal import Journal
from pipeline.journal.taking_back import edits_back


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


def undo(journal: Journal, author: str, *, group: str | None = None) -> Saved | Conflict | None:
    """Take back a person's newest action, or the one of a group.

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
    return _take_back(journal, author, history(journal.events(author=author)).done, "undo", group)


def redo(journal: Journal, author: str, *, group: str | None = None) -> Saved | Conflict | None:
    """Bring back what a person took back last; as `undo`, whose group it names."""
    return _take_back(journal, author, history(journal.events(author=author)).undone, "redo", group)


def _take_back(
    journal: Journal, author: str, stack: tuple[tuple[Event, ...], ...], action: str, group: str | None
) -> Saved | Conflict | None:
    if group is not None:
        stack = tuple(members for members in stack if members[0].group == group)
        if not stack:
            raise InputError(f"{author} has no action of this group to {action}", got=repr(group))
    if not stack:
        return None
    members = stack[-1]
    edits = edits_back(journal, members)
    return journal.write(
        edits, author, "undo" if action == "undo" else "redo", undo_of=[e.ulid for e in members]
    )
