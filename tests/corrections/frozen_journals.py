"""Journals of earlier states: what their events say, and openings of them that are killed half-way."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

from pipeline.corrections import Event, open_journal
from pipeline.corrections.journal import sqlite_file
from pipeline.corrections.journal.connection import PostgresStore

_STEPS = ("sqlite3.connect", "os.rename", "os.remove", "os.link")
"""Audit events that are steps of opening a journal, beside its statements."""
_KILLED = 9
_MOST = 500


def journal_record(events: Sequence[Event]) -> dict[str, Any]:
    """What events say: counts, a line each for people, and a hash of all that is in them."""
    said = [
        [
            e.ulid,
            e.author,
            e.time.isoformat(),
            e.ref.kind,
            e.ref.frame,
            e.ref.key,
            e.ref.field,
            e.before,
            e.after,
            e.base,
            e.version,
            e.labels,
            e.reason,
            e.group,
            e.action,
            e.undo_of,
            e.anchor,
        ]
        for e in events
    ]
    return {
        "events": len(events),
        "authors": dict(Counter(e.author for e in events)),
        "actions": dict(Counter(e.action for e in events)),
        "rows": [f"{e.author} {e.action} v{e.version} {e.ref}" for e in events],
        "sha256": hashlib.sha256(json.dumps(said, sort_keys=True, separators=(",", ":")).encode()).hexdigest(),
    }


def killed_openings(where: str | Path) -> Iterator[int]:
    """Open a journal in processes of which the first dies at its first step, the next at its second, and so on.

    Yields
    ------
    int
        The step at which one died, after each; ends when one has opened the journal.
    """
    for step in count(1):
        child = os.fork()
        if child == 0:
            _open_and_die(where, step)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert status in (0, _KILLED), f"it could not be opened: {status}"
        if status == 0:
            return
        assert step < _MOST, "it is never open"
        yield step


def _open_and_die(where: str | Path, at: int) -> None:
    """In a child: the file system and the database see the same as of a process that was killed."""
    steps = count(1)

    def step(*_: object, **__: object) -> None:
        if next(steps) == at:
            os._exit(_KILLED)

    def audit(event: str, _: object) -> None:
        if event in _STEPS:
            step()

    status = 1
    try:
        connected, run = sqlite_file.connected, PostgresStore._run

        def traced(*given: Any) -> Any:
            connection = connected(*given)
            connection.set_trace_callback(step)
            return connection

        def watched(self: PostgresStore, link: Any, statement: str, *values: Any) -> list[Any]:
            step()
            return run(self, link, statement, *values)

        sqlite_file.connected, PostgresStore._run = traced, watched
        sys.addaudithook(audit)
        open_journal(where)
        status = 0
    finally:
        os._exit(status)
