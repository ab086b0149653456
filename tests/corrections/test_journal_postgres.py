"""The journal in PostgreSQL, on a cluster of the tests' own."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from pathlib import Path

import pytest
from benchmarks.journal_writers import prove, read_report, ready_processes, write_many
from journal_world import work_of
from postgres_cluster import missing, running_cluster
from waiting import wait_until

from pipeline.corrections import (
    Conflict,
    DamagedJournal,
    Edit,
    NotSaved,
    Saved,
    back_up,
    check_journal,
    object_ref,
    open_journal,
    redo,
    relation_ref,
    undo,
)
from pipeline.corrections.journal import connection
from pipeline.corrections.journal.connection import ServerError
from pipeline.system import InputError

LEFT = relation_ref("scene/0", 1, 2, "left")


@pytest.fixture(scope="module")
def database() -> Iterator[str]:
    reason = missing()
    if reason is not None:
        if os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    with running_cluster() as url:
        yield url


def test_events_conflicts_undo_and_redo(database: str) -> None:
    ann, bob = (open_journal(database, project="story", labels="v") for _ in range(2))
    edit = Edit(object_ref("椅/0", 1, "label"), "mug", 'cup "🪴"\u2028', 0, "why", {"1": [0.1, 1 / 3, 4, 5]})
    done = ann.append([edit, Edit(LEFT, -1, 1)], "ann")
    assert isinstance(done, Saved)
    assert bob.events() == done.events
    assert done.events[0].after == edit.after
    assert done.events[0].anchor == edit.anchor
    late = bob.append([Edit(LEFT, -1, 0)], "bob")
    assert isinstance(late, Conflict)
    assert isinstance(undo(ann, "ann"), Saved)
    assert isinstance(redo(ann, "ann"), Saved)
    assert undo(bob, "bob") is None
    assert [e.action for e in bob.events()] == ["edit", "edit", "undo", "undo", "redo", "redo"]
    with pytest.raises(ServerError, match="can only grow"), ann.store.writing() as run:
        run("DELETE FROM events")
    assert len(open_journal(database, project="story").events()) == 6
    assert open_journal(database, project="another").events() == ()
    ann.close()
    bob.close()


@pytest.mark.slow
def test_writers_at_once_lose_nothing_and_overwrite_nothing(database: str, tmp_path: Path) -> None:
    proof = prove(database, tmp_path, writers=3, edits=40)
    assert proof.holds, proof
    assert proof.saved == 120
    assert proof.conflicts > 0
    with open_journal(database) as journal:
        ids = [e.id for e in journal.events()]
    assert ids == sorted(ids)
    found = check_journal(database)
    assert found.damage == ()
    assert found.events == len(found.intact) >= 120


@pytest.mark.slow
@pytest.mark.usefixtures("database")
def test_a_change_in_the_server_is_noticed(tmp_path: Path) -> None:
    with running_cluster() as url:
        with open_journal(url, project="kitchen") as journal:
            for k in range(4):
                journal.append([Edit(object_ref("f", k, "label"), "mug", "cup")], "ann")
            with journal.store.writing() as run:
                run("ALTER TABLE events DISABLE TRIGGER ALL")
                run("UPDATE events SET author = 'eve' WHERE id = 2")
        with pytest.raises(DamagedJournal, match="event 2 is not as it was saved; events 1, 3 to 4 of 4 are intact"):
            open_journal(url)
        assert check_journal(url).ranges == ((1, 1), (3, 4))
        with pytest.raises(InputError, match="pg_dump"):
            back_up(url, tmp_path / "copy")


@pytest.mark.slow
@pytest.mark.usefixtures("database")
def test_a_journal_of_the_release_before_is_chained_and_kept() -> None:
    with running_cluster() as url:
        with open_journal(url, labels="0123456789abcdef") as journal:
            work_of(journal, 30)
            saved = journal.events()
            # As it was before: no hashes, no head, and a table of Alembic's.
            with journal.store.writing() as run:
                for statement in (
                    "CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL)",
                    "INSERT INTO alembic_version VALUES ('0001')",
                    "ALTER TABLE events DROP COLUMN hash",
                    "DROP TABLE journal_head",
                ):
                    run(statement)
        assert not check_journal(url).chained
        with open_journal(url) as journal:
            assert journal.events() == saved
            assert isinstance(journal.append([Edit(LEFT, -1, 1)], "ann"), Saved)
            with journal.store.reading() as run:
                assert run("SELECT count(*) FROM events_before_chain") == [(len(saved),)]
        assert check_journal(url).damage == ()


@pytest.mark.slow
def test_a_writer_waits_for_its_turn_and_not_for_ever(database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_journal(database, project="turns") as ann, open_journal(database, project="turns") as bob:
        with ThreadPoolExecutor() as pool:
            with ann.store.writing():
                done = pool.submit(bob.append, [Edit(LEFT, -1, 1)], "bob")
                with pytest.raises(NotYet):
                    done.result(0.1)
            assert isinstance(done.result(60), Saved)
        with ann.store.writing():
            monkeypatch.setattr(connection, "BUSY_S", 0.02)
            with pytest.raises(NotSaved, match="another program holds the journal"):
                bob.append([Edit(LEFT, 1, 0, 1)], "bob")


@pytest.mark.slow
def test_a_writer_that_says_nothing_loses_its_turn(database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = connection.IDLE_S
    with open_journal(database, project="idle") as ann, open_journal(database, project="idle") as bob:

        def lost() -> None:
            monkeypatch.setattr(connection, "IDLE_S", 0.3)
            with ann.store.writing():
                monkeypatch.setattr(connection, "IDLE_S", usual)
                assert isinstance(bob.append([Edit(LEFT, -1, 1)], "bob"), Saved)

        with pytest.raises(ServerError):
            lost()
        assert isinstance(ann.append([Edit(LEFT, 1, 0, 1)], "ann"), Saved)


@pytest.mark.slow
def test_what_was_acknowledged_survives_a_killed_writer(database: str, tmp_path: Path) -> None:
    report = tmp_path / "told.jsonl"
    with open_journal(database) as journal:
        there = {e.ulid for e in journal.events()}
    writer = ready_processes().Process(target=write_many, args=(database, "9", 100_000, report))
    writer.start()
    wait_until(lambda: sum("saved" in entry for entry in read_report(report)) >= 30)
    os.kill(writer.pid or 0, signal.SIGKILL)
    writer.join()
    told = [entry["saved"] for entry in read_report(report) if "saved" in entry]
    with open_journal(database) as journal:
        found = [e.ulid for e in journal.events() if e.ulid not in there]
        assert isinstance(journal.append([Edit(object_ref("f", 5, "label"), "mug", "cup")], "ann"), Saved)
    assert len(told) >= 30
    assert found[: len(told)] == told
    assert len(found) <= len(told) + 1


@pytest.mark.slow
@pytest.mark.usefixtures("database")
def test_a_database_that_goes_away_hands_the_edit_back_and_keeps_its_password_to_itself() -> None:
    with running_cluster() as url:
        journal = open_journal(url.replace("postgres@", "postgres:very-secret@"))
        assert isinstance(journal.append([Edit(LEFT, -1, 1)], "ann"), Saved)
    with pytest.raises(NotSaved) as error:
        journal.append([Edit(LEFT, 1, 0, 1)], "ann")
    assert [e.after for e in error.value.edits] == [0]
    with pytest.raises(InputError) as unread:
        journal.events()
    for said in (str(error.value), str(unread.value)):
        assert "very-secret" not in said
        assert len(said.splitlines()) == 1
