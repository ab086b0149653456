"""Connections to one SQLite file: what is saved is on the disk, and in the file that goes by the journal's name.

SQLite goes on writing to a file that was removed or moved while it was open
(sqlite.org/howtocorrupt.html, section 4.1), and makes an empty one where there
is none. Either would take edits that nobody finds again.
"""

from __future__ import annotations

import errno
import os
import sqlite3
import tempfile
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.exc import DisconnectionError

BUSY_S = 60.0
"""How long a writer waits for its turn."""
READING = "spatialviz_reading"
GONE = "the journal's file is gone"
_FILE = "spatialviz_file"
_ROOM = 1 << 17
"""Bytes that saving an edit may need, for pages of the log and its index."""


class _Connection(sqlite3.Connection):
    """One that is known of while it is open."""

    def close(self) -> None:
        super().close()
        _HELD.pop(self, None)


_HELD: WeakKeyDictionary[_Connection, tuple[int, int] | None] = WeakKeyDictionary()
_GUARD = Lock()
_Found = TypeVar("_Found")


def connected(file: Path, mode: str) -> sqlite3.Connection:
    """A connection to a file; `mode` is that of SQLite's URI."""
    with _GUARD:
        connection = sqlite3.connect(
            f"{file.as_uri()}?mode={mode}", uri=True, timeout=BUSY_S, check_same_thread=False, factory=_Connection
        )
        _HELD[connection] = _identity(file)
    return connection


def read_plainly(file: Path, read: Callable[[], _Found]) -> _Found | None:
    """What `read` finds in a journal's files; None where this process has a connection to them.

    Whoever closes a descriptor of a file lets go of all locks that the process has on it, SQLite's too
    (sqlite.org/howtocorrupt.html, section 2.2).
    """
    with _GUARD:
        return None if _identity(file) in list(_HELD.values()) else read()


def sqlite_engine(path: str | Path, believe: Callable[[Path], object]) -> sa.Engine:
    """An engine for a file, which is made by the first connection and never again.

    Parameters
    ----------
    believe : callable
        Examines another file that has come in the place of the first one, which was examined before; raises where it
        is not to be used.
    """
    file = Path(path).expanduser().absolute()
    there = file.exists()
    known = {_identity(file)} if there else set()
    mode = "rwc"
    if there and not can_be_written(file):
        # Where it has no log, nobody writes to it.
        mode = "ro" if Path(f"{file}-wal").exists() else "ro&immutable=1"

    def connect() -> sqlite3.Connection:
        nonlocal mode
        if known and _identity(file) not in known and file.exists():
            believe(file)
        connection = connected(file, mode)
        known.add(_identity(file))
        mode = "rw" if mode == "rwc" else mode
        return connection

    engine = sa.create_engine(
        sa.URL.create("sqlite", database=str(file)), creator=connect, poolclass=sa.QueuePool
    )

    def settle(connection: Any, record: Any) -> None:
        record.info[_FILE] = _identity(file)
        _settle(connection)

    def check(_: Any, record: Any, __: Any) -> None:
        if record.info.get(_FILE) != _identity(file):
            # The pool closes this connection, and opens the file that is there now, or fails.
            raise DisconnectionError(GONE)

    event.listen(engine, "connect", settle)
    event.listen(engine, "checkout", check)
    event.listen(engine, "begin", _begin)
    return engine


def can_be_written(path: Path) -> bool:
    """Whether a journal takes events: its log and its index are made beside it."""
    return os.access(path.parent, os.W_OK) and (not path.exists() or os.access(path, os.W_OK))


def plain_reason(said: str, path: Path) -> str:
    """SQLite's words on a file, and plainer ones where its disk is full: it says "disk I/O error" of that, too."""
    if said != "disk I/O error":
        return said
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:
            file.write(bytes(_ROOM))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return f"the disk is full: {error.strerror}"
    return said


def check_in_place(connection: sa.Connection) -> None:
    """Raise OperationalError where the file was removed, moved or replaced since the connection was made."""
    if connection.info.get(_FILE) != _identity(Path(str(connection.engine.url.database))):
        raise sqlite3.OperationalError(GONE)


def _identity(path: Path) -> tuple[int, int] | None:
    """What tells one file from another; None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _settle(connection: Any) -> None:
    # The driver's own handling of transactions begins them late, and so lets two writers read the same version.
    connection.isolation_level = None
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {int(1000 * BUSY_S)}")
    # With FULL a commit returns when the write-ahead log is on the disk (sqlite.org/pragma.html#pragma_synchronous).
    cursor.execute("PRAGMA synchronous = FULL")
    cursor.close()


def _begin(connection: sa.Connection) -> None:
    reading = connection.get_execution_options().get(READING, False)
    connection.exec_driver_sql("BEGIN" if reading else "BEGIN IMMEDIATE")
