"""Connections to one SQLite file: what is saved is on the disk, and in the file that goes by the journal's name.

SQLite goes on writing to a file that was removed or moved while it was open
(sqlite.org/howtocorrupt.html, section 4.1), and makes an empty one where there
is none. Either would take edits that nobody finds again. Of a write-ahead log
with a broken frame it drops all that follows and says nothing: the log is
checked before (sqlite.org/walformat.html, its checksum in section 4.2).
"""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import TypeVar
from weakref import WeakKeyDictionary

from pipeline.corrections.journal.chain import FORBIDDEN, VERSION, Run, Store, fingerprint
from pipeline.system.limits import shown

BUSY_S = 60.0
"""How long a writer waits for its turn."""
GONE = "the journal's file is gone"
LONGEST_LOG = 64 * 10**6
"""Bytes; SQLite empties a log of a thousand pages into the file."""
_ROOM = 1 << 17
"""Bytes that saving an edit may need, for pages of the log and its index."""
_GUARD = Lock()
_Found = TypeVar("_Found")
STATEMENTS = (
    "SELECT sql FROM sqlite_master WHERE tbl_name IN ('events', 'journal_head') AND sql IS NOT NULL ORDER BY name"
)
"""Asks for what made the tables: SQLite keeps it as text."""
_HEADER, _FRAME, _INDEX = 32, 24, 48
_MAGIC = 0x377F0682
_TRIES, _PAUSE_S = 20, 0.05


class _Connection(sqlite3.Connection):
    """Connection listed in _HELD while open."""

    def close(self) -> None:
        super().close()
        _HELD.pop(self, None)


_HELD: WeakKeyDictionary[_Connection, tuple[int, int] | None] = WeakKeyDictionary()


def connected(file: Path, mode: str) -> sqlite3.Connection:
    """Connect to a file in a mode of SQLite's URI."""
    with _GUARD:
        connection = sqlite3.connect(
            f"{file.as_uri()}?mode={mode}", uri=True, timeout=BUSY_S, check_same_thread=False, factory=_Connection
        )
        _HELD[connection] = _identity(file)
    return connection


def read_plainly(file: Path, read: Callable[[], _Found]) -> _Found | None:
    """Call `read` on a journal's files; None while this process has a connection.

    Closing any descriptor of a file drops the process's locks, SQLite's too (sqlite.org/howtocorrupt.html, section
    2.2).
    """
    with _GUARD:
        return None if _identity(file) in list(_HELD.values()) else read()


_REFUSED = f"CREATE TRIGGER events_no_{{}} BEFORE {{}} ON events BEGIN SELECT RAISE(ABORT, '{FORBIDDEN}'); END"


