"""The journal in PostgreSQL, on a cluster of the tests' own."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from pathlib import Path

import pytest
from postgres_cluster import missing, running_cluster
from sqlalchemy.exc import DBAPIError

from pipeline.errors import InputError
from pipeline.journal import connection, postgres
from pipeline.journal.bench import prove, read_report, write_many
from pipeline.journal.cells import object_cell, relation_cell
from pipeline.journal.connection import writing
from pipeline.journal.events import Conflict, Edit, NotSaved, Saved
from pipeline.journal.journal import open_journal
from pipeline.journal.undo import redo, undo

LEFT = relation_cell("scene/0", 1, 2, "left")


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
    edit = Edit(object_cell("椅/0", 1, "label"), "mug", 'cup "🪴"\u2028', 0, "why", {"1": [0.1, 1 / 3, 4, 5]})
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
    with pytest.raises(DBAPIError, match="can only grow"), writing(ann.engine) as connection:
        connection.exec_driver_sql("DELETE FROM events")
    assert len(open_journal(database, project="story").events()) == 6
    assert open_journal(database, project="another").events() == ()
    ann.close()
    bob.close()


def test_writers_at_once_lose_nothing_and_overwrite_nothing(database: str, tmp_path: Path) -> None:
    proof = prove(database, tmp_path, writers=3, edits=40)
    assert proof.holds, proof
    assert proof.saved == 120
    assert proof.conflicts > 0
    with open_journal(database) as journal:
        ids = [e.id for e in journal.events()]
    assert ids == sorted(ids)


def test_a_writer_whose_turn_does_not_come_asks_again(database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(postgres, "TURN_S", 0.02)
    with open_journal(database, project="turns") as ann, open_journal(database, project="turns") as bob:
        with ThreadPoolExecutor() as pool:
            with writing(ann.engine):
                done = pool.submit(bob.append, [Edit(LEFT, -1, 1)], "bob")
                with pytest.raises(NotYet):
                    done.result(0.1)
            assert isinstance(done.result(60), Saved)
        monkeypatch.setattr(connection, "BUSY_S", 0.0)
        with writing(ann.engine), pytest.raises(NotSaved, match="locked by another program"):
            bob.append([Edit(LEFT, 1, 0, 1)], "bob")


def test_a_writer_that_says_nothing_loses_its_turn(database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(postgres, "IDLE_S", 0.05)
    with open_journal(database, project="idle") as ann, open_journal(database, project="idle") as bob:

        def lost() -> None:
            with writing(ann.engine):
                assert isinstance(bob.append([Edit(LEFT, -1, 1)], "bob"), Saved)

        with pytest.raises(DBAPIError):
            lost()
        assert isinstance(ann.append([Edit(LEFT, 1, 0, 1)], "ann"), Saved)


def test_what_was_acknowledged_survives_a_killed_writer(database: str, tmp_path: Path) -> None:
    report = tmp_path / "told.jsonl"
    with open_journal(database) as journal:
        there = {e.ulid for e in journal.events()}
    writer = multiprocessing.get_context("spawn").Process(target=write_many, args=(database, "9", 100_000, report))
    writer.start()
    until = time.monotonic() + 120
    while sum("saved" in entry for entry in read_report(report)) < 30 and time.monotonic() < until:
        time.sleep(0.02)
    os.kill(writer.pid or 0, signal.SIGKILL)
    writer.join()
    told = [entry["saved"] for entry in read_report(report) if "saved" in entry]
    with open_journal(database) as journal:
        found = [e.ulid for e in journal.events() if e.ulid not in there]
        assert isinstance(journal.append([Edit(object_cell("f", 5, "label"), "mug", "cup")], "ann"), Saved)
    assert len(told) >= 30
    assert found[: len(told)] == told
    assert len(found) <= len(told) + 1


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
