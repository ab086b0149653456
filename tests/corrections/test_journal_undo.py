"""Taking back from the newest events alone, held against the whole history; judgements that nobody is in the way of."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
from pipeline.corrections.journal import replay as undoing
from pipeline.corrections.journal.field_refs import judged_item
from pipeline.corrections.journal.replay import history, judgement_ref, newest
from pipeline.system import InputError

CELLS = [relation_ref("f", 1, b, "left") for b in (2, 3, 4)]


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("empty") / JOURNAL_FILE
    open_journal(path).close()
    return path


steps = st.lists(
    st.tuples(
        st.sampled_from(["ann", "bob"]),
        st.sampled_from(["edit", "edit", "undo", "undo", "redo", "undo group", "redo group"]),
        st.lists(st.integers(0, 2), min_size=1, max_size=3, unique=True),
        st.integers(0, 5),
    ),
    max_size=22,
)


@settings(max_examples=12, deadline=None)
@given(steps=steps, page=st.integers(1, 5))
def test_what_is_taken_back_is_what_the_whole_history_says(
    steps: list[tuple[str, str, list[int], int]], page: int, empty: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    with (
        pytest.MonkeyPatch.context() as patched,
        open_journal(shutil.copy(empty, tmp_path_factory.mktemp("undo"))) as journal,
    ):
        patched.setattr(undoing, "PAGE", page)
        for author, action, cells, number in steps:
            if action == "edit":
                heads = journal.heads(CELLS)
                made = [Edit(CELLS[k], 0, 1, heads[CELLS[k]].version if CELLS[k] in heads else 0) for k in cells]
                assert isinstance(journal.append(made, author), Saved)
            else:
                _take_back(journal, author, action, number)
            for name in ("ann", "bob"):
                whole = history(journal.events(author=name))
                assert newest(journal, name, "undo") == (whole.done[-1] if whole.done else None)
                assert newest(journal, name, "redo") == (whole.undone[-1] if whole.undone else None)


def _take_back(journal: Journal, author: str, action: str, number: int) -> None:
    whole = history(journal.events(author=author))
    turn = undo if action.startswith("undo") else redo
    stack = whole.done if turn is undo else whole.undone
    if not action.endswith("group"):
        done = turn(journal, author)
        assert (done is None) == (not stack)
        members = stack[-1] if stack else ()
    else:
        groups = list(dict.fromkeys(e.group for e in journal.events()))
        if not groups:
            return
        group = groups[number % len(groups)]
        members = next((m for m in stack if m[0].group == group), ())
        if not members:
            with pytest.raises(InputError, match="no action of this group"):
                turn(journal, author, group=group)
            return
        done = turn(journal, author, group=group)
    if isinstance(done, Saved):
        assert [e.undo_of for e in done.events] == [e.ulid for e in members]


def test_taking_back_reads_what_is_recent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_journal(tmp_path / "j.sqlite") as journal:
        for first in range(0, 3000, 500):
            edits = [Edit(relation_ref("f", 1, b, "left"), 0, 1) for b in range(first + 2, first + 502)]
            journal.append(edits, "ann")
        journal.append([Edit(relation_ref("g", 1, 2, "left"), 0, 1)], "ann")
        read: list[int] = []
        known = Journal._select

        def counted(self: Journal, *args: object, **options: object) -> tuple:
            found = known(self, *args, **options)  # pyright: ignore[reportArgumentType]
            read.append(len(found))
            return found

        monkeypatch.setattr(Journal, "_select", counted)
        assert isinstance(undo(journal, "ann"), Saved)
        assert isinstance(redo(journal, "ann"), Saved)
        assert sum(read) <= 2 * (undoing.PAGE + 4)


def test_two_judgements_of_one_item_never_meet(tmp_path: Path) -> None:
    with open_journal(tmp_path / "j.sqlite") as journal:
        for author in ("ann", "bob", "Zoë 'the; eye'"):
            cell = judgement_ref("f", "relation", 1, 2, "left", author)
            assert judged_item(cell.key) == (author, "relation", 1, 2, "left")
            assert isinstance(journal.append([Edit(cell, None, {"status": "accepted", "value": 1})], author), Saved)
        shared = judgement_ref("f", "relation", 1, 2, "left", "")
        assert shared.field == "settled"
        assert isinstance(journal.append([Edit(shared, None, {"status": "accepted", "value": 1})], "ann"), Saved)
        late = journal.append([Edit(shared, None, {"status": "rejected"})], "bob")
        assert isinstance(late, Conflict)
        assert len(journal.events(kind="review")) == 4


@pytest.mark.parametrize(
    "key",
    [
        "",
        "ann",
        "[]",
        "null",
        '["ann","relation",1,2]',
        '["ann","relation",1,null,"left"]',
        '["ann","pair",1,2,"left"]',
        '["ann","relation",1,2,"between"]',
        '["ann", "relation",1,2,"left"]',
        '["ann","relation",true,2,"left"]',
        '["ann","relation",-1,2,"left"]',
        '["\\u0000","relation",1,2,"left"]',
        '["","relation",1,2,"left"]',
        '["ann","object",99999999999,null,""]',
        '["ann","object",NaN,null,""]',
        "[" * 100_000,
        '"abcde"',
        '["ann","expression",-1,null,"\\ud800"]',
        '{"a":1,"b":2,"c":3,"d":4,"e":5}',
    ],
)
def test_what_is_no_judgement_is_refused(key: str) -> None:
    with pytest.raises(InputError):
        FieldRef("review", "f", key, "said")


@pytest.mark.parametrize(
    "value",
    [
        "accepted",
        {"status": "fine"},
        {"status": "accepted", "value": 2},
        {"value": 1},
        {"status": "accepted", "why": "so"},
        1,
        [],
    ],
)
def test_what_is_no_word_is_refused(value: object) -> None:
    with pytest.raises(InputError):
        Edit(judgement_ref("f", "object", 3, None, "", "ann"), None, value)
