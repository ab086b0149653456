"""A journal of the release before: checked, kept beside as it was, and its events chained, in one transaction."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from pipeline.corrections.journal.before_chain import judged_alone
from pipeline.corrections.journal.chain import CONTENT, FIRST, Head, Row, Verdict, chained, judged
from pipeline.corrections.journal.examining import Examined, examine, read_only
from pipeline.corrections.journal.schema import EVENTS, HEAD, create, drop_before

ORIGINAL, _TABLE = "before-chain", "events_before_chain"
"""What the name of the copy ends with, and PostgreSQL's table."""


def take_over(connection: sa.Connection, place: str) -> str:
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
        path = Path(place)
        # Nobody else writes now, so this is what the transaction sees.
        rows = examine(path).believe().intact
        kept = str(_free(path))
        copy_whole(path, Path(kept))
    else:
        rows, kept = believed(connection, place, chain=False), _TABLE
        connection.exec_driver_sql(f"CREATE TABLE IF NOT EXISTS {kept} AS TABLE events")
    drop_before(connection)
    create(connection, FIRST)
    write_rows(connection, rows)
    return kept


def write_rows(connection: sa.Connection, rows: tuple[Row, ...]) -> None:
    """Chain events, and write them into a journal that has none."""
    made = chained(FIRST, rows)
    if made:
        connection.execute(EVENTS.insert(), made)
        move_head(connection, Head(len(made), made[-1]["id"], made[-1]["hash"]))


def move_head(connection: sa.Connection, head: Head) -> None:
    """Say which event is the last one now."""
    connection.execute(HEAD.update().values(events=head.events, last=head.last, hash=head.hash))


def head_of(connection: sa.Connection) -> Head | None:
    """What the journal says of its last event; None where it does not."""
    row: Any = connection.execute(sa.select(HEAD.c.events, HEAD.c.last, HEAD.c.hash)).one_or_none()
    return None if row is None else Head(*row)


def believed(connection: sa.Connection, place: str, *, chain: bool) -> tuple[Row, ...]:
    """All events of a server's journal, where they are as they were saved.

    Raises
    ------
    DamagedJournal
        They are not.
    """
    found = examined_server(connection, place, chain=chain)
    return found.believe().intact


def examined_server(connection: sa.Connection, place: str, *, chain: bool) -> Examined:
    """As `examine`, of a journal in PostgreSQL; `chain` is whether its events are chained."""
    names = (*CONTENT, "hash") if chain else CONTENT
    query = sa.select(*(EVENTS.c[name] for name in names)).order_by(EVENTS.c.id)
    rows = [(int(row["id"]), dict(row)) for row in connection.execute(query).mappings()]
    head = head_of(connection) if chain else None
    found: Verdict = judged(rows, head) if chain else judged_alone(rows)
    return Examined(place, 2 if chain else 1, head.events if head else len(rows), found.intact, found.damage)


def _free(path: Path) -> Path:
    """A name beside the journal that nothing has."""
    name = Path(f"{path}.{ORIGINAL}")
    number = 1
    while name.exists():
        number += 1
        name = Path(f"{path}.{ORIGINAL}-{number}")
    return name


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


