"""Reading old files changes nothing in them, and a change of format that is interrupted leaves the old file."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from frozen_journals import journal_record, killed_openings
from slow_cases import mostly_slow

from pipeline.corrections import (
    JOURNAL_FILE,
    JournalLocation,
    check_journal,
    effective_tables,
    open_journal,
)
from pipeline.datasets import open_dataset
from pipeline.datasets.settings import read_settings
from pipeline.diagnosis import open_case
from pipeline.evaluation import open_database, open_run
from pipeline.evaluation.browsing import RunRows
from pipeline.labels import TABLES, open_labels
from pipeline.system import InputError

FIXTURES = Path(__file__).parent / "fixtures"
STATES = ("2026-11-21", "2026-11-22", "2026-11-26")
JOURNALS = ("journal_before_chain.sqlite", *(f"{state}/labels/{JOURNAL_FILE}" for state in STATES))
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked on POSIX alone")


def snapshot(folder: Path) -> dict[str, tuple[bytes, int]]:
    """By file its bytes, and when it was changed."""
    files = (p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): (p.read_bytes(), p.stat().st_mtime_ns) for p in files}


@pytest.fixture(params=STATES)
def state(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return Path(shutil.copytree(FIXTURES / request.param, tmp_path / request.param))


def test_reading_writes_nothing(state: Path) -> None:
    before = snapshot(state)
    for folder in sorted(p for p in state.iterdir() if (p / "frames.parquet").exists()):
        labels = open_labels(folder)
        assert all(getattr(labels, name).num_rows for name in TABLES)
        if (folder / JOURNAL_FILE).exists() and check_journal(folder / JOURNAL_FILE).chained:
            location = JournalLocation(labels)
            journal = location.to_read()
            assert journal is not None
            assert journal.count() == len(journal.events()) > 0
            effective_tables(labels, journal)
            location.close()
    for folder in sorted(p.parent for p in state.glob("*/run.json")):
        run = open_run(folder, labels=str(state / "labels"))
        assert run.records.num_rows > 0
        assert len(run.failures()) > 0
        RunRows(run.records, folder)
        with open_database(folder) as database:
            assert database.select("select count(*) from records").rows
    for folder in sorted(p.parent for p in state.glob("*/spatialviz-case.json")):
        assert open_case(folder).answer().text
    for folder in sorted(p.parent for p in state.glob("*/spatialviz.toml")):
        read_settings(folder)
    if (state / "recording").exists():
        dataset = open_dataset(state / "recording")
        assert dataset.load(dataset.frame_ids[0]).width
    assert snapshot(state) == before


def rows_of(path: Path) -> list[dict[str, object]]:
    """The rows of a sound journal without what only the chain adds."""
    found = check_journal(path)
    assert found.damage == ()
    return [{name: value for name, value in row.items() if name != "hash"} for row in found.intact]


@needs_fork
@pytest.mark.parametrize("name", mostly_slow(JOURNALS))
def test_a_killed_change_of_format_leaves_the_old_journal(name: str, tmp_path: Path) -> None:
    """At whichever step: all events are there, in the old format or in the new one, and the next opening goes on."""
    path = Path(shutil.copyfile(FIXTURES / name, tmp_path / JOURNAL_FILE))
    rows, chained, left = rows_of(path), check_journal(path).chained, list[bool]()
    for step in killed_openings(path):
        assert rows_of(path) == rows, f"killed at step {step}"
        left.append(check_journal(path).chained)
    # All steps before the last leave the old one: the change is one transaction.
    assert left[0] == chained
    assert left == sorted(left)
    with open_journal(path) as journal:
        record = journal_record(journal.events())
    assert rows_of(path) == rows
    with open_journal(path) as again:
        assert journal_record(again.events()) == record
    for kept in tmp_path.glob(f"{JOURNAL_FILE}.*"):
        if kept.suffix != ".part":
            assert rows_of(kept) == rows, "what is kept beside is the original"


def test_a_change_of_format_that_fails_says_so_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk, as the copy of the original gets its name."""
    path = Path(shutil.copyfile(FIXTURES / JOURNALS[0], tmp_path / JOURNAL_FILE))
    kept = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match="cannot be opened") as error:
        open_journal(path)
    assert len(str(error.value).splitlines()) == 1
    monkeypatch.undo()
    assert path.read_bytes() == kept
    assert not check_journal(path).chained
    assert sorted(p.name for p in tmp_path.iterdir()) == [JOURNAL_FILE]
