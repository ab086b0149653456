"""Connections to a journal's database: SQLite so that what is saved is on the disk, or PostgreSQL by URL.

A journal of the release before is checked, kept beside as it was, and its events
are chained, in one transaction.

Here too is what is done with a journal as a whole: it is checked, copied, or what
is intact of it is written into a new one.
"""

from __future__ import annotations

import os
import re
import socket
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from itertools import count
from pathlib import Path
from threading import Timer
from typing import Any

from pipeline.corrections.journal.chain import (
    BEFORE,
    CONTENT,
    FORBIDDEN,
    STORED,
    VERSION,
    Head,
    Run,
    Store,
    head_of,
    judged,
    judged_alone,
    rows,
    version_of,
    write_rows,
)
from pipeline.corrections.journal.examining import Examined, examine, known_version, read_only, require_content
from pipeline.corrections.journal.sqlite_file import SqliteStore, plain_reason
from pipeline.system.errors import InputError, as_input_error, extra_module, require
from pipeline.system.remote import is_url

CONNECT_S = 3
PING_S = 2.0
"""A connection that says nothing for so long when it is taken up again is broken."""
BUSY_S = 60.0
"""How long a writer waits for its turn."""
IDLE_S = 20.0
"""A writer that says nothing for so long loses its turn: nobody waits for one that the network has lost."""
AGAIN_S = 10.0
"""How long a server that did not answer is not asked again."""
KEPT = "events_before_chain"
_ADVISORY = 0x5350_4A4C
"""Key of the lock by which writers take turns: events are numbered in the order of their saving."""
_DEFAULTS = {
    "connect_timeout": CONNECT_S,
    "fallback_application_name": "spatialviz",
    # A peer that the network has lost is noticed (postgresql.org/docs/current/libpq-connect.html).
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 10_000,
}
_PASSWORD = re.compile(r"(?<=://)([^:/@]*):.*@")
_SECRETS = re.compile(r"(?<=[?&])[^&=]*password[^&]*&?", re.IGNORECASE)
_away: dict[str, float] = {}
"""Servers that did not answer, by location, until when they are not asked."""


class ServerError(OSError):
    """Error of a server or on the way to it."""


