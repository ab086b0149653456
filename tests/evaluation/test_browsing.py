"""A run that is looked through: facets count what a search finds, marks and kept searches last, and a second run."""

from __future__ import annotations

import json
import sys
import threading
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_records import random_records

from pipeline.datasets import demo_run
from pipeline.evaluation import CHANGES, RunRows, compare, find_failures, find_rows, open_run, with_value
from pipeline.evaluation.browsing import examples, facets_of
from pipeline.evaluation.comparing import changes, with_second
from pipeline.evaluation.run_notes import FILE, keep_filter, mark, notes_path, read_notes
from pipeline.evaluation.search import narrowed
from pipeline.system import InputError


def _same_frames(records: pa.Table, as_in: pa.Table) -> pa.Table:
    for name in ("frame", "frame_index", "scene"):
        records = records.set_column(records.schema.get_field_index(name), name, as_in.column(name))
    return records


_FIRST = random_records(0, rows=90)
TABLES = [_FIRST, *(_same_frames(random_records(seed, rows=90), _FIRST) for seed in (1, 2))]
PAIRS = [with_second(t, TABLES[(k + 1) % 3]) for k, t in enumerate(TABLES)]
QUERIES = (
    "",
    "-verdict:CORRECT,LABEL sort:margin",
    "verdict:SRM,LIFT -class:chair",
    "distance>=1 distance<2",
    "lucky",
    "change:broken,fixed trash",
    'class="a \\"b\\" c" margin<1',
    "-lucky mends:none relation:behind",
    "scene=000001",
    "second_verdict:PRM -relation:left",
)


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2), st.sampled_from(QUERIES))
def test_a_facet_counts_what_the_rest_of_the_search_finds(number: int, query: str) -> None:
    records = PAIRS[number]
    for facet in facets_of(records, query):
        own = [v for v in facet.values if v.state]
        for value in facet.values:
            # The search without this facet's own terms, and with the value.
            bare = query
            for v in own:
                bare = with_value(bare, v.term, records.schema, without=v.state < 0)
            found = find_rows(records, with_value(bare, value.term, records.schema))
            if facet.name not in query or own:
                assert len(found) == value.count, (query, facet.name, value)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2), st.sampled_from(QUERIES), st.data())
def test_a_value_that_is_asked_for_twice_is_taken_back(number: int, query: str, data: st.DataObject) -> None:
    records = PAIRS[number]
    facet = data.draw(st.sampled_from(facets_of(records, query)))
    value = data.draw(st.sampled_from(facet.values))
    once = with_value(query, value.term, records.schema)
    states = {v.name: v.state for f in facets_of(records, once) for v in f.values if f.name == facet.name}
    assert states.get(value.name, 0) == (0 if value.state == 1 else 1), (query, once)
    if facet.ranges:
        return
    without = with_value(query, value.term, records.schema, without=True)
    kept = set(find_rows(records, without).tolist()) & set(find_rows(records, value.term).tolist())
    assert not kept or value.state == -1, (query, without)


def test_values_of_a_field_are_alternatives_and_an_order_comes_last() -> None:
    schema = TABLES[0].schema
    query = "-verdict:CORRECT,LABEL sort:margin"
    query = with_value(query, "verdict:SRM", schema)
    assert query == "verdict:SRM sort:margin"
    query = with_value(query, "verdict:LIFT", schema)
    assert query == "verdict:SRM,LIFT sort:margin"
    query = with_value(query, "distance>=1 distance<2", schema)
    query = with_value(query, "distance>=2 distance<3", schema)
    assert query == "verdict:SRM,LIFT distance>=2 distance<3 sort:margin"
    assert with_value(query, "verdict:SRM", schema, without=True) == "-verdict:SRM distance>=2 distance<3 sort:margin"
    assert with_value('class:chair "50%"', 'class="trash can"', schema) == 'class=chair,"trash can" "50%"'


def test_the_second_run_sorts_every_expression_into_one_change() -> None:
    before, after = TABLES[0], TABLES[1].slice(5)
    found, rows = compare(before, after), with_second(before, after)
    change = rows.column("change").to_pylist()
    every = list(zip(rows.column("id").to_pylist(), change, strict=True))
    ids = {what: [i for i, c in every if c == what] for what in CHANGES}
    assert [ids[w] for w in ("fixed", "broken", "other_reason")] == [
        [entry["id"] for entry in entries] for entries in (found.fixed, found.broken, found.other_reason)
    ]
    assert change.count(None) == 5 == found.only_before
    assert rows.column("second_verdict").null_count == 5
    for row in rows.select(rows.column_names).to_pylist():
        if row["change"] == "verdict":
            assert row["verdict"] != row["second_verdict"]
        if row["change"] == "same":
            assert row["verdict"] == row["second_verdict"]
    assert set(changes(before, before).tolist()) == {"same"}
    assert find_failures(rows, "change:broken").column("id").to_pylist() == ids["broken"]
    counted = {v.name: v.count for f in facets_of(rows) if f.name == "change" for v in f.values}
    assert sum(counted.values()) == before.num_rows
    with pytest.raises(InputError, match="no expression in common"):
        with_second(before, before.slice(0, 0))
    with pytest.raises(InputError, match="no such change"):
        find_rows(rows, "change:better")


