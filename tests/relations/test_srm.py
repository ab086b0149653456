"""The relation network at run time: its features, its contract, antisymmetry, calibration, and how good it is."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from box_worlds import box_world
from hypothesis import given, settings
from hypothesis import strategies as st
from network_checks import random_rows, scene  # noqa: F401
from other_makers import FIGURES, REGIMES, figures, tallied, unnamed

from pipeline.answering import PreparedFrame, all_objects, appearance_of, open_pipeline
from pipeline.answering.ask import ask
from pipeline.datasets import open_dataset
from pipeline.geometry import Frame
from pipeline.language import DIRECTIONAL, PAIRWISE
from pipeline.metrics import IDENTITY, antisymmetric, expected_calibration_error, fit_calibration, fit_platt, sigmoid
from pipeline.proposals import AnnotationDetector
from pipeline.relations import (
    FEATURES,
    OnnxScorer,
    RuleScorer,
    directional_states,
    make_scorer,
    rule_probabilities,
    shipped_network,
    stacked_extents,
    with_class_lengths,
)
from pipeline.relations.model import BLOCK
from pipeline.system import InputError, asset_path
from pipeline.training.card import clear_cut, clear_cut_report, evaluate

LEFT, RIGHT, ABOVE, BELOW, FRONT, BEHIND = range(6)


def named_rows(seed: int, count: int = 6) -> np.ndarray:
    """Rows of rel32: some objects are cut by the border, of some no size of their class is known."""
    rng = np.random.default_rng([seed, 1])
    cut = rng.integers(0, 2, (count, 1)).astype(np.float64)
    labels = rng.choice(["mug", "bed", "sofa", "no such thing"], count).tolist()
    return with_class_lengths(np.concatenate([random_rows(seed, count), cut], axis=1), labels)


@pytest.fixture(scope="module")
def shipped() -> OnnxScorer:
    return OnnxScorer(shipped_network())


# Antisymmetry and calibration.


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_inverse_relations_are_each_others_mirror_to_the_last_bit(seed: int, shipped: OnnxScorer) -> None:
    p = shipped.probabilities(named_rows(seed))
    for one, other in ((LEFT, RIGHT), (ABOVE, BELOW), (FRONT, BEHIND)):
        np.testing.assert_array_equal(p[..., one], p[..., other].T)
    assert ((p >= 0) & (p <= 1)).all()


def test_a_permutation_of_the_objects_permutes_the_probabilities(shipped: OnnxScorer) -> None:
    rows, order = named_rows(4, 9), np.random.default_rng(1).permutation(9)
    np.testing.assert_allclose(
        shipped.probabilities(rows[order]), shipped.probabilities(rows)[np.ix_(order, order)], atol=1e-5
    )


def test_only_wanted_pairs_are_asked_and_they_get_the_same_to_the_last_bit(
    shipped: OnnxScorer, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = np.concatenate([named_rows(seed) for seed in range(8)])
    wanted = np.triu(np.random.default_rng(0).random((len(rows), len(rows))) < 0.2, 1)
    wanted |= wanted.T
    asked: list[int] = []
    feed = OnnxScorer._feed

    def counted(self: OnnxScorer, *args: Any) -> dict[str, np.ndarray]:
        found = feed(self, *args)
        asked.extend(len(value) for value in found.values())
        return found

    monkeypatch.setattr(OnnxScorer, "_feed", counted)
    every, some = shipped.probabilities(rows), shipped.probabilities(rows, wanted)
    np.testing.assert_array_equal(some[wanted], every[wanted])
    assert np.isnan(some[~wanted]).all()
    # Blocks of rows bound what is held at once.
    assert max(asked) <= BLOCK
    assert sum(asked) == len(rows) ** 2 + wanted.sum()


def test_a_batch_of_scenes_is_judged_as_each_alone(shipped: OnnxScorer) -> None:
    scenes = np.stack([named_rows(seed, 3) for seed in range(400)])
    np.testing.assert_array_equal(shipped.logits(scenes), np.stack([shipped.logits(rows) for rows in scenes]))


def test_relations_without_their_inverse_keep_their_logits() -> None:
    logits = np.random.default_rng(0).normal(size=(4, 4, 3))
    result = antisymmetric(logits, ("left", "on", "right"))
    np.testing.assert_array_equal(result[..., 1], logits[..., 1])
    np.testing.assert_allclose(result[..., 0], (logits[..., 0] + logits[..., 2].T) / 2)
    np.testing.assert_array_equal(antisymmetric(logits[..., :2], ("left", "on")), logits[..., :2])


def test_platt_finds_the_sigmoid_that_made_the_answers() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(0, 4, 40_000)
    holds = rng.random(len(logits)) < sigmoid(0.5 * logits - 0.8)
    slope, shift = fit_platt(logits, holds)
    assert slope == pytest.approx(0.5, abs=0.02)
    assert shift == pytest.approx(-0.8, abs=0.05)
    before = expected_calibration_error(sigmoid(logits), holds)
    assert expected_calibration_error(sigmoid(slope * logits + shift), holds) < before / 5


def test_platt_leaves_alone_what_it_cannot_judge() -> None:
    logits = np.linspace(-3, 3, 200)
    assert fit_platt(logits, logits > 2.9) == IDENTITY
    assert fit_platt(-logits, logits > 0) == IDENTITY
    slope, shift = fit_platt(logits, logits > 0)
    assert np.isfinite([slope, shift]).all()
    assert slope > 1


def test_inverse_relations_share_their_calibration() -> None:
    rng = np.random.default_rng(0)
    truth = np.where(rng.random((30, 30, 6)) < 0.3, 1, -1).astype(np.int8)
    logits = antisymmetric(rng.normal(size=(30, 30, 6)) + truth, DIRECTIONAL)
    found = fit_calibration([logits], [truth], DIRECTIONAL)
    assert tuple(found) == DIRECTIONAL
    assert found["left"] == found["right"] != IDENTITY
    assert found["front"] == found["behind"]
    doubtful = np.zeros_like(truth)
    assert fit_calibration([logits], [doubtful], DIRECTIONAL)["left"] == IDENTITY


# Figures.


def test_the_figures_of_a_case_worked_by_hand() -> None:
    truth = -np.ones((2, 2, 6), np.int8)
    truth[0, 1, LEFT] = truth[1, 0, RIGHT] = 1
    truth[0, 1, FRONT] = truth[1, 0, BEHIND] = 0
    p = np.full((2, 2, 6), 0.1)
    p[0, 1, LEFT], p[1, 0, RIGHT], p[1, 0, LEFT] = 0.9, 0.4, 0.8
    p[0, 1, FRONT] = 1.0
    rule = truth.copy()
    rule[0, 1, LEFT], rule[1, 0, RIGHT], rule[1, 0, LEFT], rule[0, 1, FRONT] = 0, -1, 0, 1
    report = evaluate([p], [truth], [rule])
    assert report["pairs"] == 2
    assert report["relations"]["left"] == {"precision": 0.5, "recall": 1.0, "f1": pytest.approx(2 / 3), "positives": 1}
    assert report["relations"]["right"]["recall"] == 0
    assert report["micro_f1"] == pytest.approx(2 / (2 + 1 + 1))
    assert report["element_accuracy"] == pytest.approx(8 / 10)
    assert report["all_negative_accuracy"] == pytest.approx(8 / 10)
    assert report["doubtful_share"] == pytest.approx(2 / 12)
    assert report["positives_per_pair"] == 1
    assert report["brier"] == pytest.approx((0.01 + 0.36 + 0.64 + 7 * 0.01) / 10)
    assert report["differing"] == {"cells": 3, "errors": 2, "rule_errors": 2, "rule_opposite": 1}


def test_saying_no_to_everything_scores_its_row() -> None:
    rows = random_rows(5, 12)
    truth = directional_states(rows[:, :3], rows[:, 3:])
    report = evaluate([np.zeros(truth.shape)], [truth])
    assert report["element_accuracy"] == report["all_negative_accuracy"] > 0.7
    assert report["micro_f1"] == 0
    assert "differing" not in report


def test_clear_cut_asks_for_ten_centimetres_along_the_dominant_axis() -> None:
    lo = np.array([[0, 0, 2], [0.61, 0, 2.2], [0, 0.55, 2.9], [0.05, 0.0, 2.5]], float)
    hi = lo + 0.5
    which = clear_cut(lo, hi)
    assert which[1, 0] == RIGHT
    assert which[0, 1] == LEFT
    assert which[2, 0] == BEHIND
    assert which[0, 2] == FRONT
    assert which[0, 3] == which[3, 0] == which[0, 0] == -1
    p = np.zeros((4, 4, 6))
    p[1, 0, RIGHT], p[0, 1, LEFT], p[1, 0, LEFT] = 0.6, 0.5, 0.7
    report = clear_cut_report([p], [(lo, hi)])
    assert report["clear_cut"] == (which >= 0).sum()
    assert report["holds"] == pytest.approx(1 / report["clear_cut"])
    assert report["doubted"] == pytest.approx(1 / report["clear_cut"])
    assert report["opposite"] == pytest.approx(1 / report["clear_cut"])


def test_the_network_scores_six_relations_and_the_rule_the_others(scene: Frame, shipped: OnnxScorer) -> None:
    context = PreparedFrame(scene)
    objects = [o.lifted for o in all_objects(context, AnnotationDetector(("a", "b", "c")))]
    scores, rule = shipped.score(objects, context.viewer, unnamed(objects)), RuleScorer().score(objects, context.viewer)
    assert shipped.name == "rel32"
    assert scores.relations == PAIRWISE
    assert scores.scored_by == {r: "rel32" if r in DIRECTIONAL else "rule" for r in PAIRWISE}
    np.testing.assert_array_equal(scores.states, rule.states)
    np.testing.assert_array_equal(scores.probabilities[..., 6:], rule.probabilities[..., 6:])
    assert scores.of("left")[0, 1] > 0.95
    assert scores.of("right")[0, 1] < 0.02
    assert scores.of("behind")[2, 0] > 0.8
    apart = ~np.eye(3, dtype=bool)
    assert (scores.probabilities[apart][:, :6] != rule.probabilities[apart][:, :6]).any()
    np.testing.assert_array_equal(scores.probabilities[~apart], rule.probabilities[~apart])
    assert shipped.score([], context.viewer, unnamed([])).probabilities.shape == (0, 0, len(PAIRWISE))
    assert shipped.score(objects[:1], context.viewer, unnamed(objects[:1])).probabilities.shape == (1, 1, 9)


def test_what_has_neither_points_nor_box_is_in_doubt(scene: Frame, shipped: OnnxScorer) -> None:
    context = PreparedFrame(scene)
    objects = [o.lifted for o in all_objects(context, AnnotationDetector(("a", "b", "c")))]
    nothing = np.full(3, np.nan)
    lost = replace(objects[1], points=np.empty((0, 3), np.float32), box=None, lo=nothing, hi=nothing)
    p = shipped.score([objects[0], lost, objects[2]], context.viewer, unnamed(objects)).probabilities[..., :6]
    assert (p[1, [0, 2]] == 0.5).all()
    assert (p[[0, 2], 1] == 0.5).all()
    whole = shipped.score(objects, context.viewer, unnamed(objects)).probabilities[0, 2, :6]
    np.testing.assert_allclose(p[0, 2], whole, atol=1e-5)


def test_scorers_by_name(tmp_path: Path) -> None:
    assert isinstance(make_scorer("rule"), RuleScorer)
    assert make_scorer("trained").name == "rel32"
    copy = tmp_path / "mine.onnx"
    copy.write_bytes(shipped_network().read_bytes())
    assert make_scorer(str(copy)).name == make_scorer(copy).name == "rel32"
    assert open_pipeline("demo").scorer.name == "rel32"
    assert open_pipeline("demo", srm="rule").scorer.name == "rule"
    with pytest.raises(InputError, match="no relation network"):
        make_scorer(tmp_path / "absent.onnx")
    with pytest.raises(InputError, match="not part of this installation"):
        asset_path("srm", "absent.onnx")


# The shipped network.


def test_the_card_belongs_to_the_shipped_network(shipped: OnnxScorer) -> None:
    from pipeline.system import file_hash

    card = json.loads(shipped_network().with_suffix(".json").read_text())
    assert card["file"] == {"bytes": shipped_network().stat().st_size, "xxh3_128": file_hash(shipped_network())}
    assert card["training"]["data_xxh3_128"] == shipped.contract.data
    assert {r: pytest.approx(ab, abs=1e-6) for r, ab in shipped.contract.calibration.items()} == card["calibration"]
    network, rule = card["held_out"]["network"], card["held_out"]["rule"]
    assert network["micro_f1"] >= 0.98
    assert network["micro_f1"] > rule["micro_f1"]
    assert network["differing"]["errors"] < network["differing"]["rule_errors"]
    parts = [card["rooms"][f"{p}_rooms"] for p in ("train", "calibration", "test")]
    assert parts[0][1] < parts[1][0] <= parts[1][1] < parts[2][0]
    assert parts[0][0] > 1000, "the demo's rooms are not trained on"


def test_the_network_that_was_shipped_before_still_answers(scene: Frame) -> None:
    before = make_scorer(Path(__file__).parents[1] / "fixtures" / "rel14.onnx")
    assert isinstance(before, OnnxScorer)
    assert (before.name, before.contract.seed) == ("rel14", 0)
    assert before.contract.data == "ad30681b5f10469c4759edb24e0f85cf"
    context = PreparedFrame(scene)
    objects = [o.lifted for o in all_objects(context, AnnotationDetector(("a", "b", "c")))]
    p = before.of_pairs(objects, context.viewer)
    np.testing.assert_allclose(p[0, 1, [0, 1]], [0.999, 0.0], atol=2e-3)
    np.testing.assert_allclose(p[..., 0], p[..., 1].T)


REGIME_LEAST = {"low": 0.955, "usual": 0.975, "high": 0.98}
"""Micro-F1 on rooms of boxes; the card has the figures of many more rooms."""


@pytest.mark.slow
@pytest.mark.parametrize("regime", REGIME_LEAST)
def test_the_shipped_network_holds_from_low_and_from_high(regime: str, shipped: OnnxScorer) -> None:
    rows, ruled = [], []
    for seed in range(100, 112):
        objects, exact, viewer, *_ = box_world(seed, 400, 300, REGIMES[regime])
        if len(objects) >= 5:
            truth = directional_states(np.array([e[0] for e in exact]), np.array([e[1] for e in exact]))
            states = directional_states(*stacked_extents(objects))
            rows.append(tallied(shipped.of_pairs(objects, viewer, unnamed(objects)), states, truth))
            ruled.append(tallied(rule_probabilities(states), states, truth))
    found, rule = (dict(zip(FIGURES, figures(np.sum(r, axis=0)[None])[0], strict=True)) for r in (rows, ruled))
    assert found["micro-F1"] >= REGIME_LEAST[regime]
    assert found["micro-F1"] > rule["micro-F1"]
    assert found["ECE"] <= 0.012


@pytest.mark.slow
@pytest.mark.parametrize("regime", ["low", "table top"])
def test_wrong_names_do_not_mislead_the_shipped_network(regime: str, shipped: OnnxScorer) -> None:
    from benchmarks.network_figures import NAMES, renamed, tallies
    from benchmarks.network_figures import worlds as seen_of

    seen = list(seen_of("houses", regime, 14))
    rule = figures(np.sum([tallies([], one)[0] for one in seen], axis=0)[None])[0]
    micro = {}
    for names in NAMES:
        shown = [replace(one, looks=renamed(one.looks, names, k)) for k, one in enumerate(seen)]
        micro[names] = figures(np.sum([tallies([shipped], one)[0] for one in shown], axis=0)[None])[0, 0]
    assert micro["exchanged"] > micro["unknown"] - 0.02, "a wrong name costs little more than none"
    assert micro["exchanged"] > rule[0]
    assert micro["true"] > micro["unknown"] - 0.003, "and a right one does no harm"


@pytest.mark.slow
def test_the_shipped_network_on_rooms_it_has_not_seen(shipped: OnnxScorer) -> None:
    pytest.importorskip("embreex")
    from pipeline.training import make_samples

    frames = make_samples([9_500_001, 9_500_002, 9_500_003], views=1, width=320, height=240)
    report = evaluate(
        [shipped.probabilities(f.rows[shipped.name]) for f in frames],
        [f.truth for f in frames],
        [f.rule for f in frames],
    )
    assert report["pairs"] > 500
    assert report["micro_f1"] > 0.97
    assert report["element_accuracy"] > report["all_negative_accuracy"] + 0.1
    assert report["differing"]["errors"] < report["differing"]["rule_errors"]
    assert report["ece"] < 0.02


@pytest.fixture(scope="module")
def worlds() -> list[tuple[np.ndarray, np.ndarray]]:
    """Of ten rooms of another maker, (rows of rel32 as seen, exact extents)."""
    found = []
    for seed in range(10):
        objects, exact, viewer, _, _ = box_world(seed)
        whole = np.array([np.concatenate(e) for e in exact])
        found.append((FEATURES["rel32"].describe(objects, viewer, unnamed(objects)), whole))
    return found


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_rooms_and_table_tops_of_another_maker(scale: float, worlds: list, shipped: OnnxScorer) -> None:
    lengths = np.isin(np.arange(10), FEATURES["rel32"].lengths)
    seen, exact = [rows * np.where(lengths, scale, 1.0) for rows, _ in worlds], [rows * scale for _, rows in worlds]
    extents_of = [(rows[:, :3], rows[:, 3:]) for rows in exact]
    truth = [directional_states(*e) for e in extents_of]
    rule = [directional_states(rows[:, :3], rows[:, 3:6]) for rows in seen]
    p = [shipped.probabilities(rows) for rows in seen]
    clear, ruled = (clear_cut_report(x, extents_of) for x in (p, [rule_probabilities(s) for s in rule]))
    assert clear["clear_cut"] > 700
    assert clear["holds"] >= 0.97
    assert clear["holds"] > ruled["holds"]
    assert clear["opposite"] <= 0.01
    report = evaluate(p, truth, rule)
    assert report["micro_f1"] > 0.96
    assert report["differing"]["errors"] < 0.7 * report["differing"]["rule_errors"]


def test_the_network_answers_on_real_frames(shared_data: Path, shipped: OnnxScorer) -> None:
    dataset = open_dataset(shared_data / "real" / "ycbv-bop")
    detector = AnnotationDetector(dataset.class_names)
    for frame_id in ("000002/000001", "000002/000020"):
        context = PreparedFrame(dataset.load(frame_id))
        for text, holds in (
            ("large marker in front of the mustard bottle", True),
            ("mustard bottle behind the large marker", True),
            ("mustard bottle in front of the large marker", False),
            ("potted meat can above the banana", False),
        ):
            trace = ask(context, text, detector, scorer=shipped, class_names=dataset.class_names)
            assert trace.ranking is not None
            assert (trace.ranking.pairs[0].p_relation > 0.5) == holds, (frame_id, text)


@pytest.mark.slow
def test_clear_pairs_of_real_frames_are_told_left_and_right_by_the_network(
    shared_data: Path, shipped: OnnxScorer
) -> None:
    from test_ask import ycb_pairs

    root = shared_data / "real" / "ycbv-bop"
    dataset = open_dataset(root)
    detector = AnnotationDetector(dataset.class_names)
    apart = 0
    for frame_id, left, right in ycb_pairs(root):
        context = PreparedFrame(dataset.load(frame_id))
        objects = all_objects(context, detector)
        a, b = ([o.label for o in objects].index(name) for name in (left, right))
        scores = shipped.score([o.lifted for o in objects], context.viewer, appearance_of(objects, context.frame))
        assert scores.of("right")[a, b] < 0.05, (frame_id, left, right)
        # Two things that lean on each other (extents overlap) may be doubted, never turned round.
        assert scores.of("left")[a, b] > 5 * scores.of("right")[a, b]
        if objects[a].lifted.hi[0] < objects[b].lifted.lo[0]:
            apart += 1
            assert scores.of("left")[a, b] > 0.9, (frame_id, left, right)
    assert apart >= 10


@pytest.mark.slow
def test_importing_the_stage_imports_no_heavy_package() -> None:
    code = (
        "import sys, pipeline.relations, pipeline.relations.model, pipeline.training.train, pipeline.training.card;"
        "heavy = {'torch', 'onnx', 'onnxruntime', 'scipy', 'embreex'} & set(sys.modules); assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).resolve().parents[2])
