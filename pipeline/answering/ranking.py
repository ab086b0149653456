"""PRM: rank pairs by P(target) P(reference) P(relation), in logs, over all pairs at once.

A nested expression is a tree of such factors; the best completion of every
branch is found exactly by max-product from the leaves up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import overload

import numpy as np

from pipeline.answering.evidence import Factor, Kind, SceneEvidence
from pipeline.answering.pair_table import (
    MIN_SCORE,
    Link,
    PairTable,
    RankConfig,
    ScoredPair,
    Side,
    attached,
    one_object_twice,
    pair_table,
    side,
)
from pipeline.language.tree import Attachment, Node, Reading
from pipeline.system.frozen import dataclass

NON_DEFAULT_PENALTY = 0.1

RelationLookup = Callable[[Attachment, np.ndarray, Sequence[np.ndarray]], np.ndarray]
"""(attachment, candidates of the head, candidates of each other end) -> probabilities of every combination."""


@dataclass(frozen=True)
class Candidates:
    """Candidates of a place of the expression."""

    index: np.ndarray  # (K,) int64: places in the list of objects
    scores: np.ndarray  # (K,) float64: P(x | name), 0..1
    labels: tuple[str, ...] = ()  # What the detector calls each under this name; empty where it is of no matter
    # (K,) float64: what the detector itself said, before any calibration; None for the same as `scores`
    raw_scores: np.ndarray | None = None

    @property
    def detector_scores(self) -> np.ndarray:
        """(K,) float64: detector's own scores."""
        return self.scores if self.raw_scores is None else self.raw_scores


class RankedPairs(Sequence[ScoredPair]):
    """Pairs in their order, each made when it is first looked at: of a hundred candidates a side few ever are.

    `order`: (P,) int64: numbers of the pairs, best first; `made`: gives the pair of a number.
    """

    def __init__(self, order: np.ndarray, made: Callable[[int], ScoredPair]) -> None:
        self._order, self._made = order, made
        self._known: dict[int, ScoredPair] = {}

    def __len__(self) -> int:
        return len(self._order)

    @overload
    def __getitem__(self, index: int) -> ScoredPair: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[ScoredPair, ...]: ...
    def __getitem__(self, index: int | slice) -> ScoredPair | tuple[ScoredPair, ...]:
        if isinstance(index, slice):
            return tuple(self[k] for k in range(len(self))[index])
        at = int(self._order[index])
        if at not in self._known:
            self._known[at] = self._made(at)
        return self._known[at]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))


@dataclass(frozen=True)
class Ranking:
    """Allowed pairs, best first."""

    pairs: Sequence[ScoredPair]
    reading: Reading  # The reading of the expression that was taken
    margin: float  # Posterior of the winner minus the runner-up's; 1 where there is only one pair
    log_margin: float  # S of the winner minus the runner-up's; inf where there is only one pair
    entropy: float  # Of the posterior, nats
    degenerate: bool  # No pair was allowed; the detector's best target stands alone
    reading_scores: tuple[float, ...]  # The best S of each reading, in their order; -inf where it has no pair

    def __repr__(self) -> str:
        return f"<Ranking of {len(self.pairs)} pairs, margin {self.margin:.3f}>"


def rank(
    readings: Sequence[Reading],
    candidates: Mapping[str, Candidates],
    lookup: RelationLookup,
    same: np.ndarray,
    mask_sizes: np.ndarray,
    config: RankConfig | None = None,
    evidence: SceneEvidence | None = None,
) -> Ranking:
    """Rank the pairs of the reading that explains the scene best.

    Parameters
    ----------
    readings : sequence of Reading
        At least one.
    candidates : mapping
        Class name of a node -> its candidates.
    lookup : callable
        Gives relation probabilities.
    same : (N, N) bool
        Pairs of one and the same object are excluded.
    mask_sizes : (N,) int
        Pixels; the larger mask wins a tie.
    evidence : SceneEvidence, optional
        Gives what attributes and choices say of the objects; without it they say nothing.
    """
    config = config or RankConfig()
    scene = _Solver(candidates, lookup, same, config, evidence)
    solved = [scene.solve(r.root, config.target_weight) for r in readings]
    best_of = tuple(float(s.side.log.max(initial=-np.inf)) for s in solved)
    chosen = int(
        np.argmax([s - (0.0 if r.is_default else NON_DEFAULT_PENALTY) for r, s in zip(readings, best_of, strict=True)])
    )
    found = SolvedReading(solved[chosen], _table(solved[chosen], mask_sizes, config))
    order = found.table.order()
    pairs: Sequence[ScoredPair] = RankedPairs(order, found.pair)
    posterior, log_scores = found.table.posterior[0, order], found.table.flat[0, order]
    degenerate = not len(order)
    if degenerate:
        pairs = _targets_alone(candidates[readings[chosen].root.label])
        posterior, log_scores = (np.array([getattr(p, name) for p in pairs]) for name in ("probability", "log_score"))
    positive = posterior[posterior > 0]
    return Ranking(
        pairs=pairs,
        reading=readings[chosen],
        margin=float(posterior[0] - posterior[1]) if len(pairs) > 1 else float(len(pairs)),
        log_margin=float(log_scores[0] - log_scores[1]) if len(pairs) > 1 else float("inf"),
        entropy=float(-(positive * np.log(positive)).sum()) if len(positive) else 0.0,
        degenerate=degenerate,
        reading_scores=best_of,
    )


