"""Many items accepted at once and taken back at once."""

from __future__ import annotations

from typing import Any

import pytest
from editor_checks import Open, desk, place  # noqa: F401

from pipeline.corrections import (
    NOTHING,
    Saved,
    Worklist,
    accept_all,
    refreshed_worklist,
    review_queue,
    say_of_item,
    worklist,
)
from pipeline.labels import Labels
from pipeline.system import InputError


@pytest.fixture(scope="module")
def work(demo_labels: Labels) -> Worklist:
    return worklist(review_queue(demo_labels))


def words(row: dict[str, Any]) -> str:
    return f"{row['relation']} {row['label']}"


def test_a_filter_finds_open_items_by_their_words(work: Worklist) -> None:
    everything = work.found(words, "")
    assert len(everything) == len(work)
    some = work.found(words, "LEFT", "relation")
    assert 0 < len(some) < len(everything)
    for k in some:
        row = work.row(work.keys[k])
        assert row["kind"] == "relation"
        assert "left" in " ".join((words(row), *row["reasons"])).lower()
    first = work.keys[some[0]]
    assert some[0] not in work.with_states({first: "accepted"}).found(words, "left", "relation")
    assert work.found(words, "no such word anywhere") == []


def test_all_that_is_found_is_accepted_and_taken_back_as_one(desk: Open, work: Worklist) -> None:
    ann = desk("ann")
    keys = [work.keys[k] for k in work.found(words, "", "relation")[:30]]
    frames = {k.frame for k in keys}
    assert len(frames) > 1
    done = ann.save(accept_all(keys, ann.frame, "ann"))
    assert isinstance(done, Saved)
    assert len({e.group for e in done.events}) == 1
    journal = ann.location.to_write()
    after, mark = refreshed_worklist(work, ann.corrector, journal, NOTHING)
    assert {after.state(k) for k in keys} == {"accepted"}
    assert isinstance(ann.undo(), Saved)
    back, _ = refreshed_worklist(after, ann.corrector, journal, mark)
    assert {back.state(k) for k in keys} == {"unreviewed"}
    assert ann.undo() is None


def test_nothing_and_too_much_are_refused(desk: Open, work: Worklist, monkeypatch: pytest.MonkeyPatch) -> None:
    ann = desk("ann")
    with pytest.raises(InputError, match="nothing to accept"):
        accept_all([], ann.frame, "ann")
    monkeypatch.setattr("pipeline.corrections.review.worklist.MOST", 2)
    with pytest.raises(InputError, match="too many"):
        accept_all(work.keys[:3], ann.frame, "ann")
    relation = next(k for k in work.keys if k.kind == "relation")
    with pytest.raises(InputError, match="not rejected"):
        say_of_item(ann.frame(relation.frame), relation, "rejected", "ann")
