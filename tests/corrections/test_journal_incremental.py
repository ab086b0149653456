"""A frame's effective labels, brought up to date by each event that comes, are those of a full rebuild."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_world import FRAME, an_expression, half_of, saved, widest

from pipeline.corrections import (
    Corrector,
    EffectiveFrame,
    FieldRef,
    Journal,
    Saved,
    object_ref,
    open_journal,
    redo,
    relation_ref,
    undo,
)
from pipeline.corrections.journal import edits
from pipeline.labels import Labels
from pipeline.language import PAIRWISE
from pipeline.relations import F, T, U
from pipeline.system import InputError

PARTS = (
    "row",
    "objects",
    "left_out",
    "expressions",
    "withdrawn",
    "marks",
    "cells",
    "statuses",
    "unapplied",
    "origins",
    "geometry",
    "boxes",
    "human_bbox",
    "renamed",
    "moved",
    "sentences",
)


def alike(found: EffectiveFrame, whole: EffectiveFrame) -> None:
    """Rows, relations, statuses, and where each value comes from: the same, in the same order where one is told."""
    for name in PARTS:
        assert getattr(found, name) == getattr(whole, name), name
    assert list(found.objects) == list(whole.objects)
    assert list(found.expressions) == list(whole.expressions)
    assert [w.row for w in found.withdrawn] == [w.row for w in whole.withdrawn]
    for name in ("numbers", "present", "states", "margins", "distance", "doubted"):
        np.testing.assert_array_equal(getattr(found.pairs, name), getattr(whole.pairs, name), name)
    np.testing.assert_array_equal(found.stale, whole.stale)


def an_edit(data: st.DataObject, frame: EffectiveFrame, author: str) -> tuple[Any, ...]:
    """One of every kind that people make, on what the frame has now."""
    there = sorted(frame.objects)
    numbers = st.sampled_from(there)
    pairs = st.sampled_from([(a, b) for a in there[:4] for b in there[:4] if a != b])
    name = st.sampled_from(frame.sentences)
    kind = data.draw(st.sampled_from(KINDS_OF_EDITS))
    if kind in ("relation", "judged", "status of a relation", "true"):
        (a, b), relation = data.draw(pairs), data.draw(st.sampled_from(["left", "right", "near", "on"]))
        state = data.draw(st.sampled_from([T, U, F]))
        if kind == "relation":
            return edits.set_relation(frame, a, b, relation, state)
        if kind == "judged":
            return edits.judge_relation(frame, a, b, relation, state, author)
        if kind == "true":
            names = frame.objects[a]["label"], frame.objects[b]["label"]
            return edits.add_sentence(frame, f"the thing {a} {relation} {b}", (names[0], relation, names[1]), a, b)
        ref = relation_ref(FRAME, a, b, f"{relation}.status")
        return edits.set_status(frame, ref, data.draw(st.sampled_from(["accepted", None])))
    if kind == "class":
        return edits.set_class(frame, data.draw(numbers), data.draw(st.sampled_from(["mug", "wall", "lamp"])))
    if kind == "reject":
        back = sorted(frame.left_out)
        number = data.draw(st.sampled_from(back)) if back and data.draw(st.booleans()) else data.draw(numbers)
        status = "accepted" if number in frame.left_out else "rejected"
        return edits.set_status(frame, object_ref(FRAME, number, "status"), status)
    if kind == "mask":
        return edits.set_mask(frame, data.draw(numbers), None)
    if kind == "bbox":
        return edits.set_bbox(frame, data.draw(numbers), [3, 4, 30 + data.draw(st.integers(0, 9)), 40])
    if kind == "new":
        return edits.add_object(frame, data.draw(st.sampled_from(["teapot", "mug"])), bbox=[5, 5, 25, 25])
    if kind == "answers":
        return edits.set_answers(frame, data.draw(name), [data.draw(numbers)])
    if kind == "mark":
        return edits.set_mark(frame, data.draw(name), data.draw(st.sampled_from(["BAD_BOX", None])))
    if kind == "status of a sentence":
        ref = FieldRef("expression", FRAME, data.draw(name), "status")
        return edits.set_status(frame, ref, data.draw(st.sampled_from(["rejected", "accepted"])), author=author)
    return edits.set_note(frame, data.draw(st.sampled_from(["look again", None])))


KINDS_OF_EDITS = (
    "relation",
    "relation",
    "judged",
    "status of a relation",
    "true",
    "class",
    "reject",
    "mask",
    "bbox",
    "new",
    "answers",
    "mark",
    "status of a sentence",
    "note",
)


def worked_on(data: st.DataObject, labels: Labels, corrector: Corrector, folder: Any, most: int) -> None:
    with open_journal(folder / "j.sqlite") as journal:
        for _ in range(data.draw(st.integers(1, most))):
            author = data.draw(st.sampled_from(["ann", "bob"]))
            turn = data.draw(st.sampled_from(["edit", "edit", "edit", "undo", "redo"]))
            frame = corrector.frame(FRAME, journal)
            try:
                done = (
                    journal.append(an_edit(data, frame, author), author)
                    if turn == "edit"
                    else (undo if turn == "undo" else redo)(journal, author)
                )
            except InputError:
                continue
            if isinstance(done, Saved):
                whole = Corrector(labels, corrector.dataset)
                whole.relifter = corrector.relifter
                alike(corrector.frame(FRAME, journal), whole.frame(FRAME, journal))


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_each_event_brings_what_a_rebuild_has(
    data: st.DataObject, demo_labels: Labels, tmp_path_factory: pytest.TempPathFactory
) -> None:
    worked_on(data, demo_labels, Corrector(demo_labels), tmp_path_factory.mktemp("j"), 12)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_each_event_brings_what_a_rebuild_lifts(
    data: st.DataObject, demo_labels: Labels, full_corrector: Corrector, tmp_path_factory: pytest.TempPathFactory
) -> None:
    worked_on(data, demo_labels, full_corrector, tmp_path_factory.mktemp("j"), 12)


def test_one_changed_relation_costs_little(demo_labels: Labels, journal: Journal) -> None:
    """Of a frame that people have worked on, a relation is made anew, and not the frame."""
    import cProfile
    import pstats

    corrector = Corrector(demo_labels)
    frame = corrector.frame(FRAME, journal)
    row = an_expression(frame)
    for a in [n for n in frame.pairs.numbers.tolist() if n != row["reference_object"]]:
        frame = corrector.frame(FRAME, journal)
        state = F if frame.pairs.state(a, row["reference_object"], row["relation"]) == T else T
        saved(journal, edits.set_relation(frame, a, row["reference_object"], row["relation"], state))
    corrector.frame(FRAME, journal)
    undo(journal, "ann")
    events, profile = journal.events(frame=FRAME), cProfile.Profile()
    profile.runcall(corrector.frame, FRAME, events)
    assert pstats.Stats(profile).total_calls < 2_000  # pyright: ignore[reportAttributeAccessIssue]


def test_a_frame_is_not_changed_by_what_comes_after(full_corrector: Corrector, journal: Journal) -> None:
    before = full_corrector.frame(FRAME, journal)
    kept = {name: getattr(before, name).copy() for name in ("objects", "origins", "cells", "statuses")}
    states = before.pairs.states.copy()
    number = widest(before)
    a, b = (int(n) for n in before.pairs.numbers[:2])
    left = PAIRWISE.index("left")
    saved(journal, edits.set_relation(before, a, b, "left", {T: F}.get(int(before.pairs.states[0, 1, left]), T)))
    saved(journal, edits.set_class(full_corrector.frame(FRAME, journal), number, "teapot"))
    saved(journal, edits.set_mask(full_corrector.frame(FRAME, journal), number, half_of(before, number)[0]))
    full_corrector.frame(FRAME, journal)
    assert {name: getattr(before, name) for name in kept} == kept
    np.testing.assert_array_equal(before.pairs.states, states)
