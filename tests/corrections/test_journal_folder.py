"""Corrected labels as a folder, corrections as a file, and labels that are made again under corrections."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from journal_world import FRAME, an_expression, half_of, saved, widest
from label_sets import validate_rows, write_labels

from pipeline.corrections import (
    Conflict,
    Corrector,
    FieldRef,
    Journal,
    Saved,
    actions_of,
    apply_actions,
    effective_tables,
    journal_of,
    materialise,
    object_ref,
    undo,
)
from pipeline.corrections.journal import edits
from pipeline.corrections.journal.materialise import MARKS_FILE, UNAPPLIED_FILE
from pipeline.datasets import Dataset
from pipeline.labels import PROVENANCE_FILE, TABLES, Labels, check_labels, open_labels, read_cases
from pipeline.relations import F, U
from pipeline.system import InputError


def relabelled(labels: Labels, folder: Path, change: Any) -> Labels:
    """The same labels made again, with other rows: `change` gets the rows of a table and its name."""
    rows = {name: change(name, getattr(labels, name).to_pylist()) for name in TABLES}
    return write_labels(folder, rows)


def test_corrections_outlive_labels_made_again(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, tmp_path: Path
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = an_expression(frame)
    a, b, relation = row["target_object"], row["reference_object"], row["relation"]
    ends = {a, b}
    renamed, gone, another = [int(n) for n in frame.pairs.numbers if n not in ends][:3]
    saved(journal, edits.set_relation(frame, a, b, relation, U))
    saved(journal, edits.set_class(frame, renamed, "teapot"))
    saved(journal, edits.set_class(frame, gone, "kettle"))
    saved(journal, edits.set_class(frame, another, "cup"))
    saved(journal, edits.set_text(frame, row["id"], "that one"))
    taken_back = saved(journal, edits.set_status(frame, object_ref(FRAME, gone, "status"), "accepted"), "bob")
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

    again = relabelled(demo_labels, tmp_path / "again", change)
    found = effective_tables(again, journal)
    because = {(u.event.ref.kind, u.event.ref.key, u.event.ref.field): (u.kind, u.reason) for u in found.unapplied}
    assert because.keys() == {
        ("object", str(renamed), "label"),
        ("object", str(gone), "label"),
        ("object", str(another), "label"),
        ("expression", row["id"], "text"),
    }
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
    saved(journal, edits.set_value(frame, object_ref(FRAME, renamed, "label"), "teapot", "applied again"))
    after = corrector.frame(FRAME, journal)
    assert after.objects[renamed]["label"] == "teapot"
    assert ("object", str(renamed)) not in {(u.event.ref.kind, u.event.ref.key) for u in after.unapplied}


def test_labels_that_agree_by_now_say_so_and_undo_does_not_turn_them_round(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, tmp_path: Path
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    number = int(frame.pairs.numbers[0])
    saved(journal, edits.set_class(frame, number, "teapot"))

    def change(name: str, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        for r in rows:
            if name == "objects" and r["frame"] == FRAME and r["object"] == number:
                r["label"] = "teapot"
        return rows

    again = Corrector(relabelled(demo_labels, tmp_path / "again", change))
    found = again.frame(FRAME, journal)
    assert [u.kind for u in found.unapplied] == ["agreed"]
    assert found.origin(object_ref(FRAME, number, "label")).source == "auto"
    undo(journal, "ann")
    assert again.frame(FRAME, journal).objects[number]["label"] == "teapot"


@pytest.mark.slow
def test_corrected_labels_are_an_ordinary_folder(
    demo_labels: Labels, full_corrector: Corrector, demo_dataset: Dataset, journal: Journal, tmp_path: Path
) -> None:
    frame = full_corrector.frame(FRAME, journal)
    row, number = an_expression(frame), widest(frame)
    a, b = row["target_object"], row["reference_object"]
    saved(journal, edits.set_relation(frame, a, b, row["relation"], F))
    saved(journal, edits.set_mark(frame, row["id"], "BAD_LABEL"))
    saved(journal, edits.split_object(frame, number, half_of(frame, number)))
    rejected = demo_labels.frames.column("frame").to_pylist()[3]
    whole = full_corrector.frame(rejected, journal)
    saved(journal, edits.set_status(whole, FieldRef("frame", rejected, "", "status"), "rejected"))
    out = tmp_path / "corrected"
    manifest, found = materialise(demo_labels, journal, out, dataset=demo_dataset)
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
    assert errors <= {(f.rule, f.frame) for f in check_labels(demo_labels) if f.severity == "error"}
    assert sum(len(c.cases) for c in read_cases(labels, 0, 99)) == labels.expressions.num_rows
    with pytest.raises(InputError, match="new or empty"):
        materialise(demo_labels, journal, out)
    assert not list(tmp_path.glob(".*"))


def test_a_file_of_edits_is_saved_as_one_or_not_at_all(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    a, b = (int(n) for n in frame.pairs.numbers[:2])
    entries: list[dict[str, Any]] = [
        {"edit": "relation", "frame": FRAME, "a": a, "b": b, "relation": "near", "to": "U", "reason": "r"},
        {"edit": "class", "frame": FRAME, "object": a, "to": "teapot"},
        {"edit": "mark", "frame": FRAME, "expression": an_expression(frame)["id"], "to": "BAD_BOX"},
        {"edit": "new", "frame": FRAME, "label": "mug", "bbox": [10, 10, 60, 60]},
        {"edit": "status", "frame": FRAME, "a": a, "b": b, "relation": "left", "to": "unsure"},
    ]
    done = apply_actions(full_corrector, journal, actions_of(entries), "ann")
    assert isinstance(done, Saved)
    assert len({e.group for e in done.events}) == 1
    assert isinstance(apply_actions(full_corrector, journal, actions_of([entries[1]]), "ann"), Saved)
    late = apply_actions(full_corrector, journal, actions_of(entries[:1]), "bob")
    assert isinstance(late, Conflict)
    assert isinstance(apply_actions(full_corrector, journal, actions_of([{**entries[1], "base": 1}]), "bob"), Conflict)
    assert isinstance(apply_actions(full_corrector, journal, actions_of([{**entries[1], "base": 2}]), "bob"), Saved)
    count = len(journal.events())
    for wrong, words in (
        ([], "not empty"),
        ({}, "not empty"),
        ([3], "edit 0 cannot be this; got 3; expected an object"),
        ([entries[0], {"edit": "paint", "frame": FRAME}], r'edit 1\.edit .*; got "paint"; expected one of \'class\', '),
        ([{"frame": FRAME}], r"edit 0\.edit cannot be this; got nothing; expected a value"),
        ([{**entries[1], "object": "1"}], r'edit 0\.object cannot be this; got "1"; expected a whole number'),
        ([{**entries[1], "colour": 1}], r"edit 0\.colour cannot be this; got a field of another name"),
        ([{**entries[0], "to": "X"}], r"edit 0\.to cannot be this; got \"X\"; expected 'T', 'U' or 'F'"),
        ([{"edit": "class", "frame": FRAME}], r"edit 0\.object cannot be this; got nothing; expected a value"),
        ([{"edit": "mask", "frame": FRAME, "object": a, "rectangle": [1]}], r"edit 0\.rectangle cannot be this"),
    ):
        with pytest.raises(InputError, match=words):
            actions_of(wrong)
    absent = actions_of([{**entries[4], "to": None}, {**entries[1], "object": 999}])
    with pytest.raises(InputError, match="edit 1: "):
        apply_actions(full_corrector, journal, absent, "bob")
    assert len(journal.events()) == count


def test_odd_labels_are_corrected_too(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    labels = label_sets["hostile"]
    corrector = Corrector(labels)
    with journal_of(labels, tmp_path / "j.sqlite") as journal:
        frame = corrector.frame("椅/3", journal)
        saved(journal, edits.set_relation(frame, 0, 9, "left", F))
        saved(journal, edits.set_class(frame, 9, "椅子"))
        broken = FieldRef("frame", "broken/1", "", "status")
        saved(journal, edits.set_status(corrector.frame("broken/1", journal), broken, "unsure"))
        nasty = corrector.frame('sp ace/"q",\n#1', journal)
        saved(journal, edits.set_class(nasty, 0, "mug"))
        found = effective_tables(labels, journal)
        materialise(labels, journal, tmp_path / "out")
    for name in TABLES:
        validate_rows(found.tables[name], name)
    assert found.frames.equals(labels.frames)
    assert open_labels(tmp_path / "out").objects.num_rows == labels.objects.num_rows
