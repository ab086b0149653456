"""The figures of a run that are worked out once, and what of it a search lists."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from pipeline.datasets import demo_run
from pipeline.evaluation import STANDS_IN, Listing, Run, RunFigures, RunSummary, Slices, figures_of, open_run
from pipeline.system import InputError


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(demo_run())


@pytest.fixture(scope="module")
def figures(run: Run) -> RunFigures:
    return figures_of(run)


def test_figures_are_made_once_and_say_why_they_cannot_be(run: Run, figures: RunFigures) -> None:
    assert figures_of(run) is figures
    assert isinstance(figures.summary, RunSummary)
    assert figures.summary is figures.summary
    assert figures.comparison is None
    assert isinstance(figures.slices("relation"), Slices)
    assert figures.slices("relation") is figures.slices("relation")
    assert isinstance(figures.slices("no dimension"), str)


def test_a_run_without_verdicts_has_none(run: Run) -> None:
    bare = copy(run)
    vars(bare)["on_file"] = run.records.drop_columns(["verdict"])
    with pytest.raises(InputError, match="no verdicts"):
        RunFigures(bare, None)


def test_the_relation_that_an_answer_stands_in_can_be_searched_for(run: Run) -> None:
    figures = RunFigures(run, None)
    assert STANDS_IN in {field.name for field in figures.fields}
    assert len(figures.rows.find(f"{STANDS_IN}:left")) > 0


def test_a_listing_knows_where_its_open_row_is(figures: RunFigures) -> None:
    found = figures.rows.find("-verdict:CORRECT")
    (row,) = figures.rows.read(found[1:2])
    listing = Listing(figures, "-verdict:CORRECT", found=found, at=(row["frame"], row["id"], row["text"]))
    assert (listing.count, listing.place) == (len(found), 1)
    assert replace(listing, at=None).place is None
    assert replace(listing, found=found[:1]).place is None
    assert listing.place_of(None) is None


def test_a_row_has_its_answers_boxes_and_the_labelled_ones_where_it_is_wrong(figures: RunFigures) -> None:
    seen = set()
    rows = figures.rows.read(np.arange(figures.rows.records.num_rows))
    for number, row in enumerate(rows):
        boxes = figures.boxes(number, row)
        names = [name for name, _ in boxes]
        assert ("labelled" in names) == (not row["set_correct"])
        assert ("answered target" in names) == (bool(row["set_correct"]) and row["box"] is not None)
        if row["box"] is not None:
            np.testing.assert_array_equal(boxes[-1][1], row["box"])
        seen |= set(names)
    assert seen == {"labelled", "answered reference", "answered target", "wrong target"}
    frame = rows[0]["frame"]
    assert figures.colors(frame) is figures.colors(frame)


def test_figures_of_what_a_search_finds_are_those_of_its_rows(run: Run, figures: RunFigures) -> None:
    found = figures.rows.find("class:laptop,mug sort:-margin")
    part = figures.of(found)
    assert part is figures.of(found[::-1])
    assert figures.of(np.arange(run.records.num_rows)) is figures
    assert isinstance(part.summary, RunSummary)
    assert part.summary.expressions == len(found) < run.records.num_rows
    rows = figures.rows.read(found)
    for verdict, share in part.summary.verdicts.items():
        assert share.count == sum(row["verdict"] == verdict for row in rows)
    cut, whole = part.slices("relation"), figures.slices("relation")
    assert isinstance(cut, Slices)
    assert isinstance(whole, Slices)
    assert sum(s.n for s in cut.slices) == len(found)
    assert sum(s.n for s in whole.slices) == run.records.num_rows
    confusion = part.confusion
    assert not isinstance(confusion, str)
    assert int(confusion.counts.sum()) == len(found)
    assert isinstance(figures.of(np.zeros(0, np.int64)).summary, str)


def test_a_second_run_is_compared_on_what_is_found(run: Run) -> None:
    other = copy(run)
    vars(other)["on_file"] = run.records.slice(200)
    figures = RunFigures(run, other)
    found = np.arange(150, 260)
    part = figures.of(found).comparison
    assert part is not None
    assert not isinstance(part, str)
    assert (part.shared, part.only_before, part.only_after) == (60, 50, 0)
    assert part.changes["same"] == 60
    assert sum(part.changes.values()) == 60
    assert isinstance(figures.of(np.arange(20)).comparison, str)
