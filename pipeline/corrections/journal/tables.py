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
    """A database that holds a journal: an SQLite file, or PostgreSQL. Shared by threads.

    Attributes
    ----------
    location : str
        Where it is, without a password.
    server : bool
    selected : str
        How a column of JSON is selected, so that it comes as text.
    zone : str
        What ends a time that is written.
    """

    location: str
    server: bool
    selected: str
    zone: str

    @property
    def writable(self) -> bool:
        """False where the folder or the file may not be written to."""
        ...

    def settle(self) -> None:
        """Set what is set once for a database, so that what is saved is on the disk."""
        ...

    def reading(self, fresh: bool = False) -> AbstractContextManager[Run]:
        """A transaction that sees one moment and waits for no writer; `fresh` reads nothing from memory."""
        ...

    def writing(self) -> AbstractContextManager[Run]:
        """A transaction whose turn it is to write; when the block ends, what it wrote is on the disk."""
        ...

    def tables(self, run: Run) -> set[str]:
        """The names of all tables."""
        ...

    def create(self, run: Run, first: str) -> None:
        """Make the tables, and what refuses to change or remove events; the first event is chained to `first`."""
        ...

    def keep(self, run: Run) -> str:
        """Copy a journal of version 1; the name of the copy."""
        ...

    def close(self) -> None:
        """Let go of the database; it is opened again when it is needed."""
        ...


def made(id_type: str, time_type: str) -> list[str]:
    """The statements that make both tables, always in the same words."""
    columns = ", \n\t".join(_EVENTS).format(id=id_type, time=time_type)
    head = ", \n\t".join(_HEAD)
    indexes = [f"CREATE INDEX events_of_{name} ON events ({some})" for name, some in _INDEXES.items()]
    return [f"CREATE TABLE {n} (\n\t{text}\n)" for n, text in (("journal_head", head), ("events", columns))] + indexes


def fingerprint(statements: Iterable[str]) -> str:
    """Of the statements that made the tables: 64 hexadecimal digits."""
    return hashlib.sha256("\n".join(statements).encode("utf-8", "surrogateescape")).hexdigest()


def version_of(store: Store, run: Run) -> int | None:
    """The version of a journal's tables; None of an empty database, 0 of one that holds something else."""
    found = store.tables(run)
    if "journal_head" in found:
        return int(run("SELECT version FROM journal_head")[0][0])
    return None if "events" not in found else 1 if BEFORE in found else 0


def columns(names: Sequence[str], selected: str) -> str:
    """A list of columns to select."""
    return ", ".join(selected.format(f'"{name}"') if name in JSON else f'"{name}"' for name in names)


def row_of(names: Sequence[str], values: Sequence[Any], parse: Callable[[str], Any] = json.loads) -> dict[str, Any]:
    """An event as it was saved; TypeError, ValueError or RecursionError where a column holds what is no value of it."""
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
    """Events; `where` is what follows the table's name."""
    found = run(f"SELECT {columns(names, store.selected)} FROM events {where}", *values)
    return [row_of(names, row) for row in found]


def write_rows(store: Store, run: Run, events: Iterable[Row], last: Head = NOTHING) -> list[dict[str, Any]]:
    """Chain events to the last one, write them into a journal, and say which is the last one now."""
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
    """What the journal says of its last event; None where it says nothing."""
    found = run("SELECT events, last, hash FROM journal_head")
    return Head(*found[0]) if len(found) == 1 else None


def begin(run: Run, first: str, tables: str = "") -> None:
    """Write the head of a new journal; `tables` is the fingerprint of its tables."""
    run("INSERT INTO journal_head VALUES (1, ?, 0, 0, ?, ?)", VERSION, first, tables)
