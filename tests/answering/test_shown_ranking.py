"""A ranking that is known only by the scores of its pairs: what they show of it, and when they show nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.answering.shown_ranking import Compared, ShownRanking


def lines(score: Callable[[np.ndarray], np.ndarray], count: int = 40, noise: float = 0.0) -> list[Compared]:
    rng = np.random.default_rng(5)
    found = [rng.uniform(0.02, 0.98, (10, 3)) for _ in range(count)]
    return [(f, score(f) + noise * rng.normal(size=len(f))) for f in found]


def weakest(f: np.ndarray) -> np.ndarray:
    return 0.6 * f[:, 2] + 0.4 * f[:, :2].min(axis=1)


@pytest.mark.parametrize(
    "score",
    [
        weakest,
        lambda f: np.log(f).sum(axis=1),
        lambda f: 100 * f.prod(axis=1),
        lambda f: np.tanh(3 * f[:, 2]) + f[:, 0],
    ],
)
def test_scores_of_any_rising_rule_are_foretold(score: Callable[[np.ndarray], np.ndarray]) -> None:
    shown = ShownRanking.of(lines(score))
    assert shown is not None
    a, b = np.random.default_rng(6).uniform(0.05, 0.95, (2, 500, 3))
    sure = np.abs(score(a) - score(b)) > 0.1 * np.ptp(score(a))
    alike = (score(a) > score(b)) == (shown.sums(a) > shown.sums(b))
    assert alike[sure].mean() > 0.97
    # More of any factor is never less.
    assert (shown.sums(np.maximum(a, b)) >= shown.sums(a) - 1e-9).all()


def test_a_wrong_score_in_every_line_changes_nothing() -> None:
    broken = lines(weakest)
    for k, (_, scores) in enumerate(broken):
        scores[k % 10] = 2.0
    shown = ShownRanking.of(broken)
    assert shown is not None
    low, high = np.array([[0.5, 0.5, 0.1], [0.5, 0.5, 0.9]])
    assert shown.sums(high) - shown.sums(low) == pytest.approx(0.48, abs=0.1)


def test_noise_makes_less_sure() -> None:
    clear, noisy = (ShownRanking.of(lines(weakest, noise=noise)) for noise in (0.0, 0.05))
    assert clear is not None
    assert noisy is not None
    assert noisy.unit > 2 * clear.unit


def test_scores_that_do_not_follow_from_their_factors_show_nothing() -> None:
    rng = np.random.default_rng(7)
    assert ShownRanking.of(lines(lambda f: rng.random(len(f)))) is None
    assert ShownRanking.of(lines(lambda f: -weakest(f))) is None
    assert ShownRanking.of([(f[:5], scores[:5]) for f, scores in lines(weakest, count=2)]) is None
    assert ShownRanking.of([]) is None
