"""Score calibration: what it fits, that it never reorders, and where it stays away."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.answering import AskConfig, Pipeline, annotated_names, calibrate_scores, open_pipeline, trace_record
from pipeline.answering.ask import ask
from pipeline.answering.detector_runs import collect_hits, reliability
from pipeline.datasets import demo_path
from pipeline.geometry import iou_2d
from pipeline.language import match
from pipeline.metrics import IDENTITY, sigmoid
from pipeline.proposals import ScoreCalibration, fit_scores, load_calibration, save_calibration, score_logit, top_k
from pipeline.system import InputError

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def demo() -> Pipeline:
    return open_pipeline(demo_path(), detector="simulated", srm="rule")


def calibration_of(a: float = 2.0, b: float = 1.0, detector: str | None = None) -> ScoreCalibration:
    return ScoreCalibration(detector, a, b, 100, 100, 10)


# The fit.


@given(SEEDS, st.floats(0.4, 3), st.floats(-2, 2))
@settings(max_examples=25, deadline=None)
def test_it_finds_the_sigmoid_that_the_hits_were_drawn_from(seed: int, a: float, b: float) -> None:
    rng = np.random.default_rng(seed)
    scores = sigmoid(rng.normal(-0.5, 1.2, 8000))
    hits = rng.random(8000) < sigmoid(a * score_logit(scores) + b)
    found = fit_scores(scores, hits)
    assert found[0] == pytest.approx(a, abs=0.05 + 0.12 * a)
    assert found[1] == pytest.approx(b, abs=0.05 + 0.12 * (a + abs(b)))


@given(SEEDS, st.integers(0, 49), st.booleans())
@settings(max_examples=25, deadline=None)
def test_too_few_of_either_leave_the_scores_alone(seed: int, few: int, rare: bool) -> None:
    rng = np.random.default_rng(seed)
    hits = np.full(400, not rare)
    hits[rng.permutation(400)[:few]] = rare
    assert fit_scores(rng.random(400), hits) == IDENTITY
    np.testing.assert_array_equal(calibration_of(*IDENTITY).apply(np.array([0.0, 0.3, 1.0])), [0.0, 0.3, 1.0])


def test_scores_that_fall_with_the_hits_are_left_alone() -> None:
    scores = np.linspace(0.01, 0.99, 1000)
    assert fit_scores(scores, scores < 0.5) == IDENTITY


@given(st.lists(st.floats(0, 1), min_size=2, max_size=40), st.floats(0.05, 5), st.floats(-4, 4))
def test_it_never_reorders(scores: list[float], a: float, b: float) -> None:
    raw = np.array(scores)
    made = calibration_of(a, b).apply(raw)
    assert ((made >= 0) & (made <= 1)).all()
    order = np.argsort(raw, kind="stable")
    assert (np.diff(made[order]) >= 0).all()
    apart = (np.diff(raw[order]) > 1e-3) & (np.abs(score_logit(raw[order][1:])) < 5)
    assert (np.diff(made[order])[apart & (np.abs(a * score_logit(raw[order][:-1]) + b) < 20)] > 0).all()


def test_logits_are_clipped() -> None:
    assert np.isfinite(score_logit(np.array([0.0, 1.0]))).all()
    np.testing.assert_allclose(score_logit(np.array([0.0, 1.0])), [np.log(1e-6), -np.log(1e-6)], rtol=1e-5)


# What it is fitted on, and what it does.


def test_hits_are_the_detections_that_ask_gets(demo: Pipeline) -> None:
    ids = demo.dataset.frame_ids[:3]
    scores, hits, frames = collect_hits(demo, ids)
    expected = []
    assert demo.detector is not None
    for n, frame_id in enumerate(ids):
        frame = demo.dataset.load(frame_id)
        for name in annotated_names(frame):
            meant = match(name, demo.dataset.class_names)
            truth = np.stack([a.bbox for a in frame.annotations if a.label in meant])
            found = top_k(demo.detector.detect(frame, [name]), demo.config.k)
            for i in range(len(found)):
                expected.append((found.scores[i], iou_2d(found.boxes[i], truth).max() >= 0.5, n))
    assert list(zip(scores, hits, frames, strict=True)) == expected
    assert 0.3 < hits.mean() < 0.9


def test_the_effect_is_measured_on_frames_it_was_not_fitted_on(demo: Pipeline) -> None:
    ids = demo.dataset.frame_ids
    calibration, report = calibrate_scores(demo, ids)
    scores, hits, frames = collect_hits(demo, ids)
    assert (calibration.a, calibration.b) == fit_scores(scores, hits)
    assert (calibration.positives, calibration.negatives) == (hits.sum(), (~hits).sum())
    made = np.zeros(len(scores))
    for fold in (frames < len(ids) / 2, frames >= len(ids) / 2):
        a, b = fit_scores(scores[~fold], hits[~fold])
        made[fold] = sigmoid(a * score_logit(scores[fold]) + b)
    assert report["after"] == reliability(made, hits)
    assert report["before"] == reliability(scores, hits)
    assert report["after"]["ece"] < 0.5 * report["before"]["ece"]
    for measure in ("brier", "log_loss"):
        assert report["after"][measure] < report["before"][measure]


def test_reliability_of_known_figures() -> None:
    found = reliability(np.array([0.05, 0.05, 0.95, 1.0]), np.array([False, True, True, True]))
    assert found["brier"] == pytest.approx((0.05**2 + 0.95**2 + 0.05**2) / 4)
    assert [(r["low"], r["count"], r["score"], r["hits"]) for r in found["reliability"]] == [
        (0.0, 2, 0.05, 0.5),
        (0.9, 2, 0.975, 1.0),
    ]


def test_names_that_the_detector_does_not_know_take_no_part(demo: Pipeline) -> None:
    ids = demo.dataset.frame_ids[:1]
    some = collect_hits(demo, ids, lambda frame: ["mug"])
    np.testing.assert_array_equal(collect_hits(demo, ids, lambda frame: ["mug", "zebra"])[0], some[0])
    skipped: list[str] = []
    collect_hits(demo, ["absent", *ids], skipped=lambda frame_id, reason: skipped.append(frame_id))
    assert skipped == ["absent"]


def test_the_truth_and_the_unannotated_are_refused(demo: Pipeline) -> None:
    with pytest.raises(InputError, match="nothing to calibrate"):
        collect_hits(open_pipeline(demo_path()), demo.dataset.frame_ids)
    with pytest.raises(InputError, match="found nothing"):
        calibrate_scores(demo, demo.dataset.frame_ids[:1], lambda frame: [])


# In an answer.


def test_pairs_are_ranked_by_calibrated_scores_and_objects_keep_theirs(demo: Pipeline) -> None:
    frame = demo.dataset.load(demo.dataset.frame_ids[0])
    calibration = calibration_of(1.7, 0.8)
    assert demo.detector is not None
    plain = ask(frame, "mug left of the laptop", demo.detector)
    made = ask(frame, "mug left of the laptop", demo.detector, config=AskConfig(score_calibration=calibration))
    assert plain.ranking is not None
    assert made.ranking is not None
    assert [o.score for o in made.objects] == [o.score for o in plain.objects]
    before = {(p.target, p.reference): p for p in plain.ranking.pairs}
    for pair in made.ranking.pairs:
        other = before[pair.target, pair.reference]
        assert pair.p_target == pytest.approx(float(calibration.apply(np.array([other.p_target]))[0]))
        assert pair.p_reference == pytest.approx(float(calibration.apply(np.array([other.p_reference]))[0]))
        assert pair.p_relation == other.p_relation
    record = trace_record(made)
    assert record["score_calibration"] == {"a": 1.7, "b": 0.8}
    assert "score_calibration" not in trace_record(plain)
    raw = made.candidates["mug"].raw_scores
    assert raw is not None
    at = list(made.candidates["mug"].index).index(made.ranking.pairs[0].target)
    assert record["answer"]["target"]["score"] == pytest.approx(raw[at], abs=1e-6)
    assert record["proposals"] == trace_record(plain)["proposals"]


def test_the_truth_is_never_calibrated() -> None:
    source = open_pipeline(
        demo_path(), srm="rule", config=AskConfig(score_calibration=calibration_of(detector="other"))
    )
    trace = source.ask(source.dataset.load(source.dataset.frame_ids[0]), "mug left of the laptop")
    assert trace.score_calibration is None
    assert trace.ranking is not None
    assert trace.ranking.pairs[0].p_target == 1


def test_another_detectors_calibration_is_refused_unless_forced(demo: Pipeline) -> None:
    assert demo.detector is not None
    own = calibration_of(detector=demo.detector.fingerprint())
    own.check(demo.detector)
    with pytest.raises(InputError, match="another detector") as caught:
        open_pipeline(demo_path(), detector="simulated", min_score=0.2, config=AskConfig(score_calibration=own))
    assert "\n" not in str(caught.value)
    forced = AskConfig(score_calibration=own.for_any())
    assert open_pipeline(demo_path(), detector="simulated", min_score=0.2, config=forced).config == forced


# Files.


def test_a_calibration_comes_back_from_its_file(tmp_path: Path) -> None:
    calibration = ScoreCalibration("yolo-seg:abc", 1.23456789012345, -0.1, 60, 70, 3)
    save_calibration(calibration, tmp_path / "new" / "c.json", {"frames": 3})
    assert load_calibration(tmp_path / "new" / "c.json") == calibration
    assert json.loads((tmp_path / "new" / "c.json").read_text())["report"] == {"frames": 3}
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["c.json"]


GOOD: dict[str, Any] = {
    "format": "spatialviz-score-calibration-1",
    "detector": "x",
    "a": 1.0,
    "b": 0.0,
    "positives": 50,
    "negatives": 50,
    "k": 10,
}


@pytest.mark.parametrize(
    "change",
    [
        {"a": 0.0},
        {"a": -1.0},
        {"a": float("nan")},
        {"b": float("inf")},
        {"b": "high"},
        {"format": "other"},
        {"detector": 3},
        {"positives": -1},
        {"k": 0},
        {"a": None},
    ],
)
def test_a_hostile_file_is_refused_in_one_line(tmp_path: Path, change: dict[str, Any]) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps(GOOD))
    assert load_calibration(path).a == 1
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(InputError, match="no score calibration") as caught:
        load_calibration(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", b"[]", b"[" * 100_000])
def test_a_file_that_is_none_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(content)
    with pytest.raises(InputError):
        load_calibration(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_calibration(tmp_path / "none.json")


def test_a_slope_that_is_not_above_zero_is_refused() -> None:
    for a in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="slope above 0"):
            replace(calibration_of(), a=a)
