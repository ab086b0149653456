"""Ranking rules of imported predictions: known by the given scores, not by their derivation.

Given scores of pairs are kept. With other factors, P(target), P(reference) and P(relation), a pair scores by so much
more or less as a model of the ranking says: the product named by the header, else the fit of the file
(`fitted_models`). A ranking not explained by its factors has no model: it is not
separable into modules, and nothing is said of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np

from pipeline.answering.fitted_models import SCALES, FittedRanking, Scale
from pipeline.answering.pair_table import MIN_RELATION, MIN_SCORE, RankConfig, Side
from pipeline.answering.predictions import Header, PredictedAnswer, Prediction, Predictions
from pipeline.language.expression import parse
from pipeline.language.naming import match
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

Pair = tuple[int, int]
Factors = dict[Pair, tuple[float, float, float]]
"""P(target), P(reference) and P(relation) by the ids of a pair."""
Model = Callable[[np.ndarray, np.ndarray], np.ndarray]
STEP = 1e-6
"""By so much, or this share, the pair that was answered stands above others that scored the same."""


def factors_of(line: Prediction) -> Factors:
    """P(target), P(reference), P(relation) of the pairs of a line with a single relation of two names, by ids."""
    relation, (first, second) = _ends(line, _asked(line))
    rows = (line.relations or {}).get(relation, ())
    return {(r[0], r[1]): (first[r[0]], second[r[1]], r[-1]) for r in rows if r[0] in first and r[1] in second}


def given_names(name: str, line: Prediction) -> tuple[str, ...]:
    """Names of a line's proposals meant by a name of its expression: an equal name alone, if present."""
    names = tuple(line.proposals or ())
    return (name,) if name in names else match(name, names)


def missing_row(line: Prediction, gold: tuple[str, str, str] | None = None) -> tuple[str, int, int] | None:
    """Asked relation of a line, and the first candidate pair without a probability; None for none.

    `gold` is the asked triple (target, relation, reference), where known.
    """
    return _lacking(line, gold or _asked(line))


def has_pairs(line: Prediction) -> bool:
    """True for a line with relation rows, and of a plain one with two things that could be its target and reference."""
    asked = _asked(line)
    first, second = _ends(line, asked)[1]
    paired = asked is None or any(a != b for a in first for b in second)
    return paired and any((line.relations or {}).values())


def _lacking(line: Prediction, asked: tuple[str, str, str] | None) -> tuple[str, int, int] | None:
    relation, (first, second) = _ends(line, asked)
    rows = {row[:2] for row in (line.relations or {}).get(relation, ())}
    return next(((relation, a, b) for a in first for b in second if a != b and (a, b) not in rows), None)


def _ends(line: Prediction, asked: tuple[str, str, str] | None) -> tuple[str, list[dict[int, float]]]:
    """Asked relation, and scores by id of the proposals of its target and its reference."""
    scores: list[dict[int, float]] = [{}, {}]
    for asked_name, found in zip((asked[0], asked[2]) if asked else (), scores, strict=False):
        for p in (p for name in given_names(asked_name, line) for p in (line.proposals or {})[name]):
            if p.dropped is None:
                found[p.id] = max(p.score, found.get(p.id, 0.0))
    return asked[1] if asked else "", scores


def _asked(line: Prediction) -> tuple[str, str, str] | None:
    """Target, relation and reference of a plain line; None for others, and unreadable ones.

    Unreadable words, or a reading other than the line's only relation, take this relation's meaning.
    """
    if line.target and line.relation and line.reference:
        return line.target, line.relation, line.reference
    names, relations = tuple(line.proposals or ()), tuple(line.relations or ())
    read = _read(line.text, names)
    if (read is not None and read[1] in relations) or len(relations) != 1 or not 1 <= len(names) <= 2:
        return read
    tried = ((a, relations[0], b) for a, b in ((names[0], names[-1]), (names[-1], names[0])))
    return next((asked for asked in tried if _fits(line, asked)), None)


