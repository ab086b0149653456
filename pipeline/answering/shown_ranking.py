"""A ranking that cannot be asked again, as far as the scores of its file show what it goes by.

Of two pairs of one line the file says which scored more. How probable that is follows from P(target), P(reference) and
P(relation) of both: a sum of curves, each of which rises with these factors, is fitted to all such comparisons of the
file, whatever the scale of its scores. A ranking that uses its factors at all gives no less to a pair that is better in
all of them. Where such a sum does not say what most comparisons say, the ranking goes by something else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST_COMPARED, MOST_COMPARED = 30, 12_000
"""Comparisons: of fewer nothing is said, of more some are taken, evenly."""
DECIDED_ALIKE = 0.8
"""A fit stands in that says so much of the comparisons as they are; some scores may be wrong themselves."""
UNLIKELY = 0.1
"""A comparison that is less probable than this is left out of the last fit: its scores are wrong, or odd."""
_RIDGE = 0.5
_BENDS = (0.25, 0.5, 0.75)

Compared = tuple[np.ndarray, np.ndarray]
"""(N, 3) float64 factors and (N,) float64 scores of the pairs of one line."""


def curves(factors: np.ndarray) -> np.ndarray:
    """(..., K) float64: of factors (..., 3), each no less where a factor is more."""
    clear = np.clip(factors, 0.01, 0.99)
    bends = [np.minimum(clear, bend) for bend in _BENDS]
    odds = np.log(clear / (1 - clear))
    t, r, p = np.moveaxis(clear, -1, 0)
    joined = [np.minimum(t, r), np.minimum(t, p), np.minimum(r, p), t * r, t * p, r * p, t * r * p]
    return np.concatenate([clear, *bends, np.log(clear), odds, np.stack(joined, axis=-1)], axis=-1)


@dataclass(frozen=True)
class ShownRanking:
    """What the file shows of its ranking.

    Attributes
    ----------
    weights : (K,) float64
        Of `curves`; the difference of two sums is the log odds that the one pair scores more.
    unit : float
        How much more a pair scores, about, in the file's own scores, where its sum is one more.
    """

    weights: np.ndarray
    unit: float

    def sums(self, factors: np.ndarray) -> np.ndarray:
        """(...) float64: of factors (..., 3)."""
        return np.asarray(curves(factors) @ self.weights)

    @staticmethod
    def of(lines: Sequence[Compared]) -> ShownRanking | None:
        """What lines show together; None where that is nothing, or nothing that their factors explain."""
        higher, lower, more = [], [], []
        for factors, scores in lines:
            a, b = np.nonzero(scores[:, None] > scores[None] + 1e-9)
            higher.append(factors[a])
            lower.append(factors[b])
            more.append(scores[a] - scores[b])
        count = sum(map(len, more))
        if count < LEAST_COMPARED:
            return None
        chosen = np.unique(np.linspace(0, count - 1, min(MOST_COMPARED, count)).astype(int))
        x = curves(np.concatenate(higher)[chosen]) - curves(np.concatenate(lower)[chosen])
        weights = _fitted(x)
        if (x @ weights > 0).mean() < DECIDED_ALIKE:
            return None
        kept = x @ weights > np.log(UNLIKELY / (1 - UNLIKELY))
        weights = _fitted(x[kept])
        apart = x[kept] @ weights
        unit = np.concatenate(more)[chosen][kept] @ apart / max(float(apart @ apart), 1e-12)
        return ShownRanking(weights, max(float(unit), 1e-12))


def _fitted(x: np.ndarray) -> np.ndarray:
    """(K,) float64, none below 0: weights that make what x ((N, K)) compares most probable, as a logistic."""
    from scipy.optimize import minimize

    scale = np.maximum(x.std(axis=0), 1e-6)
    z = x / scale

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        odds = z @ w
        wrong = 1 / (1 + np.exp(np.clip(odds, -500, 500)))
        return float(np.logaddexp(0, -odds).sum() + _RIDGE * w @ w / 2), _RIDGE * w - wrong @ z

    start = np.full(z.shape[1], 0.1)
    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(0, None)] * z.shape[1]).x / scale
