"""What the label editor tells of others and of before."""

from __future__ import annotations

from typing import Any

import pytest
from editor_checks import Open, desk, place  # noqa: F401
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_world import FRAME

from pipeline.corrections import JournalLocation, LabelEditor, Saved, object_ref, redo, relation_ref
from pipeline.corrections.journal import edits
from pipeline.corrections.label_editor import event_lines
from pipeline.relations import T
from pipeline.system import InputError

# ---- others, and history -------------------------------------------------------------


def test_news_are_what_others_saved_since_the_last_look(desk: Open) -> None:
    ann, bob = desk("ann"), desk("bob")
    number = min(ann.frame(FRAME).objects)
    assert ann.news(FRAME) == ()
    bob.save(edits.set_class(bob.frame(FRAME), number, "bowl"))
    (event,) = ann.news(FRAME)
    assert (event.author, event.after) == ("bob", "bowl")
    assert ann.news(FRAME) == (event,), "asking does not take them"
    ann.frame(FRAME)
    assert ann.news(FRAME) == ()
    assert ann.corrected(FRAME) is ann.frame(FRAME)
    assert ann.corrected("000001/000001") is None


def test_a_desk_takes_only_names(desk: Open) -> None:
    ann = desk("ann")
    ann.sign("  bob ")
    assert ann.author == "bob"
    for bad in ("", "   ", "a\x00", "x" * 1000):
        with pytest.raises(InputError):
            ann.sign(bad)
    assert ann.author == "bob"


def test_history_tells_what_was_taken_back_and_whose_it_is(desk: Open, place: JournalLocation) -> None:
    ann, bob = desk("ann"), desk("bob")
    frame = ann.frame(FRAME)
    a, b = (int(n) for n in frame.pairs.numbers[:2])
    ann.save(edits.set_relation(frame, a, b, "left", T))
    bob.save(edits.set_class(bob.frame(FRAME), a, "vase"))
    ann.save(edits.set_class(ann.frame(FRAME), b, "bowl"))

    def lines(who: LabelEditor, **about: Any) -> Any:
        who.frame(FRAME)
        return who.history(FRAME, **about)

    both = lines(ann, pair=(b, a))
    assert {x.event.ref for x in both} == {relation_ref(FRAME, a, b, "left"), relation_ref(FRAME, b, a, "right")}
    assert [x.event.author for x in lines(ann, objects=(a, b), pair=(a, b))] == ["ann", "bob", "ann", "ann"]
    assert [bool(x.group) for x in lines(bob, objects=(a, b))] == [False, True]
    group = both[0].group
    assert isinstance(ann.undo(group), Saved)
    assert [(x.undone and x.undone.author, x.group) for x in lines(ann, pair=(a, b))] == [("ann", "")] * 2
    assert ann.frame(FRAME).objects[b]["label"] == "bowl", "only that action is taken back"
    assert isinstance(redo(place.to_write(), "ann"), Saved)
    again = lines(ann, pair=(a, b))[0]
    assert again.undone is None
    assert again.group != group
    assert isinstance(ann.undo(again.group), Saved)
    assert lines(ann, pair=(a, b))[0].undone is not None
    assert lines(ann) == ()
    with pytest.raises(InputError, match="no action"):
        ann.undo("nobody's")


@settings(max_examples=25)
@given(st.lists(st.sampled_from(["edit", "undo", "redo"]), max_size=10))
def test_history_agrees_with_what_undo_would_take(steps: list[str]) -> None:
    from datetime import datetime, timezone

    from pipeline.corrections import Event

    cell, value, version = object_ref(FRAME, 1, "label"), "0", 0
    events: list[Event] = []
    stack: list[tuple[str, str, str]] = []
    undone: list[tuple[str, str, str]] = []
    for k, step in enumerate(steps):
        source = stack if step == "undo" else undone
        if step != "edit" and not source:
            continue
        before, after, of = value, str(k + 1), None
        if step == "edit":
            undone.clear()
        else:
            of, after, _ = source.pop()
        ulid = f"u{k}"
        (undone if step == "undo" else stack).append((ulid, before, after))
        events.append(
            Event(
                k + 1,
                ulid,
                "ann",
                datetime.now(timezone.utc),
                cell,
                before,
                after,
                version,
                version + 1,
                "",
                "",
                f"g{k}",
                step,  # type: ignore[arg-type]
                of,
                {},
            )
        )
        value, version = after, version + 1
    lines = event_lines(events, "ann", objects=[1])
    assert len(lines) == steps_made(events)
    assert {x.group for x in lines if x.group} == {f"g{u[1:]}" for u, _, _ in stack}


def steps_made(events: list[Any]) -> int:
    return sum(e.action == "edit" for e in events)
