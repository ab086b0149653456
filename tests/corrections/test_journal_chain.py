"""The chain of events: any change is noticed, and what is intact is said; a journal without one is taken over."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
from journal_world import work_of

from pipeline.corrections import (
    JOURNAL_FILE,
    DamagedJournal,
    Edit,
    NotSaved,
    Saved,
    back_up,
    check_journal,
    object_ref,
    open_journal,
    recover,
    undo,
)
from pipeline.corrections.journal import sqlite_file
from pipeline.corrections.journal.chain import CONTENT, FIRST, Head, chained, judged, link
from pipeline.corrections.journal.examining import examine
from pipeline.system import InputError

BEFORE = Path(__file__).parents[1] / "fixtures" / "journal_before_chain.sqlite"
"""Made by the release before: three people, two projects, an undo and a redo, a long reason, names of other scripts."""
TIME = datetime(2026, 1, 1, tzinfo=timezone.utc)
EDIT = Edit(object_ref("new", 1, "label"), "mug", "cup")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A journal of 60 events."""
    path = tmp_path_factory.mktemp("sound") / JOURNAL_FILE
    with open_journal(path, labels="0123456789abcdef") as journal:
        work_of(journal, 60)
    return path


def tampered(path: Path, *statements: str) -> None:
    """Change what the database refuses to change, and leave its tables as they were made."""
    with closing(sqlite3.connect(path, isolation_level=None)) as raw:
        kept = raw.execute("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for name, _ in kept:
            raw.execute(f"DROP TRIGGER {name}")
        for statement in statements:
            raw.execute(statement)
        for _, made in kept:
            raw.execute(made)


def raw_rows(path: Path) -> list[tuple[Any, ...]]:
    names = ", ".join(f'"{name}"' for name in CONTENT)
    with closing(sqlite3.connect(f"{path.as_uri()}?immutable=1", uri=True)) as raw:
        return raw.execute(f"SELECT {names} FROM events ORDER BY id").fetchall()


def test_each_event_carries_the_hash_of_the_one_before_it(sound: Path) -> None:
    found = examine(sound)
    assert found.damage == ()
    assert found.events == len(found.intact) >= 60
    previous = FIRST
    for row in found.intact:
        assert row["hash"] == link(previous, row)
        previous = row["hash"]


@pytest.mark.parametrize("column", [*CONTENT[1:], "hash"])
def test_a_change_of_any_column_is_noticed(sound: Path, tmp_path: Path, column: str) -> None:
    path = Path(shutil.copy(sound, tmp_path / JOURNAL_FILE))
    other = {"time": "'2026-01-01 00:00:00.000000'", "base": "77", "version": "78"}.get(column, "'\"x\"'")
    tampered(path, f'UPDATE events SET "{column}" = {other} WHERE id = 20')
    with pytest.raises(DamagedJournal, match=r"event 20 is not as it was saved; .*--recover") as error:
        open_journal(path)
    found = error.value.examined
    assert len(str(error.value).splitlines()) == 1
    last = found.events or 0
    # A hash alone is damaged where the next one agrees with what the event holds.
    assert found.ranges == (((1, last),) if column == "hash" else ((1, 19), (21, last)))


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("DELETE FROM events WHERE id > 50", "events are gone"),
        ("DELETE FROM events", "events are gone"),
        ("DELETE FROM events WHERE id = 20", "event 21 is not as it was saved"),
        ("DELETE FROM journal_head", "0 rows stand where one was"),
        ("UPDATE journal_head SET hash = lower(hex(randomblob(32)))", "hash is not that of the last event"),
        ("UPDATE journal_head SET events = events - 1", "names another last event"),
        ("UPDATE journal_head SET version = 7", "its version is 7 in one place and 2 in another"),
        ("PRAGMA user_version = 3", "its version is 2 in one place and 3 in another"),
        ("CREATE INDEX more ON events (after)", "its tables are not those that were made"),
        ("DROP TABLE events", "no such table"),
    ],
)
def test_what_was_cut_off_or_added_is_noticed(sound: Path, tmp_path: Path, statement: str, said: str) -> None:
    path = Path(shutil.copy(sound, tmp_path / JOURNAL_FILE))
    if statement.startswith("DROP"):
        with closing(sqlite3.connect(path)) as raw:
            raw.execute(statement)
    else:
        tampered(path, statement)
    with pytest.raises(DamagedJournal, match=said):
        open_journal(path)


def test_the_verdict_of_a_chain_is_of_each_event() -> None:
    plain = [{**dict.fromkeys(CONTENT), "id": k, "time": TIME} for k in range(1, 7)]
    rows = chained(FIRST, plain)
    head = Head(6, 6, rows[-1]["hash"])
    numbered = [(row["id"], row) for row in rows]
    assert judged(numbered, head).damage == ()
    assert judged((), Head(0, 0, FIRST)).damage == ()
    unread = judged([*numbered[:2], (3, None), *numbered[3:]], head)
    # Of the event after one that cannot be read nobody can say what it was chained to.
    assert [row["id"] for row in unread.intact] == [1, 2, 5, 6]
    last = judged([*numbered[:5], (6, {**rows[5], "hash": "0"})], head)
    assert len(last.intact) == 6
    assert len(last.damage) == 1
    assert judged(numbered, None).damage
    assert [row["id"] for row in judged(numbered[::-1], head).intact] == []


