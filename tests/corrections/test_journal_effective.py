"""Effective labels: automatic labels plus the journal, what follows, and where each value comes from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_world import FRAME, an_expression, half_of, saved, widest
from label_sets import validate_rows

from pipeline.corrections import (
    Corrector,
    EffectiveFrame,
    FieldRef,
    Journal,
    effective_tables,
    object_ref,
    open_journal,
    redo,
    relation_ref,
    same_value,
    undo,
)
from pipeline.corrections.journal import edits
from pipeline.corrections.journal.field_refs import box_of
from pipeline.corrections.scene import labelled_objects
from pipeline.datasets import Dataset, with_frame_up
from pipeline.geometry import Box3D
from pipeline.labels import TABLES, Labels
from pipeline.language import PAIRWISE, same_class
from pipeline.relations import F, T, U
from pipeline.system import InputError


def test_labels_without_corrections_are_themselves(
    demo_labels: Labels, full_corrector: Corrector, journal: Journal
) -> None:
    found = effective_tables(demo_labels, journal)
    for name in TABLES:
        assert found.tables[name].equals(getattr(demo_labels, name)), name
    assert found.provenance.num_rows == 0
    frame = full_corrector.frame(FRAME, journal)
    for name, table in frame.tables().items():
        first, stop = np.searchsorted(
            full_corrector.index.tables[name].column("frame_index"), [frame.auto.index + k for k in (0, 1)]
        )
        schema = full_corrector.index.tables[name].schema
        assert table.cast(schema).equals(getattr(demo_labels, name).slice(first, stop - first)), name
    assert frame.origin(relation_ref(FRAME, 0, 1, "left")).source == "auto"
    assert "viewer-cone-v1" in str(frame.origin(relation_ref(FRAME, 0, 1, "left")))


def test_lifting_anew_without_a_correction_changes_nothing(full_corrector: Corrector, journal: Journal) -> None:
    auto = full_corrector.frame(FRAME, journal).auto
    assert full_corrector.relifter is not None
    rows, pairs = full_corrector.relifter(auto, auto.objects, {}, ())
    for number, row in rows.items():
        assert {k: v for k, v in row.items() if not same_value(v, auto.objects[number][k])} == {}
    np.testing.assert_array_equal(pairs.states, auto.pairs.states)
    np.testing.assert_allclose(pairs.margins, auto.pairs.margins, atol=1e-6)


def test_what_is_lifted_anew_keeps_the_up_that_its_frame_was_labelled_with(
    demo_labels: Labels, demo_dataset: Dataset, full_corrector: Corrector, journal: Journal
) -> None:
    tilted = Corrector(demo_labels, with_frame_up(demo_dataset, FRAME, (0.6, -0.8, 0.0)))
    assert tilted.relifter is not None
    assert full_corrector.relifter is not None
    context, known = tilted.relifter.context(FRAME), full_corrector.relifter.context(FRAME)
    np.testing.assert_array_equal(context.viewer.up, known.viewer.up)
    assert context.viewer.up_source == full_corrector.frame(FRAME, journal).row["up_source"]
    frame = full_corrector.frame(FRAME, journal)
    saved(journal, edits.set_mask(frame, widest(frame), half_of(frame, widest(frame))[0]))
    there, here = tilted.frame(FRAME, journal).tables(), full_corrector.frame(FRAME, journal).tables()
    assert all(there[name].equals(here[name]) for name in TABLES)


def test_a_relation_takes_its_inverse_and_what_it_rules_out_with_it(
    bare_corrector: Corrector, journal: Journal
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    left = PAIRWISE.index("left")
    i, j = np.argwhere(frame.pairs.states[..., left] == T)[0]
    a, b = int(frame.pairs.numbers[i]), int(frame.pairs.numbers[j])
    events = saved(journal, edits.set_relation(frame, a, b, "right", T, "the mirror"))
    assert {(e.ref.key, e.ref.field, e.after) for e in events} == {(f"{a},{b}", "right", T), (f"{b},{a}", "left", T)}
    after = bare_corrector.frame(FRAME, journal)
    assert after.pairs.state(a, b, "right") == after.pairs.state(b, a, "left") == T
    # T of left(a, b) was the labeller's: the person ruled it out.
    assert after.pairs.state(a, b, "left") == after.pairs.state(b, a, "right") == F
    assert after.origin(relation_ref(FRAME, a, b, "right")).source == "human"
    assert after.origin(relation_ref(FRAME, a, b, "right")).author == "ann"
    ruled_out = after.origin(relation_ref(FRAME, a, b, "left"))
    assert (ruled_out.source, ruled_out.event) == ("recomputed", events[0].ulid)
    undo(journal, "ann")
    again = bare_corrector.frame(FRAME, journal)
    for name, table in again.tables().items():
        assert table.equals(frame.tables()[name]), name
    assert again.origin(relation_ref(FRAME, a, b, "right")).source == "auto"


def expected_sets(frame: EffectiveFrame, row: dict[str, Any]) -> tuple[list[int], list[int]]:
    """What an expression is true of, object by object and pair by pair."""

    def holds(a: int, b: int, least: int) -> bool:
        state = frame.pairs.state(a, b, row["relation"]) if a != b else None
        return state is not None and state >= least

    named = {
        role: [n for n, o in frame.objects.items() if same_class(o["label"], row[role])]
        for role in ("target", "reference")
    }
    strict, likely = (
        [a for a in named["target"] if any(holds(a, b, least) for b in named["reference"])] for least in (T, U)
    )
    return strict, likely


@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_answers_follow_from_relations_and_classes(
    data: st.DataObject, bare_corrector: Corrector, tmp_path_factory: Any
) -> None:
    with open_journal(tmp_path_factory.mktemp("j") / "j.sqlite") as journal:
        for _ in range(data.draw(st.integers(1, 3))):
            frame = bare_corrector.frame(FRAME, journal)
            row = data.draw(st.sampled_from(sorted(frame.expressions.values(), key=lambda r: r["id"])))
            if data.draw(st.booleans()):
                others = [n for n, o in frame.objects.items() if n != row["reference_object"]]
                a, state = data.draw(st.sampled_from(others)), data.draw(st.sampled_from([T, U, F]))
                made = edits.set_relation(frame, a, row["reference_object"], row["relation"], state)
            else:
                number = data.draw(st.sampled_from(sorted(frame.objects)))
                made = edits.set_class(frame, number, data.draw(st.sampled_from(["mug", "lamp", row["target"]])))
            saved(journal, made)
        frame = bare_corrector.frame(FRAME, journal)
    for row in frame.expressions.values():
        strict, likely = expected_sets(frame, row)
        assert (row["targets"], row["acceptable"]) == (strict, likely), row["text"]
        assert row["ambiguous"] == (len(likely) > 1)
        assert row["target_object"] in strict
        assert row["target"] == frame.objects[row["target_object"]]["label"]
    for gone in frame.withdrawn:
        row = frame.auto.expressions[gone.id]
        a, b, relation = row["target_object"], row["reference_object"], row["relation"]
        assert frame.pairs.state(a, b, relation) != T or "carry" in gone.reason


def test_an_expression_that_is_no_longer_true_is_withdrawn_and_said_to_be(
    bare_corrector: Corrector, journal: Journal
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = an_expression(frame)
    a, b = row["target_object"], row["reference_object"]
    saved(journal, edits.set_relation(frame, a, b, row["relation"], F))
    after = bare_corrector.frame(FRAME, journal)
    assert row["id"] not in after.expressions
    assert [w.id for w in after.withdrawn if w.id == row["id"]] == [row["id"]]
    saved(journal, edits.set_answers(after, row["id"], [a], reason="true all the same"), "bob")
    kept = bare_corrector.frame(FRAME, journal)
    assert kept.expressions[row["id"]]["targets"] == [a]
    assert kept.origin(FieldRef("expression", FRAME, row["id"], "targets")).author == "bob"


def test_expressions_take_text_answers_and_marks(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = an_expression(frame)
    other = next(n for n in frame.objects if n != row["target_object"])
    name = row["id"]
    saved(journal, edits.set_text(frame, name, "the thing over there"))
    saved(journal, edits.set_answers(frame, name, [row["target_object"]], [other]))
    saved(journal, edits.set_mark(frame, name, "BAD_BOX"))
    saved(journal, edits.set_note(frame, "look again"))
    after = bare_corrector.frame(FRAME, journal)
    found = after.expressions[name]
    assert found["text"] == "the thing over there"
    assert found["targets"] == [row["target_object"]]
    assert found["acceptable"] == sorted([row["target_object"], other])
    assert found["ambiguous"]
    assert after.marks == {name: "BAD_BOX"}
    assert after.value(FieldRef("frame", FRAME, "", "note")) == "look again"
    saved(journal, edits.set_status(after, FieldRef("expression", FRAME, name, "status"), "rejected"))
    assert name not in bare_corrector.frame(FRAME, journal).expressions


def test_a_class_name_brings_other_sentences(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = an_expression(frame)
    saved(journal, edits.set_class(frame, row["target_object"], "teapot"))
    after = bare_corrector.frame(FRAME, journal).expressions[row["id"]]
    assert after["target"] == "teapot"
    assert "teapot" in after["text"]
    assert after["targets"] == [row["target_object"]]


def test_background_takes_no_part_in_relations(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = an_expression(frame)["target_object"]
    saved(journal, edits.set_class(frame, number, "wall"))
    after = full_corrector.frame(FRAME, journal)
    assert after.pairs.index_of(number) is None
    assert (after.objects[number]["usable"], after.objects[number]["reason"]) == (False, "background")
    assert all(number not in (r["target_object"], r["reference_object"]) for r in after.expressions.values())
    saved(journal, edits.set_class(after, number, frame.objects[number]["label"]))
    again = full_corrector.frame(FRAME, journal)
    for name, table in again.tables().items():
        assert table.equals(frame.tables()[name]), name


def test_a_rejected_object_goes_with_all_that_is_said_of_it_and_comes_back(
    bare_corrector: Corrector, journal: Journal
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    number = an_expression(frame)["reference_object"]
    saved(journal, edits.set_status(frame, object_ref(frame.frame, number, "status"), "rejected"))
    after = bare_corrector.frame(FRAME, journal)
    assert number not in after.objects
    assert after.row["objects"] == len(frame.objects) - 1
    assert after.pairs.index_of(number) is None
    for row in after.expressions.values():
        assert number not in {row["target_object"], row["reference_object"], *row["acceptable"]}
    assert an_expression(frame)["id"] in {w.id for w in after.withdrawn}
    saved(journal, edits.set_status(after, object_ref(FRAME, number, "status"), "accepted"))
    back = bare_corrector.frame(FRAME, journal)
    assert back.tables()["objects"].equals(frame.tables()["objects"])
    assert back.tables()["relations"].equals(frame.tables()["relations"])


def test_a_box_that_a_person_sets_has_no_open_sides(
    full_corrector: Corrector, bare_corrector: Corrector, journal: Journal
) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = next(n for n, row in frame.objects.items() if row["open_sides"])
    box = box_of(frame.objects[number])
    saved(journal, edits.set_box(frame, number, Box3D(box.center, box.R, box.size * 1.2)))
    for corrector in (full_corrector, bare_corrector):
        assert corrector.frame(FRAME, journal).objects[number]["open_sides"] is None
        (entry,) = (o for o in labelled_objects(corrector.frame(FRAME, journal)) if o.id == number)
        assert entry.lifted.open_sides is None
    after = full_corrector.frame(FRAME, journal)
    saved(journal, edits.set_box(after, number, None))
    back = full_corrector.frame(FRAME, journal)
    assert back.objects[number]["open_sides"] == frame.objects[number]["open_sides"]
    (entry,) = (o for o in labelled_objects(back) if o.id == number)
    assert list(entry.lifted.open_sides or ()) == frame.objects[number]["open_sides"]


def test_a_new_mask_brings_points_box_relations_and_answers(
    full_corrector: Corrector, bare_corrector: Corrector, journal: Journal
) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = widest(frame)
    other = next(int(n) for n in frame.pairs.numbers if n != number)
    settled = saved(journal, edits.set_relation(frame, number, other, "near", U))
    left, _ = half_of(frame, number)
    frame = full_corrector.frame(FRAME, journal)
    (event,) = saved(journal, edits.set_mask(frame, number, left, "only this half"), "bob")
    after = full_corrector.frame(FRAME, journal)
    row, was = after.objects[number], frame.objects[number]
    assert row["mask_source"] == "human"
    assert row["mask_pixels"] == int(left.sum())
    assert row["bbox"][2] < was["bbox"][2]
    assert row["points"] < was["points"]
    assert row["hi"][0] < was["hi"][0]
    assert after.origin(object_ref(FRAME, number, "mask")).source == "human"
    box = after.origin(object_ref(FRAME, number, "box"))
    assert (box.source, box.author, box.event) == ("recomputed", "bob", event.ulid)
    moved, human = relation_ref(FRAME, number, other, "left"), relation_ref(FRAME, number, other, "near")
    assert after.origin(moved).source == "recomputed"
    assert (after.value(human), after.origin(human).event) == (U, settled[0].ulid)
    untouched = [n for n in frame.objects if n != number]
    assert all(after.objects[n] == frame.objects[n] for n in untouched)
    same = frame.pairs.of_objects(untouched).states == after.pairs.of_objects(untouched).states
    assert same.all()
    assert (frame.pairs.states != after.pairs.states).any()
    # What is said of a relation is said of the geometry that the person saw, before and after.
    i, j, k = np.argwhere(frame.pairs.states != after.pairs.states)[0]
    pair = int(after.pairs.numbers[i]), int(after.pairs.numbers[j])
    (other_way,) = {T, U, F} - {int(frame.pairs.states[i, j, k]), int(after.pairs.states[i, j, k])}
    saved(journal, edits.set_relation(after, *pair, PAIRWISE[k], other_way))
    said = full_corrector.frame(FRAME, journal)
    assert said.pairs.state(*pair, PAIRWISE[k]) == other_way
    assert said.unapplied == ()
    undo(journal, "bob")
    back = full_corrector.frame(FRAME, journal)
    assert back.objects == frame.objects
    assert back.unapplied
    assert {u.event.ref.field for u in back.unapplied} >= {PAIRWISE[k]}
    undo(journal, "ann")
    saved(journal, edits.set_relation(full_corrector.frame(FRAME, journal), *pair, PAIRWISE[k], other_way))
    redo(journal, "bob")
    kept = full_corrector.frame(FRAME, journal)
    assert kept.objects[number] == row
    assert kept.pairs.state(*pair, PAIRWISE[k]) == other_way
    assert kept.unapplied == ()
    # Without the dataset the same is known to be out of date.
    stale = bare_corrector.frame(FRAME, journal)
    assert stale.objects[number]["mask_pixels"] == int(left.sum())
    assert stale.origin(object_ref(FRAME, number, "box")).source == "stale"
    assert stale.origin(moved).source == "stale"
    assert stale.value(human) == U


def test_objects_are_split_and_merged(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = widest(frame)
    events = saved(journal, edits.split_object(frame, number, half_of(frame, number)))
    apart = full_corrector.frame(FRAME, journal)
    (new,) = apart.objects.keys() - frame.objects.keys()
    assert apart.objects[new]["label"] == frame.objects[number]["label"]
    assert apart.objects[new]["points"] > 0
    assert apart.objects[new]["usable"]
    assert apart.pairs.state(number, new, "left") in (T, U, F)
    assert apart.origin(object_ref(FRAME, new, "label")).event == events[1].ulid
    saved(journal, edits.merge_objects(apart, [number, new]))
    whole = full_corrector.frame(FRAME, journal)
    assert whole.objects.keys() == frame.objects.keys()
    for column in ("mask", "center", "size", "lo", "hi", "points", "bbox"):
        assert same_value(whole.objects[number][column], frame.objects[number][column]), column
    np.testing.assert_array_equal(whole.pairs.states, frame.pairs.states)


def test_a_box_is_moved_with_its_points(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = widest(frame)
    row = frame.objects[number]
    up, size = np.array(frame.row["up"]), np.array(row["size"])
    box = Box3D(np.array(row["center"]) + 0.5 * up, np.array(row["R"]).reshape(3, 3), size)
    saved(journal, edits.set_box(frame, number, box))
    after = full_corrector.frame(FRAME, journal).objects[number]
    assert same_value(after["center"], box.center.tolist())
    np.testing.assert_allclose(np.array(after["lo"]) - row["lo"], [0, 0.5, 0], atol=1e-4)
    np.testing.assert_allclose(np.array(after["hi"]) - row["hi"], [0, 0.5, 0], atol=1e-4)
    assert after["mask"] == row["mask"]
    assert after["bbox"] == row["bbox"]


@pytest.mark.slow
@pytest.mark.parametrize("made_of", ["mask", "bbox", "box"])
def test_a_new_object_is_lifted_from_what_it_is_made_of(
    full_corrector: Corrector, journal: Journal, made_of: str
) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = widest(frame)
    like = frame.objects[number]
    mask, box = half_of(frame, number)[0], box_of({c: like[c] for c in ("center", "R", "size")})
    given: dict[str, Any] = {"mask": {"mask": mask}, "bbox": {"bbox": like["bbox"]}, "box": {"box": box}}[made_of]
    saved(journal, edits.add_object(frame, "teapot", **given))
    after = full_corrector.frame(FRAME, journal)
    (new,) = after.objects.keys() - frame.objects.keys()
    row = after.objects[new]
    assert row["points"] > 100
    assert row["lo"] is not None
    assert row["usable"]
    assert row["mask_source"] == {"mask": "human", "bbox": "box", "box": "box3d"}[made_of]
    if made_of == "box":
        assert same_value(row["center"], like["center"])
    assert after.pairs.present[after.pairs.index_of(new)].sum() == len(after.pairs.numbers) - 1
    for name, table in after.tables().items():
        validate_rows(table, name)
    saved(journal, edits.set_class(after, new, "kettle"))
    assert full_corrector.frame(FRAME, journal).objects[new]["label"] == "kettle"
    undo(journal, "ann")
    undo(journal, "ann")
    assert full_corrector.frame(FRAME, journal).objects.keys() == frame.objects.keys()


def test_edits_of_what_is_not_there_are_refused(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    a, b = (int(n) for n in frame.pairs.numbers[:2])
    for wrong in (
        lambda: edits.set_class(frame, 99_999, "mug"),
        lambda: edits.set_relation(frame, a, a, "left", T),
        lambda: edits.set_relation(frame, a, 99_999, "left", T),
        lambda: edits.set_relation(frame, a, b, "between", T),
        lambda: edits.set_relation(frame, a, b, "left", 5),
        lambda: edits.set_mask(frame, a, np.zeros((3, 4), np.bool_)),
        lambda: edits.set_mask(frame, a, np.zeros((frame.row["height"], frame.row["width"]), np.bool_)),
        lambda: edits.set_bbox(frame, a, [-50, -50, -10, -10]),
        lambda: edits.add_object(frame, "mug"),
        lambda: edits.add_object(frame, "mug", bbox=[0, 0, 9, 9], number=5),
        lambda: edits.merge_objects(frame, [a]),
        lambda: edits.split_object(frame, a, half_of(frame, a)[:1]),
        lambda: edits.set_text(frame, "00ff", "mug left of lamp"),
        lambda: edits.set_answers(frame, an_expression(frame)["id"], []),
        lambda: edits.set_answers(frame, an_expression(frame)["id"], [99_999]),
        lambda: bare_corrector.frame("nowhere", journal),
    ):
        with pytest.raises(InputError):
            wrong()


@pytest.mark.parametrize("state", [U, T])
def test_what_was_ruled_out_can_be_corrected_again(bare_corrector: Corrector, journal: Journal, state: int) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    a, b = (int(n) for n in frame.pairs.numbers[np.argwhere(frame.pairs.states[..., PAIRWISE.index("left")] == T)[0]])
    saved(journal, edits.set_relation(frame, a, b, "left", U))
    undo(journal, "ann")
    saved(journal, edits.set_relation(bare_corrector.frame(FRAME, journal), a, b, "right", T))
    frame = bare_corrector.frame(FRAME, journal)
    assert frame.pairs.state(a, b, "left") == F
    saved(journal, edits.set_relation(frame, a, b, "left", state), "bob")
    frame = bare_corrector.frame(FRAME, journal)
    assert frame.unapplied == ()
    assert frame.pairs.state(a, b, "left") == frame.pairs.state(b, a, "right") == state
    assert frame.origin(relation_ref(FRAME, a, b, "left")).author == "bob"
    undo(journal, "bob")
    assert bare_corrector.frame(FRAME, journal).pairs.state(a, b, "left") == F


def test_pixels_can_be_set_where_they_followed_from_a_2d_box(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = widest(frame)
    half, _ = half_of(frame, number)
    saved(journal, edits.set_mask(frame, number, None))
    frame = full_corrector.frame(FRAME, journal)
    x0, y0, x1, y1 = frame.objects[number]["bbox"]
    saved(journal, edits.set_bbox(frame, number, [x0 + 4, y0 + 4, x1 - 4, y1 - 4]))
    saved(journal, edits.set_mask(full_corrector.frame(FRAME, journal), number, half))
    frame = full_corrector.frame(FRAME, journal)
    assert frame.unapplied == ()
    assert frame.objects[number]["mask_pixels"] == half.sum()
