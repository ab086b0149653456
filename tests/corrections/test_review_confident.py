"""Confident learning of one question: its counts against cleanlab's, its probabilities against known errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.corrections.review.doubts import (
    Noise,
    confident_joint,
    estimate_noise,
    probability_wrong,
    self_confidence,
)
from pipeline.system import InputError


def labelled(count: int, no_for_yes: float, yes_for_no: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth, what labels say, and the exact probability of "yes"; most questions are easy, as relations are."""
    rng = np.random.default_rng(seed)
    clear = 1 / (1 + np.exp(-rng.normal(-8, 25, count)))
    truth = rng.random(count) < clear
    says = truth ^ (rng.random(count) < np.where(truth, no_for_yes, yes_for_no))
    return truth, says, clear * (1 - no_for_yes) + (1 - clear) * yes_for_no


def test_thresholds_and_joint_are_those_of_cleanlab() -> None:
    """cleanlab 2.9.0: count.get_confident_thresholds, count.compute_confident_joint(calibrate=False)."""
    rng = np.random.default_rng(5)
    truth = rng.random(400) < 0.3
    says = truth ^ (rng.random(400) < np.where(truth, 0.2, 0.08))
    p = np.clip(np.where(truth, 0.8, 0.12) + rng.normal(0, 0.15, 400), 0.01, 0.99).round(2)
    thresholds, counts = confident_joint(p, says)
    np.testing.assert_allclose(thresholds, [0.78836431, 0.65961832], atol=5e-9)
    np.testing.assert_array_equal(counts, [[174, 23], [21, 85]])
    joint = estimate_noise(p, says).joint
    np.testing.assert_allclose(joint.sum(axis=1), [(~says).sum(), says.sum()])
    # Theirs is calibrated and rounded, ours has one more error of either kind.
    np.testing.assert_allclose(joint, [[238, 31], [26, 105]], atol=2)


@pytest.mark.parametrize(("no_for_yes", "yes_for_no"), [(0.1, 0.1), (0.25, 0.03), (0.02, 0.2), (0.0, 0.0)])
def test_noise_rates_are_found(no_for_yes: float, yes_for_no: float) -> None:
    truth, says, p = labelled(40_000, no_for_yes, yes_for_no, 1)
    noise = estimate_noise(p, says)
    assert noise.no_for_yes == pytest.approx(no_for_yes, abs=0.05)
    assert noise.yes_for_no == pytest.approx(yes_for_no, abs=0.05)
    assert noise.wrong == pytest.approx((truth != says).sum(), abs=0.03 * len(says))


def test_probabilities_are_frequencies_and_find_the_errors() -> None:
    truth, says, p = labelled(40_000, 0.1, 0.1, 2)
    wrong = probability_wrong(p, says)
    is_wrong = truth != says
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.8), (0.8, 1.0)):
        inside = (wrong >= low) & (wrong <= high)
        assert inside.sum() > 50
        assert is_wrong[inside].mean() == pytest.approx(wrong[inside].mean(), abs=0.15)
    worst = np.argsort(-wrong)[: is_wrong.sum()]
    assert is_wrong[worst].mean() > 0.75
    best = np.argsort(self_confidence(p, says))[: is_wrong.sum()]
    assert is_wrong[worst].mean() >= is_wrong[best].mean() - 0.01


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=80))
def test_a_less_probable_label_is_never_less_probably_wrong(cells: list[tuple[float, bool]]) -> None:
    p, says = np.array([c[0] for c in cells]), np.array([c[1] for c in cells])
    noise = estimate_noise(p, says)
    wrong = probability_wrong(p, says, noise)
    assert np.isfinite(wrong).all()
    assert wrong.min() >= 0
    assert wrong.max() <= 1
    for answer in (False, True):
        order = np.argsort(self_confidence(p, says)[says == answer])
        assert (np.diff(wrong[says == answer][order]) <= 1e-12).all()
    # Yes and no are two names.
    np.testing.assert_allclose(
        probability_wrong(1 - p, ~says, Noise(noise.joint[::-1, ::-1], noise.no_for_yes, noise.yes_for_no)),
        wrong,
        atol=1e-6,
    )


def test_too_few_labels_have_no_noise_rates() -> None:
    p, says = np.array([0.9, 0.2, 0.4]), np.array([True, True, False])
    np.testing.assert_allclose(probability_wrong(p, says), [0.1, 0.8, 0.4])
    assert len(probability_wrong(np.zeros(0), np.zeros(0, np.bool_))) == 0


@pytest.mark.parametrize("p", [[0.5], [np.nan, 0.5], [1.1, 0.5], [[0.5, 0.5]]])
def test_what_is_no_probability_is_refused(p: list) -> None:
    with pytest.raises(InputError):
        estimate_noise(np.array(p), np.array([True, False]))
