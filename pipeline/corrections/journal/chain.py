"""Events of a journal: their chain, in which each carries a hash of the one before, and their tables in a database."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime, timezone
from functools import partial
from typing import Any, NamedTuple, get_args

from pipeline.corrections.journal.events import Action, Edit
from pipeline.corrections.journal.field_refs import LONGEST_NAME, FieldRef, plain_text
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

FIRST = "0" * 64
"""What the first event is chained to."""
CONTENT = (
    "id",
    "ulid",
    "project",  # Whose journal it is, where several share a database
    "author",
    "time",
    "kind",
    "frame",
    "key",
    "field",
    "before",
    "after",
    "base",
    "version",
    "labels",
    "reason",
    "group",
    "action",
    "undo_of",
    "anchor",
)
"""All columns but the hash, in the order in which they are hashed."""
Row = Mapping[str, Any]
_JSON = json.JSONEncoder(sort_keys=True, separators=(",", ":"))


def link(previous: str, row: Row) -> str:
    """Hash of an event: SHA-256 of the JSON of the previous hash and its columns, 64 hexadecimal digits.

    ASCII, sorted keys, UTC to the microsecond: the same from either database. TypeError, ValueError or AttributeError
    where a column holds no value of its type.
    """
    time = row["time"].astimezone(timezone.utc).isoformat(timespec="microseconds")
    return hashlib.sha256(
        _JSON.encode([previous, *(time if name == "time" else row[name] for name in CONTENT)]).encode()
    ).hexdigest()


def chained(previous: str, rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Add hashes to rows in the order of their ids."""
    found = []
    for row in rows:
        previous = link(previous, row)
        found.append({**row, "hash": previous})
    return found


@dataclass(frozen=True)
class Head:
    """Last event as the journal has it: count, id (0 for none) and hash."""

    events: int
    last: int
    hash: str


class Verdict(NamedTuple):
    """Events as they were saved, and damage in clauses."""

    intact: tuple[Row, ...]
    damage: tuple[str, ...]


def judged(rows: Sequence[tuple[int, Row | None]], head: Head | None) -> Verdict:
    """Compare events with their hashes and with the head.

    Intact is an event whose hash follows from the event before, or whose computed hash the next one is chained to: then
    only the hash was damaged. `rows` are (id, event or None where unreadable) by id; `head` is None where unreadable.
    """
    intact: list[Row] = []
    damage: list[str] = []
    # The hashes that the event before may have had: as it is kept, and as it is computed.
    before: tuple[str, ...] = (FIRST,)
    waiting: tuple[Row, str] | None = None
    for number, row in rows:
        made = [] if row is None else [_link(p, row) for p in before]
        if row is not None and row["hash"] in made:
            if waiting is not None and made[before.index(waiting[1])] == row["hash"]:
                intact.append({**waiting[0], "hash": waiting[1]})
            intact.append(row)
            before, waiting = (str(row["hash"]),), None
            continue
        damage.append(f"event {number} cannot be read" if row is None else f"event {number} is not as it was saved")
        computed = made[0] if made else None
        waiting = None if row is None or computed is None or len(before) > 1 else (row, computed)
        kept = None if row is None else row["hash"]
        before = tuple(h for h in (kept, computed) if isinstance(h, str))
    if waiting is not None and head is not None and head.hash == waiting[1]:
        intact.append({**waiting[0], "hash": waiting[1]})
    if head is None:
        damage.append("which event is the last cannot be read")
    elif len(rows) != head.events or (rows[-1][0] if rows else 0) != head.last:
        gone = head.events - len(rows)
        damage.append(f"{gone} of {head.events} events are gone" if gone > 0 else "the head names another last event")
    elif head.hash not in (before if rows else (FIRST,)):
        damage.append("the head's hash is not that of the last event")
    return Verdict(tuple(intact), tuple(damage))


def _link(previous: str, row: Row) -> str | None:
    try:
        return link(previous, row)
    except (TypeError, ValueError, AttributeError, RecursionError):
        return None


