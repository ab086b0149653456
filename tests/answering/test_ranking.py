"""PRM against brute force: every assignment of every noun of random nested expressions, one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.answering import MIN_RELATION, Candidates, RankConfig, ScoredPair, rank
from pipeline.answering.ranking import NON_DEFAULT_PENALTY, Ranking
from pipeline.language import Attachment, Node, Reading

SEEDS = st.integers(0, 2**32 - 1)
N = 7


@dataclass
class Problem:
    """A random expression tree over N objects with random probabilities.

    `tables` holds a probability for every relation and every tuple of objects.
    """

    rng: np.random.Generator
    candidates: dict[str, Candidates] = field(default_factory=dict)
    tables: dict[str, np.ndarray] = field(default_factory=dict)
    same: np.ndarray = field(default_factory=lambda: np.eye(N, dtype=bool))
    masks: np.ndarray = field(default_factory=lambda: np.arange(N) + 100)

    def lookup(self, attachment: Attachment, heads: np.ndarray, ends: Sequence[np.ndarray]) -> np.ndarray:
        return self.tables[attachment.phrase][np.ix_(heads, *ends)]

    def node(self, relations: int, between: bool) -> Node:
        """A node with `relations` relations below it, spread at random over it and its descendants."""
        number = len(self.candidates)
        label = f"n{number}"
        k = int(self.rng.integers(1, 4))
        self.candidates[label] = Candidates(
            np.sort(self.rng.choice(N, k, replace=False)), self.rng.uniform(0.05, 0.95, k)
        )
        attachments = []
        while relations > 0:
            below = int(self.rng.integers(0, relations))
            relations -= 1 + below
            name = f"r{len(self.tables)}"
            ends = 2 if between and not self.tables else 1
            self.tables[name] = self.rng.uniform(0.01, 0.99, (N,) * (1 + ends))
            nodes = (self.node(below, False), *(self.node(0, False) for _ in range(ends - 1)))
            attachments.append(Attachment("between" if ends == 2 else "left", nodes, phrase=name))
        return Node(label, tuple(attachments), number)

    def rank(self, *roots: Node, config: RankConfig | None = None) -> Ranking:
        readings = [Reading(r, is_default=k == 0, description=str(k)) for k, r in enumerate(roots)]
        return rank(readings, self.candidates, self.lookup, self.same, self.masks, config)

    def assignments(self, node: Node) -> Iterator[dict[int, int]]:
        """Every choice of a candidate number for every noun (mention) below `node`."""
        nodes = list(node.walk())
        for choice in product(*(range(len(self.candidates[n.label].index)) for n in nodes)):
            yield {n.mention: c for n, c in zip(nodes, choice, strict=True)}

    def score(self, node: Node, choice: dict[int, int], config: RankConfig, root: bool = True) -> tuple[float, float]:
        """(S, plain product) of an assignment; -inf where one object is to be two things."""
        here = self.candidates[node.label]
        own = here.scores[choice[node.mention]]
        log = (config.target_weight if root else config.reference_weight) * np.log(own)
        head = here.index[choice[node.mention]]
        for attachment in node.attachments:
            ends = [int(self.candidates[n.label].index[choice[n.mention]]) for n in attachment.nodes]
            things = [int(head), *ends]
            if any(self.same[a, b] for k, a in enumerate(things) for b in things[:k]):
                return -np.inf, 0.0
            p = self.tables[attachment.phrase][(head, *ends)]
            log, own = log + config.relation_weight * np.log(max(p, MIN_RELATION)), own * p
            for below in attachment.nodes:
                more, factor = self.score(below, choice, config, root=False)
                log, own = log + more, own * factor
        return log, own


def random_problem(seed: int) -> tuple[Problem, Node]:
    rng = np.random.default_rng(seed)
    problem = Problem(rng)
    root = problem.node(int(rng.integers(2, 5)), between=bool(rng.random() < 0.5))
    twins = rng.random((N, N)) < 0.05
    problem.same |= twins | twins.T
    return problem, root


def brute_force(problem: Problem, root: Node, config: RankConfig) -> dict[tuple[int, ...], tuple[float, float]]:
    """(target, ends of its first relation) -> S and product of the best completion."""
    best: dict[tuple[int, ...], tuple[float, float]] = {}
    for choice in problem.assignments(root):
        log, plain = problem.score(root, choice, config)
        key = tuple(
            int(problem.candidates[n.label].index[choice[n.mention]]) for n in (root, *root.attachments[0].nodes)
        )
        if log > best.get(key, (-np.inf, 0))[0]:
            best[key] = (log, plain)
    return best


CONFIGS = st.sampled_from([RankConfig(), RankConfig(0.25, 0.5, 2.0)])


@given(SEEDS, CONFIGS)
@settings(max_examples=30, deadline=None)
def test_max_product_is_the_best_of_all_assignments(seed: int, config: RankConfig) -> None:
    problem, root = random_problem(seed)
    found = problem.rank(root, config=config)
    expected = brute_force(problem, root, config)
    if not expected:
        assert found.degenerate
        assert found.reading_scores == (-np.inf,)
        return
    got: dict[tuple[int | None, ...], ScoredPair] = {
        (p.target, p.reference, *([] if p.second_reference is None else [p.second_reference])): p for p in found.pairs
    }
    assert got.keys() == expected.keys()
    for key, (log, plain) in expected.items():
        assert got[key].log_score == pytest.approx(log, abs=1e-9)
        if config == RankConfig():
            assert got[key].product == pytest.approx(plain, rel=1e-9)
            assert np.log(got[key].product) == pytest.approx(got[key].log_score, abs=1e-9)
    assert found.reading_scores[0] == pytest.approx(max(log for log, _ in expected.values()), abs=1e-9)
    assert found.pairs[0].log_score == pytest.approx(found.reading_scores[0], abs=1e-9)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_the_posterior_is_a_distribution_that_falls_along_the_ranking(seed: int) -> None:
    problem, root = random_problem(seed)
    found = problem.rank(root)
    if found.degenerate:
        return
    p = np.array([pair.probability for pair in found.pairs])
    s = np.array([pair.log_score for pair in found.pairs])
    assert p.sum() == pytest.approx(1)
    assert (np.diff(p) <= 1e-9).all()
    np.testing.assert_allclose(p, np.exp(s - s.max()) / np.exp(s - s.max()).sum(), rtol=1e-9)
    assert found.entropy == pytest.approx(-(p * np.log(p)).sum())
    if len(p) > 1:
        assert found.margin == pytest.approx(p[0] - p[1])
        assert found.log_margin == pytest.approx(s[0] - s[1])
    else:
        assert (found.margin, found.log_margin) == (1, np.inf)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_the_links_of_a_pair_are_all_its_relations(seed: int) -> None:
    problem, root = random_problem(seed)
    relations = sum(len(n.attachments) for n in root.walk())
    for pair in problem.rank(root).pairs:
        if pair.reference is None:
            continue
        assert len(pair.links) == relations
        first = pair.links[0]
        assert (first.a, first.b, first.c) == (pair.target, pair.reference, pair.second_reference)
        assert first.probability == pair.p_relation
        for link in pair.links:
            things = [x for x in (link.a, link.b, link.c) if x is not None]
            assert not any(problem.same[a, b] for k, a in enumerate(things) for b in things[:k])
        assert pair.product <= pair.p_target * pair.p_reference * pair.p_relation + 1e-12


def simple(
    target: tuple[Sequence[int], Sequence[float]],
    reference: tuple[Sequence[int], Sequence[float]],
    relation: np.ndarray,
) -> tuple[Problem, Node]:
    problem = Problem(np.random.default_rng(0))
    problem.candidates = {
        "a": Candidates(np.array(target[0], np.int64), np.array(target[1], float)),
        "b": Candidates(np.array(reference[0], np.int64), np.array(reference[1], float)),
    }
    problem.tables = {"r": relation}
    return problem, Node("a", (Attachment("left", (Node("b", (), 1),), phrase="r"),))


def pairs_of(found: Ranking) -> list[tuple[int, int | None]]:
    return [(p.target, p.reference) for p in found.pairs]


def test_a_plain_product_by_hand() -> None:
    table = np.full((N, N), 0.05)
    table[1, 2] = 0.95
    problem, root = simple(([0, 1], [0.8, 0.4]), ([2], [0.5]), table)
    found = problem.rank(root)
    assert pairs_of(found) == [(1, 2), (0, 2)]
    best = found.pairs[0]
    assert best.product == pytest.approx(0.4 * 0.5 * 0.95)
    assert best.probability == pytest.approx(0.4 * 0.95 / (0.4 * 0.95 + 0.8 * 0.05))
    assert best.log_factors == pytest.approx(
        {"target": np.log(0.4), "reference": np.log(0.5), "relation": np.log(0.95)}
    )


def test_one_and_the_same_object_is_never_both_ends() -> None:
    table = np.full((N, N), 0.5)
    problem, root = simple(([0, 1, 2], [0.9, 0.8, 0.7]), ([0, 1, 2], [0.9, 0.8, 0.7]), table)
    assert set(pairs_of(problem.rank(root))) == {(a, b) for a in range(3) for b in range(3) if a != b}
    problem.same[0, 1] = problem.same[1, 0] = True
    assert set(pairs_of(problem.rank(root))) == {(0, 2), (2, 0), (1, 2), (2, 1)}


def test_ties_fall_to_the_relation_then_the_target_then_the_mask_then_the_number() -> None:
    table = np.full((N, N), 0.5)
    # 0.8 * 0.4 = 0.4 * 0.8: the higher relation wins.
    table[0, 6], table[1, 6] = 0.4, 0.8
    problem, root = simple(([0, 1], [0.8, 0.4]), ([6], [0.9]), table)
    assert pairs_of(problem.rank(root))[0] == (1, 6)
    # 0.8 * 0.4 of target and reference = 0.4 * 0.8 with one relation: the higher target wins.
    problem, root = simple(([0, 1], [0.4, 0.8]), ([5, 6], [0.4, 0.8]), np.full((N, N), 0.5))
    ranked = pairs_of(problem.rank(root))
    assert ranked == [(1, 6), (1, 5), (0, 6), (0, 5)]
    # All equal: the larger mask of the target, then the lower number.
    problem, root = simple(([0, 1, 2], [0.5, 0.5, 0.5]), ([6], [0.9]), np.full((N, N), 0.5))
    problem.masks = np.array([50, 90, 90, 1, 1, 1, 1])
    assert pairs_of(problem.rank(root)) == [(1, 6), (2, 6), (0, 6)]
    problem, root = simple(([2, 1], [0.5, 0.5]), ([6, 5], [0.9, 0.9]), np.full((N, N), 0.5))
    problem.masks = np.full(N, 10)
    assert pairs_of(problem.rank(root)) == [(1, 5), (1, 6), (2, 5), (2, 6)]


def test_rounding_does_not_break_a_tie() -> None:
    table = np.full((N, N), 0.5)
    table[0, 6], table[1, 6] = 0.05, 0.15
    # The two products are equal; as sums of logs the first comes out larger by a rounding.
    problem, root = simple(([0, 1], [0.15, 0.05]), ([6], [0.2]), table)
    assert pairs_of(problem.rank(root))[0] == (1, 6), "the higher relation"


def test_without_an_allowed_pair_the_best_target_stands_alone() -> None:
    problem, root = simple(([3], [0.9]), ([3], [0.8]), np.full((N, N), 0.9))
    found = problem.rank(root)
    assert found.degenerate
    assert pairs_of(found) == [(3, None)]
    assert found.pairs[0].links == ()
    assert found.pairs[0].probability == 1
    problem, root = simple(([3, 4], [0.3, 0.6]), ([3, 4], [0.5, 0.5]), np.full((N, N), 0.9))
    problem.same[:] = True
    found = problem.rank(root)
    assert found.degenerate
    assert pairs_of(found) == [(4, None), (3, None)]
    assert sum(p.probability for p in found.pairs) == pytest.approx(1)


def test_certain_and_impossible_scores_stay_finite() -> None:
    table = np.zeros((N, N))
    table[0, 6] = 1.0
    problem, root = simple(([0, 1], [1.0, 0.0]), ([6], [1.0]), table)
    found = problem.rank(root)
    assert np.isfinite([p.log_score for p in found.pairs]).all()
    assert found.pairs[0].probability == pytest.approx(1)
    assert found.pairs[0].target == 0


def test_a_non_default_reading_pays_a_tenth() -> None:
    table = np.full((N, N, 1), 0.5)[..., 0]
    problem, default = simple(([0], [0.5]), ([5], [0.5]), table)
    problem.tables["better"] = table * np.exp(NON_DEFAULT_PENALTY * 0.9)
    problem.tables["much better"] = table * np.exp(NON_DEFAULT_PENALTY * 1.1)

    def other(phrase: str) -> Node:
        return Node("a", (Attachment("left", (Node("b", (), 1),), phrase=phrase),))

    assert problem.rank(default, other("better")).reading.is_default
    found = problem.rank(default, other("much better"))
    assert not found.reading.is_default
    assert found.reading_scores[1] - found.reading_scores[0] == pytest.approx(0.11)


def test_a_reading_without_any_pair_is_not_chosen() -> None:
    problem, default = simple(([0], [0.5]), ([0], [0.5]), np.full((N, N), 0.9))
    problem.candidates["c"] = Candidates(np.array([5]), np.array([0.01]))
    problem.tables["weak"] = np.full((N, N), 0.02)
    other = Node("a", (Attachment("left", (Node("c", (), 1),), phrase="weak"),))
    found = problem.rank(default, other)
    assert found.reading_scores[0] == -np.inf
    assert not found.degenerate
    assert pairs_of(found) == [(0, 5)]


def test_weights_of_zero_leave_a_factor_out() -> None:
    table = np.full((N, N), 0.05)
    table[1, 6] = 0.95
    problem, root = simple(([0, 1], [0.8, 0.7]), ([6], [0.5]), table)
    assert problem.rank(root).pairs[0].target == 1
    found = problem.rank(root, config=RankConfig(relation_weight=0.0))
    assert found.pairs[0].target == 0
    assert found.pairs[0].log_score == pytest.approx(np.log(0.8) + np.log(0.5))
