"""Many items accepted at once and taken back at once, and how fast a person works."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta, timezone
from typing import Any

import pytest
from editor_checks import Open, desk, place  # noqa: F401
from hypothesis import given
from hypothesis import strategies as st
from journal_world import FRAME

from pipeline.corrections import (
    NOTHING,
    Event,
    QueueConfig,
    Saved,
    Worklist,
    accept_all,
    found_items,
    object_ref,
    pace_of,
    refreshed_worklist,
    review_queue,
    say_of_item,
    worklist,
)
from pipeline.labels import Labels
from pipeline.system import InputError

NOON = datetime(2026, 3, 4, 12, tzinfo=timezone.utc)


@pytest.fixture(scope="module")
def work(demo_labels: Labels) -> Worklist:
    return worklist(review_queue(demo_labels, QueueConfig(None)))


def words(row: dict[str, Any]) -> str:
    return f"{row['relation']} {row['label']}"


def test_a_filter_finds_open_items_by_their_words(work: Worklist) -> None:
    everything = found_items(work, words)
    assert len(everything) == len(work)
    some = found_items(work, words, "relation", "LEFT")
    assert 0 < len(some) < len(everything)
    for k in some:
        row = work.row(work.keys[k])
        assert row["kind"] == "relation"
        assert "left" in " ".join((words(row), *row["reasons"])).lower()
    first = work.keys[some[0]]
    assert some[0] not in found_items(work.with_states({first: "accepted"}), words, "relation", "left")
    assert found_items(work, words, None, "no such word anywhere") == []


def test_all_that_is_found_is_accepted_and_taken_back_as_one(desk: Open, work: Worklist) -> None:
    ann = desk("ann")
    keys = [work.keys[k] for k in found_items(work, words, "relation")[:30]]
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
    monkeypatch.setattr("pipeline.corrections.review.bulk.MOST", 2)
    with pytest.raises(InputError, match="too many"):
        accept_all(work.keys[:3], ann.frame, "ann")
    relation = next(k for k in work.keys if k.kind == "relation")
    with pytest.raises(InputError, match="not rejected"):
        say_of_item(ann.frame(relation.frame), relation, "rejected", "ann")


def event(k: int, at: datetime, author: str = "ann") -> Event:
    return Event(
        k,
        f"u{k}",
        author,
        at,
        object_ref(FRAME, k, "status"),
        None,
        "accepted",
        0,
        1,
        "",
        "",
        f"g{k}",
        "edit",
        None,
        {},
    )


@given(st.lists(st.floats(1, 240), min_size=2, max_size=40))
def test_the_pace_is_items_by_the_time_between_them(gaps: list[float]) -> None:
    times = [NOON + timedelta(seconds=sum(gaps[:k])) for k in range(len(gaps) + 1)]
    found = pace_of([event(k, t) for k, t in enumerate(times)], "ann", NOON)
    assert found.items == len(times)
    assert found.minutes == pytest.approx((sum(gaps) + 30) / 60, abs=0.01)
    assert found.per_hour == pytest.approx(len(times) / (sum(gaps) + 30) * 3600, rel=1e-3)


def test_rests_other_days_and_other_people_do_not_count() -> None:
    times = [NOON, NOON + timedelta(seconds=30), NOON + timedelta(hours=2), NOON + timedelta(hours=2, seconds=30)]
    events = [event(k, t) for k, t in enumerate(times)]
    found = pace_of([*events, event(9, NOON, "bob"), event(8, NOON - timedelta(days=1))], "ann", NOON)
    assert (found.items, found.minutes, found.per_hour) == (4, 2.0, 120.0)
    assert pace_of([], "ann", NOON).per_hour is None
    east = timezone(timedelta(hours=13))
    assert pace_of(events, "ann", NOON.astimezone(east)).items == 4
    assert pace_of([replace(e, action="undo") for e in events], "ann", NOON).items == 0
