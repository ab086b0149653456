"""What a module costs is told where it can be worked out, with the reason where not, and as the verdicts say."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from benchmarks.centre_rule import CENTRES
from benchmarks.fault_figures import lines
from hypothesis import given, settings
from hypothesis import strategies as st
from run_records import random_records

from pipeline.answering import Prediction, open_pipeline, write_predictions
from pipeline.diagnosis import ORACLES
from pipeline.evaluation import RunSummary, cost_words, import_run, open_run, summarise_run
from pipeline.evaluation.summary import oracle_table, verdict_table
from pipeline.labels import SourceSpec, label_dataset, open_labels
from pipeline.metrics import BootstrapConfig, markdown

QUICK = BootstrapConfig(resamples=50)
NO_NUMBER = re.compile(r"(?<![\d.])0\.0(?!\d)")


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("costs") / "labels"
    label_dataset(SourceSpec("demo"), out, limit=1)
    return out


@pytest.fixture(scope="module")
def given_lines(labels: Path) -> list[Prediction]:
    """Right answers of level 3, and in every fourth line a detector that finds no target, and so no answer."""
    dataset = open_pipeline("demo", srm="rule").dataset
    right = [x.line for x in lines(CENTRES, dataset, open_labels(labels), 3, share=0.0) if x.right]
    found = [_nothing(line) if k % 4 == 0 else line for k, line in enumerate(right)]
    assert sum(line.answer is None for line in found) >= 5
    return found


def _nothing(line: Prediction) -> Prediction:
    """The line of a detector that finds no target at all."""
    first = next(iter(line.proposals or {}))
    return replace(
        line,
        answer=None,
        problem="no pair",
        pairs=(),
        proposals={**(line.proposals or {}), first: ()},
        relations=dict.fromkeys(line.relations or {}, ()),
        boxes_3d={p.id: line.boxes_3d[p.id] for n, f in (line.proposals or {}).items() if n != first for p in f}
        if line.boxes_3d
        else None,
    )


def judged(folder: Path, given: list[Prediction], labels: Path) -> RunSummary:
    folder.mkdir()
    write_predictions(folder / "p.jsonl", CENTRES.header, given)
    import_run(folder / "p.jsonl", "demo", labels, folder / "run", plots=False)
    return summarise_run(open_run(folder / "run").records, QUICK)


def test_without_3d_boxes_what_was_not_proposed_has_no_cost_and_a_reason(
    given_lines: list[Prediction], labels: Path, tmp_path: Path
) -> None:
    found = judged(tmp_path / "bare", [replace(line, boxes_3d=None) for line in given_lines], labels)
    assert found.verdicts["OPM-TARGET"].count == found.failing.total() > 0
    assert found.untold["RECALL"] == found.untold["LIFT"] == "no 3D boxes are given"
    record = found.record()
    assert record["oracles"]["shapley"]["RECALL"] is record["oracles"]["single"]["RECALL"] is None
    assert record["oracles"]["value"]["RECALL+LIFT"] is None
    assert record["residual"]["value"] == 0
    assert found.unknown.value == pytest.approx(1 - found.accuracy.value)
    words = cost_words(found)
    assert "Verdicts name OPM-TARGET, OPM-REF most often" in words
    assert "cannot be worked out: no 3D boxes are given" in words
    assert not NO_NUMBER.search(words)
    table = oracle_table({"mine": found})
    cells = {row.name: row.cells for row in table.rows}
    assert cells["OPM-TARGET, OPM-REF"] == (None, None)
    assert "no 3D boxes are given" in table.note
    assert "RECALL" not in markdown([table])


def test_with_3d_boxes_what_was_not_proposed_costs_what_is_lost(
    given_lines: list[Prediction], labels: Path, tmp_path: Path
) -> None:
    found = judged(tmp_path / "boxed", given_lines, labels)
    assert not found.untold
    assert found.deltas is not None
    assert found.deltas.shapley["RECALL"].value > 0.7 * (1 - found.accuracy.value) > 0
    assert re.search(r"by finding the things \(OPM-TARGET, OPM-REF\) [\d.]+", cost_words(found))


def test_of_answers_alone_every_cost_is_untold(given_lines: list[Prediction], labels: Path, tmp_path: Path) -> None:
    bare = [replace(x, relations=None, boxes_3d=None, pairs=None) for x in given_lines]
    folder = tmp_path / "answers"
    folder.mkdir()
    write_predictions(folder / "p.jsonl", replace(CENTRES.header, ranking="none"), bare)
    import_run(folder / "p.jsonl", "demo", labels, folder / "run", plots=False)
    found = summarise_run(open_run(folder / "run").records, QUICK)
    assert set(found.untold) >= set(ORACLES)
    assert found.deltas is None
    assert "no relation probabilities are given" in cost_words(found)
    assert "no relation probabilities are given" in verdict_table({"mine": found}).note


def untold_records(seed: int, rows: int, share: int) -> pa.Table:
    """Random records of which some do not tell some of the costs."""
    records = random_records(seed, rows)
    kinds = [None, ["RECALL: no boxes", "LIFT: no boxes"], [f"{m}: no relations" for m in ORACLES]]
    told = [kinds[(k * 7 + seed) % 3] if k % share == 0 else None for k in range(rows)]
    if "untold" in records.column_names:
        records = records.drop_columns(["untold"])
    none = [None if told[k] == kinds[2] else v for k, v in enumerate(records.column("right_with").to_pylist())]
    at = records.column_names.index("right_with")
    records = records.set_column(at, records.schema.field(at), pa.array(none, pa.int32()))
    return records.append_column("untold", pa.array(told, pa.list_(pa.string())))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(1, 3))
def test_costs_add_up_whatever_is_untold_and_the_sentence_agrees_with_the_verdicts(
    seed: int, rows: int, share: int
) -> None:
    found = summarise_run(untold_records(seed, rows, share), QUICK)
    json.dumps(found.record(), allow_nan=False)
    if found.deltas is not None:
        assert sum(e.value for e in found.loss.values()) == pytest.approx(1, abs=1e-9)
        assert not found.untold.keys() & found.loss.keys()
        assert found.deltas.shapley.keys() | found.untold.keys() >= set(ORACLES)
    words = cost_words(found)
    assert not NO_NUMBER.search(words)
    counts: Counter[str] = found.failing
    if not counts:
        return
    name, count = counts.most_common(1)[0]
    said = re.search(r"(?:them by|parts:) [\w ]+(?: \(([^)]*)\))? [\d.]+", words)
    first = said[1] if said else None
    verdicts = {"RECALL": "OPM-TARGET, OPM-REF", "CONF": "OPM-CONF, PRM"}.get(name, name)
    assert first == verdicts or f"Verdicts name {verdicts} most often ({count} of {counts.total()});" in words
    for reason in found.untold.values():
        assert reason in words
