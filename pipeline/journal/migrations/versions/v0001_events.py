"""The table of events, which can only grow."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

_FORBIDDEN = "the journal can only grow"


def upgrade() -> None:
    """Make the table, and the triggers that refuse to change or remove what is in it."""
    op.create_table(
        "events",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True, autoincrement=True),
        sa.Column("ulid", sa.String(26), nullable=False),
        sa.Column("project", sa.Text, nullable=False),
        sa.Column("author", sa.Text, nullable=False),
        sa.Column("time", sa.DateTime(timezone=True), nullable=False),
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
        sa.UniqueConstraint("project", "kind", "frame", "key", "field", "version", name="one_successor"),
        sqlite_autoincrement=True,
    )
    op.create_index("events_of_author", "events", ["project", "author", "id"])
    op.create_index("events_of_frame", "events", ["project", "frame", "id"])
    op.create_index("events_of_group", "events", ["project", "group"])
    if op.get_bind().dialect.name == "sqlite":
        for what in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER events_no_{what.lower()} BEFORE {what} ON events "
                f"BEGIN SELECT RAISE(ABORT, '{_FORBIDDEN}'); END"
            )
        return
    op.execute(
        "CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{_FORBIDDEN}'; END $$"
    )
    op.execute(
        "CREATE TRIGGER events_only_grow BEFORE UPDATE OR DELETE OR TRUNCATE ON events "
        "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
    )
