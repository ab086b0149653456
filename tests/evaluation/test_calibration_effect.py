"""A run with a score calibration says whether its frames were held out from it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pipeline.answering import AskConfig, calibrate_scores, open_pipeline
from pipeline.evaluation import EvalSpec, evaluate_dataset
from pipeline.evaluation.grounding_tables import held_out_warning
from pipeline.labels import SourceSpec, label_dataset
from pipeline.metrics import BootstrapConfig
from pipeline.proposals import FittedFrame, ScoreCalibration, load_calibration, save_calibration

if TYPE_CHECKING:
    pass

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


@pytest.mark.slow
def test_a_run_with_a_calibration_of_its_own_frames_says_so(labels: Path, tmp_path: Path) -> None:
    source = open_pipeline("demo", detector="simulated", srm="rule")
    calibration, report = calibrate_scores(source, source.dataset.frame_ids[2:8])
    save_calibration(calibration, tmp_path / "c.json", report)
    assert load_calibration(tmp_path / "c.json") == calibration
    assert [f.frame for f in calibration.frames] == list(source.dataset.frame_ids[2:8])
    assert {f.scene for f in calibration.frames} == {"000001", "000002", "000003"}
    run = evaluate_dataset(spec_of(labels, calibration), tmp_path / "run", bootstrap=QUICK, plots=False)
    assert "fitted on 2 of the 4 frames" in run.warnings[0]
    manifest = json.loads((tmp_path / "run" / "run.json").read_text())
    assert manifest["warnings"] == [*run.causes, *run.warnings]
    assert manifest["config"]["score_calibration"]["frames"] == 6
    plain = evaluate_dataset(spec_of(labels, None), tmp_path / "plain", against=tmp_path / "run", plots=False)
    assert plain.comparison is not None
    assert plain.comparison.tests["correct"].n == run.expressions, "what it changes is a comparison of two runs"
    assert not plain.warnings


def test_what_is_held_out_is_told_by_the_pictures() -> None:
    fitted = replace(SHARP, dataset="kitchen", frames=(FittedFrame("1/0", "1", "aa"), FittedFrame("1/1", "1", "bb")))
    others = {"1/0": ("1", "cc"), "2/0": ("2", None)}
    assert "fitted on 1 of the 2" in (held_out_warning(fitted, {"9/9": ("9", "aa"), "2/0": ("2", None)}, "x") or "")
    assert "other frames of 1 of the scenes" in (held_out_warning(fitted, others, "kitchen") or "")
    assert held_out_warning(fitted, others, "another") is None, "equal names of frames are no equal frames"
    assert held_out_warning(fitted, {"2/0": ("2", "cc")}, "kitchen") is None
    assert "does not say" in (held_out_warning(SHARP, others, "kitchen") or "")
