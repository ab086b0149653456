"""What was written on 2026-11-26 opens and says what it said then, to the label, the record and the verdict.

The folder is a dataset of its own with its network, so that nothing that ships later changes what is expected;
`expected.json` was written with it. Its README tells how it was made.
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from frozen_journals import journal_record

from pipeline.answering import AskConfig
from pipeline.corrections import JOURNAL_FILE, check_journal, effective_tables, open_journal, same_value
from pipeline.corrections.journal.effective import EffectiveLabels
from pipeline.corrections.journal.effective_frame import setting_of
from pipeline.datasets import open_dataset
from pipeline.datasets.settings import read_settings
from pipeline.diagnosis import decode, encode, open_case
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.diagnosis.whatif.state import state_record
from pipeline.evaluation import Run, open_database, open_run
from pipeline.evaluation.run_notes import notes_path, read_notes
from pipeline.labels import MANIFEST_FILE, PROVENANCE_FILE, TABLES, labels_version, open_labels, read_table
from pipeline.labels.plan import load_plan
from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import content_hash
from pipeline.labels.store import LabelStore
from pipeline.relations import make_scorer

FIXTURE = Path(__file__).parent / "fixtures" / "2026-11-26"
EXPECTED: dict[str, Any] = json.loads((FIXTURE / "expected.json").read_text(encoding="utf-8"))
VIEWS: dict[str, Any] = json.loads((FIXTURE / "views.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy whose labels have the network of their day as their second opinion, and not the one that ships now."""
    folder = Path(shutil.copytree(FIXTURE, tmp_path_factory.mktemp("old") / "files"))
    manifest = folder / "labels" / MANIFEST_FILE
    text = manifest.read_text(encoding="utf-8")
    assert '"second_opinion": "trained"' in text
    network = json.dumps(str(folder / "case" / "relations.onnx"))
    manifest.write_text(text.replace('"second_opinion": "trained"', f'"second_opinion": {network}'), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def effective(folder: Path) -> EffectiveLabels:
    with open_journal(folder / "labels" / JOURNAL_FILE, must_exist=True) as journal:
        return effective_tables(open_labels(folder / "labels"), journal, dataset=open_dataset(folder / "recording"))


def test_labels() -> None:
    labels = open_labels(FIXTURE / "labels")
    expected = EXPECTED["labels"]
    assert labels_version(labels.manifest) == expected["version"]
    assert list(labels.relation_names) == expected["relations"]
    assert {name: getattr(labels, name).num_rows for name in TABLES} == expected["rows"]
    assert {name: content_hash(getattr(labels, name), name) for name in TABLES} == expected["hashes"]


def test_a_journal_and_its_chain(folder: Path) -> None:
    path = folder / "labels" / JOURNAL_FILE
    found = check_journal(path)
    assert found.damage == ()
    with open_journal(path, must_exist=True) as journal:
        record = journal_record(journal.events())
    assert record == {name: EXPECTED["journal"][name] for name in record}
    assert found.intact[-1]["hash"] == EXPECTED["journal"]["tip"]


def rows_of(table: pa.Table) -> Iterable[tuple[int, dict[str, Any]]]:
    return enumerate(table.to_pylist())


def the_same(found: pa.Table, kept: pa.Table) -> None:
    """Every column and value; numbers to within rounding."""
    assert (found.column_names, found.num_rows) == (kept.column_names, kept.num_rows)
    others = kept.to_pylist()
    wrong = [(n, c, v, others[n][c]) for n, row in rows_of(found) for c, v in row.items() if not alike(v, others[n][c])]
    assert wrong == []


def alike(a: Any, b: Any) -> bool:
    return a == b or same_value(a, b) or (a != a and b != b)


@pytest.mark.parametrize("table", TABLES)
def test_labels_with_their_corrections(effective: EffectiveLabels, table: str) -> None:
    """The tables that `effective` wrote then are those that the journal makes now, and they open as labels."""
    the_same(effective.tables[table], read_table(FIXTURE / "corrected" / f"{table}.parquet", table))
    assert getattr(open_labels(FIXTURE / "corrected"), table).num_rows == effective.tables[table].num_rows


def test_who_said_what_of_corrected_labels(effective: EffectiveLabels) -> None:
    the_same(effective.provenance, pq.read_table(FIXTURE / "corrected" / PROVENANCE_FILE))
    kept = {
        name: json.loads((FIXTURE / "corrected" / f"{name}.json").read_text(encoding="utf-8"))
        for name in ("marks", "statuses", "unapplied")
    }
    assert [{"frame": f, "id": i, "mark": m} for (f, i), m in sorted(effective.marks.items())] == kept["marks"]
    assert [{**vars(ref), "value": v} for ref, v in sorted(effective.statuses.items())] == kept["statuses"]
    assert [u.event.ulid for u in effective.unapplied] == [e["event"] for e in kept["unapplied"]["events"]]
    assert [(w.id, w.reason) for w in effective.withdrawn] == [
        (e["id"], e["reason"]) for e in kept["unapplied"]["expressions"]
    ]


def test_counts_of_corrected_labels(effective: EffectiveLabels, folder: Path) -> None:
    expected = EXPECTED["effective"]
    assert effective.counts == expected["counts"]
    assert {what: list(counts) for what, counts in effective.decided.items()} == expected["decided"]
    objects = effective.tables["objects"].to_pylist()
    names = {
        frame: {str(o["object"]): o["label"] for o in objects if o["frame"] == frame} for frame in expected["names"]
    }
    assert names == expected["names"]
    with open_journal(folder / "labels" / JOURNAL_FILE, must_exist=True) as journal:
        blind = effective_tables(open_labels(folder / "labels"), journal)
    assert blind.counts == EXPECTED["without pictures"]["counts"]


def verdicts_of(run: Run) -> list[list[Any]]:
    columns = ("frame", "id", "verdict", "detail", "set_correct")
    return [[row[c] for c in columns] for row in run.records.to_pylist()]


@pytest.mark.parametrize("name", ["run", "imported"])
def test_a_run_of_our_own_and_an_imported_one(name: str) -> None:
    run, expected = open_run(FIXTURE / name), EXPECTED[name]
    assert run.name == expected["name"]
    assert run.verdicts == expected["verdicts"]
    assert verdicts_of(run) == expected["records"]
    assert set(expected["columns"]) <= set(run.records.column_names)
    with open_database(FIXTURE / name) as database:
        found = dict(database.select("select verdict, count(*) from records group by verdict").rows)
        ((objects,),) = database.select("select count(*) from labels_objects").rows
    assert (found, objects) == (expected["verdicts"], EXPECTED["labels"]["rows"]["objects"])
    assert {"grounding", "verdicts", "oracles"} <= set(run.tables)


@pytest.mark.parametrize("name", ["run", "imported"])
def test_a_question_of_a_run_is_answered_again(name: str, folder: Path) -> None:
    """With the run's own detector or predictions, network and labels."""
    run = open_run(folder / name)
    rows = [row for row in run.records.to_pylist() if row["verdict"] not in ("CORRECT", "LABEL")]
    found = [run.answer(row["frame"], row["id"]).diagnosis for row in rows[:3]]
    assert [d.verdict if d else None for d in found] == [row["verdict"] for row in rows[:3]]


def test_boxes_are_fitted_as_they_were(folder: Path) -> None:
    """Also by the imported run, whose specification names no settings: the default is another today."""
    assert AskConfig().lift.box != "gravity"
    labels = open_labels(folder / "labels")
    assert setting_of(labels).config.lift.box == load_plan(LabelStore(folder / "labels")).config.lift.box == "gravity"
    assert "before 0.2" in makers_of(labels.manifest).lines()["boxes"]
    for name in ("run", "imported"):
        assert open_run(folder / name).source.config.lift.box == "gravity"
    for name in EXPECTED["cases"]:
        assert open_case(folder / name).source.config.lift.box == "gravity"


def test_notes_of_a_run() -> None:
    found = json.loads(json.dumps(asdict(read_notes(notes_path(FIXTURE / "run")))))
    assert found == EXPECTED["notes"]


@pytest.mark.parametrize("name", EXPECTED["cases"])
def test_a_case_answers_as_it_did(name: str) -> None:
    case, expected = open_case(FIXTURE / name), EXPECTED["cases"][name]
    assert replay_case(case).changes == ()
    answer = case.answer()
    assert answer.diagnosis is not None
    assert (answer.text, answer.diagnosis.verdict, answer.diagnosis.detail) == tuple(expected.values())


@pytest.mark.parametrize("name", VIEWS["strings"])
def test_a_view_string(name: str) -> None:
    kept = VIEWS["strings"][name]
    view = decode(kept["string"])
    assert state_record(view) == kept["record"]
    assert decode(encode(view)) == view


def test_settings_beside_a_recording() -> None:
    found = read_settings(FIXTURE / "settings")
    record = json.loads(json.dumps({**asdict(found), "up": str(found.up)}))
    assert record == EXPECTED["settings"] | {name: record[name] for name in record.keys() - EXPECTED["settings"].keys()}


def test_a_rendered_recording() -> None:
    dataset = open_dataset(FIXTURE / "recording")
    assert list(dataset.frame_ids) == list(EXPECTED["effective"]["names"])
    frame = dataset.load(dataset.frame_ids[0])
    assert (frame.height, frame.width) == (120, 160)
    assert Counter(i.label for i in frame.annotations or ())["mug"] == 2


def test_a_relation_network() -> None:
    assert make_scorer(FIXTURE / "case" / "relations.onnx").name == "rel32"