def test_marks_and_kept_searches_last_and_are_found(tmp_path: Path) -> None:
    rows = RunRows(TABLES[0], tmp_path)
    assert rows.path == tmp_path / FILE
    rows.mark([3, 1, 3], "To-Do")
    rows.mark([1], "done")
    rows.keep(" the chairs ", "class:chair")
    assert rows.find("marks:to-do").tolist() == [1, 3]
    assert rows.find("marks:TO-DO -marks:done").tolist() == [3]
    assert len(rows.find("marks:none")) == 88
    assert find_failures(rows.records, "marks:done").num_rows == 1
    assert [r["marks"] for r in rows.read(np.array([1, 0]))] == [["done", "to-do"], []]
    again = RunRows(TABLES[0], tmp_path)
    assert again.notes == rows.notes
    assert again.notes.filters == {"the chairs": "class:chair"}
    facet = {f.name: {v.name: v.count for v in f.values} for f in again.facets("")}["marks"]
    assert facet == {"to-do": 2, "done": 1}
    again.mark(range(90), "to-do", on=False)
    again.keep("the chairs", None)
    assert read_notes(again.path).filters == {}
    assert list(read_notes(again.path).marks) == ["done"]


@pytest.mark.parametrize("name", ["", "two words", "none", "a,b", "x" * 50, '"'])
def test_a_mark_is_one_word(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="a mark is one word"):
        mark(tmp_path / FILE, [("a", "b")], name)
    assert not (tmp_path / FILE).exists()


def test_who_marks_at_once_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / FILE
    writers = [
        threading.Thread(target=lambda k=k: (mark(path, [("f", str(k))], f"m{k % 3}"), keep_filter(path, f"q{k}", "")))
        for k in range(12)
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    notes = read_notes(path)
    assert Counter({name: len(keys) for name, keys in notes.marks.items()}) == {"m0": 4, "m1": 4, "m2": 4}
    assert len(notes.filters) == 12


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", 'got "{"; expected JSON (EOF'),
        ('{"format": "other", "marks": {}}', "of another release"),
        ('{"marks": [1]}', "at marks; got [1]; expected an object {...}"),
    ],
)
def test_damaged_notes_are_said_in_a_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / FILE).write_text(text)
    with pytest.raises(InputError) as refused:
        RunRows(TABLES[0], tmp_path)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.skipif(sys.platform == "win32", reason="there the last of two processes wins")
def test_notes_wait_for_those_of_another_process(tmp_path: Path) -> None:
    """Another process holds the folder: what it writes meanwhile is not lost."""
    import fcntl

    path = tmp_path / FILE
    mark(path, [("f", "first")], "seen")
    with open(tmp_path / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        waits = threading.Thread(target=mark, args=(path, [("f", "mine")], "seen"))
        waits.start()
        waits.join(0.2)
        assert waits.is_alive()
        path.write_text(path.read_text().replace("first", "theirs"))
    waits.join(10)
    assert read_notes(path).marks == {"seen": [("f", "theirs"), ("f", "mine")]}


def test_what_came_with_the_program_is_noted_with_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    path = notes_path(demo_run())
    assert path.is_relative_to(tmp_path)
    mark(path, [("f", "i")], "seen")
    assert json.loads(path.read_text())["marks"] == {"seen": [["f", "i"]]}


def test_rows_are_read_by_range_in_the_order_of_the_search(tmp_path: Path) -> None:
    rows = RunRows(TABLES[0], tmp_path, TABLES[1])
    found = rows.find("sort:-margin")
    ranges = [rows.read(found[k : k + 7]) for k in range(0, len(found), 7)]
    margins = [r["margin"] for part in ranges for r in part if r["margin"] is not None and not np.isnan(r["margin"])]
    assert margins == sorted(margins, reverse=True)
    row = ranges[0][0]
    number = rows.number(row["frame"], row["id"])
    assert number == found[0]
    assert rows.number("no", "such") is None
    assert {"change", "second_verdict", "second_said", "marks"} <= row.keys()


def test_columns_that_say_nothing_are_not_shown(tmp_path: Path) -> None:
    run = open_run(demo_run())
    rows = RunRows(run.records, tmp_path)
    names = ("text", "margin", "frame", "marks", "second_verdict")
    unmatched = rows.find("margin:none")
    assert rows.filled(unmatched, names) == ["text", "frame"]
    rows.mark(unmatched[:1].tolist(), "odd")
    assert rows.filled(unmatched, names) == ["text", "frame", "marks"]
    assert rows.filled(np.arange(run.records.num_rows), names) == ["text", "margin", "frame", "marks"]
    assert rows.widest_frame == len("000001/000000")


def test_terms_to_try_find_something() -> None:
    run = open_run(demo_run())
    tried = examples(facets_of(run.records))
    assert len(tried) == 5
    for term in tried:
        assert len(find_rows(run.records, term)), term
        assert with_value(with_value("-right", term, run.records.schema), term, run.records.schema) == "-right"


@pytest.mark.parametrize(("query", "more"), [("", "lucky"), ("class:mug -right", "-right lucky"), ('"a b"', "x:none")])
def test_a_narrowed_search_says_nothing_twice(query: str, more: str) -> None:
    found = narrowed(query, more).split()
    assert len(found) == len(set(found))
    assert set(f"{query} {more}".split()) == set(found)
