"""The metrics of relations and of their calibration: against scikit-learn, plain loops, and what must always hold."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest
from slow_cases import mostly_slow

from pipeline.metrics import (
    RelationMetrics,
    brier_score,
    cell_outcomes,
    expected_calibration_error,
    mcnemar,
    multi_label_metrics,
    reliability_diagram,
    single_label_metrics,
    true_ranks,
    tuned_thresholds,
)
from pipeline.metrics.calibration_metrics import calibration_metrics

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def oracle() -> Any:
    """scikit-learn's metrics; loaded by the worker that asks."""
    from sklearn import metrics

    return metrics


def random_cells(seed: int, pairs: int = 300, grain: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(P, 6) probabilities that know something, on a grid of 1/grain if that is given, and states with some U."""
    rng = np.random.default_rng(seed)
    truth = rng.choice(np.array([-1, -1, -1, 0, 1], np.int8), (pairs, 6))
    p = np.clip(rng.normal(0.5 + 0.2 * truth, 0.3), 0, 1)
    return (np.round(p * grain) / grain if grain else p), truth


def figures(m: RelationMetrics) -> np.ndarray:
    """All figures in one row."""
    scalars = (m.micro_f1, m.macro_f1, m.element_accuracy, m.all_negative_accuracy, m.mean_average_precision)
    return np.concatenate([m.precision, m.recall, m.f1, m.average_precision, scalars])


# Relations, several a pair.


@pytest.mark.slow
@pytest.mark.parametrize("grain", [None, 4, 20])
@pytest.mark.parametrize("seed", mostly_slow(range(5), fast=(0, 1)))
def test_relation_metrics_are_those_of_scikit_learn(oracle: Any, seed: int, grain: int | None) -> None:
    p, truth = random_cells(seed, grain=grain)
    thresholds = tuned_thresholds(*random_cells(seed + 100, grain=grain))
    for cut in (np.full(6, 0.5), thresholds):
        found = multi_label_metrics(p, truth, cut)
        for k in range(6):
            known = truth[:, k] != 0
            holds, said = truth[known, k] > 0, p[known, k] > cut[k]
            expected = [f(holds, said) for f in (oracle.precision_score, oracle.recall_score, oracle.f1_score)]
            np.testing.assert_allclose((found.precision[k], found.recall[k], found.f1[k]), expected, rtol=0, atol=1e-9)
            ap = oracle.average_precision_score(holds, p[known, k])
            assert found.average_precision[k] == pytest.approx(ap, abs=1e-9)
            confusion = oracle.confusion_matrix(holds, said)
            assert [found.fp[k], found.fn[k], found.tp[k]] == confusion.ravel()[1:].tolist()
            assert found.positives[k] == holds.sum()
            assert found.undecided[k] == (~known).sum()
        known = truth != 0
        holds, said = (truth > 0)[known], (p > cut)[known]
        assert found.micro_f1 == pytest.approx(oracle.f1_score(holds, said), abs=1e-9)
        assert found.element_accuracy == pytest.approx(oracle.accuracy_score(holds, said), abs=1e-9)
        assert found.macro_f1 == pytest.approx(found.f1.mean(), abs=1e-12)
        assert found.mean_average_precision == pytest.approx(found.average_precision.mean(), abs=1e-12)


def test_a_case_worked_by_hand() -> None:
    p = np.array([[0.9, 0.5], [0.8, 0.2], [0.7, 0.6], [0.1, 0.9]])
    truth = np.array([[1, 1], [-1, -1], [1, -1], [-1, 0]], np.int8)
    found = multi_label_metrics(p, truth, relations=("left", "right"))
    np.testing.assert_allclose(found.precision, [2 / 3, 0])
    np.testing.assert_allclose(found.recall, [1, 0], err_msg="a probability of one half is a no")
    np.testing.assert_allclose(found.f1, [0.8, 0])
    np.testing.assert_allclose(found.average_precision, [(1 + 2 / 3) / 2, 1 / 2])
    assert found.micro_f1 == pytest.approx(4 / (4 + 2 + 1))
    assert found.element_accuracy == pytest.approx(4 / 7)
    assert found.all_negative_accuracy == pytest.approx(4 / 7)
    np.testing.assert_allclose(tuned_thresholds(p, truth), [0.4, 0.35])


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, grain=st.sampled_from([None, 3, 10]))
def test_no_threshold_has_a_larger_f1_than_the_tuned_one(seed: int, grain: int | None) -> None:
    p, truth = random_cells(seed, pairs=25, grain=grain)
    best = multi_label_metrics(p, truth, tuned_thresholds(p, truth)).f1
    for cut in np.concatenate([[-0.5], np.unique(p)]):
        f1 = multi_label_metrics(p, truth, cut).f1
        assert (np.isnan(f1) | np.isnan(best) | (f1 <= best + 1e-12)).all()


def test_tuned_thresholds_at_the_ends() -> None:
    truth = np.ones((3, 1), np.int8)
    assert tuned_thresholds(np.zeros((3, 1)), truth)[0] < 0, "only a negative threshold says yes to a probability of 0"
    assert tuned_thresholds(np.zeros((3, 1)), -truth)[0] == 0.5
    assert tuned_thresholds(np.zeros((3, 1)), 0 * truth)[0] == 0.5
    # Saying yes to the first only and saying it to all have the same F1: the threshold nearer to one half is taken.
    states = np.array([[1], [-1], [-1], [1]], np.int8)
    for p, first, last, nearer in (([0.9, 0.4, 0.3, 0.1], 0.65, 0.05, 0.65), ([1.0, 0.9, 0.8, 0.6], 0.95, 0.3, 0.3)):
        column = np.array(p)[:, None]
        f1 = [multi_label_metrics(column, states, cut, ("on",)).f1[0] for cut in (first, last)]
        np.testing.assert_allclose(f1, 2 / 3)
        assert tuned_thresholds(column, states)[0] == pytest.approx(nearer)
    near = np.array([[0.3], [np.nextafter(0.3, 1)]])
    cut = tuned_thresholds(near, np.array([[-1], [1]], np.int8))
    np.testing.assert_array_equal(near > cut, [[False], [True]])


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_order_of_pairs_and_masked_cells_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, truth = random_cells(seed, pairs=40, grain=8)
    order = rng.permutation(len(p))
    elsewhere = np.where(truth == 0, rng.random(p.shape), p)
    expected = figures(multi_label_metrics(p, truth))
    np.testing.assert_allclose(figures(multi_label_metrics(p[order], truth[order])), expected, rtol=1e-12)
    np.testing.assert_array_equal(figures(multi_label_metrics(elsewhere, truth)), expected)
    np.testing.assert_array_equal(tuned_thresholds(elsewhere, truth), tuned_thresholds(p, truth))
    calibration, other = calibration_metrics(p, truth), calibration_metrics(elsewhere, truth)
    assert (other.brier, other.diagram.ece) == (calibration.brier, calibration.diagram.ece)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_always_saying_no_scores_the_share_of_negatives(seed: int) -> None:
    p, truth = random_cells(seed, pairs=30)
    row = multi_label_metrics(np.zeros(truth.shape), truth)
    assert row.element_accuracy == row.all_negative_accuracy == (truth < 0).sum() / (truth != 0).sum()
    assert row.all_negative_accuracy == multi_label_metrics(p, truth).all_negative_accuracy
    assert row.micro_f1 == 0
    assert np.isnan(row.precision).all()


def test_outcomes_are_exclusive_and_leave_u_out() -> None:
    p, truth = random_cells(3)
    cells = cell_outcomes(p, truth)
    every = np.stack([cells.tp, cells.fp, cells.fn, cells.tn]).astype(int)
    np.testing.assert_array_equal(every.sum(axis=0), truth != 0)


def test_what_has_no_meaning_is_nan() -> None:
    p, truth = random_cells(0, pairs=50)
    truth[:, 0] = 0
    truth[:, 1] = -1
    p[:, 1] = 0.1
    p[:, 2] = 0.2
    truth[0, 2] = 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = multi_label_metrics(p, truth)
        calibration = calibration_metrics(p, truth)
    for name in ("precision", "recall", "f1", "average_precision"):
        assert np.isnan(getattr(found, name)[:2]).all(), name
    assert np.isnan(found.precision[2])
    assert found.recall[2] == found.f1[2] == 0, "what holds and is never said is a failure, not undefined"
    assert found.macro_f1 == pytest.approx(found.f1[2:].mean())
    assert found.mean_average_precision == pytest.approx(found.average_precision[2:].mean())
    assert np.isfinite(calibration.diagram.ece)


def test_nothing_at_all_is_undefined_everywhere() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = multi_label_metrics(np.zeros((0, 6)), np.zeros((0, 6), np.int8))
        single = single_label_metrics(np.zeros((0, 6)), np.zeros(0, np.int64))
    assert np.isnan(figures(found)).all()
    assert np.isnan([single.top1, single.top2]).all()
    assert np.isnan([brier_score([], []), expected_calibration_error([], [])]).all()
    assert mcnemar([], []).p_value == 1


# Relations, one a pair.


@pytest.mark.slow
def test_single_label_metrics_are_those_of_scikit_learn(oracle: Any) -> None:
    rng = np.random.default_rng(1)
    truth = rng.integers(0, 6, 400)
    logits = rng.normal(size=(400, 6)) + 1.5 * np.eye(6)[truth]
    p = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    found = single_label_metrics(p, truth)
    said = p.argmax(axis=1)
    np.testing.assert_array_equal(found.confusion, oracle.confusion_matrix(truth, said))
    for k in range(6):
        expected = [f(truth == k, said == k) for f in (oracle.precision_score, oracle.recall_score, oracle.f1_score)]
        np.testing.assert_allclose((found.precision[k], found.recall[k], found.f1[k]), expected, rtol=0, atol=1e-9)
    for k, top in ((1, found.top1), (2, found.top2)):
        assert top == pytest.approx(oracle.top_k_accuracy_score(truth, p, k=k), abs=1e-9)
    blanked = truth.copy()
    blanked[:100] = -1
    part, rest = single_label_metrics(p, blanked), single_label_metrics(p[100:], truth[100:])
    assert part.pairs == 300
    assert (part.top1, part.top2) == (rest.top1, rest.top2)
    np.testing.assert_array_equal(part.confusion, rest.confusion)


def test_ranks_of_equals_agree_with_argmax() -> None:
    p = np.array([[0.25, 0.25, 0.5], [0.4, 0.4, 0.2], [0.4, 0.4, 0.2], [0.4, 0.4, 0.2]])
    np.testing.assert_array_equal(true_ranks(p, np.array([1, 0, 1, -1])), [2, 0, 1, -1])
    found = single_label_metrics(p, np.array([1, 0, 1, -1]))
    assert (found.top1, found.top2) == (1 / 3, 2 / 3)
    assert np.isnan(found.recall[2])
    assert found.precision[2] == 0
    assert np.isnan(found.f1[2]), "nothing is it: F1 has no support"
    assert np.isnan(found.precision[1])


# Calibration.


def slow_ece(p: np.ndarray, holds: np.ndarray, bins: int) -> float:
    total = 0.0
    for k in range(bins):
        inside = [i for i in range(len(p)) if int(p[i] * bins) == k or (k == bins - 1 and p[i] == 1.0)]
        if inside:
            confidence = sum(float(p[i]) for i in inside) / len(inside)
            frequency = sum(bool(holds[i]) for i in inside) / len(inside)
            total += len(inside) / len(p) * abs(confidence - frequency)
    return total


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, bins=st.sampled_from([1, 2, 10, 15]), grain=st.sampled_from([None, 10, 15]))
def test_calibration_error_is_that_of_a_plain_loop(oracle: Any, seed: int, bins: int, grain: int | None) -> None:
    rng = np.random.default_rng(seed)
    p = rng.random(80)
    p = np.round(p * grain) / grain if grain else p
    holds = rng.random(80) < p**2
    assert expected_calibration_error(p, holds, bins) == pytest.approx(slow_ece(p, holds, bins), abs=1e-9)
    assert brier_score(p, holds) == pytest.approx(oracle.brier_score_loss(holds, p), abs=1e-9)
    diagram = reliability_diagram(p, holds, bins)
    assert diagram.count.sum() == 80
    held = diagram.count > 0
    assert (diagram.count[held] @ diagram.frequency[held]) == pytest.approx(holds.sum())
    assert np.isnan(diagram.confidence[~held]).all()
    assert (diagram.confidence[held] >= diagram.edges[:-1][held] - 1e-12).all()
    assert (diagram.confidence[held] <= diagram.edges[1:][held] + 1e-12).all()


@pytest.mark.slow
def test_calibration_is_of_all_known_cells(oracle: Any) -> None:
    p, truth = random_cells(5)
    found = calibration_metrics(p, truth)
    known = truth != 0
    assert found.brier == pytest.approx(oracle.brier_score_loss(truth[known] > 0, p[known]), abs=1e-9)
    assert found.diagram.ece == pytest.approx(slow_ece(p[known], truth[known] > 0, 15), abs=1e-9)
    assert found.diagram.count.sum() == known.sum()


# McNemar.


def test_mcnemar_by_hand() -> None:
    first = np.array([1] * 10 + [0] * 2 + [1] * 30 + [0] * 8)
    second = np.array([0] * 10 + [1] * 2 + [1] * 30 + [0] * 8)
    found = mcnemar(first, second)
    assert (found.n, found.b, found.c) == (50, 10, 2)
    assert found.p_value == pytest.approx(2 * (1 + 12 + 66) / 2**12, abs=1e-12)
    assert mcnemar(second, first).p_value == found.p_value


@settings(max_examples=30, deadline=None)
@given(b=st.integers(0, 400), c=st.integers(0, 400))
def test_mcnemar_is_the_binomial_test(b: int, c: int) -> None:
    found = mcnemar([True] * b + [False] * c, [False] * b + [True] * c)
    assert (found.b, found.c) == (b, c)
    expected = binomtest(b, b + c).pvalue if b + c else 1.0
    assert found.p_value == pytest.approx(expected, rel=1e-9)