def _fits(line: Prediction, asked: tuple[str, str, str]) -> bool:
    """True for a line with all rows of a reading, and pairs and answer of its names."""
    first, second = _ends(line, asked)[1]
    answer = line.answer
    pairs = [row[:2] for row in line.pairs or ()] + ([] if answer is None else [(answer.object, answer.reference)])
    within = all(a in (None, *first) and b in (None, *second) for a, b in pairs)
    return within and _lacking(line, asked) is None


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
    """Ranking rule shown by the lines of a file together."""

    shown: FittedRanking | None
    # What is high and low for a thing by this file: of what nothing ever had, no score is known
    true_scores: tuple[float, float]

    @staticmethod
    def of(predictions: Predictions) -> RunRules:
        """Rule of a file with scores of pairs, or answered pairs."""
        compared = []
        for line in predictions.lines.values():
            factors = factors_of(line)
            scores = _pair_scores(predictions.header, line, factors)
            both = [pair for pair in factors if pair in scores]
            if both:
                rows = np.array([factors[p] for p in both]), np.array([scores[p] for p in both])
                compared.append((*rows, np.array(both, np.int64)))
        if not compared:
            return RunRules(None, RankConfig().true_scores)
        high, low = np.quantile(np.concatenate([factors for factors, _, _ in compared])[:, :2], [0.8, 0.05])
        return RunRules(FittedRanking.of(compared), (float(high), float(low)))


def _pair_scores(header: Header, line: Prediction, factors: Factors) -> dict[Pair, float]:
    """Scores of pairs, -1 for no reference; without any 1 for the answer's, and 0."""
    if header.ranking == "pair_scores":
        return {(a, -1 if b is None else b): s for a, b, s in line.pairs or ()}
    answer = line.answer
    if answer is None or answer.object is None:
        return {}
    return {(a, b): float(a == answer.object and answer.reference in (None, b)) for a, b in factors}


