"""The journal's two tables: events, which can only grow, and one row that names the last of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from datetime import datetime, timezone

import sqlalchemy as sa

VERSION = 2
"""Of this release. 1 had no chain, and kept its version in a table of Alembic's."""
TABLES = ("events", "journal_head")
BEFORE, REVISION = "alembic_version", "0001"
"""That table, and all that it ever held."""
_FORBIDDEN = "the journal can only grow"


class UtcTime(sa.types.TypeDecorator[datetime]):
    """A time with its zone, also where the database knows none."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        return None if value is None else value.astimezone(timezone.utc)

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=timezone.utc) if value.tzinfo is None else value.astimezone(timezone.utc)


METADATA = sa.MetaData()
EVENTS = sa.Table(
    "events",
    METADATA,
    sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True, autoincrement=False),
    sa.Column("ulid", sa.String(26), nullable=False),
    sa.Column("project", sa.Text, nullable=False),
    sa.Column("author", sa.Text, nullable=False),
    sa.Column("time", UtcTime, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("frame", sa.Text, nullable=False),
    sa.Column("key", sa.Text, nullable=False),
    sa.Column("field", sa.String(32), nullable=False),
    sa.Column("before", sa.JSON, nullable=False),
    sa.Column("after", sa.JSON, nullable=False),
    sa.Column("base", sa.Integer, nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("labels", sa.Text, nullable=False),
    sa.Column("reason", sa.Text, nullable=False),
    sa.Column("group", sa.String(26), nullable=False),
    sa.Column("action", sa.String(8), nullable=False),
    sa.Column("undo_of", sa.String(26), nullable=True),
    sa.Column("anchor", sa.JSON, nullable=False),
    # Of the event before it and of all that is in this one: see `pipeline.corrections.journal.chain`.
    sa.Column("hash", sa.String(64), nullable=False),
    sa.UniqueConstraint("ulid", name="one_ulid"),
    # What locks: of two who edit the same version of a cell, one is refused by the database itself.
    sa.UniqueConstraint("project", "kind", "frame", "key", "field", "version", name="one_successor"),
    sa.Index("events_of_author", "project", "author", "id"),
    sa.Index("events_of_frame", "project", "frame", "id"),
    sa.Index("events_of_group", "project", "group"),
)
HEAD = sa.Table(
    "journal_head",
    METADATA,
    sa.Column("one", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("events", sa.BigInteger, nullable=False),
    sa.Column("last", sa.BigInteger, nullable=False),
    sa.Column("hash", sa.String(64), nullable=False),
    # Of the statements that made the tables: SQLite keeps them as text.
    sa.Column("tables", sa.String(64), nullable=False),
)


def version_of(connection: sa.Connection) -> int | None:
    """The version of a journal's tables; None of an empty database.

    0 is of a database that holds something else.
    """
    found = sa.inspect(connection).get_table_names()
    if HEAD.name in found:
        return int(connection.execute(sa.select(HEAD.c.version)).scalar_one())
    if BEFORE in found and EVENTS.name in found:
        return 1
    return 0 if EVENTS.name in found else None


def create(connection: sa.Connection, first: str) -> None:
    """Make the tables, and the triggers that refuse to change or remove events, in the connection's transaction.

    Parameters
    ----------
    first : str
        What the first event is chained to.
    """
    METADATA.create_all(connection)
    made = ""
    if connection.dialect.name == "sqlite":
        for what in ("UPDATE", "DELETE"):
            connection.exec_driver_sql(
                f"CREATE TRIGGER events_no_{what.lower()} BEFORE {what} ON events "
                f"BEGIN SELECT RAISE(ABORT, '{_FORBIDDEN}'); END"
            )
        connection.exec_driver_sql(f"PRAGMA user_version = {VERSION}")
        made = fingerprint(text for (text,) in connection.exec_driver_sql(STATEMENTS))
    else:
        connection.exec_driver_sql(
            "CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN RAISE EXCEPTION '{_FORBIDDEN}'; END $$"
        )
        connection.exec_driver_sql(
            "CREATE TRIGGER events_only_grow BEFORE UPDATE OR DELETE OR TRUNCATE ON events "
            "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
        )
    head = {"one": 1, "version": VERSION, "events": 0, "last": 0, "hash": first, "tables": made}
    connection.execute(HEAD.insert(), head)


def drop_before(connection: sa.Connection) -> None:
    """Remove the tables of version 1, whose events are at hand."""
    for table in (BEFORE, EVENTS.name):
        connection.exec_driver_sql(f"DROP TABLE {table}")


STATEMENTS = f"SELECT sql FROM sqlite_master WHERE tbl_name IN {TABLES} AND sql IS NOT NULL ORDER BY name"
"""Asks SQLite for what made the tables."""


def fingerprint(statements: Iterable[str]) -> str:
    """Of the statements that made the tables: 64 hexadecimal digits."""
    return hashlib.sha256("\n".join(statements).encode("utf-8", "surrogateescape")).hexdigest()
