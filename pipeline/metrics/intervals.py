"""Figures made of counts, with confidence intervals by a bootstrap over clusters (Field and Welsh, JRSS B 2007).

Rows of one scene resemble each other, so that whole scenes are drawn again and
not rows. Everything here is a function of sums over rows: a resample is a vector
of how often each cluster was drawn, and all resamples are one matrix product.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

FEWEST_CLUSTERS = 10
"""Below this number of clusters a percentile interval is too narrow to be relied on."""
MOST_UNDEFINED = 0.05
"""With a larger share of resamples in which the figure has no meaning there is no interval."""
BLOCK_CELLS = 2**21
"""Cells of the matrix of resamples held at a time."""

Statistic = Callable[[np.ndarray], np.ndarray]
"""From sums (S, ...) to figures (S, K); NaN where undefined."""


@dataclass(frozen=True)
class BootstrapConfig:
    """Settings of a bootstrap."""

    resamples: int = 2000
    seed: int | np.random.SeedSequence = 0  # The same seed, clusters and rows give the same interval
    confidence: float = 0.95  # Between 0 and 1

    def __post_init__(self) -> None:
        require(
            self.resamples >= 1 and 0 < self.confidence < 1 and (not isinstance(self.seed, int) or self.seed >= 0),
            "a bootstrap needs resamples, a confidence between 0 and 1, and a seed of at least 0",
            got=f"{self.resamples} resamples, confidence {self.confidence}, seed {self.seed}",
        )


@dataclass(frozen=True)
class Estimate:
    """A figure with its interval.

    >>> from pipeline.metrics import Estimate
    >>> Estimate(0.627, 0.599, 0.654, n=1200, clusters=40).formatted()
    '62.7 [59.9, 65.4]'
    """

    value: float  # Of the rows as they are; NaN where undefined
    low: float  # Percentile interval; NaN where there is none
    high: float
    n: int  # Rows that count
    clusters: int  # Clusters among them
    note: str = ""  # Why the value or the interval is missing, or unreliable; else empty

    def formatted(self, scale: float = 100.0, decimals: int = 1, signed: bool = False) -> str:
        """Format as "62.7 [59.9, 65.4]"; "62.7 [–]" without an interval, "–" without a value.

        `signed` writes a plus before what is positive: for differences.
        """
        if not math.isfinite(self.value):
            return "–"

        def text(x: float) -> str:
            shown = round(x * scale, decimals) + 0.0  # Adding zero turns -0.0 into 0.0.
            return f"{shown:{'+' if signed and shown else ''}.{decimals}f}"

        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            return f"{text(self.value)} [–]"
        return f"{text(self.value)} [{text(self.low)}, {text(self.high)}]"

    def record(self) -> dict[str, Any]:
        """JSON: value, low, high (None for NaN), n, clusters, note."""
        numbers = {
            k: v if math.isfinite(v) else None
            for k, v in (("value", self.value), ("low", self.low), ("high", self.high))
        }
        return {**numbers, "n": self.n, "clusters": self.clusters, "note": self.note}


def resample_weights(
    clusters: int, config: BootstrapConfig | None = None, block_cells: int = BLOCK_CELLS
) -> Iterator[np.ndarray]:
    """Draw how often each cluster is in each resample: multinomial, as many draws as clusters.

    Blocks (b, C) float64 of rows which together have `resamples` rows. The rows do not depend on `block_cells`.
    """
    config = config or BootstrapConfig()
    rng = np.random.default_rng(config.seed)
    at_a_time = max(1, block_cells // clusters)
    for start in range(0, config.resamples, at_a_time):
        rows = min(at_a_time, config.resamples - start)
        drawn = rng.integers(0, clusters, (rows, clusters))
        drawn += np.arange(rows)[:, None] * clusters
        yield np.bincount(drawn.ravel(), minlength=rows * clusters).reshape(rows, clusters).astype(np.float64)


def bootstrap(
    rows: np.ndarray,
    clusters: Any,
    statistic: Statistic,
    *,
    counted: np.ndarray | None = None,
    other: np.ndarray | None = None,
    config: BootstrapConfig | None = None,
) -> list[Estimate]:
    """Bootstrap any figures that are functions of sums over rows, all from the same resamples.

    Parameters
    ----------
    rows : (N, ...) float64
        Summands.
    clusters : (N,) int or str
        Scene of each row, or frame where there is one scene.
    statistic : callable
        From sums (S, ...) to K figures (S, K), each resample for itself; NaN where undefined.
    counted : (N, K) bool, optional
        Rows that each figure rests on; all by default.
    other : (N, ...) float64, optional
        The same rows of another system: the figures are then those of `rows`
        less those of `other`, with the same resamples for both.

    Returns
    -------
    list of Estimate
        K of them. With one cluster the bounds are NaN and `note` says so.

    Raises
    ------
    InputError
        Numbers that are not finite, as where records lack some.
    """
    config = config or BootstrapConfig()
    systems = [np.asarray(of, np.float64) for of in (rows, other) if of is not None]
    require(
        all(np.isfinite(of).all() for of in systems), "figures that are counted must be finite", cause="are some lost?"
    )
    rows, (index, count) = systems[0], numbered(clusters)
    sums = [_cluster_sums(system.reshape(len(rows), math.prod(rows.shape[1:])), index, count) for system in systems]

    def figures(of: list[np.ndarray]) -> np.ndarray:
        found = [statistic(s.reshape(len(s), *rows.shape[1:])) for s in of]
        return found[0] if len(found) == 1 else found[0] - found[1]

    values = figures([s.sum(axis=0, keepdims=True) for s in sums])[0]
    counted = np.ones((len(rows), len(values)), np.bool_) if counted is None else counted
    per_cluster = _cluster_sums(counted.astype(np.float64), index, count)
    n, held = per_cluster.sum(axis=0).astype(int), (per_cluster > 0).sum(axis=0)
    if count < 2:
        drawn = np.full((1, len(values)), np.nan)
    else:
        # One product a system, of equal shape: equal systems then differ by exactly nothing.
        blocks = [[weights @ s for s in sums] for weights in resample_weights(count, config)]
        drawn = figures([np.concatenate(parts) for parts in zip(*blocks, strict=True)])
    return [_estimate(float(values[k]), drawn[:, k], int(n[k]), int(held[k]), config) for k in range(len(values))]


def numbered(clusters: Any) -> tuple[np.ndarray, int]:
    """Number of each row's cluster, (N,) int64, in the order of the sorted ids, and the number of clusters."""
    names, index = np.unique(np.asarray(clusters), return_inverse=True)
    return index.astype(np.int64), len(names)