def judged_alone(rows: Sequence[tuple[int, Row | None]]) -> Verdict:
    """Check events of version 1, without a chain, for impossible content; arguments as of `judged`.

    Damage that makes another possible value goes unseen.
    """
    intact: list[Row] = []
    damage: list[str] = []
    versions: dict[tuple[str, FieldRef], int] = {}
    known: set[str] = set()
    for number, row in rows:
        message = "it cannot be read" if row is None else _wrong(row, versions, known)
        if row is not None and message is None:
            intact.append(row)
        else:
            damage.append(f"event {number}: {message}")
    return Verdict(tuple(intact), tuple(damage))


def _wrong(row: Row, versions: dict[tuple[str, FieldRef], int], known: set[str]) -> str | None:
    """Impossible content of an event after others, in words."""
    try:
        ref = FieldRef(row["kind"], row["frame"], row["key"], row["field"])
        edit = Edit(ref, row["before"], row["after"], row["base"], row["reason"])
        plain_text(row["author"], "an author", LONGEST_NAME)
    except InputError as error:
        return error.what
    except (TypeError, ValueError, AttributeError, RecursionError):
        return "it cannot be read"
    if (edit.before, edit.after) != (row["before"], row["after"]):
        return "a value is not as it is kept"
    cell, before = (row["project"], ref), row["base"]
    if versions.get(cell, 0) != before or row["version"] != before + 1:
        return "its version does not follow"
    if row["action"] not in get_args(Action) or (row["action"] == "edit") != (row["undo_of"] is None):
        return "there is no such action"
    if row["ulid"] in known or (row["undo_of"] is not None and row["undo_of"] not in known):
        return "its ULID, or that of what it takes back, is wrong"
    versions[cell] = row["version"]
    known.add(row["ulid"])
    return None


VERSION = 2
"""Of this release. 1 had no chain, and kept its version in a table of Alembic's."""
TABLES = ("events", "journal_head")
BEFORE = "alembic_version"
"""That table."""
FORBIDDEN = "the journal can only grow"
JSON = ("before", "after", "anchor")
STORED = (*CONTENT, "hash")
NOTHING = Head(0, 0, FIRST)
_HEAD = (
    "one INTEGER NOT NULL",
    "version INTEGER NOT NULL",
    "events BIGINT NOT NULL",
    "last BIGINT NOT NULL",
    "hash VARCHAR(64) NOT NULL",
    "tables VARCHAR(64) NOT NULL",
    "PRIMARY KEY (one)",
)
_EVENTS = (
    "id {id} NOT NULL",
    "ulid VARCHAR(26) NOT NULL",
    "project TEXT NOT NULL",
    "author TEXT NOT NULL",
    "time {time} NOT NULL",
    "kind VARCHAR(16) NOT NULL",
    "frame TEXT NOT NULL",
    '"key" TEXT NOT NULL',
    "field VARCHAR(32) NOT NULL",
    '"before" JSON NOT NULL',
    '"after" JSON NOT NULL',
    "base INTEGER NOT NULL",
    "version INTEGER NOT NULL",
    "labels TEXT NOT NULL",
    "reason TEXT NOT NULL",
    '"group" VARCHAR(26) NOT NULL',
    "action VARCHAR(8) NOT NULL",
    "undo_of VARCHAR(26)",
    "anchor JSON NOT NULL",
    "hash VARCHAR(64) NOT NULL",
    "PRIMARY KEY (id)",
    "CONSTRAINT one_ulid UNIQUE (ulid)",
    # What locks: of two who edit the same version of a cell, one is refused by the database itself.
    'CONSTRAINT one_successor UNIQUE (project, kind, frame, "key", field, version)',
)
_INDEXES = {"author": "project, author, id", "frame": "project, frame, id", "group": 'project, "group"'}
Run = Callable[..., list[Any]]
"""Runs a statement with its values, `run("... WHERE id = ?", 3)`, in a transaction; the rows as sequences."""


