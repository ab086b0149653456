"""The journal's schema through the releases: an Alembic revision a file, run when a journal is opened."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import sqlalchemy as sa

if TYPE_CHECKING:
    from alembic.script import ScriptDirectory

HEAD = "0001"
"""The revision of this release."""
_VERSION_TABLE = "alembic_version"


@lru_cache
def known_revisions() -> frozenset[str]:
    """Every revision that this release can bring up to date."""
    return frozenset(script.revision for script in _scripts().walk_revisions())


def revision_of(connection: sa.Connection) -> str | None:
    """The revision of a journal; None of an empty database."""
    if not sa.inspect(connection).has_table(_VERSION_TABLE):
        return None
    return connection.exec_driver_sql(f"SELECT version_num FROM {_VERSION_TABLE}").scalar()


def upgrade(connection: sa.Connection) -> None:
    """Bring a journal up to this release, within the transaction that the connection is in."""
    from alembic.config import Config
    from alembic.runtime.environment import EnvironmentContext

    scripts = _scripts()
    with EnvironmentContext(
        Config(), scripts, fn=lambda revision, _: scripts._upgrade_revs(HEAD, revision), destination_rev=HEAD
    ) as environment:
        environment.configure(connection=connection, version_table=_VERSION_TABLE)
        environment.run_migrations()


def _scripts() -> ScriptDirectory:
    from alembic.script import ScriptDirectory

    return ScriptDirectory(str(Path(__file__).parent))
