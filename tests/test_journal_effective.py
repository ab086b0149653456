"""Effective labels: automatic labels plus the journal, what follows, and where each value comes from."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from label_sets import write_labels

from pipeline.boxes import Box3D
from pipeline.datasets import Dataset
from pipeline.errors import InputError
from pipeline.evaluation.cases import read_cases
from pipeline.jobs import open_source
from pipeline.journal import edits
from pipeline.journal.batch import actions_of, apply_actions
from pipeline.journal.cells import Cell, box_of, object_cell, relation_cell, same_value
from pipeline.journal.effective import Corrector, effective_tables
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Conflict, Event, Saved
from pipeline.journal.journal import Journal, journal_of, open_journal
from pipeline.journal.materialise import MARKS_FILE, UNAPPLIED_FILE, materialise
from pipeline.journal.undo import undo
from pipeline.labels.check import check_labels
from pipeline.labels.corrections import PROVENANCE_FILE
from pipeline.labels.reading import Labels, open_labels
from pipeline.labels.schema import TABLES
from pipeline.labels.tables import validate_rows
from pipeline.naming import same_class
from pipeline.relations import PAIRWISE, F, T, U
from pipeline.run_length import decode_run_length

FRAME = "000001/000000"


@pytest.fixture(scope="module")
def demo(label_sets: dict[str, Labels]) -> Labels:
    return label_sets["demo"]


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return open_source("demo", srm="rule").dataset


@pytest.fixture(scope="module")
def bare(demo: Labels) -> Corrector:
    """Without the dataset."""
    return Corrector(demo)


@pytest.fixture(scope="module")
def full(demo: Labels, dataset: Dataset) -> Corrector:
    """With the dataset."""
    return Corrector(demo, dataset)


@pytest.fixture
def journal(demo: Labels, tmp_path: Path) -> Iterator[Journal]:
    with journal_of(demo, tmp_path / "j.sqlite") as opened:
        yield opened


def saved(journal: Journal, made: tuple[Any, ...], author: str = "ann") -> tuple[Event, ...]:
    done = journal.append(made, author)
    assert isinstance(done, Saved), done
    return done.events


def an_expression(frame: EffectiveFrame) -> dict[str, Any]:
    """One of a directional relation."""
    return next(row for row in frame.expressions.values() if row["relation"] in ("left", "right", "front", "behind"))


def test_labels_without_corrections_are_themselves(demo: Labels, full: Corrector, journal: Journal) -> None:
    found = effective_tables(demo, journal)
    for name in TABLES:
        assert found.tables[name].equals(getattr(demo, name)), name
    assert found.provenance.num_rows == 0
    frame = full.frame(FRAME, journal)
    for name, table in frame.tables().items():
        first, stop = full.index.span(name, frame.auto.index)
        assert table.cast(full.index.tables[name].schema).equals(getattr(demo, name).slice(first, stop - first)), name
    assert frame.origin(relation_cell(FRAME, 0, 1, "left")).source == "auto"
    assert "viewer-cone-v1" in str(frame.origin(relation_cell(FRAME, 0, 1, "left")))


def test_lifting_anew_without_a_correction_changes_nothing(full: Corrector, journal: Journal) -> None:
    auto = full.frame(FRAME, journal).auto
    assert full.relifter is not None
    rows, pairs = full.relifter(auto, auto.objects, {}, ())
    for number, row in rows.items():
        assert {k: v for k, v in row.items() if not same_value(v, auto.objects[number][k])} == {}
    np.testing.assert_array_equal(pairs.states, auto.pairs.states)
    np.testing.assert_allclose(pairs.margins, auto.pairs.margins, atol=1e-6)


def test_a_relation_takes_its_inverse_and_what_it_rules_out_with_it(bare: Corrector, journal: Journal) -> None:
    frame = bare.frame(FRAME, journal)
    left = PAIRWISE.index("left")
    i, j = np.argwhere(frame.pairs.states[..., left] == T)[0]
    a, b = int(frame.pairs.numbers[i]), int(frame.pairs.numbers[j])
    events = saved(journal, edits.set_relation(frame, a, b, "right", T, "the mirror"))
    assert {(e.cell.key, e.cell.field, e.after) for e in events} == {(f"{a},{b}", "right", T), (f"{b},{a}", "left", T)}
    after = bare.frame(FRAME, journal)
    assert after.pairs.state(a, b, "right") == after.pairs.state(b, a, "left") == T
    # T of left(a, b) was the labeller's: the person ruled it out.
    assert after.pairs.state(a, b, "left") == after.pairs.state(b, a, "right") == F
    assert after.origin(relation_cell(FRAME, a, b, "right")).source == "human"
    assert after.origin(relation_cell(FRAME, a, b, "right")).author == "ann"
    ruled_out = after.origin(relation_cell(FRAME, a, b, "left"))
    assert (ruled_out.source, ruled_out.event) == ("recomputed", events[0].ulid)
    undo(journal, "ann")
    again = bare.frame(FRAME, journal)
    for name, table in again.tables().items():
        assert table.equals(frame.tables()[name]), name
    assert again.origin(relation_cell(FRAME, a, b, "right")).source == "auto"


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
def test_answers_follow_from_relations_and_classes(data: st.DataObject, bare: Corrector, tmp_path_factory: Any) -> None:
    with open_journal(tmp_path_factory.mktemp("j") / "j.sqlite") as journal:
        for _ in range(data.draw(st.integers(1, 3))):
            frame = bare.frame(FRAME, journal)
            row = data.draw(st.sampled_from(sorted(frame.expressions.values(), key=lambda r: r["id"])))
            if data.draw(st.booleans()):
                others = [n for n, o in frame.objects.items() if n != row["reference_object"]]
                a, state = data.draw(st.sampled_from(others)), data.draw(st.sampled_from([T, U, F]))
                made = edits.set_relation(frame, a, row["reference_object"], row["relation"], state)
            else:
                number = data.draw(st.sampled_from(sorted(frame.objects)))
                made = edits.set_class(frame, number, data.draw(st.sampled_from(["mug", "lamp", row["target"]])))
            saved(journal, made)
        frame = bare.frame(FRAME, journal)
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


def test_an_expression_that_is_no_longer_true_is_withdrawn_and_said_to_be(bare: Corrector, journal: Journal) -> None:
    frame = bare.frame(FRAME, journal)
    row = an_expression(frame)
    a, b = row["target_object"], row["reference_object"]
    saved(journal, edits.set_relation(frame, a, b, row["relation"], F))
    after = bare.frame(FRAME, journal)
    assert row["id"] not in after.expressions
    assert [w.id for w in after.withdrawn if w.id == row["id"]] == [row["id"]]
    saved(journal, edits.set_answers(after, row["id"], [a], reason="true all the same"), "bob")
    kept = bare.frame(FRAME, journal)
    assert kept.expressions[row["id"]]["targets"] == [a]
    assert kept.origin(Cell("expression", FRAME, row["id"], "targets")).author == "bob"


def test_expressions_take_text_answers_and_marks(bare: Corrector, journal: Journal) -> None:
    frame = bare.frame(FRAME, journal)
    row = an_expression(frame)
    other = next(n for n in frame.objects if n != row["target_object"])
    name = row["id"]
    saved(journal, edits.set_text(frame, name, "the thing over there"))
    saved(journal, edits.set_answers(frame, name, [row["target_object"]], [other]))
    saved(journal, edits.set_mark(frame, name, "BAD_BOX"))
    saved(journal, edits.set_note(frame, "look again"))
    after = bare.frame(FRAME, journal)
    found = after.expressions[name]
    assert found["text"] == "the thing over there"
    assert found["targets"] == [row["target_object"]]
    assert found["acceptable"] == sorted([row["target_object"], other])
    assert found["ambiguous"]
    assert after.marks == {name: "BAD_BOX"}
    assert after.value(Cell("frame", FRAME, "", "note")) == "look again"
    saved(journal, edits.set_status(after, Cell("expression", FRAME, name, "status"), "rejected"))
    assert name not in bare.frame(FRAME, journal).expressions


def test_a_class_name_brings_other_sentences(bare: Corrector, journal: Journal) -> None:
    frame = bare.frame(FRAME, journal)
    row = an_expression(frame)
    saved(journal, edits.set_class(frame, row["target_object"], "teapot"))
    after = bare.frame(FRAME, journal).expressions[row["id"]]
    assert after["target"] == "teapot"
    assert "teapot" in after["text"]
    assert after["targets"] == [row["target_object"]]


def test_background_takes_no_part_in_relations(full: Corrector, journal: Journal) -> None:
    frame = full.frame(FRAME, journal)
    number = an_expression(frame)["target_object"]
    saved(journal, edits.set_class(frame, number, "wall"))
    after = full.frame(FRAME, journal)
    assert after.pairs.place(number) is None
    assert (after.objects[number]["usable"], after.objects[number]["reason"]) == (False, "background")
    assert all(number not in (r["target_object"], r["reference_object"]) for r in after.expressions.values())
    saved(journal, edits.set_class(after, number, frame.objects[number]["label"]))
    again = full.frame(FRAME, journal)
    for name, table in again.tables().items():
        assert table.equals(frame.tables()[name]), name


def test_a_rejected_object_goes_with_all_that_is_said_of_it_and_comes_back(bare: Corrector, journal: Journal) -> None:
    frame = bare.frame(FRAME, journal)
    number = an_expression(frame)["reference_object"]
    saved(journal, edits.remove_object(frame, number))
    after = bare.frame(FRAME, journal)
    assert number not in after.objects
    assert after.row["objects"] == len(frame.objects) - 1
    assert after.pairs.place(number) is None
    for row in after.expressions.values():
        assert number not in {row["target_object"], row["reference_object"], *row["acceptable"]}
    assert an_expression(frame)["id"] in {w.id for w in after.withdrawn}
    saved(journal, edits.set_status(after, object_cell(FRAME, number, "status"), "accepted"))
    back = bare.frame(FRAME, journal)
    assert back.tables()["objects"].equals(frame.tables()["objects"])
    assert back.tables()["relations"].equals(frame.tables()["relations"])


def half_of(frame: EffectiveFrame, number: int) -> tuple[np.ndarray, np.ndarray]:
    """The left and the right half of an object's pixels."""
    mask = decode_run_length((frame.row["height"], frame.row["width"]), frame.objects[number]["mask"])
    columns = np.flatnonzero(mask.any(axis=0))
    left = mask.copy()
    left[:, columns[len(columns) // 2] :] = False
    return left, mask & ~left


def widest(frame: EffectiveFrame) -> int:
    return max(frame.pairs.numbers.tolist(), key=lambda n: frame.objects[n]["mask_pixels"])


def test_a_new_mask_brings_points_box_relations_and_answers(
    full: Corrector, bare: Corrector, journal: Journal
) -> None:
    frame = full.frame(FRAME, journal)
    number = widest(frame)
    other = next(int(n) for n in frame.pairs.numbers if n != number)
    settled = saved(journal, edits.set_relation(frame, number, other, "near", U))
    left, _ = half_of(frame, number)
    frame = full.frame(FRAME, journal)
    (event,) = saved(journal, edits.set_mask(frame, number, left, "only this half"), "bob")
    after = full.frame(FRAME, journal)
    row, was = after.objects[number], frame.objects[number]
    assert row["mask_source"] == "human"
    assert row["mask_pixels"] == int(left.sum())
    assert row["bbox"][2] < was["bbox"][2]
    assert row["points"] < was["points"]
    assert row["hi"][0] < was["hi"][0]
    assert after.origin(object_cell(FRAME, number, "mask")).source == "human"
    box = after.origin(object_cell(FRAME, number, "box"))
    assert (box.source, box.author, box.event) == ("recomputed", "bob", event.ulid)
    moved, human = relation_cell(FRAME, number, other, "left"), relation_cell(FRAME, number, other, "near")
    assert after.origin(moved).source == "recomputed"
    assert (after.value(human), after.origin(human).event) == (U, settled[0].ulid)
    untouched = [n for n in frame.objects if n != number]
    assert all(after.objects[n] == frame.objects[n] for n in untouched)
    same = frame.pairs.of_objects(untouched).states == after.pairs.of_objects(untouched).states
    assert same.all()
    assert (frame.pairs.states != after.pairs.states).any()
    # Without the dataset the same is known to be out of date.
    stale = bare.frame(FRAME, journal)
    assert stale.objects[number]["mask_pixels"] == int(left.sum())
    assert stale.origin(object_cell(FRAME, number, "box")).source == "stale"
    assert stale.origin(moved).source == "stale"
    assert stale.value(human) == U


def test_objects_are_split_and_merged(full: Corrector, journal: Journal) -> None:
    frame = full.frame(FRAME, journal)
    number = widest(frame)
    events = saved(journal, edits.split_object(frame, number, half_of(frame, number)))
    apart = full.frame(FRAME, journal)
    (new,) = apart.objects.keys() - frame.objects.keys()
    assert apart.objects[new]["label"] == frame.objects[number]["label"]
    assert apart.objects[new]["points"] > 0
    assert apart.objects[new]["usable"]
    assert apart.pairs.state(number, new, "left") in (T, U, F)
    assert apart.origin(object_cell(FRAME, new, "label")).event == events[1].ulid
    saved(journal, edits.merge_objects(apart, [number, new]))
    whole = full.frame(FRAME, journal)
    assert whole.objects.keys() == frame.objects.keys()
    for column in ("mask", "center", "size", "lo", "hi", "points", "bbox"):
        assert same_value(whole.objects[number][column], frame.objects[number][column]), column
    np.testing.assert_array_equal(whole.pairs.states, frame.pairs.states)


def test_a_box_is_moved_with_its_points(full: Corrector, journal: Journal) -> None:
    frame = full.frame(FRAME, journal)
    number = widest(frame)
    row = frame.objects[number]
    up, size = np.array(frame.row["up"]), np.array(row["size"])
    box = Box3D(np.array(row["center"]) + 0.5 * up, np.array(row["R"]).reshape(3, 3), size)
    saved(journal, edits.set_box(frame, number, box))
    after = full.frame(FRAME, journal).objects[number]
    assert same_value(after["center"], box.center.tolist())
    np.testing.assert_allclose(np.array(after["lo"]) - row["lo"], [0, 0.5, 0], atol=1e-4)
    np.testing.assert_allclose(np.array(after["hi"]) - row["hi"], [0, 0.5, 0], atol=1e-4)
    assert after["mask"] == row["mask"]
    assert after["bbox"] == row["bbox"]


@pytest.mark.parametrize("made_of", ["mask", "bbox", "box"])
def test_a_new_object_is_lifted_from_what_it_is_made_of(full: Corrector, journal: Journal, made_of: str) -> None:
    frame = full.frame(FRAME, journal)
    number = widest(frame)
    like = frame.objects[number]
    mask, box = half_of(frame, number)[0], box_of({c: like[c] for c in ("center", "R", "size")})
    given: dict[str, Any] = {"mask": {"mask": mask}, "bbox": {"bbox": like["bbox"]}, "box": {"box": box}}[made_of]
    saved(journal, edits.add_object(frame, "teapot", **given))
    after = full.frame(FRAME, journal)
    (new,) = after.objects.keys() - frame.objects.keys()
    row = after.objects[new]
    assert row["points"] > 100
    assert row["lo"] is not None
    assert row["usable"]
    assert row["mask_source"] == {"mask": "human", "bbox": "box", "box": "box3d"}[made_of]
    if made_of == "box":
        assert same_value(row["center"], like["center"])
    assert after.pairs.present[after.pairs.place(new)].sum() == len(after.pairs.numbers) - 1
    for name, table in after.tables().items():
        validate_rows(table, name)
    saved(journal, edits.set_class(after, new, "kettle"))
    assert full.frame(FRAME, journal).objects[new]["label"] == "kettle"
    undo(journal, "ann")
    undo(journal, "ann")
    assert full.frame(FRAME, journal).objects.keys() == frame.objects.keys()


def test_edits_of_what_is_not_there_are_refused(bare: Corrector, journal: Journal) -> None:
    frame = bare.frame(FRAME, journal)
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
        lambda: bare.frame("nowhere", journal),
    ):
        with pytest.raises(InputError):
            wrong()


def relabelled(labels: Labels, folder: Path, change: Any) -> Labels:
    """The same labels made again, with other rows: `change` gets the rows of a table and its name."""
    rows = {name: change(name, getattr(labels, name).to_pylist()) for name in TABLES}
    return write_labels(folder, rows)


def test_corrections_outlive_labels_made_again(demo: Labels, bare: Corrector, journal: Journal, tmp_path: Path) -> None:
    frame = bare.frame(FRAME, journal)
    row = an_expression(frame)
    a, b, relation = row["target_object"], row["reference_object"], row["relation"]
    ends = {a, b}
    renamed, gone, another = [int(n) for n in frame.pairs.numbers if n not in ends][:3]
    saved(journal, edits.set_relation(frame, a, b, relation, U))
    saved(journal, edits.set_class(frame, renamed, "teapot"))
    saved(journal, edits.set_class(frame, gone, "kettle"))
    saved(journal, edits.set_class(frame, another, "cup"))
    saved(journal, edits.set_text(frame, row["id"], "that one"))
    taken_back = saved(journal, edits.set_status(frame, object_cell(FRAME, gone, "status"), "accepted"), "bob")
    undo(journal, "bob")

    def change(name: str, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        here = [r for r in rows if r["frame"] == FRAME]
        if name == "objects":
            for r in here:
                if r["object"] == renamed:
                    r["label"] = "bowl"
                if r["object"] == another:
                    r["bbox"] = [0.0, 0.0, 3.0, 3.0]
            return [r for r in rows if r["frame"] != FRAME or r["object"] != gone]
        if name == "relations":
            return [r for r in rows if r["frame"] != FRAME or gone not in (r["a"], r["b"])]
        if name == "expressions":
            return [r for r in rows if r["frame"] != FRAME]
        return rows

    again = relabelled(demo, tmp_path / "again", change)
    found = effective_tables(again, journal)
    because = {(u.event.cell.kind, u.event.cell.key, u.event.cell.field): (u.kind, u.reason) for u in found.unapplied}
    assert because.keys() == {
        ("object", str(renamed), "label"), ("object", str(gone), "label"), ("object", str(another), "label"),
        ("expression", row["id"], "text"),
    }  # fmt: skip
    assert because["object", str(renamed), "label"][0] == "changed"
    assert "bowl" in because["object", str(renamed), "label"][1]
    assert because["object", str(gone), "label"][0] == "gone"
    assert "another thing" in because["object", str(another), "label"][1]
    assert taken_back[0].ulid not in {u.event.ulid for u in found.unapplied}
    corrector = Corrector(again)
    frame = corrector.frame(FRAME, journal)
    assert frame.pairs.state(a, b, relation) == U
    assert frame.objects[renamed]["label"] == "bowl"
    # What was seen to be out of date is corrected again, on what the labels say now.
    saved(journal, edits.reapply(frame, object_cell(FRAME, renamed, "label"), "teapot"))
    after = corrector.frame(FRAME, journal)
    assert after.objects[renamed]["label"] == "teapot"
    assert ("object", str(renamed)) not in {(u.event.cell.kind, u.event.cell.key) for u in after.unapplied}


def test_labels_that_agree_by_now_say_so_and_undo_does_not_turn_them_round(
    demo: Labels, bare: Corrector, journal: Journal, tmp_path: Path
) -> None:
    frame = bare.frame(FRAME, journal)
    number = int(frame.pairs.numbers[0])
    saved(journal, edits.set_class(frame, number, "teapot"))

    def change(name: str, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        for r in rows:
            if name == "objects" and r["frame"] == FRAME and r["object"] == number:
                r["label"] = "teapot"
        return rows

    again = Corrector(relabelled(demo, tmp_path / "again", change))
    found = again.frame(FRAME, journal)
    assert [u.kind for u in found.unapplied] == ["agreed"]
    assert found.origin(object_cell(FRAME, number, "label")).source == "auto"
    undo(journal, "ann")
    assert again.frame(FRAME, journal).objects[number]["label"] == "teapot"


def test_corrected_labels_are_an_ordinary_folder(
    demo: Labels, full: Corrector, dataset: Dataset, journal: Journal, tmp_path: Path
) -> None:
    frame = full.frame(FRAME, journal)
    row, number = an_expression(frame), widest(frame)
    a, b = row["target_object"], row["reference_object"]
    saved(journal, edits.set_relation(frame, a, b, row["relation"], F))
    saved(journal, edits.set_mark(frame, row["id"], "BAD_LABEL"))
    saved(journal, edits.split_object(frame, number, half_of(frame, number)))
    rejected = demo.frames.column("frame").to_pylist()[3]
    saved(journal, edits.set_status(full.frame(rejected, journal), Cell("frame", rejected, "", "status"), "rejected"))
    out = tmp_path / "corrected"
    manifest, found = materialise(demo, journal, out, dataset=dataset)
    labels = open_labels(out)
    assert labels.manifest == manifest
    assert manifest.corrections is not None
    assert manifest.corrections["events"] == 6
    assert manifest.corrections["stale"] == 0
    assert manifest.corrections["objects"] == 2
    assert rejected not in labels.frames.column("frame").to_pylist()
    for name in TABLES:
        validate_rows(getattr(labels, name), name)
        assert getattr(labels, name).cast(found.tables[name].schema).equals(found.tables[name])
    marks = json.loads((out / MARKS_FILE).read_text())
    assert marks == [{"frame": FRAME, "id": row["id"], "mark": "BAD_LABEL"}]
    withdrawn = json.loads((out / UNAPPLIED_FILE).read_text())["expressions"]
    assert row["id"] in {w["id"] for w in withdrawn}
    assert (out / PROVENANCE_FILE).is_file()
    # The linter finds no more errors than before: a person's word is not held against the rules.
    errors = {(f.rule, f.frame) for f in check_labels(labels) if f.severity == "error"}
    assert errors <= {(f.rule, f.frame) for f in check_labels(demo) if f.severity == "error"}
    assert sum(len(c.cases) for c in read_cases(labels, 0, 99)) == labels.expressions.num_rows
    with pytest.raises(InputError, match="new or empty"):
        materialise(demo, journal, out)
    assert not list(tmp_path.glob(".*"))


def test_a_file_of_edits_is_saved_as_one_or_not_at_all(full: Corrector, journal: Journal) -> None:
    frame = full.frame(FRAME, journal)
    a, b = (int(n) for n in frame.pairs.numbers[:2])
    entries: list[dict[str, Any]] = [
        {"edit": "relation", "frame": FRAME, "a": a, "b": b, "relation": "near", "to": "U", "reason": "r"},
        {"edit": "class", "frame": FRAME, "object": a, "to": "teapot"},
        {"edit": "mark", "frame": FRAME, "expression": an_expression(frame)["id"], "to": "BAD_BOX"},
        {"edit": "new", "frame": FRAME, "label": "mug", "bbox": [10, 10, 60, 60]},
        {"edit": "status", "frame": FRAME, "a": a, "b": b, "relation": "left", "to": "unsure"},
    ]
    done = apply_actions(full, journal, actions_of(entries), "ann")
    assert isinstance(done, Saved)
    assert len({e.group for e in done.events}) == 1
    assert isinstance(apply_actions(full, journal, actions_of([entries[1]]), "ann"), Saved)
    late = apply_actions(full, journal, actions_of(entries[:1]), "bob")
    assert isinstance(late, Conflict)
    assert isinstance(apply_actions(full, journal, actions_of([{**entries[1], "base": 1}]), "bob"), Conflict)
    assert isinstance(apply_actions(full, journal, actions_of([{**entries[1], "base": 2}]), "bob"), Saved)
    count = len(journal.events())
    for wrong in (
        [], {}, [entries[0], {"edit": "paint", "frame": FRAME}], [{**entries[1], "object": "1"}],
        [{**entries[1], "colour": 1}], [{**entries[0], "to": "X"}], [{"edit": "class", "frame": FRAME}],
    ):  # fmt: skip
        with pytest.raises(InputError):
            actions_of(wrong)
    with pytest.raises(InputError, match="edit 1: "):
        apply_actions(full, journal, actions_of([{**entries[4], "to": None}, {**entries[1], "object": 999}]), "bob")
    assert len(journal.events()) == count


def test_odd_labels_are_corrected_too(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    labels = label_sets["hostile"]
    corrector = Corrector(labels)
    with journal_of(labels, tmp_path / "j.sqlite") as journal:
        frame = corrector.frame("椅/3", journal)
        saved(journal, edits.set_relation(frame, 0, 9, "left", F))
        saved(journal, edits.set_class(frame, 9, "椅子"))
        saved(journal, edits.set_status(corrector.frame("broken/1", journal), Cell("frame", "broken/1", "", "status"),
                                        "unsure"))  # fmt: skip
        nasty = corrector.frame('sp ace/"q",\n#1', journal)
        saved(journal, edits.set_class(nasty, 0, "mug"))
        found = effective_tables(labels, journal)
        materialise(labels, journal, tmp_path / "out")
    for name in TABLES:
        validate_rows(found.tables[name], name)
    assert found.frames.equals(labels.frames)
    assert open_labels(tmp_path / "out").objects.num_rows == labels.objects.num_rows
