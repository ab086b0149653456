"""A run in figures: shares sum to one, what is lost is accounted for, slices and confusions hold every expression."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_records import random_records

from pipeline.diagnosis import VERDICTS
from pipeline.evaluation import (
    EvalSpec,
    compare,
    evaluate_dataset,
    find_rows,
    open_database,
    oracle_deltas,
    quote,
    slice_by,
    slice_table,
    summarise_run,
)
from pipeline.evaluation.confusion import answer_standings, count_standings, stands_in
from pipeline.evaluation.grounding_tables import clusters_of, column
from pipeline.evaluation.job import diagnose_run
from pipeline.evaluation.slices import DIMENSIONS
from pipeline.evaluation.summary import oracle_table, verdict_table
from pipeline.labels import SourceSpec, label_dataset, open_labels
from pipeline.metrics import BootstrapConfig, mean_estimate
from pipeline.system import InputError

QUICK = BootstrapConfig(resamples=100)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 2**16 - 1), min_size=1, max_size=40))
def test_shapley_values_sum_to_what_all_oracles_gain(bits: list[int]) -> None:
    found = oracle_deltas(np.array(bits), np.arange(len(bits)) % 3, BootstrapConfig(resamples=5))
    total = sum(e.value for e in found.shapley.values())
    gained = np.mean([b >> 15 & 1 for b in bits]) - np.mean([b & 1 for b in bits])
    assert abs(total - gained) < 1e-9


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60))
def test_shares_sum_to_one_and_losses_to_the_whole(seed: int, rows: int) -> None:
    records = random_records(seed, rows)
    found = summarise_run(records, QUICK)
    assert abs(sum(s.estimate.value for s in found.verdicts.values()) - 1) < 1e-9
    assert sum(s.count for s in found.verdicts.values()) == found.expressions == rows
    for verdict in VERDICTS:
        parts = sum(s.count for (v, _), s in found.details.items() if v == verdict)
        assert parts == 0 or parts <= found.verdicts[verdict].count
    assert found.lucky.count <= found.verdicts["CORRECT"].count
    assert abs(sum(e.value for e in found.loss.values()) - 1) < 1e-9
    assert sum(found.residual_causes.values()) == round(found.residual.value * rows)
    json.dumps(found.record(), allow_nan=False)


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(sorted(DIMENSIONS)), st.sampled_from([None, 1, 3]))
def test_slices_hold_every_expression_once(seed: int, dimension: str, most: int | None) -> None:
    records = random_records(seed, 80)
    found = slice_by({"run": records}, dimension, QUICK, most).slices
    assert sum(s.n for s in found) == records.num_rows
    for verdict in VERDICTS:
        assert sum(s.counts.get(verdict, 0) for s in found) == records.column("verdict").to_pylist().count(verdict)
    for part in found:
        assert sum(part.counts.values()) == part.n
        assert abs(sum(e.value for e in part.verdicts.values()) - 1) < 1e-9
        if part.query is None:
            continue
        # Its search finds its expressions, and its figures are those of them alone.
        rows = records.take(find_rows(records, part.query))
        assert rows.num_rows == part.n
        expected = mean_estimate(
            column(rows, "set_correct"), clusters_of(records)[0][find_rows(records, part.query)], config=QUICK
        )
        for name in ("value", "low", "high"):
            np.testing.assert_allclose(getattr(part.set_correct, name), getattr(expected, name), atol=1e-12)


def test_bins_begin_where_they_say() -> None:
    records = random_records(3, 200)
    found = slice_by({"run": records}, "distance", QUICK)
    values = column(records, "object_distance")
    counts = {s.name: s.n for s in found.slices}
    assert counts["1-2 m"] == ((values >= 1) & (values < 2)).sum() > 0
    assert counts["5+ m"] == (values >= 5).sum() > 0
    assert counts["unknown"] == np.isnan(values).sum() > 0
    assert "Bins begin at 0, 1, 2, 3, 5 m" in slice_table(found).note
    with pytest.raises(InputError, match="expected one of relation"):
        slice_by({"run": records}, "colour")


def test_runs_of_older_releases_and_other_systems() -> None:
    records = random_records(1)
    old = records.drop_columns(["verdict", "right_with", "lucky", "object_distance"])
    with pytest.raises(InputError, match="older release"):
        summarise_run(old)
    with pytest.raises(InputError, match="cannot be cut by distance"):
        slice_by({"old": old}, "distance")
    (*parts,) = slice_by({"old": old}, "relation", QUICK).slices
    assert sum(s.n for s in parts) == old.num_rows
    assert not any(s.verdicts for s in parts)
    nulls = pa.nulls(records.num_rows, pa.string())
    vlm = records.set_column(records.column_names.index("verdict"), "verdict", nulls)
    with pytest.raises(InputError, match="only the pipeline"):
        summarise_run(vlm)
    with pytest.raises(InputError, match="no expressions"):
        summarise_run(records.slice(0, 0))
    odd = records.set_column(records.column_names.index("verdict"), "verdict", pa.array(["ODD"] * records.num_rows))
    with pytest.raises(InputError, match="not known"):
        summarise_run(odd)
    both = diagnose_run({"new": records, "old": old}, config=QUICK)
    assert list(both.summaries) == ["new"]
    assert "distance" not in {s.dimension.name for s in both.slices}


def test_tables_name_what_adds_up() -> None:
    found = {"a": summarise_run(random_records(1), QUICK), "b": summarise_run(random_records(2), QUICK)}
    for systems in ({"a": found["a"]}, found):
        verdicts, oracles = verdict_table(systems), oracle_table(systems)
        assert all(len(r.cells) == len(verdicts.columns) == 2 * len(systems) for r in verdicts.rows)
        sums: Any = oracles.rows[-1].cells
        assert sums[0] is None
        assert abs(sums[1] - 1) < 1e-9
        assert "do not add" in oracles.note


def test_transitions_between_runs() -> None:
    before = random_records(5)
    verdicts = before.column("verdict").to_pylist()
    changed = ["SRM" if v == "PRM" else v for v in verdicts]
    after = before.set_column(before.column_names.index("verdict"), "verdict", pa.array(changed))
    both = compare(before, after)
    # What is the same in both runs did not become right for another reason, labelled or not.
    assert both.fixed == both.broken == both.other_reason == ()
    found = both.verdicts
    assert found is not None
    assert found["PRM"] == {"SRM": verdicts.count("PRM")}
    assert sum(n for line in found.values() for n in line.values()) == before.num_rows
    assert compare(before, after.drop_columns(["verdict"])).verdicts is None


def test_a_pair_stands_under_the_relation_that_holds() -> None:
    states = np.array([[1, 1], [0, 1], [-1, 1], [-1, -1]], np.int8)
    margins = np.array([[0.1, 0.9], [0.0, 0.2], [-0.1, np.nan], [-1, -1]])
    np.testing.assert_array_equal(stands_in(states, margins, np.zeros(4, np.int64), 7, 8), [0, 7, 1, 8])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    label_dataset(SourceSpec("demo"), folder / "labels", limit=2)
    spec = EvalSpec("demo", str(folder / "labels"), {"detector": "simulated", "srm": "rule"})
    evaluate_dataset(spec, folder / "run", bootstrap=QUICK, plots=False)
    return folder / "run"


def test_a_run_leaves_its_diagnosis(run: Path) -> None:
    found = json.loads((run / "diagnosis.json").read_text())
    (system,) = found["systems"].values()
    assert abs(system["shares_sum"] - 1) < 1e-9
    records = pq.read_table(run / "records.parquet")
    assert system["expressions"] == records.num_rows
    confusion = found["confusions"]["confusion"]
    counts = np.array(confusion["counts"])
    asked = records.column("relation").to_pylist()
    assert counts.sum(axis=1).tolist() == [asked.count(r) for r in confusion["rows"]]
    states = records.column("label_state").to_pylist()
    assert np.trace(counts[:, : len(counts)]) == states.count(1)
    assert "## Verdicts" in (run / "tables.md").read_text()
    assert (run / "tables" / "slice-relation.csv").is_file()


def test_every_cell_of_the_confusion_is_a_search(run: Path) -> None:
    records = pq.read_table(run / "records.parquet")
    labels = open_labels(run.parent / "labels")
    standings = answer_standings(records, labels)
    confusion, stands = count_standings(standings), standings.column()
    records = records.append_column("stands_in", pa.array(stands))
    for row, line in zip(confusion.rows, confusion.counts.tolist(), strict=True):
        for outcome, count in zip(confusion.columns, line, strict=True):
            assert len(find_rows(records, f"relation:{row} stands_in={quote(outcome)}")) == count


def test_other_labels_are_refused(run: Path) -> None:
    records = pq.read_table(run / "records.parquet")
    with pytest.raises(InputError, match="not the labels"):
        answer_standings(records, open_labels(run.parent / "labels"), "0" * 64)


def test_sql_reads_a_run_and_nothing_else(run: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("secret")
    objects = run.parent / "labels" / "objects.parquet"
    before = objects.read_bytes()
    with open_database(run) as database:
        count = pq.read_table(run / "records.parquet").num_rows
        assert list(database.select("SELECT count(*) FROM records").rows) == [(count,)]
        joined = "SELECT count(*) FROM records r JOIN labels_expressions e ON e.id = r.id AND e.frame = r.frame"
        assert list(database.select(joined).rows) == [(count,)]
        for sql in (
            f"SELECT * FROM read_text('{secret}')",
            f"FROM '{run}/records.parquet'",
            f"SELECT * FROM glob('{tmp_path}/*')",
            f"COPY records TO '{tmp_path}/out.csv'",
            f"ATTACH '{tmp_path}/x.db'",
            "SET enable_external_access = true",
            f"WITH t AS (COPY (SELECT 1) TO '{objects}') SELECT 1",
            "DROP VIEW records",
            "SELECT 1; SELECT 2",
            "",
            "INSTALL httpfs",
            "SELEC 1",
            "SELECT nothing_such FROM records",
            "FROM nothing_such",
            "SELECT CAST('a' AS INT)",
            f"EXPLAIN ANALYZE COPY (SELECT 1) TO '{tmp_path}/out.csv'",
        ):
            with pytest.raises(InputError) as refused:
                list(database.select(sql).rows)
            assert "\n" not in str(refused.value)
            assert "secret\n" not in str(refused.value)
        assert list(database.select("SELECT 1 AS one").rows) == [(1,)]
    assert [p.name for p in tmp_path.iterdir()] == ["secret.txt"]
    assert objects.read_bytes() == before
    with pytest.raises(InputError, match="no evaluation run"), open_database(tmp_path):
        pass


def test_sql_finds_labels_that_moved_with_the_run(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "run")
    with open_database(tmp_path / "run") as database:
        assert list(database.tables) == ["records"]
        with pytest.raises(InputError, match=f"are not at {re.escape(str(tmp_path / 'labels'))}"):
            database.select("SELECT * FROM labels_objects")
    shutil.copytree(run.parent / "labels", tmp_path / "labels")
    with open_database(tmp_path / "run") as database:
        found = list(database.select("SELECT count(*) FROM labels_objects").rows)
    assert found == [(pq.read_metadata(tmp_path / "labels" / "objects.parquet").num_rows,)]