class PostgresStore(Store):
    """`Store` at a URL "postgresql://..."; InputError for an unusable URL, MissingExtra without the driver."""

    server, selected, zone = True, "{}::text", "+00"
    table_names = "SELECT tablename FROM pg_tables WHERE schemaname = current_schema()"
    types = ("BIGINT", "TIMESTAMP WITH TIME ZONE")
    guards = (
        "CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{FORBIDDEN}'; END $$",
        "CREATE TRIGGER events_only_grow BEFORE UPDATE OR DELETE OR TRUNCATE ON events "
        "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()",
    )

    def __init__(self, where: str) -> None:
        # As URLs of earlier versions named their driver.
        where = re.sub(r"^postgresql\+pg8000:", "postgresql:", where)
        scheme = where.partition("://")[0]
        known = scheme in ("postgresql", "postgres")
        require(known, "no such kind of journal", got=scheme, expected="a path, or postgresql://...")
        self._driver = extra_module("psycopg", "a journal in PostgreSQL", "postgres")
        super().__init__(without_password(where))
        try:
            self._login = {**_DEFAULTS, **self._driver.conninfo.conninfo_to_dict(where)}
        except self._driver.Error:
            # The driver's message may hold the password.
            raise InputError("the journal's URL cannot be read", expected="postgresql://user@host/database") from None

    def _taken(self) -> Any:
        """Take an answering connection."""
        with suppress(IndexError):
            while True:
                link = self._idle.pop()
                silent = Timer(PING_S, _cut, [link])
                silent.start()
                try:
                    self._run(link, "SELECT 1")
                    return link
                except self._driver.Error:
                    link.close()
                finally:
                    silent.cancel()
        if time.monotonic() < _away.get(self.location, 0.0):
            raise TimeoutError("cannot connect: the server does not answer")
        try:
            return self._driver.connect(**self._login, autocommit=True, prepare_threshold=None)
        except self._driver.errors.ConnectionTimeout:
            _away[self.location] = time.monotonic() + AGAIN_S
            raise

    @contextmanager
    def _transaction(self, write: bool, fresh: bool = False) -> Iterator[Run]:
        try:
            with super()._transaction(write, fresh) as run:
                yield run
        except self._driver.Error as error:
            raise ServerError(str(error).rpartition("FATAL:  ")[2]) from error

    def _begin(self, link: Any, write: bool, fresh: bool) -> None:
        if not write:
            self._run(link, "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
            return
        # The settings are the transaction's (postgresql.org/docs/current/runtime-config-client.html).
        self._run(link, "BEGIN")
        self._run(link, f"SET LOCAL lock_timeout = {int(1000 * BUSY_S)}")
        self._run(link, f"SET LOCAL idle_in_transaction_session_timeout = {int(1000 * IDLE_S)}")
        self._run(link, f"SELECT pg_advisory_xact_lock({_ADVISORY})")

    def _run(self, link: Any, statement: str, *values: Any) -> list[Any]:
        return super()._run(link, statement.replace("?", "%s"), *values)

    def _usable(self, link: Any) -> bool:
        return not link.closed

    def keep(self, run: Run) -> str:
        run(f"CREATE TABLE IF NOT EXISTS {KEPT} AS TABLE events")
        return KEPT


def _cut(link: Any) -> None:
    """End a connection under a thread that waits for it."""
    with suppress(OSError, ValueError), socket.socket(fileno=link.fileno()) as shared:
        shared.shutdown(socket.SHUT_RDWR)
        shared.detach()


def without_password(where: str | Path) -> str:
    """Address of a journal without secrets."""
    text = str(where)
    return _SECRETS.sub("", _PASSWORD.sub(r"\1@", text)).rstrip("?&") if "://" in text else text


DATABASE_ERRORS = (sqlite3.Error, OSError)
"""What goes wrong in a database; the second in a server, or on the way to it."""
_HELP = (
    (("is full", "no space", "quota"), "the disk is full: free some space and save again"),
    (("disk i/o error",), "the disk is full, over a limit, read-only or broken: mend that and save again"),
    (("file is gone", "no such table"), "put the journal back where it was, and save again"),
    (("read-only transaction",), "the database takes no edits now: save again when it does"),
    (
        ("readonly", "read-only", "unable to open", "permission denied"),
        "the folder cannot be written: check that it is there, and its rights, and save again",
    ),
    (("locked", "lock timeout"), "another program holds the journal: close it, and save again"),
    (
        (
            "connect",
            "network",
            "terminat",
            "closed",
            "shutting down",
            "starting up",
            "recovery mode",
            "timed out",
            "name or service",
        ),
        "the database cannot be reached: save again when it can",
    ),
)
"""Words of a reason, and what helps."""
ORIGINAL = "before-chain"
"""What the name of the copy ends with."""


def store_at(where: str | Path) -> Store:
    """Make the store of an SQLite path, or of a URL "postgresql://..."; raises as `PostgresStore`."""
    return PostgresStore(str(where)) if is_url(where) else SqliteStore(where, _come_instead, _copied_beside)


def _come_instead(path: Path) -> None:
    """Examine a file in the place of an open journal; raise unless a journal of this version."""
    found = examine(path).believe()
    require(
        found.version == VERSION, "another file stands in the place of the journal", cause="open it anew", path=path
    )


@contextmanager
def reading(store: Store, fresh: bool = False) -> Iterator[Run]:
    """Read with `Store.reading`; InputError where the journal cannot be read."""
    what, cause = "the journal cannot be read", "spatialviz journal LABELS --check says what is wrong"
    words = {"got": lambda error: reason_of(error, store.location), "path": store.location}
    with (
        as_input_error(what, *DATABASE_ERRORS, **words),
        # Of a file that was whole when it was opened.
        as_input_error(what, ValueError, TypeError, cause=cause, **words),
        store.reading(fresh) as run,
    ):
        yield run


def prepare(store: Store) -> tuple[str, ...]:
    """Make an empty database a journal, or chain a version 1 journal; return warnings.

    SQLite files were examined before. InputError: cannot be opened, newer release, or another program's database.
    DamagedJournal: events of a server or of version 1 are not as saved.
    """
    location = store.location
    try:
        with store.reading() as run:
            found = version_of(store, run)
            if found == VERSION:
                if store.server:
                    examined_server(store, run, chain=True).believe()
                return ()
        if not store.writable:
            require(found == 1, "no journal can be made", cause="the folder cannot be written", path=location)
            return (f"{location} can only be read here: its events are checked, and not chained",)
        with store.writing() as run:
            found = version_of(store, run)
            known_version(found, location)
            if found is None:
                store.create(run)
            elif found < VERSION:
                kept = take_over(store, run)
                return (f"{location} is chained now: as the release before left it, it stands in {kept}",)
        return ()
    except DATABASE_ERRORS as error:
        reason = reason_of(error, location)
        cause = likely_cause(reason)
        raise InputError("the journal cannot be opened", got=reason, cause=cause, path=location) from error


def reason_of(error: BaseException, location: str = "") -> str:
    """Database message in a line; plainer for a full disk, where `location` is a file."""
    message = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
    return message if not location else plain_reason(message, Path(location))


def likely_cause(reason: str) -> str | None:
    """Advice against a reason of `reason_of`."""
    message = reason.lower()
    return next((help for words, help in _HELP if any(word in message for word in words)), None)


def take_over(store: Store, run: Run) -> str:
    """Chain the events of version 1 within a write transaction; return the name of the copy of the original.

    DamagedJournal, and nothing changed, where an event cannot be as it was saved.
    """
    found = examined_server(store, run, chain=False) if store.server else examine(Path(store.location))
    events, kept = found.believe().intact, store.keep(run)
    for table in (BEFORE, "events"):
        run(f"DROP TABLE {table}")
    store.create(run)
    write_rows(store, run, events)
    return kept


def examined_server(store: Store, run: Run, *, chain: bool) -> Examined:
    """Examine a journal in a server; `chain` is False for version 1."""
    found = [(row["id"], row) for row in rows(store, run, "ORDER BY id", names=STORED if chain else CONTENT)]
    head: Head | None = head_of(run) if chain else None
    saved = head.events if head else len(found)
    return Examined(store.location, 2 if chain else 1, saved, *(judged(found, head) if chain else judged_alone(found)))


def _copied_beside(path: Path) -> str:
    """Copy a journal under an unused name beside it; return the name."""
    names = (Path(f"{path}.{ORIGINAL}{'' if number == 1 else f'-{number}'}") for number in count(1))
    kept = next(name for name in names if not name.exists())
    copy_whole(path, kept)
    return str(kept)


def copy_whole(path: Path, to: Path) -> None:
    """Copy a journal with its log, synced and examined before the final name.

    DamagedJournal where the copy is not whole; OSError or sqlite3.Error where it cannot be written.
    """
    part = Path(f"{to}.part")
    try:
        with read_only(path, not Path(f"{path}-wal").exists()) as source, closing(sqlite3.connect(part)) as target:
            source.backup(target)
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        examine(part).believe()
        os.replace(part, to)
    finally:
        part.unlink(missing_ok=True)


def check_journal(where: str | Path) -> Examined:
    """Examine a journal in full, changing nothing; InputError where none can be opened."""
    if is_url(where):
        with closing(store_at(where)) as store, reading(store) as run:
            version = version_of(store, run)
            if version is not None and 0 < version <= VERSION:
                return examined_server(store, run, chain=version == VERSION)
        return Examined(store.location, version, None, (), ()).believe()
    path = Path(where).expanduser()
    require(path.is_file(), "no journal here", path=path)
    require_content(path)
    return examine(path)


def back_up(where: str | Path, to: Path) -> Examined:
    """Copy a journal into a new file, also while others save; InputError for a server or a taken name."""
    path = _file(where, to, "pg_dump copies it")
    check_journal(path).believe()
    return _written(to, lambda: copy_whole(path, to))


def recover(where: str | Path, to: Path) -> tuple[Examined, Examined]:
    """Write the intact events into a new journal; return the examined old and new journal.

    An undo or redo of a lost event is left out. InputError for a server, a taken name, or nothing intact.
    """
    path = _file(where, to, "its own backups hold it")
    found = check_journal(path)
    standing = found.standing
    if not standing:
        what = "those of its events that are intact take back others, which are not" if found.intact else found.summary
        raise InputError(f"nothing of the journal can be recovered: {what}", cause="a backup may have it", path=path)

    def write() -> None:
        part = Path(f"{to}.part")
        try:
            with closing(store_at(part)) as store:
                prepare(store)
                with store.writing() as run:
                    write_rows(store, run, standing)
            os.replace(part, to)
        finally:
            for end in ("", "-wal", "-shm"):
                Path(f"{part}{end}").unlink(missing_ok=True)

    return found, _written(to, write)


def _file(where: str | Path, to: Path, instead: str) -> Path:
    require(not is_url(where), "a journal in a server is not copied into a file", cause=instead)
    what = "there is a file of this name" if to.exists() else "the folder is not there"
    require(not to.exists() and to.parent.is_dir(), f"no journal can be written: {what}", path=to)
    return Path(where).expanduser()


def _written(to: Path, write: Callable[[], None]) -> Examined:
    with as_input_error("the copy cannot be written", *DATABASE_ERRORS, got=lambda e: reason_of(e, str(to)), path=to):
        write()
    return examine(to).believe()


def examined_record(found: Examined) -> dict[str, Any]:
    """`journal --check --json`: count of events (null if unknown), intact ranges of ids, damage."""
    return {
        "journal": found.location,
        "sound": not found.damage,
        "chained": found.chained,
        "events": found.events,
        "intact": len(found.intact),
        "ranges": [list(run) for run in found.ranges],
        "damage": list(found.damage),
        "help": found.help,
    }


def written_record(found: Examined, made: Examined) -> dict[str, Any]:
    """`journal --backup --json` and `--recover --json`: new file, and count of events."""
    return {"journal": found.location, "written": made.location, "events": len(made.intact), "of": found.events}
