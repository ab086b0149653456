"""Rankings that are not a product of ours: known by the scores that they gave, and not by how they come about.

What a pair scored is taken as it stands. What it would score with other factors, P(target), P(reference) and
P(relation), is bounded by what other pairs scored: a ranking that uses its factors at all gives no less to a pair that
is better or equal in all of them. Pairs of all lines of a file are samples of one rule where they agree with each
other. A ranking that contradicts this is not separable into modules, and nothing is said of them; where the pipeline
can be asked again (`Rescore`), it is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from pipeline.answering.pair_table import MIN_RELATION, MIN_SCORE, RankConfig, Side
from pipeline.answering.predictions import Header, Prediction, Predictions
from pipeline.language.expression import parse
from pipeline.language.naming import match
from pipeline.system.errors import InputError

Rescore = Callable[[Prediction, np.ndarray, np.ndarray], np.ndarray]
"""(line, ids (P, 2) int64, factors (P, 3) float64) -> scores (P,): the other pipeline's own ranking, asked again. An id
is -1 for a thing that was not proposed, and for the reference of an expression without one."""
CONTRADICTED = 0.05
"""Samples are not of one rule of the factors where more of the comparable pairs of them than this contradict it."""
ODD, MOST_ODD = 0.25, 0.2
"""A sample is odd that contradicts more than this share of those it compares with; so many at most may be odd. And so
many lines, ODD of all, may contradict themselves."""
MOST_SAMPLES = 2500
LEAST_SAMPLES = 30
_SAME = 1e-9


@dataclass(frozen=True)
class Samples:
    """What pairs scored.

    Attributes
    ----------
    factors : (N, 3) float64
    scores : (N,) float64
    """

    factors: np.ndarray
    scores: np.ndarray

    def bounds(self, factors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The least and the most that pairs of these factors ((P, 3)) can score; (P,) each, infinite where unknown."""
        low, high = np.full(len(factors), -np.inf), np.full(len(factors), np.inf)
        for k in range(0, len(factors), 256):
            part = factors[k : k + 256, None]
            below = (self.factors[None] <= part + _SAME).all(axis=2)
            above = (self.factors[None] >= part - _SAME).all(axis=2)
            low[k : k + 256] = np.where(below, self.scores, -np.inf).max(axis=1, initial=-np.inf)
            high[k : k + 256] = np.where(above, self.scores, np.inf).min(axis=1, initial=np.inf)
        return low, high

    @cached_property
    def _contradicted(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) int64: with how many samples each compares, and with how many its score stands the wrong way round."""
        f, s = self.factors, self.scores
        better = (f[:, None] >= f[None] - _SAME).all(axis=2) & (f[:, None] > f[None] + 1e-6).any(axis=2)
        wrong = better & (s[:, None] < s[None] - 1e-9)
        return tuple(x.sum(axis=0) + x.sum(axis=1) for x in (better, wrong))  # type: ignore[return-value]

    @property
    def contradictions(self) -> float:
        """Share of the comparable pairs of samples whose scores stand the wrong way round."""
        comparable, wrong = self._contradicted
        return float(wrong.sum() / max(comparable.sum(), 1))

    @property
    def odd(self) -> np.ndarray:
        """(N,) bool: samples that contradict many others."""
        comparable, wrong = self._contradicted
        return wrong > ODD * comparable


NONE = Samples(np.zeros((0, 3)), np.zeros(0))


def factors_of(line: Prediction) -> dict[tuple[int, int], tuple[float, float, float]]:
    """P(target), P(reference), P(relation) of the pairs of a line that says one relation of two names, by ids."""
    relation, (first, second) = _ends(line, _asked(line))
    rows = (line.relations or {}).get(relation, ())
    return {(r[0], r[1]): (first[r[0]], second[r[1]], r[-1]) for r in rows if r[0] in first and r[1] in second}


def missing_row(line: Prediction) -> tuple[str, int, int] | None:
    """The relation that a line asks, and the first pair of candidates that it has no probability for; None for none."""
    return _lacking(line, _asked(line))


def _lacking(line: Prediction, asked: tuple[str, str, str] | None) -> tuple[str, int, int] | None:
    relation, (first, second) = _ends(line, asked)
    told = {row[:2] for row in (line.relations or {}).get(relation, ())}
    return next(((relation, a, b) for a in first for b in second if a != b and (a, b) not in told), None)


def _ends(line: Prediction, asked: tuple[str, str, str] | None) -> tuple[str, list[dict[int, float]]]:
    """The relation that is asked, and the scores by id of what is proposed for its target and its reference."""
    proposals = line.proposals or {}
    names = [match(name, tuple(proposals)) for name in (asked[0], asked[2])] if asked else [(), ()]
    scores = [{p.id: p.score for name in known for p in proposals[name] if p.dropped is None} for known in names]
    return asked[1] if asked else "", scores


def _asked(line: Prediction) -> tuple[str, str, str] | None:
    """Target, relation and reference of a line that says no more; None for others, and where it cannot be read.

    Words that are read here as another relation than the only one that the line has say what that one says.
    """
    if line.target and line.relation and line.reference:
        return line.target, line.relation, line.reference
    read, told = _read(line.text, tuple(line.proposals or ())), tuple(line.relations or ())
    if read is None or read[1] in told or len(told) != 1:
        return read
    tried = ((a, told[0], b) for a, b in ((read[0], read[2]), (read[2], read[0])))
    return next((asked for asked in tried if _lacking(line, asked) is None), None)


@lru_cache(maxsize=20_000)
def _read(text: str, names: tuple[str, ...]) -> tuple[str, str, str] | None:
    try:
        query = parse(text, class_names=names)
    except InputError:
        return None
    e = query.expression
    plain = e is not None and query.default.root.triple is not None and not e.inverse and e.second_reference is None
    return (e.target, e.relation, e.reference) if plain and e is not None else None


@dataclass(frozen=True)
class RunRules:
    """What the lines of a file say together of the rule that ranks.

    Attributes
    ----------
    by_line : dict of (frame, text) to Samples
    """

    by_line: dict[tuple[str, str], Samples]

    @staticmethod
    def of(predictions: Predictions) -> RunRules:
        """The samples of a file whose pairs have scores of their own."""
        found: dict[tuple[str, str], Samples] = {}
        for key, line in predictions.lines.items():
            factors, scores = factors_of(line), {(a, b): s for a, b, s in line.pairs or () if b is not None}
            both = [pair for pair in factors if pair in scores]
            if both:
                found[key] = Samples(np.array([factors[p] for p in both]), np.array([scores[p] for p in both]))
        return RunRules(found)

    @cached_property
    def separable(self) -> bool:
        """Whether within lines more or equal in all factors is no less in score, up to a line here and there."""
        several = [s.contradictions > 0 for s in self.by_line.values() if len(s.scores) > 1]
        return not several or float(np.mean(several)) <= ODD

    @cached_property
    def _common(self) -> tuple[np.ndarray, Samples]:
        """Samples of all lines with the number of the line of each, without odd ones; none where scales differ."""
        nothing = np.zeros(0, np.int64), NONE
        if not self.by_line or not self.separable:
            return nothing
        numbers = np.repeat(np.arange(len(self.by_line)), [len(s.scores) for s in self.by_line.values()])
        chosen = np.unique(np.linspace(0, len(numbers) - 1, min(MOST_SAMPLES, len(numbers))).astype(int))
        every = Samples(
            np.concatenate([s.factors for s in self.by_line.values()])[chosen],
            np.concatenate([s.scores for s in self.by_line.values()])[chosen],
        )
        kept = np.flatnonzero(~every.odd)
        left = Samples(every.factors[kept], every.scores[kept])
        few = len(kept) < max(LEAST_SAMPLES, (1 - MOST_ODD) * len(chosen))
        return nothing if few or left.contradictions > CONTRADICTED else (numbers[chosen][kept], left)

    @cached_property
    def _numbers(self) -> dict[tuple[str, str], int]:
        return {key: k for k, key in enumerate(self.by_line)}

    def others(self, key: tuple[str, str]) -> Samples:
        """The samples of all lines but one; none where scales differ."""
        numbers, every = self._common
        there = numbers != self._numbers.get(key, -1)
        return Samples(every.factors[there], every.scores[there])


@dataclass(frozen=True, eq=False)
class PairRule:
    """How the pairs of one line score.

    Attributes
    ----------
    line : Prediction
    given : dict of (target id, reference id) to float
        As the line says.
    factors : dict of (target id, reference id) to (P(target), P(reference), P(relation))
        What these scores were given for.
    own, others : Samples
        Of this line, and of the rest of the file.
    separable : bool
    product : RankConfig or None
        The header's product, where the line's answer is not what it gives; the scores of changed pairs are then its.
    rescore : callable or None
    answered : str or None
        Of a line that does not tell what ranked: its answer in words, which no number of ours may stand beside.
    ids : (N,) int64 or None
        Of the list of objects that the table of pairs is about.
    """

    line: Prediction
    given: dict[tuple[int, int], float]
    factors: dict[tuple[int, int], tuple[float, float, float]]
    own: Samples
    others: Samples
    separable: bool
    product: RankConfig | None = None
    rescore: Rescore | None = None
    answered: str | None = None
    ids: np.ndarray | None = None

    def scores(self, target: Side, ends: Sequence[Side], p: np.ndarray, regular: bool = False) -> np.ndarray:
        """S of a table of pairs, of the shape of `p` with all axes of scenes; see `bounds`."""
        low, high = self.bounds(target, ends, p, regular)
        known = np.isfinite(low) & np.isfinite(high)
        middle = np.where(
            known, (np.where(known, low, 0) + np.where(known, high, 0)) / 2, np.where(np.isfinite(low), low, high)
        )
        return middle

    def bounds(
        self, target: Side, ends: Sequence[Side], p: np.ndarray, regular: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """The least and the most that each pair can score; the same where it is known.

        Parameters
        ----------
        target, ends, p
            As for `pair_table`; one end at most.
        regular : bool
            By the rule alone: also pairs whose factors are the line's own score what other lines' pairs would.
        """
        one = np.ones(p.shape)
        t = target.scores[..., :, None] * one if ends else target.scores * one
        r = ends[0].scores[..., None, :] * one if ends else one
        t, r, p = np.broadcast_arrays(t, r, p)
        factors = np.stack([t, r, p], axis=-1).reshape(-1, 3)
        ids = self._pairs(target, ends, t.shape)
        if self.product is not None:
            low = self._product(factors)
            high = low.copy()
        elif self.rescore is not None:
            scores = np.concatenate(
                [
                    self.rescore(self.line, i, f)
                    for i, f in zip(
                        ids.reshape(-1, *self._flat(t, ends)), factors.reshape(-1, *self._flat(t, ends, 3)), strict=True
                    )
                ]
            )
            low, high = scores, scores.copy()
        else:
            samples = self.others if regular else self.samples
            low, high = samples.bounds(factors)
            least, most = self._range
            low, high = np.maximum(low, least), np.minimum(high, most)
        if not regular:
            for pair, score in self.given.items():
                here = (ids == pair).all(axis=1)
                if pair in self.factors:
                    here &= np.abs(factors - np.array(self.factors[pair])).max(axis=1) < 1e-6
                low[here] = high[here] = score
        return low.reshape(t.shape), high.reshape(t.shape)

    def _flat(self, t: np.ndarray, ends: Sequence[Side], width: int = 2) -> tuple[int, int]:
        return int(np.prod(t.shape[-(1 + len(ends)) :])), width

    def _pairs(self, target: Side, ends: Sequence[Side], shape: tuple[int, ...]) -> np.ndarray:
        """(P, 2) int64: ids of every pair of a table of that shape."""
        assert self.ids is not None
        ids = np.concatenate([self.ids, [-1]])

        def named(side: Side) -> np.ndarray:
            return ids[np.minimum(side.index, len(ids) - 1)]

        a = named(target)[:, None] if ends else named(target)
        b = named(ends[0])[None, :] if ends else np.full(1, -1)
        return np.stack([np.broadcast_to(x, shape) for x in (a, b)], axis=-1).reshape(-1, 2)

    def _product(self, factors: np.ndarray) -> np.ndarray:
        assert self.product is not None
        c, least = self.product, np.array([MIN_SCORE, MIN_SCORE, MIN_RELATION])
        logs = np.log(np.clip(factors, least, [1 - MIN_SCORE, 1 - MIN_SCORE, np.inf]))
        return logs @ np.array([c.target_weight, c.reference_weight, c.relation_weight])

    @cached_property
    def samples(self) -> Samples:
        """Of the line and the rest of the file."""
        parts = (self.own, self.others)
        return Samples(np.concatenate([s.factors for s in parts]), np.concatenate([s.scores for s in parts]))

    @cached_property
    def _range(self) -> tuple[float, float]:
        scores = self.samples.scores
        return (float(scores.min()), float(scores.max())) if len(scores) else (0.0, 0.0)


@dataclass(frozen=True)
class RuledConfig(RankConfig):
    """Weights that a rule stands in for."""

    pairs: PairRule | None = field(default=None, compare=False)

    @property
    def rule(self) -> PairRule | None:
        """What scores pairs in place of the product."""
        return self.pairs

    @property
    def true_scores(self) -> tuple[float, float]:
        """What is high and low by this file: of what nothing ever had, no score is known."""
        samples = None if self.rule is None else self.rule.samples
        if samples is None or not len(samples.scores):
            return super().true_scores
        high, low = np.quantile(samples.factors[:, :2], [0.8, 0.05])
        return float(high), float(low)

    def of(self, ids: Sequence[int]) -> RuledConfig:
        """The same for a list of objects with these ids."""
        return self if self.rule is None else replace(self, pairs=replace(self.rule, ids=np.array(ids, np.int64)))


def line_rule(run: RunRules, header: Header, line: Prediction, rescore: Rescore | None) -> PairRule | None:
    """The rule of a line; None where its ranking is the header's product, and gives the line's answer."""
    if not line.ranked:
        return _unranked(header, line)
    if header.ranking == "product" and header.same == "overlap":
        # What overlaps is no pair, and so the best product need not be the answer.
        return None
    factors, key = factors_of(line), (line.frame, line.text)
    if header.ranking == "pair_scores":
        given = {(a, -1 if b is None else b): s for a, b, s in line.pairs or ()}
        own = run.by_line.get(key, NONE)
        return PairRule(line, given, factors, own, run.others(key), run.separable, rescore=rescore)
    if line.answer is None or line.answer.object is None:
        return None
    answered = line.answer.object, line.answer.reference
    weights = header.weights
    product = RankConfig(weights.target, weights.reference, weights.relation)
    nothing = NONE
    rule = PairRule(line, {}, factors, nothing, nothing, True, product)
    scores = dict(zip(factors, rule._product(np.array(list(factors.values())).reshape(-1, 3)).tolist(), strict=True))
    theirs = {pair: s for pair, s in scores.items() if pair[0] == answered[0] and answered[1] in (None, pair[1])}
    if not theirs:
        return None
    pair, best = max(theirs, key=theirs.__getitem__), max(scores.values())
    if header.ranking == "product" and scores[pair] >= best - 1e-6:
        return None
    given = {**scores, pair: max(best, scores[pair]) + 1.0}
    if header.ranking == "product":
        return replace(rule, given=given)
    # What ranked is not told: of the answer it is known that it stands above all others, and no more.
    own = Samples(np.array(list(factors.values())).reshape(-1, 3), np.array([float(p == pair) for p in factors]))
    return PairRule(line, {p: float(p == pair) for p in factors}, factors, own, nothing, True, rescore=rescore)


def _unranked(header: Header, line: Prediction) -> PairRule:
    """The rule of a line that does not tell what ranked: its answer stands above all else, and no more is known."""
    answer, found, words = line.answer, {}, f"{header.system} gave no answer"
    if answer is None and line.problem:
        words += f": {line.problem}"
    elif answer is not None and answer.object is not None:
        ends = (answer.reference,) if answer.reference is not None else (-1, *line.objects)
        found, words = {(answer.object, end): 1.0 for end in ends}, f"as {header.system} answered"
    elif answer is not None and answer.yes is not None:
        words = f"{header.system} answered {'yes' if answer.yes else 'no'}"
    elif answer is not None:
        numbers = ", ".join(f"{v:g}" for v in answer.point or answer.box or ())
        kind = "point" if answer.point else "box" if answer.box else "mask"
        words = f"{header.system} answered a {kind}{numbers and f' at {numbers}'}"
    return PairRule(line, found, {}, NONE, NONE, True, answered=words)