@dataclass(frozen=True, eq=False)
class PairRule:
    """Scores of the pairs of a line."""

    # dict of (target id, reference id) to float: as the line says, or by the model where it says no scores
    given: dict[Pair, float]
    # dict of (target id, reference id) to (P(target), P(reference), P(relation)): what these scores were given for
    factors: Factors = field(default_factory=dict)
    # (ids (P..., 2), factors (..., P..., 3)) -> (..., P...): what the pairs of a line score by what is known of the
    # ranking, on `scale`; None where nothing is, and their scores stand
    model: Model | None = None
    # So much more score is one more of the log odds of standing higher; 0 where the model is the ranking itself, and
    # nothing that was fitted to it
    unit: float = 0.0
    scale: Scale = "values"  # On which the model is a sum; see `fitted_models.SCALES`
    own_scores: bool = True  # The scores are the system's own, and no product
    true_scores: tuple[float, float] = RankConfig().true_scores
    # Of a line that does not tell what ranked: its answer in words, which no number of ours may stand beside
    answered: str | None = None
    scored: bool = False  # `given` are scores of the file
    # What was answered, where it is still to be put first among the pairs that are two things: `among`
    first: PredictedAnswer | None = None
    # (N,) int64: of the list of objects that the table of pairs is about
    ids: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def among(self, ids: Sequence[int], same: np.ndarray) -> PairRule | None:
        """Rule with the answer before all others of a list of objects; None where the header's product agrees already.

        Raises InputError where target and reference of the answer are a single object by `same`, (N, N) bool, and
        others are not.
        """
        known = np.array(ids, np.int64)
        apart = {(int(known[i]), int(known[j])) for i, j in np.argwhere(~same)}
        scores = {pair: score for pair, score in self.given.items() if pair in apart or pair[1] < 0}
        first = self.first
        if first is None and self.scored and scores:
            # Scores may be so small that their differences are not seen.
            first = PredictedAnswer(*max(scores, key=scores.__getitem__))
        if first is None or not any(_answers(first, pair) for pair in self.given):
            return self
        put = _answered_first(first, scores, 0.0 if self.scored else 1.0)
        return None if put == scores and not self.own_scores else replace(self, given=self.given | put, first=None)

    @cached_property
    def _known(self) -> tuple[dict[Pair, int], np.ndarray, np.ndarray, np.ndarray]:
        """Place of each pair with factors and score, its factors, scores on the scale, and modelled scores."""
        pairs = [pair for pair in self.given if pair in self.factors]
        factors = np.array([self.factors[pair] for pair in pairs]).reshape(-1, 3)
        ids = np.array(pairs, np.int64).reshape(-1, 2)
        scores = self.level(np.array([self.given[pair] for pair in pairs]))
        return {pair: k for k, pair in enumerate(pairs)}, factors, scores, self._modelled(ids, factors)

    def level(self, scores: np.ndarray) -> np.ndarray:
        """Scores (...) on the model's scale."""
        return SCALES[self.scale][0](scores)

    def _modelled(self, ids: np.ndarray, factors: np.ndarray) -> np.ndarray:
        return self.model(ids, factors) if self.model is not None and ids.size else np.zeros(factors.shape[:-1])

    def scores(self, target: Side, ends: Sequence[Side], p: np.ndarray, regular: bool = False) -> np.ndarray:
        """S of a table of pairs, of the shape of `p` with all axes of scenes.

        Given scores, and as much more or less as the model says of other factors; `regular` is by the model alone, on
        its scale. Parameters else as for `pair_table`; of two ends the answered target is known.
        """
        if len(ends) > 1:
            own = np.isin(self.ids[target.index], [a for a, _ in self.given])
            return np.broadcast_to(1.0 * own[:, None, None], p.shape)
        shape = np.broadcast_shapes(p.shape, (*target.scores.shape, 1) if ends else target.scores.shape)
        t = target.scores[..., :, None] if ends else target.scores
        r = ends[0].scores[..., None, :] if ends else 1.0
        factors = np.stack([np.broadcast_to(x, shape) for x in (t, r, p)], axis=-1)
        ids = self._pairs(target, ends)
        sums = self._modelled(ids, factors)
        if regular:
            return sums
        places, known, scores, before = self._known
        found = [places.get((a, b), -1) for a, b in ids.reshape(-1, 2).tolist()]
        at = np.array(found, np.int64).reshape(ids.shape[:-1])
        # Of a pair that the line does not have it is told what one like it would score, as its pairs do.
        rest = [float(np.median(scores - before)) if len(scores) else 0.0]
        missing = np.full((1, 3), np.nan)
        same = np.abs(factors - np.concatenate([known, missing])[at]).max(axis=-1) < 1e-6
        apart = np.concatenate([scores - before, rest])[at]
        as_given = np.array([*(self.given[pair] for pair in places), 0.0])[at]
        found = np.where(same, as_given, SCALES[self.scale][1](sums + apart))
        for pair, score in self.given.items():
            if pair not in places:
                found[..., (ids == pair).all(axis=-1)] = score
        return found

    def _pairs(self, target: Side, ends: Sequence[Side]) -> np.ndarray:
        """(T, R, 2) or (T, 2) int64: ids of the pairs of a table."""
        ids = np.concatenate([self.ids, [-1]])
        a = ids[np.minimum(target.index, len(ids) - 1)]
        if not ends:
            return np.stack([a, np.full_like(a, -1)], axis=-1)
        b = ids[np.minimum(ends[0].index, len(ids) - 1)]
        return np.stack(np.broadcast_arrays(a[:, None], b[None]), axis=-1)


@dataclass(frozen=True)
class RuledConfig(RankConfig):
    """Weights replaced by a rule."""

    pairs: PairRule | None = field(default=None, compare=False)

    @property
    def rule(self) -> PairRule | None:
        """Rule scoring pairs in place of the product."""
        return self.pairs

    @property
    def true_scores(self) -> tuple[float, float]:
        return super().true_scores if self.pairs is None else self.pairs.true_scores

    def of(self, ids: Sequence[int], same: np.ndarray | None = None) -> RuledConfig:
        """Config for a list of objects with these ids, some identical ((N, N) bool)."""
        rule = self.pairs if self.pairs is None or same is None else self.pairs.among(ids, same)
        return replace(self, pairs=None if rule is None else replace(rule, ids=np.array(ids, np.int64)))


