"""The journal: what is saved stays, nobody overwrites what they have not seen, everyone takes back their own."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from benchmarks.journal_writers import prove, read_report, ready_processes, write_many
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_checks import NAME, journal  # noqa: F401
from waiting import wait_until

from pipeline.corrections import (
    JOURNAL_FILE,
    Conflict,
    Edit,
    FieldRef,
    Journal,
    Saved,
    open_journal,
    redo,
    relation_ref,
    undo,
)
from pipeline.corrections.journal.events import new_ulid
from pipeline.corrections.journal.replay import history
from pipeline.system import InputError

LEFT = relation_ref("scene/0", 1, 2, "left")
RIGHT = relation_ref("scene/0", 2, 1, "right")


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty journal to be copied: migrations take a while."""
    path = tmp_path_factory.mktemp("empty") / JOURNAL_FILE
    open_journal(path).close()
    return path


def test_an_event_comes_back_as_it_was_saved(journal: Journal) -> None:
    edit = Edit(NAME, "mug", "cup 椅\u2028🪴", 0, "it has no handle", {"1": [0.1, 1 / 3, 5, 6]})
    done = journal.append([edit, Edit(LEFT, None, 1)], "ann")
    assert isinstance(done, Saved)
    again = open_journal(journal.location).events()
    assert again == done.events
    first = again[0]
    assert (first.ref, first.before, first.after, first.reason) == (NAME, "mug", "cup 椅\u2028🪴", "it has no handle")
    assert first.anchor == {"1": [0.1, 1 / 3, 5, 6]}
    assert (first.base, first.version, first.labels, first.action) == (0, 1, "made-once", "edit")
    assert first.time.utcoffset() is not None
    assert abs(first.time.timestamp() - time.time()) < 60
    assert again[0].group == again[1].group
    assert [e.id for e in again] == [1, 2]
    assert journal.events(kind="relation") == again[1:]
    assert journal.events(after=1) == again[1:]
    assert journal.events(last=1) == again[1:]


def test_who_is_late_is_told_who_was_there_and_nothing_is_written(journal: Journal) -> None:
    journal.append([Edit(LEFT, -1, 1)], "ann")
    late = journal.append([Edit(NAME, "mug", "cup"), Edit(LEFT, -1, 0)], "bob")
    assert isinstance(late, Conflict)
    (rival,) = late.rivals
    assert rival.event is not None
    assert (rival.event.author, rival.event.after, rival.edit.after) == ("ann", 1, 0)
    assert "ann made it T" in str(rival)
    assert len(journal.events()) == 1
    assert isinstance(journal.append([Edit(LEFT, 1, 0, rival.event.version)], "bob"), Saved)
    ahead = journal.append([Edit(LEFT, 1, 0, 7)], "ann")
    assert isinstance(ahead, Conflict)


def test_saving_again_after_an_error_does_not_save_twice(journal: Journal) -> None:
    group = new_ulid()
    first = journal.append([Edit(LEFT, -1, 1)], "ann", group=group)
    assert journal.append([Edit(LEFT, -1, 1)], "ann", group=group) == first
    assert len(journal.events()) == 1


def test_projects_share_a_database_and_see_nothing_of_each_other(tmp_path: Path) -> None:
    one, other = (open_journal(tmp_path / "j.sqlite", project=p) for p in ("kitchen", "office"))
    one.append([Edit(LEFT, -1, 1)], "ann")
    assert isinstance(other.append([Edit(LEFT, -1, 0)], "ann"), Saved)
    assert [e.after for e in one.events()] == [1]
    assert undo(other, "ann") is not None
    assert [e.after for e in one.events()] == [1]


@pytest.mark.parametrize("statement", ["UPDATE events SET author = 'eve'", "DELETE FROM events"])
def test_the_database_itself_refuses_to_change_what_was_saved(journal: Journal, statement: str) -> None:
    journal.append([Edit(LEFT, -1, 1)], "ann")
    with sqlite3.connect(journal.location) as raw, pytest.raises(sqlite3.DatabaseError, match="can only grow"):
        raw.execute(statement)
    assert [e.author for e in journal.events()] == ["ann"]


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        (("object", "f", "1", "label"), "  "),
        (("object", "f", "1", "label"), "a\x00b"),
        (("object", "f", "1", "label"), None),
        (("object", "f", "1", "label"), "\ud800"),
        (("object", "f", "1", "bbox"), [5, 5, 4, 9]),
        (("object", "f", "1", "bbox"), [0, 0, float("nan"), 9]),
        (("object", "f", "1", "mask"), "not a mask \n"),
        (("object", "f", "1", "box"), {"center": [0, 0, 1], "R": [1, 0, 0, 0, 1, 0, 0, 0, 2], "size": [1, 1, 1]}),
        (("object", "f", "1", "box"), {"center": [0, 0, 1], "size": [1, 1, 1]}),
        (("object", "f", "1", "exists"), {"label": "mug"}),
        (("object", "f", "1", "exists"), {"label": "mug", "bbox": [0, 0, 4, 4], "colour": "red"}),
        (("object", "f", "-1", "label"), "mug"),
        (("object", "f", "1,2", "label"), "mug"),
        (("object", "f", "01", "label"), "mug"),
        (("object", "f", "1", "colour"), "red"),
        (("relation", "f", "1,2", "left"), 2),
        (("relation", "f", "1,2", "left"), True),
        (("relation", "f", "1", "left"), 1),
        (("relation", "f", "1,2", "between"), 1),
        (("expression", "f", "00ff", "targets"), [1, -2]),
        (("expression", "f", "00ff", "targets"), "12"),
        (("expression", "f", "00ff", "mark"), "WRONG"),
        (("expression", "f", "00ff", "ambiguous"), 1),
        (("expression", "f", "", "text"), "mug left of lamp"),
        (("frame", "f", "x", "status"), "accepted"),
        (("frame", "", "", "status"), "accepted"),
        (("scene", "f", "", "status"), "accepted"),
    ],
)
def test_what_is_no_edit_is_refused(cell: tuple[Any, ...], value: Any) -> None:
    with pytest.raises(InputError):
        Edit(FieldRef(*cell), None, value)


