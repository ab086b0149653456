"""The journal's table, as SQLAlchemy sees it. Migrations make it: see `pipeline.journal.migrations`."""

from __future__ import annotations

from datetime import datetime, timezone

import sqlalchemy as sa


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
    sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True, autoincrement=True),
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
    sa.UniqueConstraint("ulid", name="one_ulid"),
    # What locks: of two who edit the same version of a cell, one is refused by the database itself.
    sa.UniqueConstraint("project", "kind", "frame", "key", "field", "version", name="one_successor"),
    sa.Index("events_of_author", "project", "author", "id"),
    sa.Index("events_of_frame", "project", "frame", "id"),
    sa.Index("events_of_group", "project", "group"),
    sqlite_autoincrement=True,
)
