"""The paper's tables: its shapes, its published rows, and own rows that follow from the records."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from run_records import random_records

from pipeline.datasets import SUBSETS, given_expressions, open_dataset, subsets_of
from pipeline.evaluation import AGREEMENT, PERFECT, EvalSpec, RelationSpec, RunReport, evaluate_dataset
from pipeline.evaluation.relation_records import RelationRecords, SystemRecords
from pipeline.labels import LabelConfig, Labels, SourceSpec, check_labels, label_dataset, open_labels
from pipeline.language import DIRECTIONAL, VOCABULARIES
from pipeline.metrics import BootstrapConfig, Estimate, Row, Table, as_csv, latex, markdown
from pipeline.paper import tables_of_folder, tables_of_run
from pipeline.paper.tables import ALL_NEGATIVE, AVD, IMITATION, SA, Evaluated, paper_tables, read_reported

QUICK = BootstrapConfig(resamples=100)
OF_SUBSETS = tuple(f"{k} {s}" for k in ("Top-1", "Top-2") for s in SUBSETS)
SHAPES = {
    "paper_relations_semantic_abstraction": (OF_SUBSETS, 4),
    "paper_relations_avd": (
        ("behind", "front", "above", "below", "left", "right", "micro-F1", "macro-F1", "accuracy"),
        6,
    ),
    "paper_pipeline_semantic_abstraction": (tuple(f"{k} {s}" for k in ("ACC", "mean IoU") for s in SUBSETS), 3),
    "paper_pipeline_avd": (("ACC", "mean IoU"), 7),
}
"""By table: its columns, and how many rows were published."""


def pairs_of(vocabulary: str, seed: int = 0, count: int = 400) -> tuple[RelationRecords, list[tuple[str, str, str]]]:
    """Pairs that never were: two scorers of random probabilities, in views of every kind."""
    rng = np.random.default_rng(seed)
    relations = VOCABULARIES[vocabulary]
    states = rng.choice([-1, -1, -1, -1, 0, 1], (count, len(relations))).astype(np.int8)
    scene = np.sort(rng.integers(0, 12, count)).astype(np.int32)
    p = rng.dirichlet(np.ones(len(relations)), count).astype(np.float32)
    part = np.full(count, 3, np.int8)
    prior = tuple(np.full(len(relations), 1 / len(relations)).tolist())
    systems = (
        SystemRecords("rule", "rule", relations, rng.random(p.shape).astype(np.float32), part),
        SystemRecords("net", "net, 3D-Geom", relations, rng.random(p.shape).astype(np.float32), part),
        SystemRecords("chooser", "chooser, 3D-Geom", relations, p, part, prior),
    )
    records = RelationRecords(relations, states, scene * 10, tuple(f"FloorPlan{k}" for k in range(12)), scene, systems)
    ends = rng.choice(["", "@randomized", "@synonyms"], count)
    a, b = (rng.choice(labels, count).tolist() for labels in (["couch", "desk", "mug"], ["tv", "box"]))
    frames = [f"{k:05d}|FloorPlan{s}_physics{end}" for k, (s, end) in enumerate(zip(scene, ends, strict=True))]
    names = list(zip(frames, a, b, strict=True))
    return records, names


def tables_of(vocabulary: str, layout: str = SA, shares: dict[str, str] | None = None) -> dict[str, Table]:
    records, names = pairs_of(vocabulary)
    answers, rng = random_records(3), np.random.default_rng(4)
    ends = ("@randomized", "@synonyms")
    changed = {
        "frame": [f"{k:05d}|FloorPlan1_physics{ends[k % 2]}" for k in range(answers.num_rows)],
        "target": rng.choice(["couch", "desk", "mug"], answers.num_rows).tolist(),
        **{name: rng.random(answers.num_rows).astype(np.float32) for name in ("iou", "opm_iou")},
    }
    for name, values in changed.items():
        answers = answers.set_column(answers.column_names.index(name), name, [values])
    found = paper_tables(
        Evaluated(vocabulary, "my rooms", layout, shares=shares or {}), {"ours": answers}, records, names, config=QUICK
    )
    return {table.key: table for table in found}


def reported(table: Table) -> list[Row]:
    return [row for row in table.rows if row.source == "reported"]


def value(cell: object) -> object:
    return cell.value if isinstance(cell, Estimate) else cell


@pytest.mark.parametrize("vocabulary", [SA, AVD])
def test_tables_have_the_papers_shapes_and_all_of_its_rows(vocabulary: str) -> None:
    found = tables_of(vocabulary)
    assert list(found) == [key for key in SHAPES if key.endswith(vocabulary.replace("-", "_"))]
    for key, table in found.items():
        columns, published = SHAPES[key]
        assert table.columns == columns
        lines = [line for line in read_reported() if line.table == key]
        assert len(reported(table)) == len(lines) == published
        assert table.rows[:published] == tuple(reported(table))
        for row, line in zip(reported(table), lines, strict=True):
            assert row.name == line.name
            assert dict(zip(columns, row.cells, strict=True)) == {c: line.figures.get(c) for c in columns}
        assert "my rooms" in table.title
        assert "reported on" in table.title


def test_published_figures_agree_with_each_other() -> None:
    rows = [line for line in read_reported() if line.table == "paper_relations_avd"]
    for line in rows:
        of_relations = [line.figures[r] for r in DIRECTIONAL]
        assert np.mean(of_relations) == pytest.approx(line.figures["macro-F1"], abs=1e-4)
    # Micro-F1 and the accuracy of six cells a pair bound the share of positives, and so what always saying no gets.
    bounds = []
    for line in rows:
        f, a = line.figures["micro-F1"], line.figures["accuracy"]
        if f != a:
            tp = f * (1 - a) / (2 * (1 - f))
            bounds.append((1 - tp - (1 - a), 1 - tp))
    assert len(bounds) == 4
    assert max(low for low, _ in bounds) == pytest.approx(0.802, abs=2e-3)
    assert min(high for _, high in bounds) == pytest.approx(0.826, abs=2e-3)
    assert sum(line.figures["accuracy"] == line.figures["micro-F1"] for line in rows) == 2
    assert all(0 <= v <= 1 for line in read_reported() for v in line.figures.values())


def test_published_figures_name_their_source() -> None:
    assert all(line.source for line in read_reported())


def test_figures_are_printed_in_the_papers_units() -> None:
    for vocabulary, expected in (
        (SA, ("| 3D-Geom+Lng (reported) | 76.16 |", "| OPM(DETIC) (reported) | 53.67 | 53.86 | 46.49 | 0.49 |")),
        (AVD, ("| 93.62 | 86.41 | 97.63 |", "| LLaVA-1.5-Vicuna-13B (reported) | 13.00 | 4.68 |")),
    ):
        text = markdown(list(tables_of(vocabulary).values()))
        assert all(part in text for part in expected)
    table = tables_of(SA)["paper_pipeline_semantic_abstraction"]
    assert table.shown(table.rows[2]) == ("–", "–", "–", "0.19", "0.23", "0.20")
    for text in table.shown(table.rows[-1])[3:]:
        assert 0 <= float(text.split()[0]) <= 1
    assert "$^\\dagger$" in latex([table])
    lines = list(csv.reader(io.StringIO(as_csv(table))))
    assert len({len(line) for line in lines}) == 1


def test_own_rows_follow_from_the_records_and_carry_intervals() -> None:
    records, names = pairs_of(AVD)
    table = tables_of(AVD)["paper_relations_avd"]
    own = [row for row in table.rows if row.source == "measured"]
    rows = {row.name: dict(zip(table.columns, row.cells, strict=True)) for row in own}
    assert list(rows) == [ALL_NEGATIVE, "rule", "net, 3D-Geom"]
    known = records.states[records.states != 0]
    assert value(rows[ALL_NEGATIVE]["accuracy"]) == pytest.approx((known < 0).mean())
    net = records.systems[1]
    for relation in DIRECTIONAL:
        k = records.relations.index(relation)
        said, truth = net.p[:, k] > 0.5, records.states[:, k]
        tp, fp, fn = (said & (truth > 0)).sum(), (said & (truth < 0)).sum(), (~said & (truth > 0)).sum()
        assert value(rows["net, 3D-Geom"][relation]) == pytest.approx(2 * tp / (2 * tp + fp + fn))
    for name in ("rule", "net, 3D-Geom"):
        for cell in rows[name].values():
            assert isinstance(cell, Estimate)
            assert cell.low < cell.value < cell.high

    records, names = pairs_of(SA)
    table = tables_of(SA)["paper_relations_semantic_abstraction"]
    frequent, row = [row for row in table.rows if row.source == "measured"]
    holds = records.states[(records.states > 0).sum(axis=1) == 1] > 0
    order = np.argsort(-holds.mean(axis=0))
    novel = [k for k, n in enumerate(names) if "Class" in subsets_of(*n) and (records.states[k] > 0).sum() == 1]
    assert value(frequent.cells[2]) == pytest.approx((records.states[novel][:, order[0]] > 0).mean())
    assert value(frequent.cells[5]) == pytest.approx((records.states[novel][:, order[:2]] > 0).any(axis=1).mean())
    chooser = records.systems[2]
    for name, cell in zip(table.columns, row.cells, strict=True):
        top, subset = int(name[4]), name.split(" ")[1]
        right = [
            records.states[k, np.argsort(-chooser.p[k])[:top]].max() > 0
            for k in range(len(records))
            if (records.states[k] > 0).sum() == 1 and subset in subsets_of(*names[k])
        ]
        assert isinstance(cell, Estimate)
        assert (cell.value, cell.n) == (pytest.approx(np.mean(right)), len(right))
        assert cell.low < cell.value < cell.high


def test_rows_that_share_a_maker_with_the_labels_stand_below_the_others() -> None:
    table = tables_of(AVD, shares={"rule": AGREEMENT, "ours": PERFECT})["paper_relations_avd"]
    assert [row.name for row in table.rows[-3:]] == [ALL_NEGATIVE, "net, 3D-Geom", "rule"]
    text = markdown([table])
    assert text.index("net, 3D-Geom") < text.index(AGREEMENT) < text.index("| rule |")
    assert f"\\midrule \\multicolumn{{10}}{{l}}{{\\emph{{{AGREEMENT}}}}}" in latex([table])
    pipeline = tables_of(AVD, shares={"ours": PERFECT})["paper_pipeline_avd"]
    assert [row.shares for row in pipeline.rows] == [""] * 7 + [PERFECT] * 2


def test_a_dataset_without_the_subsets_has_a_column_for_all() -> None:
    for table in tables_of(SA, layout="bop").values():
        first, last = table.rows[0], table.rows[-1]
        assert table.columns[3].endswith(" all")
        assert table.columns[7].endswith(" all")
        assert first.cells[3] is first.cells[7] is None
        assert last.cells[:3] == (None,) * 3
        assert isinstance(last.cells[3], Estimate)
    both = tables_of("all")
    assert list(both) == [k for k in SHAPES if k.endswith("abstraction")] + [k for k in SHAPES if k.endswith("avd")]


# A written copy of rendered rooms


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("embreex", reason="the extra render is not installed")
    pytest.importorskip("h5py")
    from benchmarks.semantic_abstraction_copy import write_copy

    root = tmp_path_factory.mktemp("copy")
    write_copy(root, 0, 2, views=1, size=224, points=20_000, first=1, tried=6)
    return root


@pytest.fixture(scope="module")
def given_labels(copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Labels:
    config = LabelConfig(vocabulary=SA, profile="given", style="semantic-abstraction")
    out = tmp_path_factory.mktemp("given") / "labels"
    splits = ("vool/unseen_instances_dr", "vool/unseen_instances_synonyms")
    label_dataset(SourceSpec(str(copy)), out, config, frames_of=splits)
    return open_labels(out)


@pytest.mark.slow
def test_given_labels_say_what_the_dataset_says(copy: Path, given_labels: Labels) -> None:
    dataset = open_dataset(copy)
    frames = given_labels.frames.to_pylist()
    assert {f["scene"] for f in frames} == {"FloorPlan1", "FloorPlan2"}
    assert [f["frame"].rpartition("@")[2] for f in frames] == ["randomized"] * 2 + ["synonyms"] * 2
    rows = {(r["frame"], r["a"], r["b"]): r for r in pq.read_table(given_labels.root / "relations.parquet").to_pylist()}
    relations = given_labels.relation_names
    certain: dict[tuple[str, int, int], set[str]] = {}
    for frame in frames:
        for e in given_expressions(dataset, frame["frame"]):
            # A thing is not left of itself: of two books the other one is meant.
            others = [k for k in e.reference_indices if k not in e.target_indices]
            if len(e.target_indices) == len(others) == 1:
                key = frame["frame"], e.target_indices[0], others[0]
                certain.setdefault(key, set()).add(e.relation)
    assert len(certain) > 20
    for key, row in rows.items():
        holding = {r for r in relations if row[r] > 0}
        assert holding == certain.get(key, set())
        assert key in certain or not any(row[r] < 0 for r in relations)
    assert {r for held in certain.values() for r in held} >= {"on", "left", "behind"}
    said = {
        (e["frame"], e["target_object"], e["reference_object"], e["relation"])
        for e in pq.read_table(given_labels.root / "expressions.parquet").to_pylist()
    }
    assert said
    assert all(relation in certain[frame, a, b] for frame, a, b, relation in said)
    assert not [f for f in check_labels(given_labels) if f.severity == "error"]


@pytest.mark.slow
def test_a_run_on_the_copy_has_rows_by_subset(given_labels: Labels, copy: Path, tmp_path: Path) -> None:
    spec = EvalSpec(str(copy), str(given_labels.root), {"srm": "rule"}, relations=RelationSpec())
    out = tmp_path / "run"
    report: RunReport = evaluate_dataset(spec, out, paper=tables_of_folder, plots=False, bootstrap=QUICK)
    assert [t.key for t in report.tables] == [k for k in SHAPES if k.endswith("abstraction")]
    assert (out / "tables.md").read_text().startswith(f"## {report.tables[0].title}")
    assert "rendered rooms" in report.tables[0].title
    records = pq.read_table(out / "records.parquet").to_pylist()
    table = report.tables[1]
    own = next(row for row in table.rows if row.name == "annotations + rule")
    for k, subset in enumerate(SUBSETS):
        mine = [r for r in records if subset in subsets_of(r["frame"], r["target"], r["reference"])]
        cell, overlap = own.cells[k], own.cells[3 + k]
        assert (cell is None) == (not mine)
        if mine:
            assert value(cell) == pytest.approx(np.mean([r["correct"] for r in mine]))
            assert value(overlap) == pytest.approx(np.mean([r["iou"] for r in mine]), abs=1e-6)
    assert own.cells[0] is not None
    assert own.shares == PERFECT
    again = tables_of_run(out)
    assert [(t.key, t.title, len(t.rows)) for t in again] == [(t.key, t.title, len(t.rows)) for t in report.tables]
    assert [value(c) for c in again[1].rows[-1].cells] == [value(c) for c in own.cells]
    assert (out / "tables" / "paper_pipeline_semantic_abstraction.csv").exists()


@pytest.mark.slow
def test_a_scorer_of_the_labels_own_rule_is_told(given_labels: Labels, copy: Path, tmp_path: Path) -> None:
    config = LabelConfig(vocabulary="avd", second_opinion="none")
    label_dataset(SourceSpec(str(copy)), tmp_path / "ruled", config, frames_of=("vool/unseen_instances",))
    for labels, expected in ((tmp_path / "ruled", AGREEMENT), (given_labels.root, "")):
        spec = EvalSpec(str(copy), str(labels), {"srm": "rule"}, grounding=False, relations=RelationSpec())
        report = evaluate_dataset(
            replace(spec), tmp_path / f"run-{labels.name}", paper=tables_of_folder, plots=False, bootstrap=QUICK
        )
        rules = [row for table in report.tables for row in table.rows if row.name == "rule"]
        assert (IMITATION in report.tables[0].note) == bool(expected)
        assert [row.shares for row in rules] == ([expected] if expected else [])
    manifest = json.loads((tmp_path / "run-ruled" / "run.json").read_text())
    assert manifest["relations"]["systems"][0]["title"] == "rule"
