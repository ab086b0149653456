"""Taking events back: onto which version of its cell, where other events came since and were taken back themselves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pipeline.corrections.journal.events import Edit, Event
from pipeline.corrections.journal.journal import Journal


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