def _cluster_sums(rows: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """Sums of (N, m) rows by cluster, (C, m) float64."""
    if not len(rows):
        return np.zeros((0, rows.shape[1]))
    order = np.argsort(index, kind="stable")
    starts = np.searchsorted(index[order], np.arange(count))
    return np.add.reduceat(rows[order], starts, axis=0)


def _estimate(value: float, drawn: np.ndarray, n: int, clusters: int, config: BootstrapConfig) -> Estimate:
    defined = drawn[~np.isnan(drawn)]
    missing = 1 - len(defined) / len(drawn)
    reasons = (
        (n == 0, "no row counts"),
        (not math.isfinite(value), "undefined on these rows"),
        (clusters < 2, "one cluster: no interval can be drawn from it"),
        (missing > MOST_UNDEFINED, f"undefined in {missing:.0%} of the resamples: no interval"),
    )
    note = next((text for applies, text in reasons if applies), None)
    if note is not None:
        return Estimate(value, math.nan, math.nan, n, clusters, note)
    tail = 50 * (1 - config.confidence)
    low, high = np.percentile(defined, [tail, 100 - tail])
    few = f"{clusters} clusters: with fewer than {FEWEST_CLUSTERS} an interval is unreliable"
    return Estimate(value, float(low), float(high), n, clusters, few if clusters < FEWEST_CLUSTERS else "")


def ratio_estimate(
    numerator: Any,
    denominator: Any,
    clusters: Any,
    *,
    other: tuple[Any, Any] | None = None,
    config: BootstrapConfig | None = None,
) -> Estimate:
    """Sum of (N,) numerators over sum of (N,) denominators; rows with denominator 0 do not count.

    With `other`, the (numerator, denominator) of another system on the same
    rows, the difference of the two ratios. Arguments else as in `bootstrap`.
    """
    first = np.stack([numerator, denominator], axis=1)
    second = None if other is None else np.stack(other, axis=1)
    counted = first[:, 1:] != 0 if second is None else (first[:, 1:] != 0) | (second[:, 1:] != 0)
    return bootstrap(
        first, clusters, lambda sums: ratio(sums[:, :1], sums[:, 1:]), counted=counted, other=second, config=config
    )[0]


def mean_estimate(
    values: Any, clusters: Any, *, other: Any | None = None, config: BootstrapConfig | None = None
) -> Estimate:
    """Mean of (N,) values, such as hits or IoUs; with `other` (N,), the mean of `values` less the mean of `other`."""
    second = None if other is None else (other, np.ones(np.shape(other)))
    return ratio_estimate(values, np.ones(np.shape(values)), clusters, other=second, config=config)


def share_estimate(flags: Any, clusters: Any, confidence: float = 0.95) -> Estimate:
    """Share of (N,) flags that are set, with Wilson's score interval (JASA 1927).

    It takes the rows as independent, and so is too narrow where those of a cluster resemble each other; unlike a
    bootstrap it has a width where there are few rows or all are alike.

    >>> from pipeline.metrics import share_estimate
    >>> share_estimate([True] * 8 + [False] * 2, ["kitchen"] * 5 + ["office"] * 5).formatted()
    '80.0 [49.0, 94.3]'
    """
    flags, (_, held) = np.asarray(flags, np.bool_), numbered(clusters)
    n = len(flags)
    if not n:
        return Estimate(math.nan, math.nan, math.nan, 0, 0, "no row counts")
    share, z2 = float(flags.mean()), NormalDist().inv_cdf((1 + confidence) / 2) ** 2
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = math.sqrt(z2 * (share * (1 - share) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return Estimate(share, max(0.0, middle - half), min(1.0, middle + half), n, held)


def ratio(part: Any, whole: Any) -> np.ndarray:
    """Quotient `part` / `whole` of arrays of any shape, float64; NaN where `whole` is 0."""
    part, whole = np.broadcast_arrays(np.asarray(part, np.float64), np.asarray(whole, np.float64))
    return np.divide(part, whole, out=np.full(part.shape, np.nan), where=whole != 0)


def f1_of(tp: Any, fp: Any, fn: Any) -> np.ndarray:
    """F1 = 2 tp / (2 tp + fp + fn); NaN without support (tp + fn = 0), whatever was predicted."""
    doubled, support = 2.0 * np.asarray(tp, np.float64), np.asarray(tp, np.float64) + fn
    return ratio(doubled, np.where(support > 0, doubled + fp + fn, 0.0))


def mean_of_defined(values: np.ndarray) -> np.ndarray:
    """Mean over the last axis without NaN; NaN where all are."""
    defined = ~np.isnan(values)
    return ratio(np.where(defined, values, 0.0).sum(axis=-1), defined.sum(axis=-1))


@dataclass(frozen=True)
class McNemar:
    """McNemar's exact test."""

    n: int  # Questions
    b: int  # Questions that only the first system answered rightly
    c: int  # Questions that only the second system answered rightly
    p_value: float  # Two-sided; 1 where the systems never disagree


def mcnemar(first: Any, second: Any) -> McNemar:
    """Test a paired difference by McNemar's exact test, the binomial probability of as uneven a split of b + c.

    It takes the questions as independent. Questions about one scene are not, so
    that its p-value is too small where scenes differ; the clustered interval of
    the difference (`pipeline.metrics.intervals`) does not need that.

    Parameters
    ----------
    first, second : (N,) bool
        Right answers of each system, question by question.

    >>> from pipeline.metrics import mcnemar
    >>> mcnemar([True] * 9 + [False], [False] * 6 + [True] * 4)
    McNemar(n=10, b=6, c=1, p_value=0.125)
    """
    first, second = np.asarray(first, np.bool_), np.asarray(second, np.bool_)
    b, c = int((first & ~second).sum()), int((~first & second).sum())
    return McNemar(len(first), b, c, _two_sided(b, c))


def _two_sided(b: int, c: int) -> float:
    if b == c:
        return 1.0
    from scipy.special import bdtr

    # Under one half the distribution is symmetric, so that both tails weigh the same.
    return min(1.0, 2 * float(bdtr(min(b, c), b + c, 0.5)))


@dataclass(frozen=True, eq=False)
class Agreement:
    """Two reviewers' judgements of the same items."""

    judgements: tuple[str, ...]  # All judgements, sorted: the order of rows and columns
    table: np.ndarray  # (J, J) int64, items by the judgement of the first (rows) and the second (columns)
    observed: float  # Share of items judged alike; NaN without items
    expected: float  # Share by chance, with each one's own habits; NaN without items
    kappa: float  # (observed - expected) / (1 - expected); NaN where both always judged one and the same

    @property
    def items(self) -> int:
        return int(self.table.sum())

    def record(self) -> dict[str, Any]:
        """JSON; None where a figure has no meaning."""
        figures = {name: float(getattr(self, name)) for name in ("observed", "expected", "kappa")}
        return {
            "items": self.items,
            **{name: value if np.isfinite(value) else None for name, value in figures.items()},
            "judgements": list(self.judgements),
            "table": self.table.tolist(),
        }


def cohen_kappa(first: Sequence[str], second: Sequence[str]) -> Agreement:
    """Cohen's kappa of two reviewers' judgements of the same items, in the same order.

    >>> from pipeline.metrics import cohen_kappa
    >>> cohen_kappa(["yes", "yes", "no", "no"], ["yes", "no", "no", "no"]).kappa
    0.5
    """
    names, codes = np.unique(np.array([*first, *second], np.str_), return_inverse=True)
    table = np.zeros((len(names), len(names)), np.int64)
    np.add.at(table, (codes[: len(first)], codes[len(first) :]), 1)
    judgements = tuple(str(name) for name in names)
    if not len(first):
        return Agreement(judgements, table, float("nan"), float("nan"), float("nan"))
    share = table / table.sum()
    observed = float(np.trace(share))
    expected = float(share.sum(axis=1) @ share.sum(axis=0))
    kappa = (observed - expected) / (1 - expected) if expected < 1 else float("nan")
    return Agreement(judgements, table, observed, expected, kappa)
