"""Answers in words: the best pair, its fit to the question, or the reason for none."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.detector_prompts import unused_words
from pipeline.answering.pair_table import HOLDS, Link, ScoredPair
from pipeline.answering.ranking import Candidates, Ranking
from pipeline.language.chain import why_unused
from pipeline.language.choices import compares
from pipeline.language.lexicon import wording
from pipeline.language.tree import Node
from pipeline.relations.attributes import SIZES
from pipeline.system.frozen import dataclass

NOTHING = Candidates(np.zeros(0, np.int64), np.zeros(0))
SEVERAL = 5
NO_SUCH_THING = "nothing is all of that; nearest is "
NO_SUCH_PAIR = "no such pair; nearest is "
IN_PART = "not all of it was used; by the rest it is "
SUPERLATIVES = ("closest", "farthest")
TIED = 5e-4
"""Posteriors that differ by less are called a tie."""


@dataclass(frozen=True)
class AnswerWords:
    """Best pair in words."""

    # Every relation of the answer has a probability of at least a half; None where that is so of a question that was
    # asked in part
    holds: bool | None
    # What stands before the pair: nothing, that there is no such pair, or that a pair of less confidence is one
    lead: str
    numbers: str  # The relation's probability (of several the weakest's) and the product of all factors
    below: str  # The posterior over the candidate pairs, and its margin to the next one
    fails: tuple[str, ...]  # Each relation that does not hold, where the expression has several

    def sentence(self, pair: str) -> str:
        """All words on a line, around the pair in words."""
        return f"{self.lead}{pair}: {', '.join((self.numbers, *self.fails))}"


def best_pair(trace: Trace) -> ScoredPair | None:
    """Best pair; None for a missing name, or candidates all of the same object."""
    ranking = trace.ranking
    none = ranking is None or ranking.degenerate or not ranking.pairs or len(trace.tied) > 1
    return None if none or ranking is None else ranking.pairs[0]


def holds(trace: Trace) -> bool | None:
    """True for an answer fulfilling all of the question; None for the same with parts of the question unused."""
    best = best_pair(trace)
    return best is not None and stands(trace, best)


def stands(trace: Trace, pair: ScoredPair) -> bool | None:
    """True for a pair of a trace fulfilling the question; None as in `holds`."""
    return None if pair.holds and asked_in_part(trace) else pair.holds


def asked_in_part(trace: Trace) -> bool:
    """True with distinguishing words left out of the question, which may not hold."""
    if why_unused(trace.query) is not None:
        return True
    # A detector that was asked for the whole phrase has judged `striped` by it.
    plain = [n for n in trace.query.nodes if n.label not in trace.candidates.get(n.label, NOTHING).labels]
    return any(not a.judged for n in plain for a in n.attributes)


def why_no_answer(trace: Trace) -> str | None:
    """Reason for no answer, a line; None with an answer."""
    if trace.answered is not None and trace.ranking is None:
        return trace.answered
    if trace.missing:
        names = " and no ".join(repr(n) for n in trace.missing)
        return f"no {names} found in frame {trace.frame.id}"
    if len(trace.tied) > 1:
        several = ", ".join(trace.name(k) for k in trace.tied[:SEVERAL]) + (", …" if len(trace.tied) > SEVERAL else "")
        unused = " and ".join(f"'{words}' ({why})" for words, why in unused_words(trace.query))
        left_out = f"; not used: {unused}" if unused else ""
        return f"{len(trace.tied)} things fit '{trace.query.text}' equally well: {several}{left_out}"
    if trace.ranking is None or trace.ranking.degenerate:
        return f"in frame {trace.frame.id} there are not enough different objects for all names of the expression"
    return None


def failing_links(pair: ScoredPair) -> tuple[Link, ...]:
    """Relations of an answer that do not hold."""
    return tuple(link for link in pair.links if link.probability < HOLDS)


def words_of_answer(trace: Trace, name: Callable[[int], str], pair: ScoredPair | None = None) -> AnswerWords:
    """Words of an answer, or of another pair.

    Parameters
    ----------
    trace : Trace
        One that has an answer.
    name : callable
        What an object of the trace is called, by its index.
    pair : ScoredPair, optional
        By default the best one.
    """
    ranking = trace.ranking
    assert ranking is not None
    pair = pair or ranking.pairs[0]
    several = len(pair.links) > 1
    fails = [f"{link_words(link, name)} {probability(link.probability)}" for link in failing_links(pair) if several]
    fails += [f"{name(f.object)} {f.text} {probability(f.probability)}" for f in pair.factors if not f.holds]
    factors = {what: probability(p) for what, p in headline(pair, trace.own_scores)}
    return AnswerWords(
        holds=stands(trace, pair),
        lead="" if trace.answered else _lead(trace, ranking, pair),
        numbers=trace.answered or ", ".join(f"{what} {p}" for what, p in factors.items()),
        below="" if trace.answered else _below(ranking, pair),
        fails=() if trace.answered else tuple(fails),
    )


def headline(pair: ScoredPair, own_scores: bool = False) -> tuple[tuple[str, float], ...]:
    """Top numbers of an answer: of its relation, of its attributes and choices, and the product.

    Without the product where a pair's score is another (`Trace.own_scores`), unless nothing else is left.
    """
    relation = "weakest relation" if len(pair.links) > 1 else "relation"
    asked = ((relation, pair.relation_probability),) if pair.reference is not None else ()
    attributes = (("attributes", pair.p_attributes),) if pair.factors else ()
    numbers = (*asked, *attributes)
    return numbers if numbers and own_scores else (*numbers, ("product", pair.product))


def pair_words(trace: Trace, pair: ScoredPair, name: Callable[[int], str]) -> str:
    """Pair as a sentence: "mug·4 left of laptop·2"; without a relation a single object."""
    ends = " and ".join(name(k) for k in (pair.reference, pair.second_reference) if k is not None)
    return f"{name(pair.target)} {trace.phrase} {ends}" if ends else name(pair.target)


def _lead(trace: Trace, ranking: Ranking, pair: ScoredPair) -> str:
    if pair.holds:
        return IN_PART if asked_in_part(trace) else ""
    weakest = pair.weakest
    if weakest is not None and weakest.relation in SUPERLATIVES:
        # There always is a closest one; the detector's scores overruled it.
        return f"another is the {weakest.relation}; best by all scores is "
    standing = next((rank for rank, p in enumerate(ranking.pairs, start=1) if p.holds), None)
    if standing is not None:
        return f"pair {standing} stands in it with a smaller product; best by all scores is "
    return NO_SUCH_PAIR if pair.reference is not None else NO_SUCH_THING


def _below(ranking: Ranking, pair: ScoredPair) -> str:
    count = len(ranking.pairs)
    if count == 1:
        return f"posterior {probability(pair.probability)}, the only candidate pair"
    if pair is not ranking.pairs[0]:
        rank = next(k for k, p in enumerate(ranking.pairs, start=1) if p is pair)
        best = probability(ranking.pairs[0].probability)
        return f"posterior {probability(pair.probability)}, rank {rank} of {count}; the answer has {best}"
    tied = np.isfinite(ranking.margin) and abs(ranking.margin) < TIED
    margin = "tied with the next" if tied else f"margin {ranking.margin:.2f}"
    return f"posterior {probability(pair.probability)}, {margin}, {count} pairs"


def link_words(link: Link, name: Callable[[int], str]) -> str:
    """Relation of an answer: "mug·4 left of laptop·2"."""
    second = "" if link.c is None else f" and {name(link.c)}"
    return f"{name(link.a)} {wording(link.relation, inverse=link.inverse)} {name(link.b)}{second}"


def probability(value: float) -> str:
    """Probability with two digits; a small number with enough digits to differ from 0."""
    if 0 < value < 0.005:
        return f"{value:.1g}" if value >= 1e-4 else "<0.0001"
    return f"{value:.2f}"


_HEIGHTS = ("high", "low")
_FIRST = {
    "closest": "closest",
    "farthest": "farthest",
    "near": "nearest",
    "far": "farthest",
    "high": "highest",
    "low": "lowest",
    "left": "leftmost",
    "right": "rightmost",
    "wide": "widest",
    "big": "biggest",
    "thin": "thinnest",
}
"""The superlatives of orders and relations that do not end in -est."""


def reading_notes(trace: Trace) -> tuple[str, ...]:
    """Notes for an answer, a line each, without repeats.

    A comparison decides between two; of more the first in order is taken, with their number told. Heights, and sizes
    without completed boxes, are those of the part of each object seen by the camera.
    """
    return tuple(dict.fromkeys(note for node in trace.root.walk() for note in _of_node(trace, node)))


def _of_node(trace: Trace, node: Node) -> Iterator[str]:
    found = trace.candidates.get(node.label)
    things = [] if found is None else [trace.objects[int(i)] for i in dict.fromkeys(found.index.tolist())]
    if len(things) < 2:
        return
    compared = [(c.text, c.order) for c in node.choices if c.rank == 1 and compares(c.text)]
    compared += [
        (a.phrase, a.relation)
        for a in node.attachments
        if a.relation in ("closest", "farthest") and not a.negated and compares(a.phrase)
    ]
    if len(things) > 2:
        for text, order in dict.fromkeys(compared):
            first = _FIRST.get(order, f"{order}est")
            several = f"{len(things)} things are called '{node.name}'"
            yield f"'{text}' compares two, and {several}: of those that fit, the {first} is taken"
    sizes = [c.text for c in node.choices if c.order in SIZES]
    sizes += [str(a) for a in node.attributes if a.kind == "size"]
    heights = [c.text for c in node.choices if c.order in _HEIGHTS]
    lifted = [thing for thing in things if thing.lifted.quality.points]
    cut = sum(thing.lifted.quality.touches_border for thing in lifted)
    border = f"; {cut} of {len(things)} are cut by the border of the picture" if cut else ""
    if any(thing.whole is not None for thing in lifted):
        completed = sum(thing.whole is not None and bool(thing.whole.completed) for thing in lifted)
        beyond = f": {completed} of {len(things)} are estimated beyond what is seen" if completed else ""
        yield from (f"'{text}' goes by whole boxes{beyond}" for text in dict.fromkeys(sizes))
        sizes = []
    for text in dict.fromkeys((*sizes, *heights)) if lifted else ():
        yield f"'{text}' goes by the part of each thing that is seen, not by the whole{border}"