class SqliteStore(Store):
    """`Store` in one file, made by the first connection and never again.

    `believe` examines a file that replaced the first one, and raises; `copy` copies the file under a free name beside
    it.
    """

    table_names = "SELECT name FROM sqlite_master WHERE type = 'table'"
    types = ("INTEGER", "DATETIME")
    guards = (*map(_REFUSED.format, ("update", "delete"), ("UPDATE", "DELETE")), f"PRAGMA user_version = {VERSION}")

    def __init__(self, path: str | Path, believe: Callable[[Path], object], copy: Callable[[Path], str]) -> None:
        self.file = Path(path).expanduser().absolute()
        super().__init__(str(self.file))
        self._believe, self._copy = believe, copy
        there = self.file.exists()
        self._known = {_identity(self.file)} if there else set()
        self._mode = "rwc"
        if there and not can_be_written(self.file):
            # Where it has no log, nobody writes to it.
            self._mode = "ro" if Path(f"{self.file}-wal").exists() else "ro&immutable=1"

    @property
    def writable(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return can_be_written(self.file)

    def _taken(self) -> sqlite3.Connection:
        """Take a connection to the present file."""
        with suppress(IndexError):
            while True:
                connection = self._idle.pop()
                if _HELD.get(connection) == _identity(self.file):
                    return connection
                connection.close()
        if self._known and _identity(self.file) not in self._known and self.file.exists():
            self._believe(self.file)
        connection = connected(self.file, self._mode)
        # The driver's own handling of transactions begins them late, and so lets two writers read the same version.
        connection.isolation_level = None
        connection.execute(f"PRAGMA busy_timeout = {int(1000 * BUSY_S)}")
        # A commit returns when the write-ahead log is on the disk (sqlite.org/pragma.html#pragma_synchronous).
        connection.execute("PRAGMA synchronous = FULL")
        if self._mode == "rwc":
            _set_log(connection)
            self._mode = "rw"
        self._known.add(_identity(self.file))
        return connection

    def _begin(self, link: sqlite3.Connection, write: bool, fresh: bool) -> None:
        if write and not self.writable:
            raise sqlite3.OperationalError("attempt to write a readonly database")
        if fresh:
            link.execute("PRAGMA shrink_memory")
        link.execute("BEGIN IMMEDIATE" if write else "BEGIN")

    def _commit(self, link: sqlite3.Connection, write: bool) -> None:
        if write and _HELD.get(link) != _identity(self.file):  # pyright: ignore[reportArgumentType]
            raise sqlite3.OperationalError(GONE)
        link.execute("COMMIT")

    def _usable(self, link: sqlite3.Connection) -> bool:
        return not link.in_transaction

    def _made(self, run: Run) -> str:
        return fingerprint(text for (text,) in run(STATEMENTS))

    def keep(self, run: Run) -> str:
        # Nobody else writes now, so this is what the transaction sees.
        return self._copy(self.file)


def _set_log(connection: sqlite3.Connection) -> None:
    """Set the write-ahead log; of two openers of a new file the second tries again."""
    until = time.monotonic() + BUSY_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > until:
                connection.close()
                raise
        time.sleep(0.02)


def can_be_written(path: Path) -> bool:
    """True where events can be saved: log and index are made beside the file."""
    return os.access(path.parent, os.W_OK) and (not path.exists() or os.access(path, os.W_OK))


def plain_reason(message: str, path: Path) -> str:
    """SQLite's message, plainer for a full disk, also a "disk I/O error" there."""
    with suppress(OSError):
        if message == "disk I/O error" and shutil.disk_usage(path.parent).free < _ROOM:
            return "the disk is full"
    return message


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and inode; None for no file."""
    with suppress(OSError):
        found = os.stat(path)
        return found.st_dev, found.st_ino
    return None


def lost_in_log(path: Path) -> str | None:
    """Loss in a journal's log, in a clause; None for none.

    Written frames that are half done at the first look are whole at another.
    """
    found, seen = None, b""
    with suppress(OSError):
        if Path(f"{path}-wal").stat().st_size > LONGEST_LOG:
            return f"its write-ahead log is longer than {shown(LONGEST_LOG)} bytes"
    for _ in range(_TRIES):
        # The index first: what it says was saved is in a log that is read after it.
        index, log = _bytes(Path(f"{path}-shm")), _bytes(Path(f"{path}-wal"))
        found = _lost(log, index)
        if found is None or log == seen:
            return found
        seen = log
        time.sleep(_PAUSE_S)
    return found


def _bytes(path: Path) -> bytes:
    with suppress(OSError):
        return path.read_bytes()
    return b""


def _lost(log: bytes, index: bytes) -> str | None:
    if len(log) <= _HEADER:
        return None
    magic, _, size = struct.unpack(">3I", log[:12])
    order = ">" if magic & 1 else "<"
    sound = magic & ~1 == _MAGIC and 512 <= size <= 65_536 and size & (size - 1) == 0
    before = _sums(log[:24], order, (0, 0))
    if not sound or before != struct.unpack(">2I", log[24:_HEADER]):
        return "the head of the write-ahead log cannot be read"
    valid, ends = None, []
    starts = range(_HEADER, len(log) - _FRAME - size + 1, _FRAME + size)
    for number, at in enumerate(starts):
        _, pages, _, _, *sums = struct.unpack(">6I", log[at : at + _FRAME])
        salts = [log[at + k : at + k + 4] == log[8 + k : 12 + k] for k in (8, 12)]
        if valid is None:
            before = _sums(log[at : at + 8] + log[at + _FRAME : at + _FRAME + size], order, before)
            if not all(salts) or before != tuple(sums):
                valid = number
        # What is left from an earlier turn of the log has other salts, both of them; nothing but damage makes zeros.
        if (any(salts) and pages > 0) or not any(log[at : at + _FRAME]):
            ends.append(number)
    valid = len(starts) if valid is None else valid
    saved = _frames_saved(index, log[16:24])
    if saved is None:
        # A process that is killed while it writes its last frame leaves the same as damage to that frame does.
        return f"the write-ahead log is broken at frame {valid + 1}" if ends and ends[-1] >= valid else None
    known = max((end + 1 for end in ends if end < valid), default=0)
    return f"the write-ahead log is broken at frame {valid + 1} of {saved}" if known < saved else None


def _frames_saved(index: bytes, salt: bytes) -> int | None:
    """Count of saved frames by the log's index; None for an index of another log."""
    if len(index) < 2 * _INDEX:
        return None
    sound = index[:_INDEX] == index[_INDEX : 2 * _INDEX] and index[32:40] == salt
    whole = _sums(index[:40], "=", (0, 0)) == struct.unpack("=2I", index[40:_INDEX])
    return struct.unpack("=I", index[16:20])[0] if sound and whole else None


def _sums(data: bytes, order: str, before: tuple[int, int]) -> tuple[int, int]:
    """Checksums of pairs of 32-bit words, from the sums before."""
    one, two = before
    for first, second in struct.iter_unpack(f"{order}2I", data):
        one = (one + first + two) & 0xFFFFFFFF
        two = (two + second + one) & 0xFFFFFFFF
    return one, two


NETWORK_FILE_SYSTEMS = frozenset(
    {
        "nfs",
        "nfs3",
        "nfs4",
        "cifs",
        "smb3",
        "smbfs",
        "fuse.sshfs",
        "9p",
        "lustre",
        "gpfs",
        "beegfs",
        "afs",
        "ceph",
        "fuse.ceph",
        "glusterfs",
        "fuse.glusterfs",
        "ocfs2",
        "gfs2",
        "fuse.s3fs",
        "fuse.gcsfuse",
        "davfs",
        "fuse.davfs2",
    }
)
_ESCAPE = re.compile(r"\\([0-7]{3})")


def network_file_system(path: str | Path, mounts: str | Path = "/proc/self/mounts") -> str | None:
    """Kind of network file system of a path; None for a local file system.

    SQLite's write-ahead log needs shared memory, and so one machine (sqlite.org/wal.html).
    """
    try:
        lines = Path(mounts).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    location, kind, longest = Path(path).expanduser().resolve(), "", 0
    for fields in (line.split(" ") for line in lines):
        point = _ESCAPE.sub(lambda m: chr(int(m[1], 8)), fields[1]) if len(fields) > 2 else ""
        if point and location.is_relative_to(point) and len(point) >= longest:
            kind, longest = fields[2], len(point)
    return kind if kind in NETWORK_FILE_SYSTEMS else None
