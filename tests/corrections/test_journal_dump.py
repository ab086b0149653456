"""A journal that PostgreSQL held on 2026-11-26, from its dump: opens with all events, also after openings that died."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from frozen_journals import journal_record, killed_openings
from postgres_cluster import binaries, missing, running_cluster
from waiting import LONG_S

from pipeline.corrections import (
    JOURNAL_FILE,
    Edit,
    Saved,
    check_journal,
    object_ref,
    open_journal,
)

FIXTURE = Path(__file__).parents[1] / "fixtures" / "2026-11-26"
EXPECTED: dict[str, Any] = json.loads((FIXTURE / "expected.json").read_text(encoding="utf-8"))
OLDER = (
    "CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL)",
    "INSERT INTO alembic_version VALUES ('0001')",
    "ALTER TABLE events DROP COLUMN hash",
    "DROP TABLE journal_head",
)
"""Make of a journal one of the release before the chain."""


def psql() -> str | None:
    folder = binaries()
    return shutil.which("psql") or (None if folder is None else shutil.which("psql", path=folder))


@pytest.fixture
def database() -> Iterator[str]:
    reason = missing() or (None if psql() else "psql, which reads a dump, is not installed")
    if reason is not None:
        if os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    with running_cluster() as url:
        command = [str(psql()), "-q", "-v", "ON_ERROR_STOP=1", "-f", str(FIXTURE / "journal.postgresql.sql"), url]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONG_S, check=False)
        assert done.returncode == 0, done.stderr
        yield url


def says_what_it_said(url: str) -> None:
    """The events of the SQLite journal beside it, and those of another project."""
    for project, kept in (("", "journal"), ("recording", "postgresql")):
        with open_journal(url, project=project, must_exist=True) as journal:
            record = journal_record(journal.events())
        assert record == {name: EXPECTED[kept][name] for name in record}


@pytest.mark.slow
def test_a_dump_opens_with_all_events_and_reading_writes_nothing(database: str, tmp_path: Path) -> None:
    before = check_journal(database)
    assert (before.damage, before.chained) == ((), True)
    kept = {row["ulid"]: row["hash"] for row in before.intact}
    assert EXPECTED["journal"]["tip"] in kept.values()
    beside = check_journal(shutil.copyfile(FIXTURE / "labels" / JOURNAL_FILE, tmp_path / JOURNAL_FILE))
    assert [row["hash"] for row in beside.intact] == list(kept.values())[: len(beside.intact)]
    says_what_it_said(database)
    after = check_journal(database)
    assert {row["ulid"]: row["hash"] for row in after.intact} == kept
    with open_journal(database, project="recording") as journal:
        assert isinstance(
            journal.append([Edit(object_ref("000001/000000", 7, "label"), "book", "atlas")], "ben"), Saved
        )
    assert check_journal(database).damage == ()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked on POSIX alone")
def test_a_killed_change_of_format_leaves_the_old_journal(database: str) -> None:
    with open_journal(database) as journal, journal.store.writing() as run:
        for statement in OLDER:
            run(statement)
    events, left = check_journal(database).events, list[bool]()
    for step in killed_openings(database):
        found = check_journal(database)
        assert (found.damage, found.events) == ((), events), f"killed at step {step}"
        left.append(found.chained)
    assert left == sorted(left)
    assert not left[0]
    says_what_it_said(database)
