"""Pair scores of PRM: the score of every candidate pair, excluded pairs, and the order.

S = target_weight log P(target) + reference_weight log P(reference) + relation_weight log P(relation). The ranking, an
evaluation and a diagnosis all build this table, with as many axes of scenes in front as they need.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.answering.evidence import HOLDS, Factor
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

MIN_RELATION = 1e-6
MIN_SCORE = 1e-6
RIGHT_SCORE, WRONG_SCORE = 0.99, 0.01
TIE = 1e-9
"""Scores, and sums of posteriors, that differ by less are a tie."""


@dataclass(frozen=True)
class RankConfig:
    """Weights of the three log factors."""

    target_weight: float = 1.0
    reference_weight: float = 1.0
    relation_weight: float = 1.0
    aggregate: str = "max"  # The best pair wins, as in the paper; files of before may say "marginal"

    def __post_init__(self) -> None:
        require(self.aggregate == "max", "a ranking by sums of pairs is no more", got=self.aggregate, expected="max")

    @property
    def rule(self) -> Any:
        """Rule scoring pairs in place of the product: a `pair_rules.PairRule` of an imported ranking, or None."""
        return None

    @property
    def true_scores(self) -> tuple[float, float]:
        """Confidence of an object of the asked class, and of any other."""
        return RIGHT_SCORE, WRONG_SCORE

    def of(self, ids: Sequence[int], same: np.ndarray | None = None) -> RankConfig:
        """Config for a list of objects with these identities, some identical ((N, N) bool)."""
        return self


@dataclass(frozen=True)
class Link:
    """Relation of the answer: object `a` RELATION object `b` (and `c`, for between), with its probability.

    With `inverse` the relation holds the other way round: "table holding a lamp" has the table as `a`, and says that
    `b` is on it.
    """

    relation: str
    a: int
    b: int
    probability: float
    c: int | None = None
    inverse: bool = False
    names: tuple[str, ...] = ()  # Of `b` and `c` in the question


@dataclass(frozen=True)
class ScoredPair:
    """Candidate answer."""

    target: int
    # Places in the list of objects; None where no pair was allowed, or no relation to another object was asked
    reference: int | None
    # p_target, p_reference, p_relation: The three factors
    p_target: float
    p_reference: float
    p_relation: float
    log_score: float  # S, the weighted sum of logs
    product: float  # Of the factors, with those of all further relations of the expression
    probability: float  # Posterior over all allowed pairs
    # All relations of the expression with the objects that fill them; empty where only the one was asked
    links: tuple[Link, ...] = ()
    second_reference: int | None = None  # The other end of "between"
    # What the expression says of its objects one by one: attributes, choices, what they are not
    factors: tuple[Factor, ...] = ()

    def __repr__(self) -> str:
        factors = f"{self.p_target:.3f} · {self.p_reference:.3f} · {self.p_relation:.3f}"
        return f"<ScoredPair {self.target}, {self.reference}: {factors}, posterior {self.probability:.3f}>"

    @property
    def weakest(self) -> Link | None:
        """Least probable relation of the answer; None without links."""
        return min(self.links, key=lambda link: link.probability, default=None)

    @property
    def relation_probability(self) -> float:
        """Probability of the asked relation, of several the weakest."""
        return self.p_relation if self.weakest is None else self.weakest.probability

    @property
    def holds(self) -> bool:
        """True with every relation, attribute and choice at least as probable as not."""
        return self.relation_probability >= HOLDS and all(f.holds for f in self.factors)

    @property
    def p_attributes(self) -> float:
        """P(attributes, choices | x): product of statements on single objects; 1 without any."""
        return math.prod(f.probability for f in self.factors)

    @property
    def log_factors(self) -> dict[str, float]:
        """Contribution of each factor to S, unweighted."""
        return {
            "target": float(np.log(max(self.p_target, MIN_SCORE))),
            "reference": float(np.log(max(self.p_reference, MIN_SCORE))),
            "relation": float(np.log(max(self.p_relation, MIN_RELATION))),
        } | ({"attributes": float(np.log(max(self.p_attributes, MIN_SCORE)))} if self.factors else {})


@dataclass(frozen=True, eq=False)
class Side:
    """Candidates of a place of a pair."""

    index: np.ndarray  # (K,) or (..., K) int64: places in the list of objects
    scores: np.ndarray  # (..., K) float64: P(x | name), 0..1
    # (..., K) float64: what each adds to S: its own weighted log score, and the best of everything that hangs on it
    log: np.ndarray


def side(index: np.ndarray, scores: np.ndarray, weight: float) -> Side:
    """Candidates of a place without further relations."""
    # Not np.clip, which costs as much as all the rest.
    return Side(index, scores, weight * np.log(np.minimum(np.maximum(scores, MIN_SCORE), 1 - MIN_SCORE)))


def one_object_twice(indices: Sequence[np.ndarray], same: np.ndarray) -> np.ndarray:
    """Bool array with an axis for each place: combinations with two places of the same object.

    `indices` are those into `same`, (N, N) bool: pairs of the same object.
    """
    if len(indices) == 2:
        return same[indices[0][:, None], indices[1]]
    forbidden = np.zeros([len(p) for p in indices], np.bool_)
    for i in range(len(indices)):
        for j in range(i):
            shape = [1] * len(indices)
            shape[i], shape[j] = len(indices[i]), len(indices[j])
            forbidden |= same[np.ix_(indices[j], indices[i])].reshape(shape)
    return forbidden


def attached(p: np.ndarray, ends: Sequence[Side], forbidden: np.ndarray, config: RankConfig) -> np.ndarray:
    """(..., T, R) or (..., T, R, R): contribution of a relation and its ends to S; -inf where forbidden."""
    total = config.relation_weight * np.log(np.maximum(p, MIN_RELATION))
    for axis, end in enumerate(ends, start=1):
        total = total + _along(end.log, axis, 1 + len(ends))
    return np.where(forbidden, -np.inf, total)


def pair_table(
    target: Side, ends: Sequence[Side], p: np.ndarray, forbidden: np.ndarray, sizes: np.ndarray, config: RankConfig
) -> PairTable:
    """Score all pairs, of a single scene or of many at once.

    `ends`: the reference; with "between" both; `p`: (..., T, R) or (..., T, R, R) float64: probability of the relation;
    `forbidden`: no pairs: see `one_object_twice`; `sizes`: (N,) int64: pixels of the mask of every object; the larger
    target wins a tie.

    >>> import numpy as np
    >>> mugs, laptops = (side(np.array(k), np.array(p), 1.0) for k, p in (([0, 1], [0.9, 0.8]), ([2], [0.95])))
    >>> p, free = np.array([[0.05], [0.95]]), np.zeros((2, 1), bool)
    >>> table = pair_table(mugs, [laptops], p, free, np.ones(3, int), RankConfig())
    >>> table.pair(int(table.order()[0]))
    <ScoredPair 1, 2: 0.800 · 0.950 · 0.950, posterior 0.944>
    """
    if config.rule is not None and (len(ends) < 2 or config.rule.answered is not None):
        log_score = np.where(forbidden, -np.inf, config.rule.scores(target, ends, p))
        return PairTable(target, tuple(ends), p, log_score, sizes, config)
    # The same order of sums everywhere, so that S is the same to the last bit.
    log_score = _along(target.log, 0, 1 + len(ends)) + attached(p, ends, forbidden, config)
    return PairTable(target, tuple(ends), p, log_score, sizes, config)


def _along(values: np.ndarray, axis: int, axes: int) -> np.ndarray:
    """(..., K) along a single axis of the last `axes` axes."""
    return values.reshape(values.shape[:-1] + tuple(values.shape[-1] if a == axis else 1 for a in range(axes)))


@dataclass(frozen=True, eq=False)
class PairTable:
    """Pairs of a question, numbered by place in their scene's flattened table."""

    target: Side
    ends: tuple[Side, ...]
    # p_relation, log_score: (..., T, R) or (..., T, R, R) float64: S is -inf where there is no pair
    p_relation: np.ndarray
    log_score: np.ndarray
    sizes: np.ndarray  # (N,) int64
    config: RankConfig

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """(T, R) or (T, R, R)."""
        return self.log_score.shape[-1 - len(self.ends) :]

    @cached_property
    def flat(self) -> np.ndarray:
        """(B, P) float64: S, scene by scene."""
        scenes = self.log_score.shape[: self.log_score.ndim - len(self.shape)]
        return self.log_score.reshape(math.prod(scenes), math.prod(self.shape))

    def scene(self, k: int) -> PairTable:
        """Scene of a table with a single axis of scenes."""

        def own(part: Side) -> Side:
            return Side(part.index, *(values[k] if values.ndim > 1 else values for values in (part.scores, part.log)))

        p = self.p_relation[k] if self.p_relation.ndim == self.log_score.ndim else self.p_relation
        ends = tuple(own(end) for end in self.ends)
        return PairTable(own(self.target), ends, p, self.log_score[k], self.sizes, self.config)

    def with_relation(self, p: np.ndarray) -> PairTable:
        """Pairs with other probabilities of the relation, of equal shape."""
        return pair_table(self.target, self.ends, p, np.isneginf(self.log_score), self.sizes, self.config)

    @cached_property
    def posterior(self) -> np.ndarray:
        """(B, P) float64: posterior of each scene's pairs; 0 for no pair."""
        top = self.flat.max(axis=1, keepdims=True, initial=-np.inf)
        top[np.isneginf(top)] = 0
        weight = np.exp(self.flat - top)
        total = weight.sum(axis=1, keepdims=True)
        total[total == 0] = 1
        return weight / total

    def _ties(self, scene: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, ...]:
        """Tie-breakers between pairs of equal S, the last first: relation, target's score, its mask, lower places."""
        i, rest = np.divmod(at, math.prod(self.shape[1:]))

        def of_scene(values: np.ndarray, places: np.ndarray) -> np.ndarray:
            rows = values.reshape(-1, values.shape[-1])
            return rows[scene if len(rows) > 1 else 0, places]

        target = of_scene(self.target.index, i)
        end = rest // math.prod(self.shape[2:])
        reference = of_scene(self.ends[0].index, end) if self.ends else np.zeros_like(target)
        p = of_scene(self.p_relation.reshape(-1, self.flat.shape[1]), at)
        return reference, target, -self.sizes[target], -of_scene(self.target.scores, i), -p

    def order(self) -> np.ndarray:
        """(K,) int64: pairs of the only scene, best first."""
        at = np.flatnonzero(np.isfinite(self.flat[0]))
        if not len(at):
            return at
        return at[np.lexsort((*self._ties(np.zeros_like(at), at), -np.round(self.flat[0, at] / TIE)))]

    def first(self, allowed: np.ndarray | None = None) -> np.ndarray:
        """(B,) int64: first pair of each scene, as in `order`; -1 for none.

        Parameters
        ----------
        allowed : bool, (B, P) or of a shape that fits the table, optional
            The first of these.
        """
        flat = self.flat
        if not flat.shape[1]:
            return np.full(len(flat), -1, np.int64)
        if allowed is not None:
            fits = allowed if allowed.size == flat.size else np.broadcast_to(allowed, self.log_score.shape)
            flat = np.where(fits.reshape(flat.shape), flat, -np.inf)
        found, top = flat.argmax(axis=1), flat.max(axis=1, keepdims=True)
        near = flat > top - 2 * TIE
        count = np.count_nonzero(near)
        if count == len(flat) and (count == 1 or near.any(axis=1).all()):
            return found
        found[np.isneginf(top[:, 0])] = -1
        scene, at = np.nonzero(near)
        # Of those near the top the ones that round to it, and of these the first by the rules for ties.
        tied = np.round(flat[scene, at] / TIE) >= np.round(top[scene, 0] / TIE)
        scene, at = scene[tied], at[tied]
        order = np.lexsort((*self._ties(scene, at), scene))
        heads = order[np.flatnonzero(np.diff(scene[order], prepend=-1))]
        found[scene[heads]] = at[heads]
        return found

    def lead(self, first: int) -> float:
        """S of the first pair of the only scene less that of the next; inf for a single pair."""
        scores = self.flat[0]
        # The pair after it is the second largest, or in a tie with that.
        return float(scores[first] - np.partition(scores, -2)[-2]) if len(scores) > 1 else math.inf

    def places(self, at: int) -> list[int]:
        """Place of a pair along each axis of `shape`."""
        # Not np.unravel_index, which for one number costs as much as the rest of a pair.
        found = []
        for size in reversed(self.shape[1:]):
            at, place = divmod(at, size)
            found.append(place)
        return [at, *reversed(found)]

    def pair(self, at: int) -> ScoredPair:
        """Pair of the only scene, for a single relation of two objects; without a relation a single object."""
        i, *ends = self.places(at)
        p_target, p = float(self.target.scores[i]), float(self.p_relation.flat[at])
        reference, second = (*(int(e.index[k]) for e, k in zip(self.ends, ends, strict=True)), None, None)[:2]
        p_reference, p_second = (*(float(e.scores[k]) for e, k in zip(self.ends, ends, strict=True)), 1.0, 1.0)[:2]
        return ScoredPair(
            target=int(self.target.index[i]),
            reference=reference,
            p_target=p_target,
            p_reference=p_reference,
            p_relation=p,
            log_score=float(self.flat[0, at]),
            product=p_target * p * p_reference * p_second,
            probability=float(self.posterior[0, at]),
            second_reference=second,
        )
