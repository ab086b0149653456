"""Corrections made elsewhere: what was changed in an export comes back as events, and nothing else does."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from annotation_tools import polygons, through_cvat
from journal_world import FRAME, an_expression, half_of, saved, widest
from slow_cases import mostly_slow

from pipeline.corrections import (
    Corrector,
    FieldRef,
    ImportConfig,
    ImportReport,
    Journal,
    import_corrections,
    import_record,
    materialise,
    object_ref,
    relation_ref,
    undo,
)
from pipeline.corrections.journal import edits
from pipeline.datasets import Dataset
from pipeline.geometry import decode_run_length, encode_run_length
from pipeline.labels import Labels, export_labels, open_labels
from pipeline.language import INVERSE
from pipeline.relations import F, T
from pipeline.system import InputError

Rows = list[dict[str, Any]]


def read(path: Path) -> Rows:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def write(path: Path, rows: Rows) -> Path:
    path.write_text("".join(json.dumps(r) + "\n" for r in rows), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def exported(demo_labels: Labels, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Exports of the demo's automatic labels; not to be changed."""
    folder = tmp_path_factory.mktemp("exported")
    for format in ("coco", "jsonl"):
        export_labels(demo_labels, format, folder / format)
    return folder


@pytest.fixture(scope="module")
def instances(exported: Path) -> Callable[[], dict[str, Any]]:
    text = (exported / "coco" / "instances.json").read_text(encoding="utf-8")
    return lambda: json.loads(text)


Take = Callable[..., ImportReport]


@pytest.fixture
def take(demo_labels: Labels, journal: Journal) -> Take:
    """Import into the journal."""

    def found(path: Path, author: str = "eve", **config: Any) -> ImportReport:
        return import_corrections(demo_labels, journal, path, author, ImportConfig(**config))

    return found


def in_frame(content: dict[str, Any], frame: str = FRAME) -> dict[int, dict[str, Any]]:
    """Annotations of a frame by their object."""
    (image,) = [i["id"] for i in content["images"] if i["frame"] == frame]
    return {a["object"]: a for a in content["annotations"] if a["image_id"] == image}