def line_rule(run: RunRules, header: Header, line: Prediction) -> PairRule | None:
    """Rule of a line; None for the header's product agreeing with the answer."""
    known, model = PairRule({}), run.shown and partial(_shown, run.shown)
    if header.ranking == "product":
        known, model = replace(known, own_scores=False), partial(_product, header)
    else:
        known = replace(known, true_scores=run.true_scores)
        if run.shown is not None:
            known = replace(known, unit=run.shown.unit, scale=run.shown.scale)
    if not line.ranked:
        # Of one that had nothing to rank it is known how it would have been.
        return replace(known, **_unranked(header, line), model=model if line.relations is not None else None)
    factors, first = factors_of(line), line.answer
    scores = _pair_scores(header, line, factors)
    # Of a sentence of more than two names no factors are known, and so nothing of what another truth would score.
    rule = replace(known, factors=factors, model=model if factors else None, first=first)
    of_three = any(len(row) > 3 for rows in (line.relations or {}).values() for row in rows)
    if header.ranking == "pair_scores" and not (of_three and first):
        return replace(rule, given=_unscored_last(scores, factors), scored=True)
    if first is None:
        return None
    if of_three or 1.0 not in scores.values():
        return replace(rule, **_unranked(header, line), model=None, own_scores=True, first=None)
    if rule.model is None:
        return replace(rule, given=scores, first=None)
    # Of the answer it is known that it stands above all others, and no more.
    scores = rule.model(np.array(list(factors), np.int64), np.array(list(factors.values()))).tolist()
    return replace(rule, given=dict(zip(factors, scores, strict=True)))


def _unscored_last(scores: dict[Pair, float], factors: Factors) -> dict[Pair, float]:
    """Scores with unranked pairs of known factors below all ranked ones."""
    if not scores or factors.keys() <= scores.keys():
        return scores
    least = min(scores.values())
    return {**dict.fromkeys(factors, least - STEP * (abs(least) or 1.0)), **scores}


def _answers(answer: PredictedAnswer, pair: Pair) -> bool:
    """True for an answer meaning a pair."""
    return pair[0] == answer.object and (answer.reference is None or pair[1] in (-1, answer.reference))


def _answered_first(answer: PredictedAnswer, scores: dict[Pair, float], ahead: float) -> dict[Pair, float]:
    """Scores with the answer first: its best pair raised over a tie, and by `ahead` from below others. Only the system
    knows the answered one of equal pairs."""
    own = [pair for pair in scores if _answers(answer, pair)]
    others = [s for p, s in scores.items() if p not in own]
    if not others:
        return scores
    require(
        own,
        "target and reference of the answer are one thing by the header, and so no pair",
        got=f"{answer.object}, {answer.reference}",
        expected='another answer, or "same": "ids"',
    )
    first, best = max(own, key=scores.__getitem__), max(others)
    over = STEP * max(1.0, abs(best))
    if scores[first] > best + over:
        return scores
    return {**scores, first: best + over + (ahead if scores[first] < best - over else 0.0)}


def outranked(header: Header, line: Prediction) -> bool:
    """True for an answered pair that the product of the header puts below another one."""
    factors, answer = factors_of(line), line.answer
    if answer is None or not factors:
        return False
    scores = _product(header, np.array(list(factors)), np.array(list(factors.values())))
    own = [s for pair, s in zip(factors, scores, strict=True) if _answers(answer, pair)]
    return bool(own) and max(own) < scores.max() - STEP * max(1.0, abs(scores.max()))


def _product(header: Header, ids: np.ndarray, factors: np.ndarray) -> np.ndarray:
    least = np.array([MIN_SCORE, MIN_SCORE, MIN_RELATION])
    logs = np.log(np.clip(factors, least, [1 - MIN_SCORE, 1 - MIN_SCORE, np.inf]))
    w = header.weights
    return logs @ np.array([w.target, w.reference, w.relation])


def _shown(shown: FittedRanking, ids: np.ndarray, factors: np.ndarray) -> np.ndarray:
    pairs = ids.reshape(-1, 2)
    return shown.sums(factors.reshape(-1, len(pairs), 3), pairs).reshape(factors.shape[:-1])


def _unranked(header: Header, line: Prediction) -> dict[str, Any]:
    """Rule of a line without a known ranking: its answer, above all else."""
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
    return {"given": found, "answered": words}
