"""A journal's file, examined in full before it is believed: SQLite's checks, the chain, and what the log has lost."""

from __future__ import annotations

import json
import shutil
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.chain import (
    BEFORE,
    CONTENT,
    STORED,
    TABLES,
    VERSION,
    Head,
    Row,
    fingerprint,
    judged,
    judged_alone,
    row_of,
)
from pipeline.corrections.journal.sqlite_file import STATEMENTS, connected, lost_in_log, plain_reason, read_plainly
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import limits_of
from pipeline.system.whole_files import scratch_folder

_NOT_DAMAGE = ("locked", "unable to open", "disk i/o", "readonly", "full", "permission", "out of memory", "busy")
"""Words of SQLite's errors that say nothing of the file."""
_MAGIC, _FIXED = b"SQLite format 3\0", b"\0@  "
"""What every file of SQLite's has in its bytes 0 to 15, and 20 to 23."""
_ERRORS = (sqlite3.Error, UnicodeError)
"""The second where SQLite's message quotes what is no UTF-8."""
_SHOWN = 3
"""Pieces of damage that one line tells."""
_KEPT = "it was not changed: keep a copy of it with its -wal file; "
_RECOVER = f"{_KEPT}spatialviz journal LABELS --recover NEW.sqlite writes what is intact into a new journal"
_BACKUP = f"{_KEPT}none of it can be written into a new journal: put a backup in its place, or begin anew without it"


class DamagedJournal(InputError):
    """Error of a journal that is not as it was saved: damage, intact events and advice in one line."""

    def __init__(self, examined: Examined) -> None:
        more = len(examined.damage) - _SHOWN
        parts = [*examined.damage[:_SHOWN], *([f"and {more} more"] if more > 0 else []), examined.summary]
        super().__init__(f"the journal is damaged: {'; '.join(parts)}", cause=examined.help, path=examined.location)
        self.examined = examined


@dataclass(frozen=True)
class Examined:
    """Result of an examination; `version` as of `chain.version_of`, `events` None where the count is unknown."""

    location: str
    version: int | None
    events: int | None
    intact: tuple[Row, ...]  # in the order of saving
    damage: tuple[str, ...]  # in clauses

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """First and last id of each run of intact events."""
        runs = [
            [n for _, n in run]
            for _, run in groupby(enumerate(row["id"] for row in self.intact), key=lambda x: x[1] - x[0])
        ]
        return tuple((run[0], run[-1]) for run in runs)

    @property
    def summary(self) -> str:
        """Intact events in words."""
        of = "" if self.events is None else f" of {self.events:,}"
        runs = [f"{a:,}" if a == b else f"{a:,} to {b:,}" for a, b in self.ranges]
        if len(runs) > _SHOWN:
            return f"{len(self.intact):,}{of} events are intact"
        return f"events {', '.join(runs)}{of} are intact" if runs else "none of its events can be read"

    @property
    def standing(self) -> tuple[Row, ...]:
        """Intact events without an undo or redo of lost events: the content of a recovered journal."""
        found: dict[str, Row] = {}
        for row in self.intact:
            if row["undo_of"] is None or row["undo_of"] in found:
                found[row["ulid"]] = row
        return tuple(found.values())

    @property
    def help(self) -> str | None:
        """Advice for a damaged journal; None for a sound journal."""
        return None if not self.damage else _RECOVER if self.standing else _BACKUP

    @property
    def chained(self) -> bool:
        return self.version is not None and self.version > 1

    def believe(self) -> Examined:
        """Raise DamagedJournal for damage, else as `known`; return self."""
        if self.damage:
            raise DamagedJournal(self)
        return self.known()

    def known(self) -> Examined:
        """Raise InputError for a newer release or no journal; return self, damaged or not."""
        known_version(None if self.damage and self.version else self.version, self.location)
        return self


def known_version(version: int | None, location: str) -> None:
    """Raise InputError for a newer version, or 0; see `chain.version_of`."""
    require(
        version is None or version <= VERSION,
        "the journal is of a newer release",
        got=f"version {version}",
        expected=f"at most {VERSION}",
        cause="install the release that wrote it",
        path=location,
    )
    require(version != 0, "the database holds something else than a journal", path=location)


def is_empty(path: Path) -> bool:
    """True for an existing file without bytes, log included."""
    return path.exists() and not any(f.exists() and f.stat().st_size for f in (path, Path(f"{path}-wal")))


def require_content(path: Path) -> None:
    """Raise InputError for an empty file."""
    require(
        not is_empty(path), "the journal is an empty file", cause="put a copy in its place, or remove it", path=path
    )


