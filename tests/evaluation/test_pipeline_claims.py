"""What the whole pipeline must show with a simulated detector: in rendered rooms and on real frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pipeline.evaluation import EvalSpec, evaluate_dataset, evaluate_labels, read_records
from pipeline.evaluation.grounding_tables import relation_gain
from pipeline.labels import Labels, SourceSpec, label_dataset
from pipeline.metrics import markdown

pytestmark = pytest.mark.slow


def test_the_relation_adds_ten_points_in_rendered_rooms(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    spec = EvalSpec("demo", str(label_sets["demo"].root), {"detector": "simulated"})
    report = evaluate_dataset(spec, tmp_path / "run", plots=False)
    difference, test = relation_gain(read_records(tmp_path / "run"))
    assert difference.n == report.expressions > 400
    assert difference.value >= 0.10
    assert difference.low > 0.05
    assert test.p_value < 1e-6
    text = markdown(report.tables)
    assert difference.formatted() in text
    assert all(f"[{n}" not in text for n in ("nan", "n/a"))


def test_the_relation_helps_on_real_frames(shared_data: Path, tmp_path: Path) -> None:
    """Every class stands once in these frames, so that only the detector's mistakes leave a relation anything to do."""
    dataset = str(shared_data / "real" / "ycbv-bop")
    label_dataset(SourceSpec(dataset), tmp_path / "labels")
    records = []
    for seed in range(5):
        (tmp_path / f"{seed}.toml").write_text(f"seed = {seed}\n")
        options: dict[str, Any] = {"srm": "rule", "detector": "simulated", "model": tmp_path / f"{seed}.toml"}
        records += evaluate_labels(EvalSpec(dataset, str(tmp_path / "labels"), options))
    gains = [relation_gain(table) for table in records]
    assert all(test.n == gains[0][1].n > 20 for _, test in gains)
    # The same objects and sentences, seen by five detectors of the same quality.
    assert sum(test.b for _, test in gains) > sum(test.c for _, test in gains)
    exact = EvalSpec(dataset, str(tmp_path / "labels"), {"detector": "annotations", "srm": "rule"})
    (table,) = evaluate_labels(exact)
    assert all(table.column("set_correct").to_pylist())
