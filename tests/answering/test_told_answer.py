"""How an answer is told: the relation's probability at the top, and no pair where none stands in the relation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.answering import (
    HOLDS,
    NO_SUCH_PAIR,
    Link,
    Pipeline,
    PreparedFrame,
    ScoredPair,
    Trace,
    best_pair,
    holds,
    open_pipeline,
    probability,
    trace_record,
    words_of_answer,
)

PAIR = ScoredPair(0, 1, 0.9, 0.8, 0.7, log_score=-0.7, product=0.5, probability=1.0)


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline("demo", srm="rule")


@pytest.fixture(scope="module")
def context(source: Pipeline) -> PreparedFrame:
    return PreparedFrame(source.dataset.load(source.dataset.frame_ids[0]), source.config.lift)


def named(trace: Trace) -> Any:
    return lambda place: trace.objects[place].label


def test_an_answer_that_holds_is_headed_by_its_relation_and_its_product(
    source: Pipeline, context: PreparedFrame
) -> None:
    trace = source.ask(context, "mug left of the laptop")
    best, answer = best_pair(trace), words_of_answer(trace, named(trace))
    assert best is not None
    assert holds(trace)
    assert answer.lead == ""
    assert answer.numbers == f"relation {best.p_relation:.2f}, product {best.product:.2f}"
    assert f"posterior {best.probability:.2f}" in answer.below
    record = trace_record(trace)["answer"]
    assert record["holds"] is True
    assert "fails" not in record
    assert record["relation_probability"] == record["p_relation"] >= HOLDS


@pytest.mark.parametrize("text", ["mug behind the laptop", "laptop above the shelf", "laptop below the desk"])
def test_a_false_relation_is_no_pair_whatever_the_posterior(
    source: Pipeline, context: PreparedFrame, text: str
) -> None:
    trace = source.ask(context, text)
    best = best_pair(trace)
    assert best is not None
    if len(trace.ranking.pairs if trace.ranking else ()) == 1:
        assert best.probability == 1.0
    assert best.p_relation < HOLDS
    assert not holds(trace)
    answer = words_of_answer(trace, named(trace))
    assert answer.lead == NO_SUCH_PAIR
    assert answer.sentence("this pair").startswith("no such pair; nearest is this pair: relation 0.05, product 0.05")
    record = trace_record(trace)
    assert record["answer"]["holds"] is False
    assert record["answer"]["target"] is not None
    assert [link["relation"] for link in record["answer"]["fails"]] == [trace.relation]
    assert all(p["holds"] == (p["relation_probability"] >= HOLDS) for p in record["pairs"])


def test_no_answer_does_not_hold(source: Pipeline, context: PreparedFrame) -> None:
    here = {a.label for a in context.frame.annotations}
    other = next(name for name in source.dataset.class_names if name not in here)
    trace = source.ask(context, f"{other} left of the laptop")
    assert trace.missing
    assert best_pair(trace) is None
    assert not holds(trace)
    assert trace_record(trace)["answer"] is None


def links(*probabilities: float, relation: str = "left") -> ScoredPair:
    return replace(PAIR, links=tuple(Link(relation, k, k + 1, p) for k, p in enumerate(probabilities)))


@pytest.mark.parametrize(
    ("found", "stands", "weakest"),
    [
        (links(0.7), True, 0.7),
        (links(0.7, 0.6), True, 0.6),
        (links(0.9, 0.2), False, 0.2),
        (links(0.5), True, 0.5),
        (links(0.4999), False, 0.4999),
        (replace(PAIR, reference=None, p_relation=0.0), False, 0.0),
    ],
)
def test_every_relation_of_an_answer_has_to_hold(found: ScoredPair, stands: bool, weakest: float) -> None:
    assert found.holds == stands
    assert found.relation_probability == weakest


def test_the_relation_that_fails_is_named() -> None:
    ranking: Any = SimpleNamespace(pairs=(links(0.9, 0.2),), margin=1.0)
    trace: Any = SimpleNamespace(answered=None, own_scores=False, ranking=ranking)
    answer = words_of_answer(trace, lambda place: f"thing·{place}")
    assert answer.numbers == "weakest relation 0.20, product 0.50"
    assert answer.fails == ("thing·1 left of thing·2 0.20",)
    assert answer.below == "posterior 1.00, the only candidate pair"


def test_where_the_closest_lost_by_its_score_no_one_is_told_that_there_is_none() -> None:
    ranking: Any = SimpleNamespace(pairs=(links(0.05, relation="closest"),), margin=1.0)
    trace: Any = SimpleNamespace(answered=None, own_scores=False, ranking=ranking)
    answer = words_of_answer(trace, str)
    assert not answer.holds
    assert answer.lead == "another is the closest; best by all scores is "


def test_no_pair_is_denied_that_stands_below_the_best() -> None:
    weak, standing = links(0.1), replace(links(0.9), product=0.01)
    for pairs, lead in (
        ((weak, links(0.2)), NO_SUCH_PAIR),
        ((weak, links(0.2), standing), "pair 3 stands in it with a smaller product; best by all scores is "),
    ):
        trace: Any = SimpleNamespace(answered=None, own_scores=False, ranking=SimpleNamespace(pairs=pairs, margin=0.5))
        assert words_of_answer(trace, str).lead == lead


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0.00"),
        (1.0, "1.00"),
        (0.5, "0.50"),
        (0.005, "0.01"),
        (0.0049, "0.005"),
        (0.00042, "0.0004"),
        (3e-5, "<0.0001"),
        (0.999, "1.00"),
    ],
)
def test_a_small_probability_is_not_written_as_zero(value: float, text: str) -> None:
    assert probability(value) == text