class Store(ABC):
    """Database of a journal, an SQLite file or PostgreSQL, with its idle connections; shared by threads."""

    server = False
    selected = "{}"  # select expression of a JSON column, as text
    zone = ""  # end of a written time
    table_names: str  # query for the names of all tables
    types: tuple[str, str]  # of ids and times
    guards: tuple[str, ...]  # statements that make triggers against changes
    writable = True  # False for a folder or file without write permission

    def __init__(self, location: str) -> None:
        self.location = location  # without a password
        self._idle: list[Any] = []

    def reading(self, fresh: bool = False) -> AbstractContextManager[Run]:
        """Begin a snapshot without waiting for writers; `fresh` drops cached pages."""
        return self._transaction(False, fresh)

    def writing(self) -> AbstractContextManager[Run]:
        """Begin a transaction in the writer's turn, synced to disk at the end of the block."""
        return self._transaction(True)

    @contextmanager
    def _transaction(self, write: bool, fresh: bool = False) -> Iterator[Run]:
        link = self._taken()
        try:
            self._begin(link, write, fresh)
            yield partial(self._run, link)
            self._commit(link, write)
        except BaseException:
            with suppress(Exception):
                link.rollback()
            raise
        finally:
            if self._usable(link):
                self._idle.append(link)
            else:
                link.close()

    def _run(self, link: Any, statement: str, *values: Any) -> list[Any]:
        found = link.execute(statement, values)
        return found.fetchall() if found.description else []

    @abstractmethod
    def _taken(self) -> Any:
        """Take an idle connection, or open another."""

    @abstractmethod
    def _begin(self, link: Any, write: bool, fresh: bool) -> None:
        """Begin a transaction."""

    def _commit(self, link: Any, write: bool) -> None:
        self._run(link, "COMMIT")

    @abstractmethod
    def _usable(self, link: Any) -> bool:
        """True for a connection without a fault or an open transaction."""

    def create(self, run: Run) -> None:
        """Make the tables, and the triggers against changes."""
        for statement in (*made(*self.types), *self.guards):
            run(statement)
        run("INSERT INTO journal_head VALUES (1, ?, 0, 0, ?, ?)", VERSION, FIRST, self._made(run))

    def _made(self, run: Run) -> str:
        """Fingerprint of the tables, where the database keeps their statements."""
        return ""

    @abstractmethod
    def keep(self, run: Run) -> str:
        """Copy a version 1 journal; return the name of the copy."""

    def close(self) -> None:
        """Close all connections; the next use opens others."""
        with suppress(IndexError):
            while True:
                self._idle.pop().close()


def made(id_type: str, time_type: str) -> list[str]:
    """Statements for both tables, always in the same words."""
    columns = ", \n\t".join(_EVENTS).format(id=id_type, time=time_type)
    head = ", \n\t".join(_HEAD)
    indexes = [f"CREATE INDEX events_of_{name} ON events ({some})" for name, some in _INDEXES.items()]
    return [f"CREATE TABLE {n} (\n\t{text}\n)" for n, text in (("journal_head", head), ("events", columns))] + indexes


def fingerprint(statements: Iterable[str]) -> str:
    """Hash of the tables' statements: 64 hexadecimal digits."""
    return hashlib.sha256("\n".join(statements).encode("utf-8", "surrogateescape")).hexdigest()


def version_of(store: Store, run: Run) -> int | None:
    """Version of a journal's tables; None for an empty database, 0 for another program's."""
    found = {name for (name,) in run(store.table_names)}
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
    """Chain events to the last event, insert, and update the head; return the rows with hashes."""
    made = chained(last.hash, events)
    statement = f"INSERT INTO events ({columns(STORED, '{}')}) VALUES ({', '.join('?' * len(STORED))})"
    for row in made:
        time = row["time"].astimezone(timezone.utc).strftime("%Y-%m-%d %H:%M:%S.%f") + store.zone
        kept = {**row, "time": time, **{name: json.dumps(row[name]) for name in JSON}}
        run(statement, *[kept[name] for name in STORED])
    if made:
        run(
            "UPDATE journal_head SET events = ?, last = ?, hash = ?",
            last.events + len(made),
            made[-1]["id"],
            made[-1]["hash"],
        )
    return made


def head_of(run: Run) -> Head | None:
    """Last event by the head; None for no single head."""
    found = run("SELECT events, last, hash FROM journal_head")
    return Head(*found[0]) if len(found) == 1 else None
