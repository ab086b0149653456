"""Connections to a journal's database: SQLite so that what is saved is on the disk, or PostgreSQL by URL.

A journal of the release before is checked, kept beside as it was, and its events
are chained, in one transaction.

Here too is what is done with a journal as a whole: it is checked, copied, or what
is intact of it is written into a new one.
"""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from pipeline.corrections.journal.chain import (
    BEFORE,
    CONTENT,
    EVENTS,
    FIRST,
    HEAD,
    VERSION,
    Head,
    Row,
    chained,
    create,
    judged,
    judged_alone,
    version_of,
)
from pipeline.corrections.journal.examining import Examined, empty_file, examine, is_empty, known_version, read_only
from pipeline.corrections.journal.postgres import ask_for_turn, postgres_engine, state_of
from pipeline.corrections.journal.sqlite_file import (
    BUSY_S,
    READING,
    can_be_written,
    check_same_file,
    plain_reason,
    sqlite_engine,
)
from pipeline.system.errors import InputError, as_input_error, require

DATABASE_ERRORS = (SQLAlchemyError, sqlite3.Error, OSError)
"""What goes wrong in a database; the second where a connection is only being made, the third on the network."""
_HELP = (
    (("is full", "no space", "quota"), "the disk is full: free some space and save again"),
    (("disk i/o error",), "the disk is full, over a limit, read-only or broken: mend that and save again"),
    (("file is gone", "no such table"), "put the journal back where it was, and save again"),
    (("read-only transaction",), "the database takes no edits now: save again when it does"),
    (("readonly", "read-only", "unable to open", "permission denied"),
     "the folder cannot be written: check that it is there, and its rights, and save again"),
    (("locked",), "another program holds the journal: close it, and save again"),
    (("connect", "network", "terminat", "closed", "shutting down", "starting up", "recovery mode", "timed out",
      "name or service"), "the database cannot be reached: save again when it can"),
)  # fmt: skip
"""Words of a reason, and what helps."""
_ADVISORY = 0x5350_4A4C
"""Key of the lock by which PostgreSQL's writers take turns: events are numbered in the order of their saving."""
ORIGINAL, _TABLE = "before-chain", "events_before_chain"
"""What the name of the copy ends with, and PostgreSQL's table."""
NOTHING = Head(0, 0, FIRST)


def is_url(where: str | Path) -> bool:
    """Whether a journal is named by a URL."""
    return "://" in str(where)


def make_engine(where: str | Path) -> sa.Engine:
    """An engine for the path of an SQLite file, or a URL "postgresql://...".

    Raises
    ------
    InputError
        A URL that cannot be used.
    MissingExtra
        PostgreSQL's driver is not installed.
    """
    return postgres_engine(str(where)) if is_url(where) else sqlite_engine(where, _come_instead)


@contextmanager
def opened(where: str | Path) -> Iterator[sa.Engine]:
    """`make_engine` for as long as the block lasts."""
    engine = make_engine(where)
    try:
        yield engine
    finally:
        engine.dispose()


def _come_instead(path: Path) -> None:
    """Believe a file that has come in the place of a journal that is open."""
    found = examine(path).believe()
    require(
        found.version == VERSION, "another file stands in the place of the journal", cause="open it anew", path=path
    )


def location_of(engine: sa.Engine) -> str:
    """Where a journal is, without its password."""
    return (
        str(engine.url.database)
        if engine.dialect.name == "sqlite"
        else engine.url.set(drivername="postgresql").render_as_string(hide_password=True)
    )