def test_an_action_needs_an_author_and_different_cells(journal: Journal) -> None:
    for edits, author in (([], "ann"), ([Edit(LEFT, -1, 1), Edit(LEFT, -1, 0)], "ann"), ([Edit(LEFT, -1, 1)], " ")):
        with pytest.raises(InputError):
            journal.append(edits, author)
    assert journal.events() == ()


def test_undo_and_redo_take_back_whole_actions_across_restarts(journal: Journal) -> None:
    journal.append([Edit(LEFT, -1, 1), Edit(RIGHT, -1, 1)], "ann")
    journal.append([Edit(NAME, "mug", "cup")], "ann")
    assert values(journal) == {LEFT: 1, RIGHT: 1, NAME: "cup"}
    journal.close()
    journal = open_journal(journal.location)
    assert undo(journal, "bob") is None
    undo(journal, "ann")
    undo(journal, "ann")
    assert values(journal) == {LEFT: -1, RIGHT: -1, NAME: "mug"}
    assert undo(journal, "ann") is None
    redo(journal, "ann")
    assert values(journal) == {LEFT: 1, RIGHT: 1, NAME: "mug"}
    journal.append([Edit(LEFT, 1, 0, 3)], "ann")
    assert redo(journal, "ann") is None
    story = [(e.action, e.ref.field, e.after) for e in journal.events()]
    assert story == [
        ("edit", "left", 1),
        ("edit", "right", 1),
        ("edit", "label", "cup"),
        ("undo", "label", "mug"),
        ("undo", "left", -1),
        ("undo", "right", -1),
        ("redo", "left", 1),
        ("redo", "right", 1),
        ("edit", "left", 0),
    ]


def test_two_edits_of_one_field_are_taken_back_one_after_the_other(journal: Journal) -> None:
    journal.append([Edit(NAME, "mug", "cup")], "ann")
    journal.append([Edit(NAME, "cup", "bowl", 1)], "ann")
    bob = journal.append([Edit(NAME, "bowl", "vase", 2)], "bob")
    assert isinstance(bob, Saved)
    assert isinstance(undo(journal, "ann"), Conflict), "what bob said stands"
    undo(journal, "bob")
    said = []
    for turn in (undo, undo, redo, redo, undo, undo):
        assert isinstance(turn(journal, "ann"), Saved)
        said.append(values(journal)[NAME])
    assert said == ["cup", "mug", "cup", "bowl", "cup", "mug"]
    assert isinstance(redo(journal, "bob"), Conflict), "it was made on ann's"


def test_undo_does_not_take_back_what_somebody_built_upon(journal: Journal) -> None:
    first = journal.append([Edit(LEFT, -1, 1)], "ann")
    journal.append([Edit(LEFT, 1, 0, 1)], "bob")
    stuck = undo(journal, "ann")
    assert isinstance(stuck, Conflict)
    assert stuck.rivals[0].event is not None
    assert stuck.rivals[0].event.author == "bob"
    assert values(journal) == {LEFT: 0}
    assert isinstance(first, Saved)
    with pytest.raises(InputError, match="no action of this group"):
        undo(journal, "bob", group=first.group)


def values(journal: Journal) -> dict[FieldRef, Any]:
    """What each cell with events says now."""
    return {e.ref: e.after for e in journal.events()}


CELLS = [relation_ref("f", 1, b, "left") for b in (2, 3, 4)]
steps = st.lists(
    st.tuples(
        st.sampled_from(["ann", "bob"]),
        st.sampled_from(["edit", "edit", "edit", "stale", "undo", "redo"]),
        st.lists(st.tuples(st.integers(0, 2), st.integers(-1, 1)), min_size=1, max_size=3, unique_by=lambda x: x[0]),
    ),
    max_size=25,
)


