"""What a score calibration changes in an evaluation: the second answer, the table, the plot, the warning."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.answering import AskConfig, calibrate_scores, open_pipeline
from pipeline.evaluation import EvalSpec, evaluate_dataset, evaluate_labels
from pipeline.evaluation.grounding_tables import calibration_table, ece_estimate, held_out_warning
from pipeline.evaluation.records import RAW, detector_scores, is_calibrated, raw_records
from pipeline.geometry import iou_2d
from pipeline.labels import SourceSpec, label_dataset, open_labels, read_cases
from pipeline.metrics import BootstrapConfig, Estimate, expected_calibration_error
from pipeline.proposals import FittedFrame, ScoreCalibration, load_calibration, save_calibration, top_k

if TYPE_CHECKING:
    import pyarrow as pa

FRAMES = 4
SHARP = ScoreCalibration(None, 4.0, 1.5, 100, 100, 10)
"""So steep that it changes some winners."""
QUICK = BootstrapConfig(resamples=200)


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("effect") / "labels"
    label_dataset(SourceSpec("demo"), out, limit=FRAMES)
    return out


def spec_of(labels: Path, calibration: ScoreCalibration | None, detector: str = "simulated") -> EvalSpec:
    config = AskConfig(score_calibration=calibration)
    return EvalSpec("demo", str(labels), {"srm": "rule", "detector": detector, "config": config})


def records_of(spec: EvalSpec) -> pa.Table:
    (table,) = evaluate_labels(spec)
    return table


@pytest.fixture(scope="module")
def plain(labels: Path) -> pa.Table:
    return records_of(spec_of(labels, None))


@pytest.fixture(scope="module")
def calibrated(labels: Path) -> pa.Table:
    return records_of(spec_of(labels, SHARP))


def test_the_second_answer_is_that_of_a_run_without_calibration(plain: pa.Table, calibrated: pa.Table) -> None:
    assert not is_calibrated(plain)
    assert is_calibrated(calibrated)
    for name in RAW:
        assert calibrated.column(f"raw_{name}").equals(plain.column(name)), name
        assert raw_records(calibrated).column(name).equals(plain.column(name)), name
    assert calibrated.column("box") != plain.column("box"), "the calibration must change some answer"
    # A calibration never changes the order of one name's detections.
    assert calibrated.column("opm_box").equals(plain.column("opm_box"))


def test_every_detection_is_counted_once(labels: Path, calibrated: pa.Table) -> None:
    source = open_pipeline("demo", detector="simulated")
    detector = source.needed_detector()
    expected = []
    for truth in read_cases(open_labels(labels), 0, FRAMES):
        frame = source.dataset.load(truth.frame)
        asked = {c.target: c.target_object for c in truth.cases}
        asked |= {c.reference: c.reference_object for c in truth.cases}
        for name, labelled in asked.items():
            found = top_k(detector.detect(frame, [name]), 10)
            overlap = iou_2d(found.boxes, truth.boxes[truth.alike[labelled]]).max(axis=1, initial=0)
            expected += [(truth.frame, float(s), bool(o >= 0.5)) for s, o in zip(found.scores, overlap, strict=True)]
    scores = detector_scores(calibrated)
    got = zip(scores.frames.tolist(), scores.raw.tolist(), scores.hits.tolist(), strict=True)
    assert sorted(got) == sorted(expected)
    np.testing.assert_allclose(scores.calibrated, SHARP.apply(scores.raw), atol=1e-12)
    assert set(scores.scenes) == {"000001", "000002"}


@given(st.integers(0, 2**32 - 1), st.integers(1, 300))
@settings(max_examples=30, deadline=None)
def test_the_error_with_an_interval_is_that_of_the_metric(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    p, clusters = rng.random(n), rng.integers(0, 12, n)
    p[rng.random(n) < 0.05] = 1.0
    hits = rng.random(n) < p**2
    found = ece_estimate(p, hits, clusters, config=QUICK)
    assert found.value == pytest.approx(expected_calibration_error(p, hits), abs=1e-12)
    other = np.sqrt(p)
    difference = ece_estimate(p, hits, clusters, other=other, config=QUICK)
    assert difference.value == pytest.approx(found.value - expected_calibration_error(other, hits), abs=1e-12)
    same = ece_estimate(p, hits, clusters, other=p, config=QUICK)
    assert same.value == 0.0
    assert same.low in (0.0, pytest.approx(np.nan, nan_ok=True))


def test_the_table_says_what_changed(plain: pa.Table, calibrated: pa.Table) -> None:
    assert calibration_table({"plain": plain}, QUICK) is None
    table = calibration_table({"sharp": calibrated, "plain": plain}, QUICK)
    assert table is not None
    rows = {row.name.removeprefix("sharp: "): row.cells for row in table.rows}
    right = {k: np.array(t.column("correct").to_pylist()) for k, t in (("raw", plain), ("own", calibrated))}
    raw, own, difference, gained, lost, _, n = rows["Acc@0.5 single truth"]
    assert all(isinstance(cell, Estimate) for cell in (raw, own, difference))
    assert [c.value for c in (raw, own, difference) if isinstance(c, Estimate)] == pytest.approx(
        [right["raw"].mean(), right["own"].mean(), right["own"].mean() - right["raw"].mean()]
    )
    assert gained == (right["own"] & ~right["raw"]).sum()
    assert lost == (right["raw"] & ~right["own"]).sum()
    assert n == len(right["own"])
    scores = detector_scores(calibrated)
    brier = rows["Brier score of detections"]
    assert isinstance(brier[2], Estimate)
    expected = np.mean(np.square(scores.calibrated - scores.hits) - np.square(scores.raw - scores.hits))
    assert brier[2].value == pytest.approx(expected)
    assert brier[-1] == len(scores.raw)


@pytest.mark.slow
def test_the_truth_has_nothing_to_calibrate(labels: Path) -> None:
    assert not is_calibrated(records_of(spec_of(labels, SHARP, "annotations")))


def test_records_of_earlier_releases_have_no_second_answer(plain: pa.Table) -> None:
    assert not is_calibrated(plain.drop_columns(["raw_iou"]))


@pytest.mark.slow
def test_a_run_with_a_calibration_of_its_own_frames_says_so(labels: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra report is not installed")
    source = open_pipeline("demo", detector="simulated", srm="rule")
    calibration, report = calibrate_scores(source, source.dataset.frame_ids[2:8])
    save_calibration(calibration, tmp_path / "c.json", report)
    assert load_calibration(tmp_path / "c.json") == calibration
    assert [f.frame for f in calibration.frames] == list(source.dataset.frame_ids[2:8])
    assert {f.scene for f in calibration.frames} == {"000001", "000002", "000003"}
    run = evaluate_dataset(spec_of(labels, calibration), tmp_path / "run", bootstrap=QUICK)
    assert "fitted on 2 of the 4 frames" in run.warnings[0]
    manifest = json.loads((tmp_path / "run" / "run.json").read_text())
    assert manifest["warnings"] == list(run.warnings)
    assert manifest["config"]["score_calibration"]["frames"] == 6
    assert [row.name for row in run.tables[0].rows[:3]] == [
        "simulated + rule: OPM only",
        "simulated + rule, raw scores",
        "simulated + rule",
    ]
    assert (tmp_path / "run" / "tables" / "calibration.csv").is_file()
    assert (tmp_path / "run" / "plots" / "calibration.png").stat().st_size > 10_000
    assert "Reliability of the detector" in (tmp_path / "run" / "plots" / "plots.html").read_text()


def test_what_is_held_out_is_told_by_the_pictures() -> None:
    fitted = replace(SHARP, dataset="kitchen", frames=(FittedFrame("1/0", "1", "aa"), FittedFrame("1/1", "1", "bb")))
    others = {"1/0": ("1", "cc"), "2/0": ("2", None)}
    assert "fitted on 1 of the 2" in (held_out_warning(fitted, {"9/9": ("9", "aa"), "2/0": ("2", None)}, "x") or "")
    assert "other frames of 1 of the scenes" in (held_out_warning(fitted, others, "kitchen") or "")
    assert held_out_warning(fitted, others, "another") is None, "equal names of frames are no equal frames"
    assert held_out_warning(fitted, {"2/0": ("2", "cc")}, "kitchen") is None
    assert "does not say" in (held_out_warning(SHARP, others, "kitchen") or "")