def examine(path: Path) -> Examined:
    """Read an SQLite journal in full, changing nothing; InputError where opening fails."""
    # Where nobody has it open no log is there, and none need be made to read it.
    alone = not Path(f"{path}-wal").exists()
    found = _examine(path, alone)
    return _examine(path, False) if found.damage and alone and Path(f"{path}-wal").exists() else found


def _examine(path: Path, alone: bool) -> Examined:
    # What this process has open it has examined before.
    head, lost = read_plainly(path, lambda: (_header(path), lost_in_log(path))) or (None, None)
    if lost is not None:
        # SQLite would write a new index of what it reads of the log, and nobody would know any more what is missing.
        found = Examined(str(path), None, None, (), (lost,))
    else:
        damage = [] if head is None else [head]
        try:
            with read_only(path, alone) as connection:
                found = _contents(path, connection, damage)
        except _ERRORS as error:
            found = Examined(str(path), None, None, (), (*damage, _reason(error, path)))
    mended = _mended(path) if found.damage and not found.intact else None
    if mended is None:
        return found
    # What the log has lost is counted nowhere.
    events = None if lost is not None else mended.events
    return replace(mended, location=str(path), events=events, damage=found.damage)


def _mended(path: Path) -> Examined | None:
    """Examine a copy with a new file header; None for no use."""
    with suppress(*_ERRORS, OSError, InputError), scratch_folder() as folder:
        copy, log = Path(folder) / path.name, Path(f"{path}-wal")
        # Larger ones are no journal of people's work, and would be copied for nothing.
        length, most = path.stat().st_size, limits_of(path).bytes
        if not 512 <= length <= most or (log.exists() and log.stat().st_size > most):
            return None
        if not read_plainly(path, lambda: shutil.copyfile(path, copy)):
            return None
        with open(copy, "r+b") as file:
            data = bytearray(file.read(512))
        size = int.from_bytes(data[16:18], "big")
        size = size if size >= 512 and size & (size - 1) == 0 else 4_096
        data[:24] = struct.pack(">16sH6B", _MAGIC, size, *([2, 2] if log.exists() else [1, 1]), *_FIXED)
        # Pages, no free ones; a schema of format 4 without automatic vacuum, in UTF-8.
        for at, values in ((24, (1, length // size, 0, 0)), (44, (4, 0, 0, 1)), (64, (0,)), (92, (1,))):
            struct.pack_into(f">{len(values)}I", data, at, *values)
        with open(copy, "r+b") as file:
            file.write(data)
        if log.exists():
            shutil.copy(log, f"{copy}-wal")
        with read_only(copy, not log.exists()) as connection:
            # Statements that cannot be parsed are passed over.
            connection.execute("PRAGMA writable_schema = ON")
            return _contents(copy, connection, ())
    return None


@contextmanager
def read_only(path: Path, alone: bool = False) -> Iterator[sqlite3.Connection]:
    """Open a connection without any change, also when closed last; `alone`: nobody has the file open, and no log."""
    connection = connected(path.expanduser().absolute(), "ro&immutable=1" if alone else "ro")
    try:
        connection.isolation_level = None
        connection.text_factory = _any_text
        connection.execute("BEGIN")
        yield connection
    finally:
        connection.close()


def _any_text(text: bytes) -> str:
    """Decode any bytes, also no UTF-8."""
    return text.decode("utf-8", "surrogateescape")


def _header(path: Path) -> str | None:
    """Fault of the file's first bytes, ignored by SQLite (sqlite.org/fileformat.html, 1.3)."""
    head = b""
    with suppress(OSError), open(path, "rb") as file:
        head = file.read(100)
    if not head:
        return None
    sound = head[:16] == _MAGIC and head[18] == head[19] and head[18] in (1, 2)
    if len(head) < 100 or not sound or head[20:24] != _FIXED or head[56:60] not in (b"\0\0\0\1", b"\0\0\0\0"):
        return "its first bytes are not those of a journal"
    return None


def _contents(path: Path, connection: sqlite3.Connection, lost: Sequence[str]) -> Examined:
    damage = list(lost)
    (kept,) = connection.execute("PRAGMA user_version").fetchone()
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    try:
        message = "\n".join(str(line) for (line,) in connection.execute("PRAGMA integrity_check(10)")).splitlines()
        damage += [f"SQLite finds {line[:80]}" for line in message if line != "ok" and not line.startswith("***")]
    except _ERRORS as error:
        damage.append(_reason(error, path))
    if not tables:
        if connection.execute("PRAGMA page_count").fetchone()[0] > 1 or kept:
            damage.append("its tables are gone")
        return Examined(str(path), None, None, (), tuple(damage))
    if not tables & {*TABLES, BEFORE} or tables == {"events"}:
        # Whatever is wrong with another program's file is not ours to say.
        return Examined(str(path), 0, None, (), ())
    if TABLES[1] in tables:
        return _with_head(path, connection, kept, damage)
    rows = _rows(connection, CONTENT, damage)
    last = _one(connection, "SELECT seq FROM sqlite_sequence WHERE name = 'events'", []) or ((None,) if rows else (0,))
    found = judged_alone(rows)
    damage += found.damage
    if [n for n, _ in rows] != list(range(1, len(rows) + 1)) or last[0] != len(rows):
        damage.append(f"{len(rows)} events stand where {last[0]} were saved")
    return Examined(str(path), 1, _saved(rows, last[0]), found.intact, tuple(damage))


def _with_head(path: Path, connection: sqlite3.Connection, kept: int, damage: list[str]) -> Examined:
    row = _one(connection, "SELECT version, events, last, hash, tables FROM journal_head WHERE one = 1", damage)
    typed = row is not None and [type(value) for value in row[:4]] == [int, int, int, str]
    if row is not None and typed and row[0] == kept > VERSION:
        return Examined(str(path), kept, None, (), tuple(damage))
    if row is not None and not row[0] == kept == VERSION:
        damage.append(f"its version is {row[0]!r} in one place and {kept!r} in another")
    if row is not None and row[4] != fingerprint(str(text) for (text,) in connection.execute(STATEMENTS)):
        damage.append("its tables are not those that were made")
    rows = _rows(connection, STORED, damage)
    head = Head(*row[1:4]) if row is not None and typed else None
    found = judged(rows, head)
    events = head.events if head is not None and not found.damage else _saved(rows, head and head.events)
    return Examined(str(path), VERSION, events, found.intact, (*damage, *found.damage))


def _saved(rows: Sequence[tuple[int, Row | None]], message: Any) -> int | None:
    """Count of saved events as far as known: ids begin with 1 and have no gaps."""
    return max(rows[-1][0] if rows else 0, message if isinstance(message, int) and message < 100_000_000 else 0)


def _one(connection: sqlite3.Connection, query: str, damage: list[str]) -> tuple[Any, ...] | None:
    """Only row of a query; anything else is damage."""
    try:
        found = connection.execute(query).fetchall()
        problem = f"{len(found)} rows stand where one was"
    except _ERRORS as error:
        found, problem = [], _reason(error, None)
    if len(found) == 1:
        return found[0]
    damage.append(problem)
    return None


def _rows(connection: sqlite3.Connection, names: Sequence[str], damage: list[str]) -> list[tuple[int, Row | None]]:
    """Read all events by id, without an index; None for an unreadable event."""
    columns = ", ".join(f'"{name}"' for name in names)
    found: list[tuple[int, Row | None]] = []
    query = f"SELECT {columns} FROM events NOT INDEXED ORDER BY id"
    try:
        for values in connection.execute(query):
            found.append((values[0], _row(names, values)))
        return found
    except _ERRORS as error:
        damage.append(_reason(error, None))
    # Beyond a page that is broken: one by one, each from the top of the tree.
    last = read = found[-1][0] if found else 0
    (pages,) = connection.execute("PRAGMA page_count").fetchone()
    for query in ("SELECT last FROM journal_head", "SELECT seq FROM sqlite_sequence WHERE name = 'events'"):
        with suppress(*_ERRORS):
            last = max([last, *(n for (n,) in connection.execute(query) if isinstance(n, int) and n < 100 * pages)])
    for number in range(read + 1, last + 1):
        found.append((number, None))
        with suppress(*_ERRORS):
            values = connection.execute(f"SELECT {columns} FROM events NOT INDEXED WHERE id = ?", (number,)).fetchone()
            found[-1] = number, None if values is None else _row(names, values)
    return found


def _row(names: Sequence[str], values: Sequence[Any]) -> Row | None:
    """Parse an event; None for a column of another type."""
    try:
        return row_of(names, values, _parsed)
    except (TypeError, ValueError, RecursionError):
        return None


_parsed = lru_cache(maxsize=4_096)(json.loads)
"""Few values are of one event alone. Nothing changes what it returns."""


def _reason(error: Exception, path: Path | None) -> str:
    """SQLite's message of damage in a clause; InputError for any other trouble."""
    message = " ".join(str(error).split())
    if any(word in message.lower() for word in _NOT_DAMAGE):
        raise InputError(
            "the journal cannot be opened", got=message if path is None else plain_reason(message, path), path=path
        ) from error
    return f"SQLite says {message}"
