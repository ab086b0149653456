"""What each module costs: the accuracy that its truth would gain, where that can be worked out, and why where not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import factorial
from typing import Any

import numpy as np

from pipeline.diagnosis.oracles import ORACLES, SUBSETS, names_of
from pipeline.evaluation.grounding_tables import column
from pipeline.metrics.intervals import BootstrapConfig, Estimate, mean_estimate
from pipeline.system.arrow import pa

EVERY = SUBSETS - 1
"""The bits of all ORACLES."""
UNTOLD = "no relation probabilities are given"
"""Why costs cannot be worked out in records of before, which do not say it."""


@dataclass(frozen=True)
class Deltas:
    """Set-valued accuracy on the gold parse with parts of the pipeline replaced by the truth."""

    expressions: int
    # value (2^K,) float64: v(S) for each subset of the K oracles; of an expression of which some oracles are not known,
    # without these
    value: np.ndarray
    # single: v({m}) - v(none), not clipped: a negative one says that the module made up for an error of another. These
    # do not add up.
    single: dict[str, Estimate]
    # shapley: phi_m = sum over S without m of |S|! (K - 1 - |S|)! / K! (v(S + m) - v(S)). These add up to v(all) -
    # v(none).
    shapley: dict[str, Estimate]
    # untold: the oracles whose costs cannot be worked out, which the two do not hold, and why
    untold: dict[str, str] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """Convert to JSON; null for costs without a basis."""
        nothing = dict.fromkeys(self.untold)
        value = {"+".join(names_of(s)) or "none": float(v) for s, v in enumerate(self.value)}
        told = {name: v if self.untold.keys().isdisjoint(name.split("+")) else None for name, v in value.items()}
        explained = float(sum(e.value for e in self.shapley.values()))
        return {
            "expressions": self.expressions,
            "value": told,
            "single": {m: e.record() for m, e in self.single.items()} | nothing,
            "shapley": {m: e.record() for m, e in self.shapley.items()} | nothing,
            "shapley_sum": explained,
            "loss_explained": explained if self.untold else float(self.value[-1] - self.value[0]),
            # What no oracle mends: bad labels, pairs excluded as one thing, ties.
            "residual": None if self.untold else float(1 - self.value[-1]),
            "untold": self.untold,
        }


def shapley_weights(n: int) -> np.ndarray:
    """(n, 2^n) float64: phi = weights @ v."""
    weights = np.zeros((n, 1 << n))
    for m, subset in product(range(n), range(1 << n)):
        others = (subset & ~(1 << m)).bit_count()
        share = factorial(others) * factorial(n - 1 - others) / factorial(n)
        weights[m, subset] = share if subset >> m & 1 else -share
    return weights


def oracle_deltas(
    right_with: np.ndarray,
    clusters: np.ndarray,
    config: BootstrapConfig | None = None,
    oracles: Sequence[str] = ORACLES,
    untold: Mapping[str, str] | None = None,
) -> Deltas:
    """The deltas of a run.

    `right_with` (E,) int, or (E, 2^K) float64: of each expression, bit s set where the answer is right with subset s;
    or 1 for it in column s. `clusters` (E,): what resembles each other, for the intervals: scenes, or frames.
    `oracles`: those that the subsets are of, in the order of their bits. `untold`: those whose costs are left out, and
    why.
    """
    right, subsets = np.asarray(right_with), 1 << len(oracles)
    if right.ndim < 2:
        right = ((right.astype(np.int64)[:, None] >> np.arange(subsets)) & 1).astype(np.float64)
    told = [(m, name) for m, name in enumerate(oracles) if name not in (untold or {})]
    single = {name: mean_estimate(right[:, 1 << m], clusters, other=right[:, 0], config=config) for m, name in told}
    weights = shapley_weights(len(oracles))
    shapley = {name: mean_estimate(right @ weights[m], clusters, config=config) for m, name in told}
    value = right.mean(axis=0) if len(right) else np.full(subsets, np.nan)
    return Deltas(len(right), value, single, shapley, dict(untold or {}))


@dataclass(frozen=True, eq=False)
class KnownOracles:
    """What is known of the expressions of a run."""

    # right (E, S) float64: 1 where the answer is right under a subset of the oracles, as far as these can be put in
    # place
    right: np.ndarray
    known: np.ndarray  # (E,) int64: the bits of the oracles that can
    why: dict[str, list[str | None]]  # of each expression, by oracle and PARSE: why it cannot

    @staticmethod
    def of(records: pa.Table) -> KnownOracles:
        """Read `right_with` and `untold` of records; earlier records have no `untold`."""
        answered, right_with = column(records, "set_correct") > 0, column(records, "right_with")
        none = np.isnan(right_with)
        said = records.column("untold").to_pylist() if "untold" in records.column_names else [None] * len(none)
        parts = [dict(part.split(": ", 1) for part in told or ()) for told in said]
        why = {
            m: [row.get(m, UNTOLD if n else None) for row, n in zip(parts, none.tolist(), strict=True)] for m in ORACLES
        }
        known = sum((np.array([w is None for w in why[m]], np.int64) << k for k, m in enumerate(ORACLES)), 0 * none)
        parsed = column(records, "parse_ok") != 0
        why["PARSE"] = [w if n and not p else None for w, n, p in zip(why[ORACLES[0]], none, parsed, strict=True)]
        bits = np.where(none, answered * ((1 << SUBSETS) - 1), right_with).astype(np.int64)
        right = (bits[:, None] >> (np.arange(SUBSETS) & known[:, None])) & 1
        return KnownOracles(right.astype(np.float64), known, why)

    @property
    def unmended(self) -> np.ndarray:
        """(E,) bool: wrong with all oracles in place."""
        return self.right[:, -1] == 0

    def untold(self, costs: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Costs ((E,) float64 by oracle and PARSE) without a basis, with the reasons.

        A cost is told where more is known of it than is not: 0 is never told for what nobody knows.
        """
        found = {}
        for name, cost in costs.items():
            reasons = self.why[name]
            missing = np.array([w is not None for w in reasons])
            open_ = missing & self.unmended
            if len(missing) and (missing.all() or open_.sum() > max(float(cost.sum()), 0.0)):
                counted = open_ if open_.any() else missing
                (why, n), *_ = Counter(w for w, one in zip(reasons, counted, strict=True) if one).most_common(1)
                wrong = int(self.unmended.sum())
                found[name] = str(why) if n == wrong or not open_.any() else f"{why} ({n} of {wrong} wrong answers)"
        return found
