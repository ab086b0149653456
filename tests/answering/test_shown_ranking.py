"""A ranking that is known only by the scores of its pairs: what they show of it, and when they show nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slow_cases import mostly_slow

from pipeline.answering import FittedRanking, Header, PredictedAnswer, Prediction, Proposal, RunRules, Scale, side
from pipeline.answering.fitted_models import SCALES, Compared, described
from pipeline.answering.pair_rules import line_rule
from pipeline.geometry import Box3D, viewer_axes


def lines(score: Callable[[np.ndarray], np.ndarray], count: int = 40, noise: float = 0.0) -> list[Compared]:
    rng = np.random.default_rng(5)
    found = [rng.uniform(0.02, 0.98, (10, 3)) for _ in range(count)]
    ids = np.stack([np.arange(10), 100 + np.arange(10)], axis=1)
    return [(f, score(f) + noise * rng.normal(size=len(f)), ids) for f in found]


def weakest(f: np.ndarray) -> np.ndarray:
    return 0.6 * f[:, 2] + 0.4 * f[:, :2].min(axis=1)


RISING: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "weakest": weakest,
    "logs": lambda f: np.log(f).sum(axis=1),
    "product": lambda f: 100 * f.prod(axis=1),
    "saturating": lambda f: np.tanh(3 * f[:, 2]) + f[:, 0],
    "decided first": lambda f: (f[:, 2] > 0.5) + 0.7 * f[:, 0] + 0.3 * f[:, 1],
    "score threshold": lambda f: f[:, 2] - (f[:, 0] < 0.3) - (f[:, 1] < 0.3),
    "lexicographic": lambda f: 100 * np.round(f[:, 2], 1) + 10 * f[:, 0] + 0.1 * f[:, 1],
    "noisy or": lambda f: 1 - (1 - f).prod(axis=1),
    "share of a line": lambda f: np.exp(9 * f @ [0.2, 0.2, 0.6]) / np.exp(9 * f @ [0.2, 0.2, 0.6]).sum(),
    "classifier": lambda f: 1 / (1 + np.exp(20 - 30 * f @ [0.2, 0.2, 0.6])),
}


@pytest.mark.parametrize("rule", mostly_slow(RISING, fast=(0, 9)))
def test_scores_of_any_rising_rule_are_foretold(rule: str) -> None:
    score = RISING[rule]
    shown = FittedRanking.of(lines(score))
    assert shown is not None
    a, b = np.random.default_rng(6).uniform(0.05, 0.95, (2, 500, 3))
    sure = np.abs(score(a) - score(b)) > 0.1 * np.ptp(score(a))
    alike = (score(a) > score(b)) == (shown.sums(a) > shown.sums(b))
    assert alike[sure].mean() > 0.97
    # More of any factor is never less.
    assert (shown.sums(np.maximum(a, b)) >= shown.sums(a) - 1e-9).all()


@pytest.mark.slow
def test_scores_that_are_shares_or_chances_are_fitted_as_such() -> None:
    def odds(f: np.ndarray) -> np.ndarray:
        return 30 * f @ [0.2, 0.2, 0.6] - 20

    shares = FittedRanking.of(lines(lambda f: np.exp(odds(f)) / np.exp(odds(f)).sum()))
    chances = FittedRanking.of(lines(lambda f: 1 / (1 + np.exp(-odds(f)))))
    assert shares is not None
    assert chances is not None
    assert (shares.scale, chances.scale) == ("logs", "odds")
    low, high = np.array([[0.5, 0.5, 0.2], [0.5, 0.5, 0.9]])
    # However small a share or near to 1 a chance is: it is as far from the others as its sum is.
    for shown in (shares, chances):
        assert shown.sums(high) - shown.sums(low) == pytest.approx(30 * 0.6 * 0.7, rel=0.1)


@pytest.mark.parametrize("scale", sorted(SCALES))
def test_a_scale_keeps_the_order_and_leads_back(scale: Scale) -> None:
    forward, back = SCALES[scale]
    scores = np.linspace(0.001, 0.999, 50)
    assert (np.diff(forward(scores)) > 0).all()
    np.testing.assert_allclose(back(forward(scores)), scores, atol=1e-9)
    assert np.isfinite(forward(np.array([-1.0, 0.0, 1.0, 2.0]))).all()
    assert np.isfinite(back(np.array([-1e9, 1e9]))).all() or scale == "values"


@pytest.mark.slow
def test_a_shortlist_is_known_by_how_things_stand_among_their_like() -> None:
    rng = np.random.default_rng(5)
    ids = np.array([(a, b) for a in range(6) for b in range(10, 14)])

    def line() -> np.ndarray:
        t, r = rng.uniform(0.02, 0.98, 6), rng.uniform(0.02, 0.98, 4)
        return np.array([(t[a], r[b - 10], rng.uniform(0.02, 0.98)) for a, b in ids])

    def score(f: np.ndarray) -> np.ndarray:
        surest = np.sort(np.unique(f[:, 0]))[-2:]
        return f[:, 2] + 0.5 * f[:, 1] + 10.0 * np.isin(f[:, 0], surest)

    shown = FittedRanking.of([(f, score(f), ids) for f in (line() for _ in range(40))])
    assert shown is not None
    others = [line() for _ in range(20)]
    told = shown.sums(np.stack(others), ids)
    right = [s.argmax() == score(f).argmax() for s, f in zip(told, others, strict=True)]
    assert np.mean(right) > 0.9
    # What was not proposed takes nobody's place.
    extra = np.concatenate([others[0], [[0.99, 0.9, 0.1]]])
    np.testing.assert_allclose(shown.sums(extra, np.concatenate([ids, [[-1, 10]]]))[:-1], told[0])


def test_a_wrong_score_in_every_line_changes_nothing() -> None:
    broken = lines(weakest)
    for k, (_, scores, _) in enumerate(broken):
        scores[k % 10] = 2.0
    shown = FittedRanking.of(broken)
    assert shown is not None
    low, high = np.array([[0.5, 0.5, 0.1], [0.5, 0.5, 0.9]])
    assert shown.sums(high) - shown.sums(low) == pytest.approx(0.48, abs=0.1)


def test_a_reference_that_counts_before_all_else_hides_nothing_of_the_rest() -> None:
    shown = FittedRanking.of(lines(lambda f: 100 * f[:, 1] + f[:, 0] * f[:, 2]))
    assert shown is not None
    low, high = np.array([[0.9, 0.5, 0.3], [0.9, 0.5, 0.4]])
    # What is 0.1 % of all that it spans is told apart.
    assert shown.sums(high) - shown.sums(low) == pytest.approx(0.09, abs=0.02)
    assert shown.unit < 0.09


@pytest.mark.slow
def test_noise_makes_less_sure() -> None:
    clear, noisy = (FittedRanking.of(lines(weakest, noise=noise)) for noise in (0.0, 0.05))
    assert clear is not None
    assert noisy is not None
    assert noisy.unit > 2 * clear.unit


def test_scores_that_do_not_follow_from_their_factors_show_nothing() -> None:
    rng = np.random.default_rng(7)
    assert FittedRanking.of(lines(lambda f: rng.random(len(f)))) is None
    assert FittedRanking.of(lines(lambda f: -weakest(f))) is None
    assert FittedRanking.of([(f[:5], scores[:5], ids[:5]) for f, scores, ids in lines(weakest, count=2)]) is None
    assert FittedRanking.of([]) is None


@given(
    st.lists(st.sampled_from([0.1, 0.5, 0.5 + 1e-9, 0.9]), min_size=6, max_size=6),
    st.integers(0, 2),
    st.sampled_from([None, 3, 4]),
    st.sampled_from(["pair_scores", "product"]),
)
def test_the_pair_that_was_answered_stands_first(
    scores: list[float], answer: int, end: int | None, ranking: Literal["pair_scores", "product"]
) -> None:
    pairs = [(a, b) for a in range(3) for b in (3, 4)]
    box = (0.0, 0.0, 9.0, 9.0)
    told = {"cup": tuple(Proposal(i, 0.5, box) for i in range(3)), "box": tuple(Proposal(i, 0.5, box) for i in (3, 4))}
    line = Prediction(
        "1",
        "cup left of box",
        answer=PredictedAnswer(object=answer, reference=end),
        proposals=told,
        relations={"left": tuple((a, b, p) for (a, b), p in zip(pairs, scores, strict=True))},
        pairs=tuple((a, b, s) for (a, b), s in zip(pairs, scores, strict=True)) if ranking == "pair_scores" else None,
    )
    found = line_rule(RunRules(None, (0.9, 0.1)), Header(1, ranking=ranking), line)
    rule = None if found is None else found.among(range(5), np.eye(5, dtype=np.bool_))
    own = [p for p in pairs if p[0] == answer and end in (None, p[1])]
    given = dict(zip(pairs, scores, strict=True)) if rule is None else rule.given
    first = max(given, key=given.__getitem__)
    assert first in own
    others = [s for p, s in given.items() if p not in own]
    assert given[first] > max(others) + 1e-9
    if ranking == "pair_scores":
        # Nothing but the one that was answered is moved.
        assert all(given[p] == s for p, s in zip(pairs, scores, strict=True) if p != first)


def test_a_line_that_had_nothing_to_rank_scores_what_the_truth_adds() -> None:
    shown = FittedRanking.of(lines(lambda f: f[:, 2] + (f[:, 0] == f[:, 0].max())))
    assert shown is not None
    line = Prediction("1", "cup left of box", problem="no cup", proposals={"cup": ()}, relations={"left": ()})
    rule = line_rule(RunRules(shown, (0.9, 0.1)), Header(1, ranking="pair_scores"), line)
    assert rule is not None
    nothing, missing = (side(np.zeros(n, np.int64), np.full(n, 0.5), 1.0) for n in (0, 1))
    assert rule.scores(nothing, [nothing], np.zeros((0, 0))).shape == (0, 0)
    low, high = (float(rule.scores(missing, [missing], np.full((1, 1), p))[0, 0]) for p in (0.1, 0.9))
    assert low < high


def test_weights_of_fewer_curves_still_say_what_they_said() -> None:
    kept = FittedRanking(np.concatenate([[1.0, 2.0, 3.0], np.zeros(22)]), 0.1)
    assert kept.sums(np.array([0.2, 0.3, 0.4])) == pytest.approx(0.2 + 0.6 + 1.2)


def test_weights_of_fewer_columns_still_say_what_they_said() -> None:
    viewer = viewer_axes(np.array([0.0, -1.0, 0.0]))
    boxes = [Box3D(np.array([x, 0.0, 2.0]), np.eye(3), np.array([0.2, 0.3, 0.1])) for x in (-0.5, 0.5)]
    away = described(boxes, viewer)[0, 1]
    # The first columns, and their order, are those of cases that were kept.
    np.testing.assert_allclose(away[:3], [-1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(away[3:6], [-1 / 0.25, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(away[6:8], [-0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(away[8:14], [0.8, -0.3, -0.1, 0.8, 0.0, 0.0], atol=1e-12)
    assert away[14] == 1.0
    # The opposite pair lies the opposite way: of what has a sign.
    np.testing.assert_allclose(described(boxes, viewer)[1, 0][:8], -away[:8], atol=1e-12)
