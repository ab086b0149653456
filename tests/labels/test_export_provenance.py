"""Exports of corrected labels: every format says of its rows whose values they are, and of what state they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from export_readers import import_labels
from journal_world import FRAME, an_expression, saved

from pipeline.corrections import Corrector, FieldRef, Journal, materialise, object_ref, relation_ref
from pipeline.corrections.journal import edits
from pipeline.labels import TABLES, ExportedFrom, Labels, export_labels, labels_version, open_labels
from pipeline.labels.exports.base import ENTRY, REVIEWED, extended_schema
from pipeline.relations import F
from pipeline.system import InputError


@pytest.fixture(scope="module")
def corrected(demo_labels: Labels, bare_corrector: Corrector, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Labels with a renamed object, a flipped relation, marks, statuses and a note, and their events."""
    from pipeline.corrections import journal_of

    folder = tmp_path_factory.mktemp("corrected")
    with journal_of(demo_labels, folder / "j.sqlite") as journal:
        frame = bare_corrector.frame(FRAME, journal)
        row = an_expression(frame)
        a, b = row["target_object"], row["reference_object"]
        other = next(n for n in frame.pairs.numbers.tolist() if n not in (a, b))
        quiet = next(
            e
            for e in frame.expressions.values()
            if {e["target_object"], e["reference_object"]}.isdisjoint({a, b, other})
        )
        events = [
            *saved(journal, edits.set_class(frame, other, "samovar", "has a spout")),
            *saved(journal, edits.set_relation(frame, a, b, row["relation"], F), "bob"),
            *saved(journal, edits.set_mark(frame, quiet["id"], "BAD_BOX")),
            *saved(journal, edits.set_status(frame, object_ref(FRAME, a, "status"), "accepted")),
            *saved(journal, edits.set_status(frame, FieldRef("frame", FRAME, "", "status"), "unsure")),
            *saved(journal, edits.set_note(frame, "check the lamp")),
            *saved(journal, edits.set_status(frame, relation_ref(FRAME, a, b, "near.status"), "accepted")),
            *saved(journal, edits.judge_relation(frame, a, other, "near", F, "ann")),
            *saved(journal, edits.set_status(frame, object_ref(FRAME, other, "status"), "unsure", author="ann")),
        ]
        materialise(demo_labels, journal, folder / "labels")
    return open_labels(folder / "labels"), events, {"a": a, "b": b, "other": other, "quiet": quiet["id"], "row": row}


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def by_column(row: dict[str, Any]) -> dict[str, dict[str, Any]]:
    assert all(list(entry) == list(ENTRY) for entry in row["provenance"])
    return {entry["column"]: entry for entry in row["provenance"]}


def check_rows(tables: dict[str, list[dict[str, Any]]], events: list[Any], ids: dict[str, Any], base: str) -> None:
    """Whatever the format: what was corrected says by whom and when, and nothing else says anything."""
    for rows in tables.values():
        assert {r["base"] for r in rows} == {base}
        assert len({r["made_by"] for r in rows}) == 1
    (renamed,) = [r for r in tables["objects"] if r["frame"] == FRAME and r["object"] == ids["other"]]
    label = by_column(renamed)["label"]
    assert renamed["label"] == "samovar"
    assert (label["source"], label["author"], label["event"]) == ("human", "ann", events[0].ulid)
    assert label["time"] == events[0].time.isoformat()
    assert label["reason"] == "has a spout"
    assert json.loads(label["was"]) != "samovar"
    (flipped,) = [r for r in tables["relations"] if (r["frame"], r["a"], r["b"]) == (FRAME, ids["a"], ids["b"])]
    relation = by_column(flipped)[ids["row"]["relation"]]
    assert (relation["source"], relation["author"], relation["was"]) == ("human", "bob", "1")
    assert flipped["statuses"] == [{"relation": "near", "status": "accepted"}]
    (marked,) = [r for r in tables["expressions"] if r["frame"] == FRAME and r["id"] == ids["quiet"]]
    assert marked["mark"] == "BAD_BOX"
    assert sum(r["mark"] is not None for r in tables["expressions"]) == 1
    reworded = [r for r in tables["expressions"] if "samovar" in (r["target"], r["reference"])]
    assert reworded
    assert all(by_column(r)["text"]["source"] == "recomputed" for r in reworded)
    (whole,) = [r for r in tables["frames"] if r["frame"] == FRAME]
    assert (whole["status"], whole["note"]) == ("unsure", "check the lamp")
    assert [r["object"] for r in tables["objects"] if r["status"] == "accepted"] == [ids["a"]]
    for name, rows in tables.items():
        assert not any(r["provenance"] for r in rows if r["frame"] != FRAME), name


def test_rows_of_jsonl_and_parquet(corrected: Any, tmp_path: Path) -> None:
    labels, events, ids = corrected
    base = f"{labels.manifest.corrections['automatic']}.{events[-1].ulid}.0"
    export_labels(labels, "jsonl", tmp_path / "jsonl")
    check_rows({n: lines(tmp_path / "jsonl" / f"{n}.jsonl") for n in TABLES}, events, ids, base)
    export_labels(labels, "parquet", tmp_path / "hub")
    tables = {n: pq.read_table(next((tmp_path / "hub" / "data" / n).iterdir())) for n in TABLES}
    assert all(table.schema.equals(extended_schema(name)) for name, table in tables.items())
    check_rows({name: table.to_pylist() for name, table in tables.items()}, events, ids, base)
    card = (tmp_path / "hub" / "README.md").read_text(encoding="utf-8")
    assert "No person has checked" not in card
    assert f"People corrected {labels.manifest.corrections['human']} values" in card
    jsonschema = pytest.importorskip("jsonschema")
    for name in TABLES:
        schema = json.loads((tmp_path / "jsonl" / "schemas" / f"{name}.json").read_text(encoding="utf-8"))
        validator = jsonschema.Draft202012Validator(schema)
        for row in lines(tmp_path / "jsonl" / f"{name}.jsonl"):
            if row["frame"] == FRAME and (row["provenance"] or name != "relations"):
                validator.validate(row)