@dataclass(frozen=True)
class _Solved:
    """Solved node: contribution of each candidate to S by itself, and with the best of its subtree.

    `belief`: fit of each candidate to the noun phrase, 0..1; `factors`: statements on each alone.
    """

    own: np.ndarray
    side: Side
    branches: tuple[_Branch, ...]
    mention: int
    belief: np.ndarray
    factors: tuple[tuple[Kind, str, np.ndarray], ...]


@dataclass(frozen=True)
class _Branch:
    """Attachment: probability of every combination of ends, and the forbidden ones."""

    attachment: Attachment
    ends: tuple[_Solved, ...]
    probability: np.ndarray
    forbidden: np.ndarray
    total: np.ndarray

    @property
    def belief(self) -> np.ndarray:
        """(K,) float64: belief of each head standing in the relation to a fitting end."""
        if not self.probability.size:
            return np.zeros(len(self.probability))
        found = np.where(self.forbidden, 0.0, self.probability)
        for axis, end in enumerate(self.ends, start=1):
            found = found * np.expand_dims(end.belief, tuple(a for a in range(found.ndim) if a != axis))
        return found.reshape(len(found), -1).max(axis=1, initial=0.0)


@dataclass(frozen=True)
class _Solver:
    """Inputs shared by all nodes of an expression."""

    candidates: Mapping[str, Candidates]
    lookup: RelationLookup
    same: np.ndarray
    config: RankConfig
    evidence: SceneEvidence | None

    def solve(self, node: Node, weight: float) -> _Solved:
        """Solve a node with all below."""
        here = self.candidates[node.label]
        own = side(here.index, here.scores, weight)
        factors = self._attributes(node, here.index)
        branches = [self._branch(a, here.index) for a in node.attachments if a.of_pairs]
        belief = here.scores / max(float(here.scores.max(initial=0.0)), MIN_SCORE)
        factors += self._negations(node, here.index)
        for p in (*(p for _, _, p in factors), *(b.belief for b in branches)):
            belief = belief * p
        factors += self._choices(node, here.index, belief)
        alone = own.log + sum((np.log(np.maximum(p, MIN_SCORE)) for _, _, p in factors), np.zeros(len(own.log)))
        best = alone + sum((_max_over_ends(b.total) for b in branches), np.zeros(len(own.log)))
        for _, _, p in factors:
            belief = np.minimum(belief, p)
        return _Solved(alone, replace(own, log=best), tuple(branches), node.mention, belief, tuple(factors))

    def _branch(self, attachment: Attachment, heads: np.ndarray) -> _Branch:
        ends = tuple(self.solve(n, self.config.reference_weight) for n in attachment.nodes)
        indices = (heads, *(e.side.index for e in ends))
        probability = self.lookup(attachment, indices[0], indices[1:])
        forbidden = one_object_twice(indices, self.same)
        if len(attachment.nodes) == 2 and attachment.nodes[0] == replace(
            attachment.nodes[1], mention=attachment.nodes[0].mention
        ):
            # "between a mug and a mug": the two ends may be swapped, and one answer would stand twice.
            forbidden |= indices[1][:, None] > indices[2][None, :]
        total = attached(probability, [e.side for e in ends], forbidden, self.config)
        return _Branch(attachment, ends, probability, forbidden, total)

    def _attributes(self, node: Node, index: np.ndarray) -> list[tuple[Kind, str, np.ndarray]]:
        if self.evidence is None:
            return []
        judged = [(a, self.evidence.attribute(a, index)) for a in node.attributes]
        return [("attribute", str(a), p) for a, p in judged if p is not None]

    def _negations(self, node: Node, index: np.ndarray) -> list[tuple[Kind, str, np.ndarray]]:
        """Negated relations to any reference, and negated names."""
        found: list[tuple[Kind, str, np.ndarray]] = []
        for attachment in node.attachments:
            if attachment.negated and not any(n.viewer for n in attachment.nodes):
                branch = self._branch(attachment, index)
                found.append(("negation", f"not {attachment.phrase}", 1 - branch.belief))
        for other in node.excluded:
            if not all(a.judged for a in other.attributes):
                # `not the striped one` would exclude them all.
                continue
            solved = self.solve(other, self.config.reference_weight)
            alike = self.same[np.ix_(index, solved.side.index)] * solved.belief
            found.append(("negation", f"not {other.label}", 1 - alike.max(axis=1, initial=0.0)))
        return found

    def _choices(self, node: Node, index: np.ndarray, belief: np.ndarray) -> list[tuple[Kind, str, np.ndarray]]:
        if self.evidence is None:
            return []
        found: list[tuple[Kind, str, np.ndarray]] = []
        for choice in sorted(node.choices, key=lambda c: c.rank is not None):
            # The leftmost one of the front row is the leftmost of those in it.
            p = self.evidence.choice(choice, index, belief)
            found.append(("choice", choice.text, p))
            belief = belief * p if choice.rank is None else belief
        for attachment in node.attachments:
            if any(n.viewer for n in attachment.nodes):
                p = self.evidence.of_viewer(attachment.relation, index, belief)
                if p is not None:
                    found.append(("viewer", attachment.phrase, 1 - p if attachment.negated else p))
        return found


