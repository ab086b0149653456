"""PRM: rank pairs by P(target) P(reference) P(relation), in logs, over all pairs at once.

A nested expression is a tree of such factors; the best completion of every
branch is found exactly by max-product from the leaves up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pipeline.expression import Attachment, Node, Reading

MIN_RELATION = 1e-6
MIN_SCORE = 1e-6
NON_DEFAULT_PENALTY = 0.1
TIE = 1e-9

RelationLookup = Callable[[Attachment, np.ndarray, Sequence[np.ndarray]], np.ndarray]
"""(attachment, candidates of the head, candidates of each other end) -> probabilities of every combination."""


@dataclass(frozen=True)
class RankConfig:
    """Weights of the three log factors, and how references are aggregated.

    `max` takes the best pair, as the paper; `marginal` first takes the target
    whose pairs together are most probable.
    """

    target_weight: float = 1.0
    reference_weight: float = 1.0
    relation_weight: float = 1.0
    aggregate: Literal["max", "marginal"] = "max"


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


@dataclass(frozen=True)
class Link:
    """One relation of the answer: object `a` RELATION object `b` (and `c`, for between), with its probability.

    Where `inverse` is set the relation holds the other way round: "table holding
    a lamp" has the table as `a`, and says that `b` is on it.
    """

    relation: str
    a: int
    b: int
    probability: float
    c: int | None = None
    inverse: bool = False


@dataclass(frozen=True)
class RankedPair:
    """One candidate answer.

    Attributes
    ----------
    target : int
    reference : int or None
        Places in the list of objects; None where no pair was allowed.
    second_reference : int or None
        The other end of "between".
    p_target, p_reference, p_relation : float
        The three factors.
    product : float
        Their product, with the factors of all further relations of the expression.
    probability : float
        Posterior over all allowed pairs.
    log_score : float
        S, the weighted sum of logs.
    links : tuple of Link
        All relations of the expression with the objects that fill them.
    """

    target: int
    reference: int | None
    p_target: float
    p_reference: float
    p_relation: float
    product: float
    probability: float
    log_score: float
    links: tuple[Link, ...] = ()
    second_reference: int | None = None

    @property
    def log_factors(self) -> dict[str, float]:
        """Each factor's contribution to S, unweighted: what a pair loses where."""
        return {
            "target": float(np.log(max(self.p_target, MIN_SCORE))),
            "reference": float(np.log(max(self.p_reference, MIN_SCORE))),
            "relation": float(np.log(max(self.p_relation, MIN_RELATION))),
        }