@pytest.mark.slow
def test_coco_kitti_and_questions(corrected: Any, tmp_path: Path) -> None:
    labels, events, ids = corrected
    for format in ("coco", "kitti", "vqa"):
        export_labels(labels, format, tmp_path / format)
    instances = json.loads((tmp_path / "coco/instances.json").read_bytes())
    (image,) = [i for i in instances["images"] if i["frame"] == FRAME]
    assert (image["spatialviz"]["status"], image["spatialviz"]["note"]) == ("unsure", "check the lamp")
    found = {a["object"]: a for a in instances["annotations"] if a["image_id"] == image["id"]}
    assert by_column(found[ids["other"]])["label"]["event"] == events[0].ulid
    assert found[ids["a"]]["status"] == "accepted"
    assert found[ids["a"]]["attributes"] == {"object": ids["a"]}
    refs = json.loads((tmp_path / "coco/refs.json").read_bytes())
    assert [r["id"] for r in refs if r["mark"]] == [ids["quiet"]]
    relations = json.loads((tmp_path / "coco/relations.json").read_bytes())
    (pairs,) = [i for i in relations["images"] if i["image_id"] == image["id"]]
    pair = {"a": found[ids["a"]]["id"], "b": found[ids["b"]]["id"]}
    assert pairs["statuses"] == [{**pair, "relation": "near", "status": "accepted"}]
    flipped = [e for e in pairs["provenance"] if e["column"] == ids["row"]["relation"] and e["source"] == "human"]
    assert [{"a": e["a"], "b": e["b"]} for e in flipped] == [pair]

    beside = lines(tmp_path / "kitti/provenance.jsonl")
    samovars = [r for r in beside if "label" in by_column(r)]
    assert [(r["frame"], r["object"]) for r in samovars] == [(FRAME, ids["other"])]
    written = (tmp_path / "kitti" / "label_2" / f"{samovars[0]['index']:06d}.txt").read_text().splitlines()
    assert written[samovars[0]["line"] - 1].startswith("samovar ")
    assert len(beside) == labels.objects.num_rows

    questions = json.loads((tmp_path / "vqa/conversations.json").read_bytes())
    asked = [q for q in questions if q["metadata"]["frame"] == FRAME]
    touched = [q for q in asked if ids["other"] in q["metadata"]["objects"]]
    assert touched
    for q in touched:
        label = by_column(found[ids["other"]])["label"]
        assert {"table": "objects", "key": str(ids["other"]), **label} in q["provenance"]
    assert not any(q["provenance"] for q in questions if q["metadata"]["frame"] != FRAME)


@pytest.mark.parametrize("format", ["jsonl", "coco", "parquet"])
def test_reading_back_gives_the_corrected_tables(corrected: Any, format: str, tmp_path: Path) -> None:
    labels = corrected[0]
    export_labels(labels, format, tmp_path / "out")
    for name, table in import_labels(tmp_path / "out", format).items():
        assert table.to_pylist() == getattr(labels, name).to_pylist()


@pytest.mark.slow
def test_the_schema_is_the_same_whether_anything_was_corrected_or_not(
    demo_labels: Labels, corrected: Any, tmp_path: Path
) -> None:
    export_labels(demo_labels, "jsonl", tmp_path / "plain")
    export_labels(corrected[0], "jsonl", tmp_path / "corrected")
    for name, said in REVIEWED.items():
        plain, other = (lines(tmp_path / kind / f"{name}.jsonl") for kind in ("plain", "corrected"))
        assert len({tuple(row) for row in (*plain, *other)}) == 1
        assert all(row["provenance"] == [] for row in plain)
        assert not any(row[key] for row in plain for key in said)
        assert {row["base"] for row in plain} == {f"{labels_version(demo_labels.manifest)}.0.0"}


def test_damaged_reviews_are_told(corrected: Any, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(corrected[0].root, tmp_path / "labels")
    (tmp_path / "labels" / "statuses.json").write_text('[{"kind": "object"}]')
    with pytest.raises(InputError, match="what reviewers said of the labels is damaged"):
        export_labels(open_labels(tmp_path / "labels"), "coco", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "labels" / "statuses.json").unlink()
    (tmp_path / "labels" / "provenance.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="provenance of the labels is damaged"):
        export_labels(open_labels(tmp_path / "labels"), "coco", tmp_path / "out")


@pytest.mark.parametrize("text", ["", "x", 3, None, "0123456789abcdef.0", "0123456789abcdef.0.2", "é" * 20])
def test_what_names_no_state(text: Any) -> None:
    with pytest.raises(InputError, match="not the state of labels"):
        ExportedFrom.parse(text)


def test_a_state_and_its_text() -> None:
    for state in (ExportedFrom("0" * 16, None, False), ExportedFrom("f" * 16, "01ARZ3NDEKTSV4RRFFQ69G5FAV", True)):
        assert ExportedFrom.parse(str(state)) == state


def test_a_journal_without_events_changes_nothing_but_the_state(
    demo_labels: Labels, journal: Journal, tmp_path: Path
) -> None:
    materialise(demo_labels, journal, tmp_path / "labels")
    export_labels(open_labels(tmp_path / "labels"), "jsonl", tmp_path / "out")
    row = lines(tmp_path / "out" / "objects.jsonl")[0]
    assert row["base"] == f"{labels_version(demo_labels.manifest)}.0.0"
