"""The journal as JSON, with documented and stable keys."""

from __future__ import annotations

from typing import Any

from pipeline.corrections.journal.events import Conflict, Event, Saved
from pipeline.corrections.journal.examining import Examined


def who_and_what(event: Event) -> dict[str, Any]:
    """Who changed which field when, as JSON."""
    return {
        "id": event.id,
        "event": event.ulid,
        "author": event.author,
        "time": event.time.isoformat(),
        "kind": event.cell.kind,
        "frame": event.cell.frame,
        "key": event.cell.key,
        "field": event.cell.field,
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
    """What came of saving: {"saved": [events], "conflicts": [{"wanted", "there", "message"}]}."""
    saved = [event_record(e) for e in done.events] if isinstance(done, Saved) else []
    conflicts = [
        {
            "kind": r.edit.cell.kind,
            "frame": r.edit.cell.frame,
            "key": r.edit.cell.key,
            "field": r.edit.cell.field,
            "wanted": r.edit.after,
            "there": None if r.event is None else event_record(r.event),
            "message": str(r),
        }
        for r in (done.rivals if isinstance(done, Conflict) else ())
    ]
    return {"saved": saved, "conflicts": conflicts}


def examined_record(found: Examined) -> dict[str, Any]:
    """`journal --check --json`: "events" were saved (null where unknown), "ranges" of ids are intact."""
    return {
        "journal": found.place,
        "sound": not found.damage,
        "chained": found.chained,
        "events": found.events,
        "intact": len(found.intact),
        "ranges": [list(run) for run in found.ranges],
        "damage": list(found.damage),
        "help": found.help,
    }


def written_record(found: Examined, made: Examined) -> dict[str, Any]:
    """`journal --backup --json` and `--recover --json`: the file that was made, and its events."""
    return {"journal": found.place, "written": made.place, "events": len(made.intact), "of": found.events}
