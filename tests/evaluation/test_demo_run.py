"""The run that comes with the demo: failures of every verdict, and the rows that the same command gives again."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from rewording import read_sentences, reword

from pipeline.datasets import demo_labels, demo_run
from pipeline.datasets.demo import demo_run
from pipeline.diagnosis import read_marks, shown_verdicts
from pipeline.evaluation import open_run
from pipeline.evaluation.records import COLUMNS
from pipeline.evaluation.run import Evaluator, table_of
from pipeline.labels import open_labels, read_cases
from pipeline.system import InputError

HERE = demo_run().parent


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return pq.read_table(demo_run() / "records.parquet").to_pylist()


def test_every_verdict_occurs(rows: list[dict[str, Any]]) -> None:
    assert {r["verdict"] for r in rows} == set(shown_verdicts(()))
    details = {"AMBIGUOUS", "BAD_LABEL", "BAD_BOX", "RANK", "THRESHOLD", "LOCALISATION", "ABSENT"}
    assert {r["detail"] for r in rows} >= details
    assert any(r["lucky"] for r in rows)
    assert all((r["verdict"] == "CORRECT") == r["correct"] for r in rows)


def test_the_run_is_of_the_shipped_labels(rows: list[dict[str, Any]]) -> None:
    labels = open_labels(demo_labels())
    manifest = json.loads((demo_run() / "run.json").read_text())
    assert manifest["labels"]["content_hash"] == labels.manifest.tables["expressions"].content_hash
    assert manifest["expressions"] == labels.expressions.num_rows == len(rows)
    assert sum(f.stat().st_size for f in HERE.rglob("*") if f.is_file()) < 1.5e6


def test_the_same_command_gives_the_same_rows(rows: list[dict[str, Any]]) -> None:
    run = open_run(demo_run())
    assert run.spec.marks == read_marks(HERE / "marks.json")
    assert run.spec.options["model"] == demo_run().with_name("simulated.toml")
    evaluator = Evaluator(run.spec)
    assert run.manifest["detector"].endswith(evaluator.source.needed_detector().fingerprint())
    again = []
    for index in (0, 6):
        for truth in read_cases(evaluator.labels, index, index + 1):
            again += evaluator.frame(truth)
    shipped = {(r["frame"], r["id"]): r for r in rows}
    assert len(again) == 300
    for row in table_of(again).to_pylist():
        other = shipped[row["frame"], row["id"]]
        for name in COLUMNS:
            if isinstance(row[name], float):
                np.testing.assert_allclose(row[name], other[name], rtol=1e-4, atol=1e-4)
            elif isinstance(row[name], list) and name not in ("repair", "mends"):
                np.testing.assert_allclose(row[name], other[name], atol=0.1)
            else:
                assert row[name] == other.get(name), name


def test_sentences_are_those_of_the_labels() -> None:
    sentences = read_sentences(HERE / "sentences.json")
    expressions = open_labels(demo_labels()).expressions.to_pylist()
    said = {(e["frame"], e["id"]): e["text"] for e in expressions}
    assert all(said[key] == text for key, text in sentences.items())


def test_reword_keeps_all_but_the_words(tmp_path: Any) -> None:
    import shutil

    folder = tmp_path / "labels"
    shutil.copytree(demo_labels(), folder)
    before = open_labels(folder).expressions.to_pylist()
    key = (before[3]["frame"], before[3]["id"])
    assert reword(folder, {key: "something else"}) == 1
    labels = open_labels(folder)
    after = labels.expressions.to_pylist()
    assert after[3] == {**before[3], "text": "something else"}
    assert [a for k, a in enumerate(after) if k != 3] == [b for k, b in enumerate(before) if k != 3]
    assert (
        labels.manifest.tables["expressions"].content_hash
        != open_labels(demo_labels()).manifest.tables["expressions"].content_hash
    )
    with pytest.raises(InputError, match="no such expression"):
        reword(folder, {("nowhere", "0"): "x"})
    assert open_labels(folder).expressions.to_pylist() == after


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[1]",
        '[{"frame": "f", "id": "1"}]',
        '[{"frame": "f", "id": "1", "mark": "WRONG"}]',
        '[{"frame": "f", "id": "1", "mark": "BAD_BOX"}, {"frame": "f", "id": "1", "mark": "BAD_LABEL"}]',
    ],
)
def test_marks_that_cannot_be_used(tmp_path: Any, text: str) -> None:
    path = tmp_path / "marks.json"
    path.write_text(text)
    with pytest.raises(InputError):
        read_marks(path)