@dataclass(frozen=True)
class Ranking:
    """All allowed pairs, best first.

    Attributes
    ----------
    pairs : tuple of RankedPair
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

    pairs: tuple[RankedPair, ...]
    reading: Reading
    margin: float
    log_margin: float
    entropy: float
    degenerate: bool
    reading_scores: tuple[float, ...]


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
    best_of = tuple(float(s.best.max(initial=-np.inf)) for s in solved)
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
    """A node with the best log score of its subtree for each of its candidates."""

    candidates: Candidates
    own: np.ndarray
    best: np.ndarray
    branches: tuple[_Branch, ...]


@dataclass(frozen=True)
class _Branch:
    """One attachment: its probability, and its log factor plus the best below, for every combination of ends."""

    attachment: Attachment
    ends: tuple[_Solved, ...]
    probability: np.ndarray
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
    own = weight * np.log(np.clip(here.scores, MIN_SCORE, 1 - MIN_SCORE))
    branches = []
    best = own
    for attachment in node.attachments:
        ends = tuple(_solve(n, candidates, lookup, same, config, config.reference_weight) for n in attachment.nodes)
        places = (here.index, *(e.candidates.index for e in ends))
        probability = lookup(attachment, places[0], places[1:])
        total = config.relation_weight * np.log(np.maximum(probability, MIN_RELATION))
        for axis, end in enumerate(ends, start=1):
            total = total + end.best.reshape([-1 if a == axis else 1 for a in range(total.ndim)])
        forbidden = _one_object_twice(places, same)
        if len(attachment.nodes) == 2 and attachment.nodes[0] == replace(
            attachment.nodes[1], mention=attachment.nodes[0].mention
        ):
            # "between a mug and a mug": the two ends may be swapped, and one answer would stand twice.
            forbidden |= places[1][:, None] > places[2][None, :]
        total = np.where(forbidden, -np.inf, total)
        branches.append(_Branch(attachment, ends, probability, total))
        best = best + _max_over_ends(total)
    return _Solved(here, own, best, tuple(branches))


def _one_object_twice(places: Sequence[np.ndarray], same: np.ndarray) -> np.ndarray:
    """Bool array with one axis a place: combinations in which two places are one and the same object."""
    forbidden = np.zeros([len(p) for p in places], np.bool_)
    for i in range(len(places)):
        for j in range(i):
            shape = [1] * len(places)
            shape[i], shape[j] = len(places[i]), len(places[j])
            forbidden |= same[np.ix_(places[j], places[i])].reshape(shape)
    return forbidden


def _max_over_ends(total: np.ndarray) -> np.ndarray:
    flat = total.reshape(len(total), -1) if total.size else np.full((len(total), 1), -np.inf)
    return flat.max(axis=1, initial=-np.inf)


def _ranked_pairs(root: _Solved, mask_sizes: np.ndarray, config: RankConfig) -> tuple[RankedPair, ...]:
    targets, first = root.candidates, root.branches[0]
    rest = root.own + sum((_max_over_ends(b.total) for b in root.branches[1:]), np.zeros(len(targets.index)))
    score = rest.reshape([-1] + [1] * (first.total.ndim - 1)) + first.total
    place = np.argwhere(np.isfinite(score))
    if not len(place):
        return ()
    log_score = score[tuple(place.T)]
    p_relation = first.probability[tuple(place.T)]
    references = first.ends[0].candidates
    i, j = place[:, 0], place[:, 1]
    target, reference = targets.index[i], references.index[j]
    weight = np.exp(log_score - log_score.max())
    posterior = weight / weight.sum()

    keys = [
        reference,
        target,
        -mask_sizes[target],
        -targets.scores[i],
        -p_relation,
        -np.round(log_score / TIE) * TIE,
    ]
    if config.aggregate == "marginal":
        marginal = np.bincount(i, weights=posterior, minlength=len(targets.index))
        keys.append(-np.round(marginal[i] / TIE) * TIE)

    found = []
    for k in np.lexsort(keys):
        links, product = _links(root, int(i[k]), tuple(int(x) for x in place[k, 1:]))
        found.append(
            RankedPair(
                target=int(target[k]),
                reference=int(reference[k]),
                p_target=float(targets.scores[i[k]]),
                p_reference=float(references.scores[j[k]]),
                p_relation=float(p_relation[k]),
                product=product,
                probability=float(posterior[k]),
                log_score=float(log_score[k]),
                links=links,
                second_reference=links[0].c,
            )
        )
    return tuple(found)


def _links(solved: _Solved, at: int, first_ends: tuple[int, ...] | None) -> tuple[tuple[Link, ...], float]:
    """All relations below candidate number `at`, each at its best, and the product of all factors."""
    links: list[Link] = []
    product = float(solved.candidates.scores[at])
    for number, branch in enumerate(solved.branches):
        block = branch.total[at]
        best = tuple(int(x) for x in np.unravel_index(int(block.argmax()), block.shape))
        ends = first_ends if number == 0 and first_ends is not None else best
        objects = [int(e.candidates.index[k]) for e, k in zip(branch.ends, ends, strict=True)]
        probability = float(branch.probability[(at, *ends)])
        product *= probability
        links.append(
            Link(
                branch.attachment.relation,
                int(solved.candidates.index[at]),
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


def _targets_alone(targets: Candidates) -> tuple[RankedPair, ...]:
    order = np.argsort(-targets.scores, kind="stable")
    total = float(targets.scores.sum()) or 1.0
    return tuple(
        RankedPair(
            target=int(targets.index[k]),
            reference=None,
            p_target=float(targets.scores[k]),
            p_reference=0.0,
            p_relation=0.0,
            product=0.0,
            probability=float(targets.scores[k] / total),
            log_score=float(np.log(np.clip(targets.scores[k], MIN_SCORE, 1 - MIN_SCORE))),
        )
        for k in order
    )
