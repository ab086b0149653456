"""An answer as it is told: whether the best pair stands in what was asked, the numbers at the top, those below them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import HOLDS, Link, ScoredPair
from pipeline.answering.ranking import Ranking
from pipeline.language.lexicon import wording

NO_SUCH_PAIR = "no such pair; nearest is "
SUPERLATIVES = ("closest", "farthest")
TIED = 5e-4
"""Posteriors that differ by less are called a tie."""


@dataclass(frozen=True)
class ToldAnswer:
    """The best pair in words.

    Attributes
    ----------
    holds : bool
        Every relation of the answer has a probability of at least a half.
    lead : str
        What stands before the pair: nothing, that there is no such pair, or that a pair of less confidence is one.
    numbers : str
        The relation's probability (of several the weakest's) and the product of all factors.
    below : str
        The posterior over the candidate pairs, and its margin to the next one.
    fails : tuple of str
        Each relation that does not hold, where the expression has several.
    """

    holds: bool
    lead: str
    numbers: str
    below: str
    fails: tuple[str, ...]

    def sentence(self, pair: str) -> str:
        """All of it on one line, around the pair in words."""
        return f"{self.lead}{pair}: {', '.join((self.numbers, *self.fails))}"


def best_pair(trace: Trace) -> ScoredPair | None:
    """The answer; None where there is none: a name was not found, or all candidates are one thing."""
    ranking = trace.ranking
    return None if ranking is None or ranking.degenerate or not ranking.pairs else ranking.pairs[0]


def holds(trace: Trace) -> bool:
    """There is an answer, and it stands in every relation that was asked."""
    best = best_pair(trace)
    return best is not None and best.holds


def failing_links(pair: ScoredPair) -> tuple[Link, ...]:
    """The relations of an answer in which it does not stand."""
    return tuple(link for link in pair.links if link.probability < HOLDS)


def told(trace: Trace, name: Callable[[int], str], pair: ScoredPair | None = None) -> ToldAnswer:
    """The words of an answer, or of another of its pairs.

    Parameters
    ----------
    trace : Trace
        One that has an answer.
    name : callable
        What an object of the trace is called, by its place.
    pair : ScoredPair, optional
        By default the best one.
    """
    ranking = trace.ranking
    assert ranking is not None
    pair = pair or ranking.pairs[0]
    several = len(pair.links) > 1
    what = "weakest relation" if several else "relation"
    fails = tuple(f"{link_words(link, name)} {probability(link.probability)}" for link in failing_links(pair))
    return ToldAnswer(
        holds=pair.holds,
        lead=_lead(ranking, pair),
        numbers=f"{what} {probability(pair.relation_probability)}, product {probability(pair.product)}",
        below=_below(ranking, pair),
        fails=fails if several else (),
    )


def _lead(ranking: Ranking, pair: ScoredPair) -> str:
    if pair.holds:
        return ""
    weakest = pair.weakest
    if weakest is not None and weakest.relation in SUPERLATIVES:
        # There always is a closest one; the detector's scores overruled it.
        return f"another is the {weakest.relation}; best by all scores is "
    standing = next((place for place, p in enumerate(ranking.pairs, start=1) if p.holds), None)
    if standing is not None:
        return f"pair {standing} stands in it with a smaller product; best by all scores is "
    return NO_SUCH_PAIR


def _below(ranking: Ranking, pair: ScoredPair) -> str:
    count = len(ranking.pairs)
    if count == 1:
        return f"posterior {probability(pair.probability)}, the only candidate pair"
    if pair is not ranking.pairs[0]:
        place = next(k for k, p in enumerate(ranking.pairs, start=1) if p is pair)
        best = probability(ranking.pairs[0].probability)
        return f"posterior {probability(pair.probability)}, rank {place} of {count}; the answer has {best}"
    tied = np.isfinite(ranking.margin) and abs(ranking.margin) < TIED
    margin = "tied with the next" if tied else f"margin {ranking.margin:.2f}"
    return f"posterior {probability(pair.probability)}, {margin}, {count} pairs"


def link_words(link: Link, name: Callable[[int], str]) -> str:
    """A relation of an answer: "mug·4 left of laptop·2"."""
    second = "" if link.c is None else f" and {name(link.c)}"
    return f"{name(link.a)} {wording(link.relation, inverse=link.inverse)} {name(link.b)}{second}"


def probability(value: float) -> str:
    """Two digits; a small one with so many that it is not 0."""
    if 0 < value < 0.005:
        return f"{value:.1g}" if value >= 1e-4 else "<0.0001"
    return f"{value:.2f}"
