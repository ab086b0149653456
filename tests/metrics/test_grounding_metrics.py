"""Grounding metrics: against plain loops, at their edges, and on input that cannot be judged."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from benchmarks.grounding_figures import SWEEP, grounding_outcomes, largest_iou, mean_iou, threshold_sweep
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.geometry import iou_2d, paired_iou_2d
from pipeline.system import InputError

SEEDS = st.integers(0, 2**32 - 1)


def random_boxes(rng: np.random.Generator, n: int) -> np.ndarray:
    corner = rng.uniform(0, 60, (n, 2))
    return np.concatenate([corner, corner + rng.uniform(1, 60, (n, 2))], axis=1)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_grounding_is_that_of_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 25
    truth = random_boxes(rng, n)
    predicted = truth + rng.normal(0, 2, (n, 4)).round()
    predicted[:, 2:] = np.maximum(predicted[:, 2:], predicted[:, :2])
    predicted[rng.random(n) < 0.2] = np.nan
    strict = [np.concatenate([truth[i : i + 1], random_boxes(rng, int(rng.integers(0, 3)))]) for i in range(n)]
    acceptable = [np.concatenate([s, random_boxes(rng, int(rng.integers(0, 3)))]) for s in strict]
    strict[3] = np.zeros((0, 4))
    found = grounding_outcomes(predicted, truth, strict, acceptable)
    np.testing.assert_array_equal(found.answered, ~np.isnan(predicted[:, 0]))
    np.testing.assert_allclose(found.iou, np.diag(iou_2d(predicted, truth)), atol=1e-12)
    for i in range(n):
        for ious, sets in ((found.iou_strict, strict), (found.iou_set, acceptable)):
            each = [float(iou_2d(predicted[i], box)[0, 0]) for box in sets[i]]
            assert ious[i] == (pytest.approx(max(each)) if each else pytest.approx(np.nan, nan_ok=True))
    single, strictly, set_valued = found.hits()
    assert (single & ~set_valued).sum() == 0
    assert (strictly & ~set_valued).sum() == 0
    assert not single[~found.answered].any()
    assert not strictly[3]
    sweep = threshold_sweep(found)
    for cut, a, b, c in zip(SWEEP, sweep.single, sweep.strict, sweep.acceptable, strict=True):
        assert a == (found.iou >= cut).mean()
        assert b == (np.delete(found.iou_strict, 3) >= cut).mean()
        assert c == (found.iou_set >= cut).mean()
    expected = (found.iou.mean(), np.delete(found.iou_strict, 3).mean(), found.iou_set.mean())
    assert mean_iou(found) == pytest.approx(expected)
    order = rng.permutation(n)
    sets = ([s[i] for i in order] for s in (strict, acceptable))
    other = grounding_outcomes(predicted[order], truth[order], *sets)
    np.testing.assert_array_equal(other.iou_set, found.iou_set[order])


def test_exactly_one_half_is_a_hit_and_no_answer_is_none() -> None:
    target = np.array([[0, 0, 2, 1]] * 3)
    predicted = np.array([[0, 0, 1, 1], [0, 0, 0.999, 1], [np.nan] * 4])
    found = grounding_outcomes(predicted, target, [target[:1]] * 3, [[[0, 0, 2, 1], [0, 0, 1, 1]]] * 3, [1, 0, np.nan])
    assert found.iou.tolist() == [0.5, pytest.approx(0.4995), 0]
    assert found.hits()[0].tolist() == [True, False, False]
    assert found.hits()[2].tolist() == [True, True, False]
    np.testing.assert_allclose(threshold_sweep(found, [0.45, 0.5, 0.55]).single, [2 / 3, 1 / 3, 0])
    assert found.hits(0.4)[0].tolist() == [True, True, False]
    assert found.reference_right[:2].tolist() == [1, 0]
    assert np.isnan(found.reference_right[2])
    assert np.isnan(found.pair_right).all()
    assert largest_iou(predicted, [target[:1], [], []])[0] == 0.5


BOX = [[0.0, 0.0, 2.0, 2.0]]


@pytest.mark.parametrize(
    ("predicted", "truth", "sets", "right"),
    [
        ([[0, 0, np.nan, 1]], BOX, [BOX], None),
        ([[0, 0, np.inf, 1]], BOX, [BOX], None),
        ([[5, 5, 2, 2]], BOX, [BOX], None),
        (BOX, [[np.nan] * 4], [BOX], None),
        (BOX, [[4, 4, 2, 2]], [BOX], None),
        (BOX, BOX * 2, [BOX], None),
        (BOX, BOX, [], None),
        (BOX, BOX, [[[0, 0, 1]]], None),
        (BOX, BOX, [BOX[0]], None),
        (BOX, BOX, [[[np.nan] * 4]], None),
        (np.zeros((1, 5)), BOX, [BOX], None),
        (BOX, BOX, [BOX], [True, False]),
        (BOX, BOX, [BOX], [0.5]),
    ],
)
def test_boxes_that_cannot_be_judged_are_refused(predicted: list, truth: list, sets: list, right: list | None) -> None:
    with pytest.raises(InputError):
        grounding_outcomes(predicted, truth, sets, sets, right)


def test_sweeps_refuse_an_iou_of_nothing() -> None:
    found = grounding_outcomes(BOX, BOX, [BOX], [BOX])
    for cut in (0.0, 1.1, np.nan):
        with pytest.raises(InputError):
            threshold_sweep(found, cut)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_paired_iou_is_the_diagonal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_boxes(rng, 6), random_boxes(rng, 6)
    np.testing.assert_array_equal(paired_iou_2d(a, b), np.diag(iou_2d(a, b)))
    np.testing.assert_array_equal(paired_iou_2d(a, a), np.ones(6))


def test_no_expressions_have_no_accuracy() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = grounding_outcomes(np.zeros((0, 4)), [], [], [])
        assert np.isnan(mean_iou(found)).all()
        assert np.isnan(threshold_sweep(found).acceptable).all()