def test_an_edit_that_cannot_be_read_back_is_not_saved(tmp_path: Path) -> None:
    journal = open_journal(tmp_path / JOURNAL_FILE)
    with closing(sqlite3.connect(journal.location)) as raw:
        raw.execute("DROP TRIGGER events_no_update")
        raw.execute(
            "CREATE TRIGGER broken AFTER INSERT ON events BEGIN UPDATE events SET reason = 'x' WHERE id = NEW.id; END"
        )
    with pytest.raises(NotSaved, match="cannot be read back") as error:
        journal.append([EDIT], "ann")
    assert error.value.edits == (EDIT,)
    journal.close()
    with pytest.raises(DamagedJournal):
        open_journal(journal.location)


def test_nothing_is_chained_to_an_event_that_is_not_the_last(tmp_path: Path) -> None:
    journal = open_journal(tmp_path / JOURNAL_FILE)
    journal.append([EDIT], "ann")
    tampered(tmp_path / JOURNAL_FILE, "DELETE FROM events")
    with pytest.raises(NotSaved, match="its last event is not the one that was saved last"):
        journal.append([EDIT], "ann")


def test_a_damaged_file_that_takes_the_journals_place_is_not_written_to(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / JOURNAL_FILE
    journal = open_journal(path)
    journal.append([EDIT], "ann")
    other = Path(shutil.copy(sound, tmp_path / "other"))
    tampered(other, "UPDATE events SET author = 'eve' WHERE id = 3")
    for end in ("-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)
    other.replace(path)
    kept = path.read_bytes()
    with pytest.raises(InputError, match="event 3 is not as it was saved"):
        journal.events()
    with pytest.raises(NotSaved, match="event 3 is not as it was saved") as error:
        journal.append([EDIT], "ann")
    assert error.value.edits == (EDIT,)
    assert path.read_bytes() == kept


# ---- the release before -------------------------------------------------------------


def test_a_journal_of_the_release_before_is_chained_and_kept(tmp_path: Path) -> None:
    path = Path(shutil.copy(BEFORE, tmp_path / JOURNAL_FILE))
    assert not check_journal(path).chained
    rows = raw_rows(BEFORE)
    for chained_now in (True, False):
        with open_journal(path) as journal, open_journal(path, project="office") as office:
            events = journal.events()
            assert ["it stands in" in w for w in journal.warnings] == [True] * chained_now
            assert [e.action for e in office.events()] == ["edit", "undo", "redo"]
    assert len(events) + 3 == len(rows) == 10
    assert [(e.author, e.after) for e in events if e.ref.kind == "frame"] == [("椅子", "dark")]
    assert raw_rows(path) == rows
    found = check_journal(path)
    assert (found.chained, found.damage, found.events) == (True, (), 10)
    # The original stands beside, once, with all that was in it.
    assert sorted(p.name for p in tmp_path.iterdir()) == [JOURNAL_FILE, f"{JOURNAL_FILE}.before-chain"]
    assert raw_rows(tmp_path / f"{JOURNAL_FILE}.before-chain") == rows
    with open_journal(path) as journal:
        assert isinstance(undo(journal, "ben"), Saved)
        assert isinstance(journal.append([EDIT], "ben"), Saved)
    assert check_journal(path).damage == ()


def test_where_nothing_can_be_written_a_journal_is_checked_and_read(
    tmp_path: Path, sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlite_file, "can_be_written", lambda _: False)
    for name, made, count in (("old", BEFORE, 7), ("new", sound, examine(sound).events)):
        folder = tmp_path / name
        folder.mkdir()
        path = Path(shutil.copy(made, folder / JOURNAL_FILE))
        kept = path.read_bytes()
        with open_journal(path) as journal:
            assert journal.count() == len(journal.events()) == count
            assert [w for w in journal.warnings if "not chained" in w] == list(journal.warnings)
            assert len(journal.warnings) == (name == "old")
            with pytest.raises(NotSaved, match="readonly"):
                journal.append([EDIT], "ann")
        assert path.read_bytes() == kept
        assert [p.name for p in folder.iterdir()] == [JOURNAL_FILE]
    with pytest.raises(InputError, match="no journal"):
        open_journal(tmp_path / "none.sqlite", must_exist=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("DELETE FROM events WHERE id = 10", "9 events stand where 10 were saved"),
        ("DELETE FROM events WHERE id = 4", "event 5: its version does not follow; .*9 events stand where 10"),
        ("UPDATE events SET version = 9 WHERE id = 1", "event 1: its version does not follow"),
        ("UPDATE events SET after = '\"' WHERE id = 3", "event 3: it cannot be read"),
        ("UPDATE events SET after = 5 WHERE id = 1", "event 1: no such state"),
        ("UPDATE events SET reason = CAST(x'ff41' AS TEXT) WHERE id = 1", "event 1: "),
        ("UPDATE events SET frame = '' WHERE id = 1", "event 1: the frame's id"),
    ],
)
def test_what_is_impossible_in_a_journal_without_a_chain_is_noticed(tmp_path: Path, change: str, said: str) -> None:
    path = Path(shutil.copy(BEFORE, tmp_path / JOURNAL_FILE))
    tampered(path, change)
    kept = path.read_bytes()
    with pytest.raises(DamagedJournal, match=said):
        open_journal(path)
    assert path.read_bytes() == kept
    assert not (tmp_path / f"{JOURNAL_FILE}.before-chain").exists()


# ---- copies, and going on -----------------------------------------------------------


def test_a_copy_has_what_is_saved_while_others_save(tmp_path: Path) -> None:
    path, copy = tmp_path / JOURNAL_FILE, tmp_path / "copy.sqlite"
    with open_journal(path) as journal:
        journal.append([EDIT], "ann")
        made = back_up(path, copy)
        journal.append([Edit(EDIT.ref, "cup", "jar", 1)], "ann")
        assert [e.after for e in journal.events()] == ["cup", "jar"]
    assert made.events == 1
    with open_journal(copy) as journal:
        assert [e.after for e in journal.events()] == ["cup"]
        assert isinstance(journal.append([Edit(EDIT.ref, "cup", "bowl", 1)], "ben"), Saved)
    with pytest.raises(InputError, match="there is a file of this name"):
        back_up(path, copy)
    tampered(path, "UPDATE events SET author = 'eve' WHERE id = 2")
    with pytest.raises(DamagedJournal):
        back_up(path, tmp_path / "another")
    assert not (tmp_path / "another").exists()


def test_what_is_intact_goes_on_in_a_new_journal(tmp_path: Path) -> None:
    path, new = tmp_path / JOURNAL_FILE, tmp_path / "new.sqlite"
    with open_journal(path) as journal:
        for number in range(6):
            journal.append([Edit(object_ref("f", number, "label"), "mug", "cup")], "ann")
        undo(journal, "ann")
        undo(journal, "ann")
    tampered(path, "UPDATE events SET reason = 'x' WHERE id = 5")
    kept = path.read_bytes()
    damaged, made = recover(path, new)
    assert path.read_bytes() == kept
    assert (damaged.ranges, damaged.events) == (((1, 4), (6, 8)), 8)
    assert made.damage == ()
    with open_journal(new) as journal:
        # The undo of the fifth is left out with it.
        assert [(e.id, e.action) for e in journal.events()] == [
            (1, "edit"),
            (2, "edit"),
            (3, "edit"),
            (4, "edit"),
            (6, "edit"),
            (7, "undo"),
        ]
        assert isinstance(journal.append([EDIT], "ben"), Saved)
        assert isinstance(undo(journal, "ann"), Saved)
    assert check_journal(new).damage == ()
    assert json.dumps(check_journal(new).ranges) == "[[1, 4], [6, 9]]"


def test_a_file_without_an_event_that_can_be_read_is_not_recovered(tmp_path: Path) -> None:
    path = tmp_path / JOURNAL_FILE
    path.write_bytes(b"")
    for open_it in (lambda: open_journal(path, must_exist=True), lambda: recover(path, tmp_path / "new")):
        refused(open_it)
    path.write_bytes(bytes(8192))
    refused(lambda: open_journal(path))
    refused(lambda: recover(path, tmp_path / "new"))
    refused(lambda: check_journal(tmp_path / "none"))
    assert [p.name for p in tmp_path.iterdir()] == [JOURNAL_FILE]


def refused(open_it: Callable[[], object]) -> None:
    with pytest.raises(InputError) as error:
        open_it()
    assert len(str(error.value).splitlines()) == 1


def test_an_empty_file_is_neither_checked_as_sound_nor_begun_without_a_word(tmp_path: Path) -> None:
    path = tmp_path / JOURNAL_FILE
    path.write_bytes(b"")
    refused(lambda: check_journal(path))
    with open_journal(path) as journal:
        assert "was an empty file" in " ".join(journal.warnings)
    with open_journal(path) as journal:
        assert journal.warnings == ()


def test_help_never_names_a_recovery_that_is_refused(tmp_path: Path) -> None:
    path = tmp_path / JOURNAL_FILE
    with open_journal(path) as journal:
        journal.append([EDIT], "ann")
        undo(journal, "ann")
    tampered(path, "UPDATE events SET reason = 'x' WHERE id = 1")
    found = check_journal(path)
    assert (found.ranges, found.standing) == (((2, 2),), ())
    assert "--recover" not in str(found.help)
    with pytest.raises(InputError, match="take back others") as error:
        recover(path, tmp_path / "new.sqlite")
    assert "can be read" not in str(error.value)