def put(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("format", ["coco", "jsonl"])
def test_an_export_that_nobody_changed_brings_no_event(exported: Path, take: Take, format: str) -> None:
    report = take(exported / format)
    assert report.compared > 100
    assert (report.edits, report.saved, report.conflicts, report.problems) == ((), None, (), ())
    assert all("not read" in note for note in report.notes)


@pytest.mark.parametrize("format", mostly_slow(["coco", "jsonl"]))
def test_a_corrected_export_that_nobody_changed_brings_no_event(
    demo_labels: Labels,
    full_corrector: Corrector,
    demo_dataset: Dataset,
    journal: Journal,
    take: Take,
    format: str,
    tmp_path: Path,
) -> None:
    frame = full_corrector.frame(FRAME, journal)
    saved(journal, edits.split_object(frame, widest(frame), half_of(frame, widest(frame))))
    row = an_expression(frame)
    pair = row["target_object"], row["reference_object"]
    saved(journal, edits.set_relation(frame, *pair, row["relation"], F))
    saved(journal, edits.set_status(frame, relation_ref(FRAME, *pair, "near.status"), "unsure"))
    saved(journal, edits.set_note(frame, "hm"))
    for name, dataset in (("bare", None), ("full", demo_dataset)):
        materialise(demo_labels, journal, tmp_path / name, dataset=dataset)
        export_labels(open_labels(tmp_path / name), format, tmp_path / f"{name}.out")
    assert take(tmp_path / "bare.out").edits == ()
    with pytest.raises(InputError, match="the dataset is needed"):
        take(tmp_path / "full.out")
    report = import_corrections(demo_labels, journal, tmp_path / "full.out", "eve", open_dataset=lambda: demo_dataset)
    assert (report.edits, report.conflicts, report.problems) == ((), (), ())


def test_edited_jsonl_is_what_the_labels_say_then(
    exported: Path, bare_corrector: Corrector, journal: Journal, take: Take, tmp_path: Path
) -> None:
    before = bare_corrector.frame(FRAME, ())
    row, number = an_expression(before), widest(before)
    a, b, relation = row["target_object"], row["reference_object"], row["relation"]
    free = next(
        e
        for e in before.expressions.values()
        if {a, b, number}.isdisjoint({e["target_object"], e["reference_object"], *e["acceptable"]})
    )
    other = next(n for n in before.objects if n not in {*free["acceptable"], a, b, number})
    objects, relations, expressions, frames = (
        read(exported / "jsonl" / f"{n}.jsonl") for n in ("objects", "relations", "expressions", "frames")
    )
    for r in objects:
        if (r["frame"], r["object"]) == (FRAME, number):
            r |= {"label": "treasure chest", "status": "corrected", "center": [0.5, 0.25, 2.0]}
    objects.append({"frame": FRAME, "label": "lost key", "bbox": [10.0, 20, 30, 44.5], "object": None})
    for r in relations:
        if (r["frame"], r["a"], r["b"]) == (FRAME, a, b):
            r |= {relation: -1, "statuses": [{"relation": relation, "status": "corrected"}]}
    for r in expressions:
        if r["frame"] == FRAME and r["id"] == free["id"]:
            r |= {"text": "the thing over there", "acceptable": [*r["acceptable"], other], "mark": "BAD_LABEL"}
    frames[0] |= {"note": "bright", "status": "accepted"}
    folder = tmp_path / "edited"
    folder.mkdir()
    edited = {"objects": objects, "relations": relations, "expressions": expressions, "frames": frames}
    for name, rows in edited.items():
        write(folder / f"{name}.jsonl", rows)
    report = take(folder)
    assert report.saved is not None, import_record(report)
    assert len({e.group for e in report.saved.events}) == 1
    assert {e.author for e in report.saved.events} == {"eve"}
    now = bare_corrector.frame(FRAME, journal)
    assert now.objects[number]["label"] == "treasure chest"
    assert now.objects[number]["center"] == [0.5, 0.25, 2.0]
    assert now.statuses[object_ref(FRAME, number, "status")] == "corrected"
    (new,) = now.objects.keys() - before.objects.keys()
    assert (now.objects[new]["label"], now.objects[new]["bbox"]) == ("lost key", [10.0, 20.0, 30.0, 44.5])
    assert now.pairs.state(a, b, relation) == F
    assert now.pairs.state(b, a, INVERSE[relation]) == F
    assert now.statuses[relation_ref(FRAME, a, b, f"{relation}.status")] == "corrected"
    changed = now.expressions[free["id"]]
    assert changed["text"] == "the thing over there"
    assert changed["acceptable"] == sorted([*free["acceptable"], other])
    assert changed["ambiguous"] is True
    assert now.marks == {free["id"]: "BAD_LABEL"}
    assert now.statuses[FieldRef("frame", FRAME, "", "note")] == "bright"
    again = take(folder)
    assert (again.edits, again.saved, again.conflicts) == ((), None, ())
    assert again.agreed >= 8
    undo(journal, "eve")
    assert bare_corrector.frame(FRAME, journal).tables()["objects"].equals(before.tables()["objects"])


def test_edited_coco_is_what_the_labels_say_then(
    instances: Callable[[], dict[str, Any]],
    exported: Path,
    bare_corrector: Corrector,
    journal: Journal,
    take: Take,
    tmp_path: Path,
) -> None:
    before = bare_corrector.frame(FRAME, ())
    content = instances()
    found, size = in_frame(content), (before.row["height"], before.row["width"])
    numbers = sorted(before.pairs.numbers.tolist(), key=lambda n: -before.objects[n]["mask_pixels"])
    renamed, redrawn, coded, moved, deleted = numbers[:5]
    content["categories"].append({"id": 999, "name": "samovar"})
    found[renamed]["category_id"] = 999
    found[redrawn]["segmentation"] = [[20, 30, 120, 30, 120.5, 90.25, 20, 90]]
    found[redrawn]["bbox"] = [20, 30, 100.5, 60.25]
    left, _ = half_of(before, coded)
    runs = np.flatnonzero(np.diff(np.concatenate([[0], left.T.ravel().astype(np.int8), [0]])))
    counts = np.diff(np.concatenate([[0], runs, [left.size]])).tolist()
    found[coded]["segmentation"] = {"size": list(size), "counts": counts}
    x0, y0, x1, y1 = before.objects[moved]["bbox"]
    found[moved]["bbox"] = [x0 + 2, y0 + 3, x1 - x0 - 4, y1 - y0 - 5]
    image = found[deleted]["image_id"]
    content["annotations"].remove(found[deleted])
    for k, crowd in ((0, 0), (1, 1)):
        content["annotations"].append({
            "id": 100_000 + k, "image_id": image, "category_id": 999, "bbox": [200, 100, 40, 40], "iscrowd": crowd,
            "segmentation": [[200, 100, 240, 100, 220, 140]],
        })  # fmt: skip
    path = put(tmp_path / "instances.json", content)
    report = take(path, deleted="reject")
    assert report.saved is not None, import_record(report)
    now = bare_corrector.frame(FRAME, journal)
    assert now.objects[renamed]["label"] == "samovar"
    mask = decode_run_length(size, now.objects[redrawn]["mask"])
    assert mask.sum() == pytest.approx(100 * 60, rel=0.03)
    assert mask[31:89, 21:119].all()
    assert (decode_run_length(size, now.objects[coded]["mask"]) == left).all()
    assert now.objects[moved]["bbox"] == pytest.approx([x0 + 2, y0 + 3, x1 - 2, y1 - 2], abs=1e-4)
    assert now.objects[moved]["mask"] == before.objects[moved]["mask"]
    assert set(now.left_out) == {deleted}
    (new,) = now.objects.keys() - before.objects.keys()
    assert now.objects[new]["label"] == "samovar"
    assert {(e.ref.numbers[0], e.ref.field) for e in report.edits} == {
        (renamed, "label"),
        (redrawn, "mask"),
        (coded, "mask"),
        (moved, "bbox"),
        (deleted, "status"),
        (new, "exists"),
    }
    assert take(path, deleted="reject").edits == ()
    assert len(journal.events()) == 6


def test_a_missing_annotation_rejects_nothing_unless_it_is_asked_for(
    instances: Callable[[], dict[str, Any]], bare_corrector: Corrector, journal: Journal, take: Take, tmp_path: Path
) -> None:
    content = instances()
    image = content["images"][0]["id"]
    gone = [a["object"] for a in content["annotations"] if a["image_id"] == image][:2]
    content["annotations"] = [a for a in content["annotations"] if a["image_id"] == image and a["object"] not in gone]
    content["images"] = content["images"][:1]
    path = put(tmp_path / "part.json", content)
    assert take(path).edits == ()
    report = take(path, deleted="reject")
    assert {(e.ref.numbers[0], e.after) for e in report.edits} == {(n, "rejected") for n in gone}
    assert {e.ref.frame for e in journal.events()} == {FRAME}


def test_sentences_and_relations_of_coco_are_named_as_not_read(exported: Path, take: Take) -> None:
    (note,) = take(exported / "coco").notes
    assert "(refs.json, relations.json): 2" in note
    for name in ("refs.json", "relations.json"):
        with pytest.raises(InputError, match="--format jsonl"):
            take(exported / "coco" / name)


def test_two_people_are_both_told_and_nothing_is_overwritten(
    exported: Path, bare_corrector: Corrector, journal: Journal, take: Take, tmp_path: Path
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    one, two, three = frame.pairs.numbers.tolist()[:3]
    saved(journal, edits.set_class(frame, one, "pot"), "bob")
    saved(journal, edits.set_class(frame, two, "samovar"), "bob")
    saved(journal, edits.set_status(frame, object_ref(frame.frame, three, "status"), "rejected"), "bob")
    rows = [r for r in read(exported / "jsonl" / "objects.jsonl") if r["frame"] == FRAME]
    for r in rows:
        # The first contradicts bob, the second says the same; the third is gone. A fourth is nobody's business.
        said = {one: "jug", two: "samovar", three: "cup", rows[-1]["object"]: "lid"}
        r["label"] = said.get(r["object"], r["label"])
    path = write(tmp_path / "objects.jsonl", rows)
    report = take(path)
    assert report.saved is None
    assert report.agreed == 1
    assert len(report.conflicts) == 2
    assert "wanted jug, is pot now: bob corrected it at" in report.conflicts[0]
    assert "objects.jsonl line" in report.conflicts[0]
    assert f"object {three} was rejected since by bob" in report.conflicts[1]
    assert {e.author for e in journal.events()} == {"bob"}
    report = take(path, skip_conflicts=True)
    assert report.saved is not None
    assert [(e.ref.numbers[0], e.after) for e in report.saved.events] == [(rows[-1]["object"], "lid")]
    now = bare_corrector.frame(FRAME, journal)
    assert now.objects[one]["label"] == "pot"
    assert three in now.left_out


def test_fields_that_the_file_left_alone_never_undo_a_newer_correction(
    exported: Path, bare_corrector: Corrector, journal: Journal, take: Take, tmp_path: Path
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    number = int(frame.pairs.numbers[0])
    saved(journal, edits.set_class(frame, number, "pot"), "bob")
    rows = read(exported / "jsonl" / "objects.jsonl")
    for r in rows:
        if (r["frame"], r["object"]) == (FRAME, number):
            r["status"] = "accepted"
    report = take(write(tmp_path / "objects.jsonl", rows))
    assert [(e.ref.field, e.after) for e in report.edits] == [("status", "accepted")]
    assert bare_corrector.frame(FRAME, journal).objects[number]["label"] == "pot"


def test_answers_that_were_recomputed_since_are_not_overwritten(
    exported: Path, bare_corrector: Corrector, journal: Journal, take: Take, tmp_path: Path
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = next(e for e in frame.expressions.values() if len(e["targets"]) > 1)
    other = next(n for n in row["targets"] if n != row["target_object"])
    for reference in frame.pairs.numbers.tolist():
        if frame.pairs.state(other, reference, row["relation"]) == T:
            now = bare_corrector.frame(FRAME, journal)
            saved(journal, edits.set_relation(now, other, reference, row["relation"], F), "bob")
    rows = [r for r in read(exported / "jsonl" / "expressions.jsonl") if (r["frame"], r["id"]) == (FRAME, row["id"])]
    rows[0] |= {"targets": [other], "acceptable": [other]}
    report = take(write(tmp_path / "expressions.jsonl", rows))
    assert report.saved is None
    assert any("it was recomputed since" in line for line in report.conflicts), import_record(report)


def test_what_annotation_tools_write_without_a_change_brings_no_event(
    instances: Callable[[], dict[str, Any]], exported: Path, take: Take, tmp_path: Path
) -> None:
    for kept in (True, False):
        content = through_cvat(instances(), attributes=kept)
        path = put(tmp_path / "annotations.json", content)
        with pytest.raises(InputError, match="not said what the file was exported from"):
            take(path)
        report = take(path, base=str(exported / "coco"))
        assert (report.edits, report.problems, report.conflicts) == ((), (), ())
        assert report.compared == len(content["annotations"])
        assert any("told by where they lie" in n for n in report.notes) is not kept


@pytest.mark.slow
@pytest.mark.parametrize("kept", mostly_slow([True, False]))
def test_what_was_drawn_in_an_annotation_tool_comes_back(
    instances: Callable[[], dict[str, Any]],
    bare_corrector: Corrector,
    journal: Journal,
    take: Take,
    tmp_path: Path,
    kept: bool,
) -> None:
    before = bare_corrector.frame(FRAME, ())
    number, original = widest(before), instances()
    content = through_cvat(original, attributes=kept)
    size = before.row["height"], before.row["width"]
    mask = decode_run_length(size, before.objects[number]["mask"])
    grown = mask.copy()
    grown[:, 8:] |= mask[:, :-8]
    (image,) = [i["id"] for i in content["images"] if i["file_name"].endswith("000000.jpg")]
    was = polygons(mask)
    (drawn,) = [a for a in content["annotations"] if a["image_id"] == image and a["segmentation"] == was]
    drawn["segmentation"] = polygons(grown)
    report = take(put(tmp_path / "annotations.json", content), base="now")
    assert [(e.ref.numbers[0], e.ref.field) for e in report.edits] == [(number, "mask")]
    now = decode_run_length(size, bare_corrector.frame(FRAME, journal).objects[number]["mask"])
    assert (now & grown).sum() / (now | grown).sum() > 0.9


def test_a_dry_run_saves_nothing(
    exported: Path, demo_labels: Labels, journal: Journal, take: Take, tmp_path: Path
) -> None:
    rows = read(exported / "jsonl" / "objects.jsonl")[:3]
    rows[0]["label"] = "jug"
    path = write(tmp_path / "objects.jsonl", rows)
    for report in (
        take(path, dry_run=True),
        import_corrections(demo_labels, None, path, "eve", ImportConfig(dry_run=True)),
    ):
        assert [e.after for e in report.edits] == ["jug"]
        assert report.saved is None
    assert journal.events() == ()


def test_a_mask_that_was_made_again_is_the_same(exported: Path, take: Take, tmp_path: Path) -> None:
    row = read(exported / "jsonl" / "objects.jsonl")[0]
    mask = decode_run_length((480, 640), row["mask"])
    row["mask"] = "0" + encode_run_length(~mask) if mask[0, 0] else encode_run_length(mask)
    assert take(write(tmp_path / "objects.jsonl", [row])).edits == ()
