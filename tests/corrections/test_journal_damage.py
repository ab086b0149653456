"""Damage to a journal's files: it is refused in one line, or nothing is missing; never an error of the program."""

from __future__ import annotations

import random
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from journal_damage import HARM, PAGE, Parts, flipped, parts_of, placed
from journal_world import work_of
from waiting import LONG_S

from pipeline.corrections import JOURNAL_FILE, DamagedJournal, Edit, Event, Saved, object_ref, open_journal
from pipeline.corrections.journal import sqlite_file
from pipeline.corrections.journal.examining import examine
from pipeline.corrections.journal.sqlite_file import lost_in_log


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Parts], tuple[Event, ...]]:
    """A journal as it is when it was closed, and while it is open; and its events."""
    path = tmp_path_factory.mktemp("files") / JOURNAL_FILE
    with open_journal(path, labels="0123456789abcdef") as journal:
        work_of(journal, 120)
        copies = {"open": parts_of(path)}
        events = journal.events()
    return {**copies, "closed": parts_of(path)}, events


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite_file, "_PAUSE_S", 0.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("harm", HARM)
def test_damage_is_refused_or_does_no_harm(
    files: tuple[dict[str, Parts], tuple[Event, ...]], tmp_path: Path, harm: str, seed: int
) -> None:
    copies, events = files
    state, damage = HARM[harm]
    parts = {end: bytearray(data) for end, data in copies[state].items()}
    damage(parts, random.Random(f"{harm} {seed}"))
    path = placed(parts, tmp_path)
    refused = examine(path)
    if not refused.damage:
        with open_journal(path) as journal:
            assert journal.events() == events
            assert isinstance(journal.append([Edit(object_ref("new", 1, "label"), "mug", "cup")], "ann"), Saved)
        with open_journal(path) as journal:
            assert journal.events()[:-1] == events
        return
    with pytest.raises(DamagedJournal, match="--recover" if refused.standing else "backup") as error:
        open_journal(path)
    assert len(str(error.value).splitlines()) == 1
    assert {row["ulid"] for row in refused.intact} <= {e.ulid for e in events}
    after = parts_of(path)
    assert all(after[end] == data for end, data in parts.items() if end != "-shm")


@pytest.mark.parametrize("index", [True, False])
def test_a_log_has_lost_something_where_sqlite_reads_less_of_it(
    files: tuple[dict[str, Parts], tuple[Event, ...]], tmp_path: Path, index: bool
) -> None:
    copies, events = files
    rng = random.Random(0)
    kept = {end: data for end, data in copies["open"].items() if index or end != "-shm"}
    assert lost_in_log(placed(kept, tmp_path)) is None
    seen = set()
    for _ in range(12):
        parts = {end: bytearray(data) for end, data in kept.items()}
        flipped(parts["-wal"], rng)
        path = placed(parts, tmp_path)
        said = lost_in_log(path)
        with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as raw:
            tables = raw.execute("SELECT count(*) FROM sqlite_master WHERE name = 'events'").fetchone()[0]
            found = raw.execute("SELECT count(*) FROM events").fetchone()[0] if tables else 0
        assert (said is None) == (found == len(events)), said
        seen.add(said is None)
        Path(f"{path}-shm").unlink(missing_ok=True)
    assert False in seen


def test_a_writer_that_was_killed_leaves_no_damage(
    files: tuple[dict[str, Parts], tuple[Event, ...]], tmp_path: Path
) -> None:
    copies, events = files
    parts = {end: bytearray(data) for end, data in copies["open"].items()}
    # Of an action that was never acknowledged only a part is written, after what the log had.
    frame = PAGE + 24
    torn = parts["-wal"][32 : 32 + frame + 300]
    parts["-wal"] += torn[:8] + parts["-wal"][16:24] + torn[16:]
    path = placed(parts, tmp_path)
    assert examine(path).damage == ()
    with open_journal(path) as journal:
        assert journal.events() == events


def test_what_can_be_read_of_a_file_whose_first_bytes_are_gone(
    files: tuple[dict[str, Parts], tuple[Event, ...]], tmp_path: Path
) -> None:
    copies, events = files
    parts = {"": bytearray(copies["closed"][""])}
    parts[""][:64] = bytes(64)
    found = examine(placed(parts, tmp_path))
    assert found.damage
    assert [row["ulid"] for row in found.intact] == [e.ulid for e in events]


def test_who_looks_at_a_journal_leaves_the_writers_turn_alone(tmp_path: Path) -> None:
    """A process that closes a file lets go of its own locks on it: then two would write at once."""
    path = tmp_path / JOURNAL_FILE
    program = f"import sqlite3; sqlite3.connect({str(path)!r}, timeout=0).execute('BEGIN IMMEDIATE')"

    def another() -> str:
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=LONG_S, check=False
        )
        return done.stderr

    with open_journal(path) as journal:
        with journal.store.writing():
            assert examine(path).damage == ()
            open_journal(path).close()
            assert "database is locked" in another()
        assert another() == ""