@contextmanager
def reading(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A connection that waits for no writer.

    Raises
    ------
    InputError
        The journal cannot be read.
    """
    try:
        with engine.connect().execution_options(**{READING: True}) as connection, connection.begin():
            yield connection
    except InputError:
        raise
    except (*DATABASE_ERRORS, ValueError, TypeError) as error:
        # Of a file that was whole when it was opened.
        cause = None if isinstance(error, DATABASE_ERRORS) else "spatialviz journal LABELS --check says what is wrong"
        location = location_of(engine)
        reason = reason_of(error, location)
        raise InputError("the journal cannot be read", got=reason, cause=cause, path=location) from error


@contextmanager
def writing(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A connection whose turn it is to write; when the block ends, what it wrote is on the disk."""
    file = Path(location_of(engine)) if engine.dialect.name == "sqlite" else None
    if file is not None and file.exists() and not can_be_written(file):
        raise sqlite3.OperationalError("attempt to write a readonly database")
    with engine.connect() as connection, _turn(connection):
        yield connection
        if engine.dialect.name == "sqlite":
            check_same_file(connection)


def _turn(connection: sa.Connection) -> sa.RootTransaction:
    """A transaction whose turn it is."""
    until = time.monotonic() + BUSY_S
    while True:
        turn = connection.begin()
        if connection.dialect.name != "postgresql" or ask_for_turn(connection, _ADVISORY):
            return turn
        turn.rollback()
        if time.monotonic() > until:
            raise TimeoutError("locked by another program, which goes on writing")


def prepare(engine: sa.Engine) -> tuple[str, ...]:
    """Make an empty database a journal, or chain an older one; what a user should know of it is returned.

    An SQLite file that is there was examined before.

    Raises
    ------
    InputError
        It cannot be opened, is of a newer release, or holds something else.
    DamagedJournal
        Events of a server, or of an older journal, are not as they were saved.
    """
    location = location_of(engine)
    try:
        on_server = engine.dialect.name != "sqlite"
        writable = on_server or can_be_written(Path(location))
        if not on_server and writable:
            _use_write_ahead_log(engine)
        # Head and events of one moment: on a server others go on writing while they are read.
        snapshot: dict[str, Any] = {"isolation_level": "REPEATABLE READ"} if on_server else {}
        with engine.connect().execution_options(**{READING: True}, **snapshot) as connection, connection.begin():
            found = version_of(connection)
            if found == VERSION:
                if on_server:
                    examined_server(connection, location, chain=True).believe()
                return ()
        if not writable:
            require(found == 1, "no journal can be made", cause="the folder cannot be written", path=location)
            return (f"{location} can only be read here: its events are checked, and not chained",)
        with writing(engine) as connection:
            found = version_of(connection)
            known_version(found, location)
            if found is None:
                create(connection, FIRST)
            elif found < VERSION:
                kept = take_over(connection, location)
                return (f"{location} is chained now: as the release before left it, it stands in {kept}",)
        return ()
    except DATABASE_ERRORS as error:
        reason = reason_of(error, location)
        cause = likely_cause(reason)
        raise InputError("the journal cannot be opened", got=reason, cause=cause, path=location) from error


def _use_write_ahead_log(engine: sa.Engine) -> None:
    """Set once for the file; two that open a new file at the same time get in each other's way, and one tries again."""
    until = time.monotonic() + BUSY_S
    while True:
        connection = engine.raw_connection()
        try:
            connection.cursor().execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > until:
                raise
            time.sleep(0.02)
        finally:
            connection.close()


def reason_of(error: BaseException, location: str = "") -> str:
    """The database's own words, in one line; of a full disk plainer ones, where `location` is a file."""
    inner = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
    message = state_of(inner).get("M") or str(inner)
    if isinstance(inner.__cause__, OSError) and str(inner.__cause__) not in message:
        message = f"{message}: {inner.__cause__}"
    message = next((line.strip() for line in message.splitlines() if line.strip()), type(inner).__name__)
    return message if not location else plain_reason(message, Path(location))


def likely_cause(reason: str) -> str | None:
    """What helps against a reason of `reason_of`."""
    message = reason.lower()
    return next((help for words, help in _HELP if any(word in message for word in words)), None)


def take_over(connection: sa.Connection, location: str) -> str:
    """Chain the events of version 1, in the connection's turn to write; the original is kept beside.

    Returns
    -------
    str
        Where it is kept: a file, or a table.

    Raises
    ------
    DamagedJournal
        Its events are not all as they can have been saved. Nothing was changed.
    """
    if connection.dialect.name == "sqlite":
        path = Path(location)
        # Nobody else writes now, so this is what the transaction sees.
        rows = examine(path).believe().intact
        kept = str(_free(path))
        copy_whole(path, Path(kept))
    else:
        rows, kept = examined_server(connection, location, chain=False).believe().intact, _TABLE
        connection.exec_driver_sql(f"CREATE TABLE IF NOT EXISTS {kept} AS TABLE events")
    for table in (BEFORE, EVENTS.name):
        connection.exec_driver_sql(f"DROP TABLE {table}")
    create(connection, FIRST)
    write_rows(connection, rows)
    return kept


def write_rows(connection: sa.Connection, rows: Iterable[Row], last: Head = NOTHING) -> list[dict[str, Any]]:
    """Chain events to the last one, write them into a journal, and say which is the last one now."""
    made = chained(last.hash, rows)
    if made:
        connection.execute(EVENTS.insert(), made)
        end = {"last": made[-1]["id"], "hash": made[-1]["hash"]}
        connection.execute(HEAD.update().values(events=last.events + len(made), **end))
    return made


def examined_server(connection: sa.Connection, location: str, *, chain: bool) -> Examined:
    """As `examine`, of a journal in PostgreSQL; `chain` is whether its events are chained."""
    query = sa.select(*(EVENTS.c[name] for name in ((*CONTENT, "hash") if chain else CONTENT))).order_by(EVENTS.c.id)
    rows = [(int(row["id"]), dict(row)) for row in connection.execute(query).mappings()]
    kept = connection.execute(sa.select(HEAD.c.events, HEAD.c.last, HEAD.c.hash)).one_or_none() if chain else None
    head = None if kept is None else Head(*kept)
    return Examined(
        location,
        2 if chain else 1,
        head.events if head else len(rows),
        *(judged(rows, head) if chain else judged_alone(rows)),
    )


def _free(path: Path) -> Path:
    """A name beside the journal that nothing has."""
    names = (Path(f"{path}.{ORIGINAL}{'' if number == 1 else f'-{number}'}") for number in count(1))
    return next(name for name in names if not name.exists())


def copy_whole(path: Path, to: Path) -> None:
    """A copy of a journal with what is in its log, on the disk and examined before it has its name.

    Raises
    ------
    DamagedJournal
        The copy is not whole.
    OSError, sqlite3.Error
        It cannot be written.
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
    """Examine a journal in full, and change nothing.

    Parameters
    ----------
    where : str or Path
        As `open_journal` takes it.

    Raises
    ------
    InputError
        There is none, or it cannot be opened.
    """
    if is_url(where):
        with opened(where) as engine, reading(engine) as connection:
            version = version_of(connection)
            if version is not None and 0 < version <= VERSION:
                return examined_server(connection, location_of(engine), chain=version == VERSION)
        return Examined(location_of(engine), version, None, (), ()).believe()
    path = Path(where).expanduser()
    require(path.is_file(), "no journal here", path=path)
    if is_empty(path):
        raise empty_file(path)
    return examine(path)


def back_up(where: str | Path, to: Path) -> Examined:
    """Write a copy of a journal, with what is in its log, and examine it; others may save meanwhile.

    Raises
    ------
    InputError
        It is in a server, the copy's name is taken, or it cannot be written.
    DamagedJournal
        The journal is damaged.
    """
    path = _file(where, to, "pg_dump copies it")
    check_journal(path).believe()
    return _written(to, lambda: copy_whole(path, to))


def recover(where: str | Path, to: Path) -> tuple[Examined, Examined]:
    """Write what is intact of a journal into a new one; the damaged one is not changed.

    An undo or redo is left out where what it takes back is.

    Returns
    -------
    damaged, made : Examined

    Raises
    ------
    InputError
        It is in a server, nothing is intact, the new name is taken, or it cannot be written.
    """
    path = _file(where, to, "its own backups hold it")
    found = check_journal(path)
    rows = found.standing
    if not rows:
        what = "those of its events that are intact take back others, which are not" if found.intact else found.summary
        raise InputError(f"nothing of the journal can be recovered: {what}", cause="a backup may have it", path=path)

    def write() -> None:
        part = Path(f"{to}.part")
        try:
            with opened(part) as engine:
                prepare(engine)
                with writing(engine) as connection:
                    write_rows(connection, rows)
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
    """`journal --check --json`: "events" were saved (null where unknown), "ranges" of ids are intact."""
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
    """`journal --backup --json` and `--recover --json`: the file that was made, and its events."""
    return {"journal": found.location, "written": made.location, "events": len(made.intact), "of": found.events}
