"""Where a run loses its accuracy: each oracle alone, and fair shares of all of them by Shapley."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np

from pipeline.diagnosis.substitution import ORACLES, SUBSETS, names_of
from pipeline.metrics.intervals import BootstrapConfig, Estimate, mean_estimate


@dataclass(frozen=True)
class Deltas:
    """Set-valued accuracy on the gold parse with parts of the pipeline replaced by the truth.

    Attributes
    ----------
    expressions : int
    value : (16,) float64
        v(S) for each subset of the oracles.
    single : dict of str to Estimate
        v({m}) - v(none), not clipped: a negative one says that the module made up for an error of another.
        These do not add up.
    shapley : dict of str to Estimate
        phi_m = sum over S without m of |S|! (3 - |S|)! / 4! (v(S + m) - v(S)). These add up to v(all) - v(none).
    """

    expressions: int
    value: np.ndarray
    single: dict[str, Estimate]
    shapley: dict[str, Estimate]

    @property
    def residual(self) -> float:
        """1 - v(all): what no oracle mends (bad labels, pairs excluded as one thing, ties)."""
        return float(1 - self.value[-1])

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "expressions": self.expressions,
            "value": {"+".join(names_of(s)) or "none": float(v) for s, v in enumerate(self.value)},
            "single": {m: e.record() for m, e in self.single.items()},
            "shapley": {m: e.record() for m, e in self.shapley.items()},
            "shapley_sum": float(sum(e.value for e in self.shapley.values())),
            "loss_explained": float(self.value[-1] - self.value[0]),
            "residual": self.residual,
        }


def shapley_weights() -> np.ndarray:
    """(4, 16) float64: phi = weights @ v."""
    n = len(ORACLES)
    weights = np.zeros((n, SUBSETS))
    for m in range(n):
        for subset in range(SUBSETS):
            if subset >> m & 1:
                continue
            size = subset.bit_count()
            share = factorial(size) * factorial(n - 1 - size) / factorial(n)
            weights[m, subset | 1 << m] += share
            weights[m, subset] -= share
    return weights


def oracle_deltas(right_with: np.ndarray, clusters: np.ndarray, config: BootstrapConfig | None = None) -> Deltas:
    """The deltas of a run.

    Parameters
    ----------
    right_with : (E,) int
        Of each expression, bit s set where the answer is right with subset s.
    clusters : (E,)
        What resembles each other, for the intervals: scenes, or frames.
    """
    right = (np.asarray(right_with, np.int64)[:, None] >> np.arange(SUBSETS)) & 1
    right = right.astype(np.float64)
    weights = shapley_weights()
    single, shapley = {}, {}
    for m, name in enumerate(ORACLES):
        single[name] = mean_estimate(right[:, 1 << m], clusters, other=right[:, 0], config=config)
        shapley[name] = mean_estimate(right @ weights[m], clusters, config=config)
    return Deltas(len(right), right.mean(axis=0) if len(right) else np.full(SUBSETS, np.nan), single, shapley)
