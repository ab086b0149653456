"""Tables of a journal, the same in SQLite and PostgreSQL: events that only grow, and a head that names the last one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from datetime import datetime, timezone
from typing import Any, Protocol

from pipeline.corrections.journal.chain import CONTENT, FIRST, Head, Row, chained

VERSION = 2
"""Of this release. 1 had no chain, and kept its version in a table of Alembic's."""
TABLES = ("events", "journal_head")
BEFORE, REVISION = "alembic_version", "0001"
"""That table, and all that it ever held."""
FORBIDDEN = "the journal can only grow"
JSON = ("before", "after", "anchor")
STORED = (*CONTENT, "hash")
NOTHING = Head(0, 0, FIRST)
_QUOTED = ("key", "before", "after", "group")
_HEAD = ("one INTEGER NOT NULL", "version INTEGER NOT NULL", "events BIGINT NOT NULL", "last BIGINT NOT NULL",
         "hash VARCHAR(64) NOT NULL", "tables VARCHAR(64) NOT NULL", "PRIMARY KEY (one)")  # fmt: skip
_EVENTS = (
    "id {id} NOT NULL", "ulid VARCHAR(26) NOT NULL", "project TEXT NOT NULL", "author TEXT NOT NULL",
    "time {time} NOT NULL", "kind VARCHAR(16) NOT NULL", "frame TEXT NOT NULL", '"key" TEXT NOT NULL',
    "field VARCHAR(32) NOT NULL", '"before" JSON NOT NULL', '"after" JSON NOT NULL', "base INTEGER NOT NULL",
    "version INTEGER NOT NULL", "labels TEXT NOT NULL", "reason TEXT NOT NULL", '"group" VARCHAR(26) NOT NULL',
    "action VARCHAR(8) NOT NULL", "undo_of VARCHAR(26)", "anchor JSON NOT NULL", "hash VARCHAR(64) NOT NULL",
    "PRIMARY KEY (id)", "CONSTRAINT one_ulid UNIQUE (ulid)",
    # What locks: of two who edit the same version of a cell, one is refused by the database itself.
    'CONSTRAINT one_successor UNIQUE (project, kind, frame, "key", field, version)',
)  # fmt: skip
_INDEXES = {"author": "project, author, id", "frame": "project, frame, id", "group": 'project, "group"'}
Run = Callable[..., list[Any]]
"""Runs a statement with its values, `run("... WHERE id = ?", 3)`, in a transaction; the rows as sequences."""


class Store(Protocol):
    """Database of a journal: an SQLite file, or PostgreSQL; shared by threads."""

    location: str  # without a password
    server: bool
    selected: str  # select expression of a JSON column, as text
    zone: str  # end of a written time

    @property
    def writable(self) -> bool:
        """False for a folder or file without write permission."""
        ...

    def settle(self) -> None:
        """Set the durable write-ahead log, once for a database."""
        ...

    def reading(self, fresh: bool = False) -> AbstractContextManager[Run]:
        """Begin a snapshot that waits for no writer; `fresh` drops cached pages."""
        ...

    def writing(self) -> AbstractContextManager[Run]:
        """Begin a transaction in the writer's turn, synced to disk at the end of the block."""
        ...

    def tables(self, run: Run) -> set[str]:
        """Names of all tables."""
        ...

    def create(self, run: Run, first: str) -> None:
        """Make the tables, and the triggers that refuse changes; `first` is the hash before the first event."""
        ...

    def keep(self, run: Run) -> str:
        """Copy a version 1 journal; return the name of the copy."""
        ...

    def close(self) -> None:
        """Close all connections; the next use opens new ones."""
        ...


def made(id_type: str, time_type: str) -> list[str]:
    """Statements that make both tables, always in the same words."""
    columns = ", \n\t".join(_EVENTS).format(id=id_type, time=time_type)
    head = ", \n\t".join(_HEAD)
    indexes = [f"CREATE INDEX events_of_{name} ON events ({some})" for name, some in _INDEXES.items()]
    return [f"CREATE TABLE {n} (\n\t{text}\n)" for n, text in (("journal_head", head), ("events", columns))] + indexes


def fingerprint(statements: Iterable[str]) -> str:
    """Hash of the statements that made the tables: 64 hexadecimal digits."""
    return hashlib.sha256("\n".join(statements).encode("utf-8", "surrogateescape")).hexdigest()


def version_of(store: Store, run: Run) -> int | None:
    """Version of a journal's tables; None for an empty database, 0 for another program's."""
    found = store.tables(run)
    if "journal_head" in found:
        return int(run("SELECT version FROM journal_head")[0][0])
    return None if "events" not in found else 1 if BEFORE in found else 0


def columns(names: Sequence[str], selected: str) -> str:
    """List of columns to select."""
    return ", ".join(selected.format(f'"{name}"') if name in JSON else f'"{name}"' for name in names)


def row_of(names: Sequence[str], values: Sequence[Any], parse: Callable[[str], Any] = json.loads) -> dict[str, Any]:
    """Parse an event; TypeError, ValueError or RecursionError for a wrong value."""
    row = dict(zip(names, values, strict=True))
    for name in JSON:
        # SQLite keeps JSON's numbers as numbers.
        row[name] = row[name] if type(row[name]) in (int, float) else parse(row[name])
    time = row["time"]
    row["time"] = (
        time.astimezone(timezone.utc)
        if isinstance(time, datetime)
        else datetime.fromisoformat(time).replace(tzinfo=timezone.utc)
    )
    return row


def rows(store: Store, run: Run, where: str = "", *values: Any, names: Sequence[str] = CONTENT) -> list[dict[str, Any]]:
    """Select events; `where` follows the table's name."""
    found = run(f"SELECT {columns(names, store.selected)} FROM events {where}", *values)
    return [row_of(names, row) for row in found]


def write_rows(store: Store, run: Run, events: Iterable[Row], last: Head = NOTHING) -> list[dict[str, Any]]:
    """Chain events to the last one, insert them, and update the head; return them with hashes."""
    made = chained(last.hash, events)
    statement = f"INSERT INTO events ({columns(STORED, '{}')}) VALUES ({', '.join('?' * len(STORED))})"
    for row in made:
        time = row["time"].astimezone(timezone.utc).strftime("%Y-%m-%d %H:%M:%S.%f") + store.zone
        kept = {**row, "time": time, **{name: json.dumps(row[name]) for name in JSON}}
        run(statement, *[kept[name] for name in STORED])
    if made:
        run(
            "UPDATE journal_head SET events = ?, last = ?, hash = ?",
            last.events + len(made), made[-1]["id"], made[-1]["hash"],
        )  # fmt: skip
    return made


def head_of(run: Run) -> Head | None:
    """Last event by the head; None for no single head."""
    found = run("SELECT events, last, hash FROM journal_head")
    return Head(*found[0]) if len(found) == 1 else None


def begin(run: Run, first: str, tables: str = "") -> None:
    """Insert the head of a new journal; `tables` is the fingerprint."""
    run("INSERT INTO journal_head VALUES (1, ?, 0, 0, ?, ?)", VERSION, first, tables)