def _max_over_ends(total: np.ndarray) -> np.ndarray:
    flat = total.reshape(len(total), -1) if total.size else np.full((len(total), 1), -np.inf)
    return flat.max(axis=1, initial=-np.inf)


def _table(root: _Solved, mask_sizes: np.ndarray, config: RankConfig) -> PairTable:
    """Pairs of the first relation, each with the best completion of its ends; single objects without a relation."""
    if not root.branches:
        count = len(root.own)
        return pair_table(root.side, (), np.ones(count), np.zeros(count, np.bool_), mask_sizes, config)
    first, *others = root.branches
    rest = root.own + sum((_max_over_ends(b.total) for b in others), np.zeros(len(root.own)))
    ends = [e.side for e in first.ends]
    return pair_table(replace(root.side, log=rest), ends, first.probability, first.forbidden, mask_sizes, config)


@dataclass(frozen=True, eq=False)
class SolvedReading:
    """Pairs of a reading, with all statements of the expression."""

    root: _Solved  # The target with all below it
    table: PairTable  # The pairs of its first relation; without one the targets alone

    def pair(self, at: int) -> ScoredPair:
        """Pair of the table with its links and factors."""
        i, *ends = self.table.places(at)
        links, factors, product = _links(self.root, i, tuple(ends))
        return replace(self.table.pair(at), product=product, links=links, factors=factors)


def solve(
    root: Node,
    candidates: Mapping[str, Candidates],
    lookup: RelationLookup,
    same: np.ndarray,
    mask_sizes: np.ndarray,
    config: RankConfig,
    evidence: SceneEvidence | None = None,
) -> SolvedReading:
    """Score all pairs of a single reading; arguments as for `rank`."""
    solved = _Solver(candidates, lookup, same, config, evidence).solve(root, config.target_weight)
    return SolvedReading(solved, _table(solved, mask_sizes, config))


def _links(
    solved: _Solved, at: int, first_ends: tuple[int, ...] | None
) -> tuple[tuple[Link, ...], tuple[Factor, ...], float]:
    """Relations below candidate number `at`, each at its best, statements on each object, and the product."""
    links: list[Link] = []
    here = int(solved.side.index[at])
    factors = [Factor(kind, text, solved.mention, here, float(p[at])) for kind, text, p in solved.factors]
    product = float(solved.side.scores[at]) * math.prod(f.probability for f in factors)
    for number, branch in enumerate(solved.branches):
        ends = first_ends if number == 0 else None
        if ends is None:
            block = branch.total[at]
            ends = tuple(int(x) for x in np.unravel_index(int(block.argmax()), block.shape))
        objects = [int(e.side.index[k]) for e, k in zip(branch.ends, ends, strict=True)]
        probability = float(branch.probability[(at, *ends)])
        product *= probability
        second = objects[1] if len(objects) > 1 else None
        asked = branch.attachment
        names = tuple(n.label for n in asked.nodes)
        links.append(Link(asked.relation, here, objects[0], probability, second, asked.inverse, names))
        for end, k in zip(branch.ends, ends, strict=True):
            below, stated, factor = _links(end, k, None)
            links += below
            factors += stated
            product *= factor
    return tuple(links), tuple(factors), product


def alone(candidates: Candidates) -> int | None:
    """Best target without any relation (OPM only), as a place in the list of objects; None for none."""
    return int(candidates.index[int(np.argmax(candidates.scores))]) if len(candidates.index) else None


def _targets_alone(targets: Candidates) -> tuple[ScoredPair, ...]:
    order = np.argsort(-targets.scores, kind="stable")
    total = float(targets.scores.sum()) or 1.0
    return tuple(
        ScoredPair(
            target=int(targets.index[k]),
            reference=None,
            p_target=float(targets.scores[k]),
            p_reference=0.0,
            p_relation=0.0,
            log_score=float(np.log(np.clip(targets.scores[k], MIN_SCORE, 1 - MIN_SCORE))),
            product=0.0,
            probability=float(targets.scores[k] / total),
        )
        for k in order
    )