@settings(max_examples=20, deadline=None)
@given(steps=steps)
def test_any_sequence_of_edits_and_undos_equals_its_replay(
    steps: list[tuple[str, str, list[tuple[int, int]]]], empty: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A model in memory: values, versions, and a stack of actions a person."""
    journal = open_journal(shutil.copy(empty, tmp_path_factory.mktemp("replay")))
    now: dict[FieldRef, list[int]] = {cell: [-1] for cell in CELLS}
    # What stands of each cell, after each of its events: an action may be taken back where that is as it was after it.
    stands: dict[FieldRef, list[tuple[int, ...]]] = {cell: [()] for cell in CELLS}
    done: dict[str, list[list[tuple[FieldRef, int, int, int]]]] = {"ann": [], "bob": []}
    undone: dict[str, list[list[tuple[FieldRef, int, int, int]]]] = {"ann": [], "bob": []}
    acknowledged = 0
    for author, action, chosen in steps:
        if action in ("edit", "stale"):
            behind = int(action == "stale")
            edits = [Edit(CELLS[k], now[CELLS[k]][-1], v, max(len(now[CELLS[k]]) - 1 - behind, 0)) for k, v in chosen]
            result = journal.append(edits, author)
            if any(e.base != len(now[e.ref]) - 1 for e in edits):
                assert isinstance(result, Conflict)
                continue
            assert isinstance(result, Saved)
            acknowledged += len(edits)
            done[author].append([(e.ref, e.before, e.after, e.base + 1) for e in edits])
            undone[author].clear()
            for e in edits:
                now[e.ref].append(e.after)
                stands[e.ref].append((*stands[e.ref][-1], acknowledged))
            continue
        stack, other = (done, undone) if action == "undo" else (undone, done)
        result = (undo if action == "undo" else redo)(journal, author)
        if not stack[author]:
            assert result is None
            continue
        top = stack[author][-1]
        if any(stands[cell][version] != stands[cell][-1] for cell, _, _, version in top):
            assert isinstance(result, Conflict)
            continue
        assert isinstance(result, Saved)
        acknowledged += len(top)
        stack[author].pop()
        other[author].append([(cell, after, before, len(now[cell])) for cell, before, after, version in top])
        for cell, before, _, version in top:
            now[cell].append(before)
            stands[cell].append(stands[cell][version - 1])
    events = open_journal(journal.location).events()
    assert len(events) == acknowledged
    for cell in CELLS:
        chain = [e for e in events if e.ref == cell]
        assert [-1, *(e.after for e in chain)] == now[cell]
        assert [e.version for e in chain] == list(range(1, len(chain) + 1))
        assert [e.before for e in chain] == now[cell][:-1]
    for author in ("ann", "bob"):
        seen = history(journal.events(author=author))
        assert [len(g) for g in seen.done] == [len(g) for g in done[author]]
        assert [len(g) for g in seen.undone] == [len(g) for g in undone[author]]
    journal.close()


@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_two_interleaved_authors_lose_nothing(
    data: st.DataObject, empty: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Each with a connection of their own, each looking only when told of a conflict."""
    place = shutil.copy(empty, tmp_path_factory.mktemp("two"))
    journals = {name: open_journal(place) for name in ("ann", "bob")}
    seen: dict[str, dict[FieldRef, tuple[int, Any]]] = {name: {} for name in journals}
    saved = []
    for _ in range(data.draw(st.integers(1, 20))):
        name = data.draw(st.sampled_from(sorted(journals)))
        cell = data.draw(st.sampled_from(CELLS))
        version, before = seen[name].get(cell, (0, -1))
        result = journals[name].append([Edit(cell, before, data.draw(st.integers(-1, 1)), version)], name)
        if isinstance(result, Saved):
            event = result.events[0]
            saved.append(event)
        else:
            assert result.rivals[0].event is not None
            event = result.rivals[0].event
            assert event.author != name
        seen[name][cell] = event.version, event.after
    assert list(journals["ann"].events()) == saved
    for cell in CELLS:
        chain = [e for e in saved if e.ref == cell]
        assert all(b.before == a.after and b.base == a.version for a, b in pairwise(chain))
    for journal in journals.values():
        journal.close()


@pytest.mark.slow
def test_writers_at_once_lose_nothing_and_overwrite_nothing(tmp_path: Path) -> None:
    proof = prove(str(tmp_path / JOURNAL_FILE), tmp_path, writers=3, edits=60)
    assert proof.holds, proof
    assert proof.saved == 180
    assert proof.conflicts > 0


def test_what_was_acknowledged_survives_a_killed_writer(tmp_path: Path) -> None:
    place, report = str(tmp_path / JOURNAL_FILE), tmp_path / "told.jsonl"
    writer = ready_processes().Process(target=write_many, args=(place, "0", 100_000, report))
    writer.start()
    wait_until(lambda: len(read_report(report)) >= 30)
    os.kill(writer.pid or 0, signal.SIGKILL)
    writer.join()
    told = [entry["saved"] for entry in read_report(report) if "saved" in entry]
    assert len(told) >= 30
    journal = open_journal(place)
    found = [e.ulid for e in journal.events()]
    assert found[: len(told)] == told
    # At most the one that was on its way when the writer died.
    assert len(found) <= len(told) + 1
    assert isinstance(journal.append([Edit(NAME, "mug", "cup")], "ann"), Saved)
