"""How a pair stands among the others of its line: every view of it by definition, and what a ranking goes by."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slow_cases import mostly_slow

from pipeline.answering import FittedRanking
from pipeline.answering.fitted_models import standing

RELATION_SHARES = 18
"""The first column of shares: of the relation, among the pairs of the same target."""


def line(rng: np.random.Generator, targets: int = 4, references: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Factors (P, 3) and ids (P, 2) of all pairs of so many things."""
    t, r = rng.uniform(0.02, 0.98, targets), rng.uniform(0.02, 0.98, references)
    ids = np.array([(a, 10 + b) for a in range(targets) for b in range(references)])
    return np.stack([t[ids[:, 0]], r[ids[:, 1] - 10], rng.uniform(0.02, 0.98, len(ids))], axis=1), ids


def shares(x: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    return np.array([v / x[numbers == n].sum() for v, n in zip(x, numbers, strict=True)])


@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 5), st.sampled_from([0, 1, 2]))
def test_more_of_a_factor_is_no_less_in_any_view(seed: int, targets: int, references: int, part: int) -> None:
    rng = np.random.default_rng(seed)
    factors, ids = line(rng, targets, references)
    row = int(rng.integers(len(ids)))
    own = np.arange(len(ids)) == row if part == 2 else ids[:, part] == ids[row, part]
    more = factors.copy()
    more[own, part] = rng.uniform(factors[row, part], 1)
    before, after = standing(np.stack([factors, more]), ids)[:, row]
    assert (after >= before - 1e-9).all()


@given(st.integers(0, 10**6))
def test_neither_the_order_of_pairs_nor_what_was_not_proposed_counts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    factors, ids = line(rng)
    told, order = standing(factors, ids), rng.permutation(len(ids))
    np.testing.assert_allclose(standing(factors[order], ids[order]), told[order], atol=1e-9)
    extra = np.concatenate([factors, rng.uniform(0, 1, (2, 3))]), np.concatenate([ids, [[-1, 10], [1, -1]]])
    np.testing.assert_allclose(standing(*extra)[:-2], told, atol=1e-9)


def test_shares_are_those_of_the_pairs_of_one_target() -> None:
    factors, ids = line(np.random.default_rng(3))
    told = standing(factors, ids)[:, RELATION_SHARES : RELATION_SHARES + 6]
    p = factors[:, 2]
    best = np.array([max(p[(ids[:, 0] == a) & (ids[:, 1] != b)]) for a, b in ids])
    mean = np.array([p[ids[:, 0] == a].mean() for a, _ in ids])
    share = shares(p, ids[:, 0])
    expected = [np.log(share), share, p >= best, (p - best) / np.maximum(p, best), np.maximum(p, best), mean]
    np.testing.assert_allclose(told, np.stack(expected, axis=1), atol=1e-9)


def test_a_line_of_which_nothing_was_proposed_has_numbers() -> None:
    assert np.isfinite(standing(np.full((3, 3), 0.5), np.full((3, 2), -1))).all()
    assert standing(np.zeros((0, 3)), np.zeros((0, 2), np.int64)).shape[0] == 0


def softmax(f: np.ndarray, ids: np.ndarray) -> np.ndarray:
    return f[:, 0] * shares(f[:, 1] * f[:, 2], ids[:, 0])


def dual_softmax(f: np.ndarray, ids: np.ndarray) -> np.ndarray:
    x = f.prod(axis=1)
    return shares(x, ids[:, 0]) * shares(x, ids[:, 1])


def within_the_line(f: np.ndarray, ids: np.ndarray) -> np.ndarray:
    return ((f - f.min(axis=0)) / np.ptp(f, axis=0)).sum(axis=1)


def deviations(f: np.ndarray, ids: np.ndarray) -> np.ndarray:
    return ((f - f.mean(axis=0)) / f.std(axis=0)).sum(axis=1)


def mutual(f: np.ndarray, ids: np.ndarray) -> np.ndarray:
    return f[:, 0] * f[:, 1] * np.minimum(shares(f[:, 2], ids[:, 0]), shares(f[:, 2], ids[:, 1]))


def best_target_first(f: np.ndarray, ids: np.ndarray) -> np.ndarray:
    x = f.prod(axis=1)
    return np.array([10 * x[ids[:, 0] == a].max() for a, _ in ids]) + 0.01 * x


RULES = [softmax, dual_softmax, within_the_line, deviations, mutual, best_target_first]


@pytest.mark.parametrize("score", mostly_slow(RULES, fast=(3,)))
def test_a_ranking_by_what_stands_beside_a_pair_is_foretold(
    score: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> None:
    rng = np.random.default_rng(5)
    seen = [line(rng, *rng.integers(2, 6, 2)) for _ in range(50)]
    shown = FittedRanking.of([(f, score(f, ids), ids) for f, ids in seen])
    assert shown is not None
    first = []
    for _ in range(100):
        f, ids = line(rng, *rng.integers(2, 6, 2))
        # As when a true probability stands for one that was given.
        f[rng.integers(len(f)), 2] = 0.98
        first.append(shown.sums(f, ids).argmax() == score(f, ids).argmax())
    assert np.mean(first) > 0.93
