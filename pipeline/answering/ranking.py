"""PRM: rank pairs by P(target) P(reference) P(relation), in logs, over all pairs at once.

A nested expression is a tree of such factors; the best completion of every
branch is found exactly by max-product from the leaves up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

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
from pipeline.language.expression import Attachment, Node, Reading

NON_DEFAULT_PENALTY = 0.1

RelationLookup = Callable[[Attachment, np.ndarray, Sequence[np.ndarray]], np.ndarray]
"""(attachment, candidates of the head, candidates of each other end) -> probabilities of every combination."""


@dataclass(frozen=True)
class Candidates:
    """The objects that may fill one place of the expression.

    Attributes
    ----------
    index : (K,) int64
        Places in the list of objects.
    scores : (K,) float64
        P(x | name), 0..1.
    labels : tuple of str
        What the detector calls each under this name; empty where it is of no matter.
    raw_scores : (K,) float64 or None
        What the detector itself said, before any calibration; None for the same as `scores`.
    """

    index: np.ndarray
    scores: np.ndarray
    labels: tuple[str, ...] = ()
    raw_scores: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"<Candidates {len(self.index)}: objects {' '.join(map(str, self.index.tolist()))}>"


@dataclass(frozen=True)
class Ranking:
    """All allowed pairs, best first.

    Attributes
    ----------
    pairs : tuple of ScoredPair
    reading : Reading
        The reading of the expression that was taken.
    margin : float
        Posterior of the winner minus the runner-up's; 1 where there is only one pair.
    log_margin : float
        S of the winner minus the runner-up's; inf where there is only one pair.
    entropy : float
        Of the posterior, nats.
    degenerate : bool
        No pair was allowed; the detector's best target stands alone.
    reading_scores : tuple of float
        The best S of each reading, in their order; -inf where it has no pair.
    """

    pairs: tuple[ScoredPair, ...]
    reading: Reading
    margin: float
    log_margin: float
    entropy: float
    degenerate: bool
    reading_scores: tuple[float, ...]

    def __repr__(self) -> str:
        return f"<Ranking of {len(self.pairs)} pairs, margin {self.margin:.3f}>"


def rank(
    readings: Sequence[Reading],
    candidates: Mapping[str, Candidates],
    lookup: RelationLookup,
    same: np.ndarray,
    mask_sizes: np.ndarray,
    config: RankConfig | None = None,
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
    """
    config = config or RankConfig()
    solved = [_solve(r.root, candidates, lookup, same, config, config.target_weight) for r in readings]
    best_of = tuple(float(s.side.log.max(initial=-np.inf)) for s in solved)
    chosen = int(
        np.argmax([s - (0.0 if r.is_default else NON_DEFAULT_PENALTY) for r, s in zip(readings, best_of, strict=True)])
    )
    pairs = _ranked_pairs(solved[chosen], mask_sizes, config)
    degenerate = not pairs
    if degenerate:
        pairs = _targets_alone(candidates[readings[chosen].root.label])
    posterior = np.array([p.probability for p in pairs])
    positive = posterior[posterior > 0]
    return Ranking(
        pairs=pairs,
        reading=readings[chosen],
        margin=float(posterior[0] - posterior[1]) if len(pairs) > 1 else float(len(pairs)),
        log_margin=pairs[0].log_score - pairs[1].log_score if len(pairs) > 1 else float("inf"),
        entropy=float(-(positive * np.log(positive)).sum()) if len(positive) else 0.0,
        degenerate=degenerate,
        reading_scores=best_of,
    )


@dataclass(frozen=True)
class _Solved:
    """A node: what each candidate adds to S by itself, and with the best of its subtree."""

    own: np.ndarray
    side: Side
    branches: tuple[_Branch, ...]


@dataclass(frozen=True)
class _Branch:
    """One attachment: its probability for every combination of ends, and which of these are none."""

    attachment: Attachment
    ends: tuple[_Solved, ...]
    probability: np.ndarray
    forbidden: np.ndarray
    total: np.ndarray


def _solve(
    node: Node,
    candidates: Mapping[str, Candidates],
    lookup: RelationLookup,
    same: np.ndarray,
    config: RankConfig,
    weight: float,
) -> _Solved:
    here = candidates[node.label]
    own = side(here.index, here.scores, weight)
    branches = []
    best = own.log
    for attachment in node.attachments:
        ends = tuple(_solve(n, candidates, lookup, same, config, config.reference_weight) for n in attachment.nodes)
        indices = (here.index, *(e.side.index for e in ends))
        probability = lookup(attachment, indices[0], indices[1:])
        forbidden = one_object_twice(indices, same)
        if len(attachment.nodes) == 2 and attachment.nodes[0] == replace(
            attachment.nodes[1], mention=attachment.nodes[0].mention
        ):
            # "between a mug and a mug": the two ends may be swapped, and one answer would stand twice.
            forbidden |= indices[1][:, None] > indices[2][None, :]
        total = attached(probability, [e.side for e in ends], forbidden, config)
        branches.append(_Branch(attachment, ends, probability, forbidden, total))
        best = best + _max_over_ends(total)
    return _Solved(own.log, replace(own, log=best), tuple(branches))


def _max_over_ends(total: np.ndarray) -> np.ndarray:
    flat = total.reshape(len(total), -1) if total.size else np.full((len(total), 1), -np.inf)
    return flat.max(axis=1, initial=-np.inf)


def _table(root: _Solved, mask_sizes: np.ndarray, config: RankConfig) -> PairTable:
    """The pairs of the first relation, each with the best of all that hangs on its ends."""
    first, *others = root.branches
    rest = root.own + sum((_max_over_ends(b.total) for b in others), np.zeros(len(root.own)))
    ends = [e.side for e in first.ends]
    return pair_table(replace(root.side, log=rest), ends, first.probability, first.forbidden, mask_sizes, config)


def _ranked_pairs(root: _Solved, mask_sizes: np.ndarray, config: RankConfig) -> tuple[ScoredPair, ...]:
    table = _table(root, mask_sizes, config)
    found = []
    for at in table.order().tolist():
        i, *ends = (int(x) for x in np.unravel_index(at, table.shape))
        links, product = _links(root, i, tuple(ends))
        found.append(replace(table.pair(at), product=product, links=links))
    return tuple(found)


def _links(solved: _Solved, at: int, first_ends: tuple[int, ...] | None) -> tuple[tuple[Link, ...], float]:
    """All relations below candidate number `at`, each at its best, and the product of all factors."""
    links: list[Link] = []
    product = float(solved.side.scores[at])
    for number, branch in enumerate(solved.branches):
        block = branch.total[at]
        best = tuple(int(x) for x in np.unravel_index(int(block.argmax()), block.shape))
        ends = first_ends if number == 0 and first_ends is not None else best
        objects = [int(e.side.index[k]) for e, k in zip(branch.ends, ends, strict=True)]
        probability = float(branch.probability[(at, *ends)])
        product *= probability
        links.append(
            Link(
                branch.attachment.relation,
                int(solved.side.index[at]),
                objects[0],
                probability,
                objects[1] if len(objects) > 1 else None,
                branch.attachment.inverse,
            )
        )
        for end, k in zip(branch.ends, ends, strict=True):
            below, factor = _links(end, k, None)
            links += below
            product *= factor
    return tuple(links), product


def alone(candidates: Candidates) -> int | None:
    """The best target without any relation (OPM only), as a place in the list of objects; None where there is none."""
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
