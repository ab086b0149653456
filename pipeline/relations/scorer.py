"""SRM: relation scorers. The rule scorer is the first; a trained network has the same interface.

Relations by rule that involve more than two objects, closest, farthest and between, stand here too.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import DIRECTIONAL, PAIRWISE
from pipeline.relations.features import Appearance
from pipeline.relations.relations import PROFILE, F, Indices, T, U, judged_relations, measure_pairs, pairwise_states
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

RULE_PROBABILITY = {1: 0.95, 0: 0.50, -1: 0.05}
"""T, U and F as probabilities."""
Beyond = Mapping[str, Mapping[tuple[int, ...], float]]
"""Of closest, farthest and between what is given: (candidate, reference ...) -> probability, by objects' numbers."""


@dataclass(frozen=True)
class RelationScores:
    """Probabilities of every relation of every ordered pair of a list of objects.

    >>> states = np.array([[[0], [1]], [[-1], [0]]], np.int8)
    >>> scores = RelationScores(("left",), states, np.where(states > 0, 0.9, 0.1), {"left": "mine"})
    >>> scores, float(scores.of("left")[0, 1])
    (<RelationScores of 2 objects: left>, 0.9)
    """

    relations: tuple[str, ...]  # Names, in the order of R
    states: np.ndarray  # (N, N, R) int8: the rule's verdicts: 1 T, 0 U, -1 F
    probabilities: np.ndarray  # (N, N, R) float64: P("a RELATION b") at [a, b]
    scored_by: dict[str, str]  # Relation -> name of what scored it ("rule" where no network has a head for it)
    beyond: Beyond = field(default_factory=dict)
    # (N, N, R) bool: which of the probabilities are as they were given, of a file or of arrays; the others are worked
    # out in their place. None where nothing is given.
    given: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"<RelationScores of {len(self.probabilities)} objects: {', '.join(self.relations)}>"

    def of(self, relation: str) -> np.ndarray:
        """(N, N) probabilities of a relation."""
        return self.probabilities[..., self.relations.index(relation)]

    def worked_out(self, a: int, b: int) -> tuple[str, ...]:
        """Relations with P("a RELATION b") computed here and not given; none where nothing is given at all."""
        if self.given is None:
            return ()
        return tuple(r for r, told in zip(self.relations, self.given[a, b], strict=True) if not told)


class RelationScorer(Protocol):
    """Scorer of each relation of each ordered pair.

    >>> class Always:
    ...     name = "always"
    ...
    ...     def score(self, objects, viewer, appearance=None, relations=PAIRWISE):
    ...         shape = (len(objects), len(objects), len(relations))
    ...         by = dict.fromkeys(relations, self.name)
    ...         return RelationScores(tuple(relations), np.ones(shape, np.int8), np.ones(shape), by)
    >>> scorer: RelationScorer = Always()
    >>> scorer.score([], None).of("left").shape
    (0, 0)
    """

    @property
    def name(self) -> str: ...

    def score(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        relations: Collection[str] = PAIRWISE,
    ) -> RelationScores:
        """Scores of all ordered pairs; InputError where a needed appearance is missing.

        Only `relations` need be scored: on, in and near look at all points, and cost the most.
        """
        ...


@dataclass(frozen=True)
class RuleScorer:
    """Geometric rule profile, T .95, U .5, F .05."""

    profile: str = PROFILE

    name = "rule"

    def score(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        relations: Collection[str] = PAIRWISE,
    ) -> RelationScores:
        lo, hi = stacked_extents(objects)
        axes, names = viewer.matrix.T.astype(np.float32), judged_relations(relations)
        clouds = None if names == DIRECTIONAL else [o.points @ axes for o in objects]
        states = pairwise_states(lo, hi, clouds, relations=relations)
        return RelationScores(names, states, rule_probabilities(states), dict.fromkeys(names, self.name))


def rule_probabilities(states: np.ndarray) -> np.ndarray:
    """States as probabilities, same shape, float64.

    >>> import numpy as np
    >>> rule_probabilities(np.array([1, 0, -1])).tolist()
    [0.95, 0.5, 0.05]
    """
    return np.array([RULE_PROBABILITY[-1], RULE_PROBABILITY[0], RULE_PROBABILITY[1]])[states.astype(np.int64) + 1]


def stacked_extents(objects: Sequence[LiftedObject]) -> tuple[np.ndarray, np.ndarray]:
    """lo and hi of all objects, each (N, 3) float64."""
    return np.array([o.lo for o in objects]).reshape(-1, 3), np.array([o.hi for o in objects]).reshape(-1, 3)


BEYOND_PAIRS = ("closest", "farthest", "between")


def probabilities_beyond(
    relation: str,
    objects: Sequence[LiftedObject],
    heads: Indices,
    ends: Sequence[Indices],
    same: np.ndarray | None = None,
    given: Mapping[tuple[int, ...], float] | None = None,
    ids: Sequence[int] = (),
) -> np.ndarray:
    """closest and farthest (C, R), or between (C, A, B): `given` for these `ids`, else by rule."""
    lo, hi = stacked_extents(objects)
    if relation == "between":
        states = between_states(lo, hi, heads, ends[0], ends[1])
    else:
        states = superlative_states(lo, hi, heads, ends[0], farthest=relation == "farthest", same=same)
    found = rule_probabilities(states)
    if given:
        places = [{ids[k]: at for at, k in enumerate(side)} for side in (heads, *ends)]
        for row, p in given.items():
            at = tuple(place.get(i) for place, i in zip(places, row, strict=False))
            if None not in at and len(at) == found.ndim:
                found[at] = p
    return found


def distances(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """(N, N) float64: metres between the extents of every two objects, 0 for an overlap."""
    return np.linalg.norm(measure_pairs(lo, hi).gap, axis=2)


RANK_MARGIN = 0.03


def superlative_states(
    lo: np.ndarray,
    hi: np.ndarray,
    candidates: Indices,
    references: Indices,
    farthest: bool = False,
    same: np.ndarray | None = None,
) -> np.ndarray:
    """closest or farthest: candidates at the end of the row, seen from each reference.

    `candidates`, `references`: objects that compete, and objects they are measured from; `same`: (N, N) bool: entries
    that are one and the same thing; by default each is only itself. Returns (C, R) int8: T for the nearest (farthest)
    candidate, U for those within 3 cm of it, F for the rest; an object is no candidate for itself.
    """
    away = distances(lo, hi)[np.ix_(list(candidates), list(references))]
    centers = (lo + hi) / 2
    apart = np.linalg.norm(centers[list(candidates)][:, None] - centers[list(references)][None], axis=2)
    # Objects that touch the reference all have a gap of 0; centres decide among them.
    measure = np.where(np.isfinite(away), away + 1e-3 * apart, np.nan)
    if farthest:
        measure = -measure
    itself = np.eye(len(lo), dtype=np.bool_) if same is None else same
    measure = np.where(itself[np.ix_(list(candidates), list(references))] | np.isnan(measure), np.inf, measure)
    best = measure.min(axis=0, keepdims=True) if len(measure) else measure
    state = np.where(measure <= best + RANK_MARGIN, U, F)
    # Rounding must not decide between two that are equally far.
    state[measure <= best + 1e-9] = T
    state[~np.isfinite(measure)] = F
    return state.astype(np.int8)


def between_states(lo: np.ndarray, hi: np.ndarray, candidates: Indices, first: Indices, second: Indices) -> np.ndarray:
    """between: the candidate's centre in the corridor from one object to another, in plan.

    T where the centre projects onto the middle 70 % of the line between the two
    centres and lies within a quarter of its length of it; U up to the whole line and half its length.

    Returns (C, A, B) int8.
    """
    plan = ((lo + hi) / 2)[:, [0, 2]]
    p, a, b = plan[list(candidates)][:, None, None], plan[list(first)][None, :, None], plan[list(second)][None, None]
    line = b - a
    length = np.linalg.norm(line, axis=-1)
    safe = np.maximum(length, 1e-9)
    along = ((p - a) * line).sum(axis=-1) / safe**2
    aside = np.linalg.norm((p - a) - along[..., None] * line, axis=-1) / safe
    off_middle = np.abs(along - 0.5)
    holds, undecided = (off_middle <= 0.35) & (aside <= 0.25), (off_middle <= 0.5) & (aside <= 0.5)
    state = np.where(holds, T, np.where(undecided, U, F))
    c, i, j = np.asarray(candidates)[:, None, None], np.asarray(first)[None, :, None], np.asarray(second)[None, None]
    state[np.broadcast_to((c == i) | (c == j) | (i == j) | (length < 1e-6), state.shape)] = F
    return state.astype(np.int8)


Rows = Iterable[Sequence[float]]
"""[a, b, p]: P("a RELATION b") of two objects by their numbers."""


@dataclass(frozen=True)
class SuppliedRelations:
    """Relation scorer of given probabilities."""

    relations: Mapping[str, Rows]  # By relation; see `supplied_relations`
    stand_in: RelationScorer  # Scores what is not given
    name: str = "given"  # Who gave them
    asked_again: bool = True  # The stand-in is what made them, and may be asked of other geometry

    def score(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        relations: Collection[str] = PAIRWISE,
    ) -> RelationScores:
        found = self.stand_in.score(objects, viewer, appearance, relations)
        if appearance is None or not appearance.ids:
            return found
        # A thing that was asked for under two names stands in the list twice.
        places: dict[int, list[int]] = {}
        for k, i in enumerate(appearance.ids):
            places.setdefault(i, []).append(k)
        probabilities, scored_by = found.probabilities.copy(), dict(found.scored_by)
        given = np.zeros(probabilities.shape, np.bool_)
        for relation in self.relations.keys() & set(found.relations):
            r = found.relations.index(relation)
            scored_by[relation] = self.name
            for a, b, *_, p in self.relations[relation]:
                pairs = *np.ix_(places.get(int(a), []), places.get(int(b), [])), r
                probabilities[pairs], given[pairs] = p, True
        return replace(found, probabilities=probabilities, scored_by=scored_by, beyond=self.beyond, given=given)

    @cached_property
    def beyond(self) -> Beyond:
        """Given probabilities of relations among more than two objects."""
        others = {relation: self.relations[relation] for relation in self.relations if relation not in PAIRWISE}
        return {relation: {tuple(map(int, row[:-1])): row[-1] for row in rows} for relation, rows in others.items()}


def supplied_relations(
    relations: Mapping[str, np.ndarray | Mapping[tuple[int, int], float]], count: int, rest: RelationScorer
) -> SuppliedRelations:
    """Relation scorer of given probabilities.

    `relations`: by relation P("a RELATION b"), 0..1: (N, N) float, NaN for unknown, or {(a, b): p}; `count`: N, the
    number of objects.
    """
    rows: dict[str, Rows] = {}
    for relation, told in relations.items():
        require(relation in PAIRWISE, "no such relation", got=repr(relation), expected=f"one of {', '.join(PAIRWISE)}")
        if isinstance(told, Mapping):
            found = [(*pair, p) for pair, p in told.items()]
        else:
            table = np.asarray(told, np.float64)
            shape = f"relation {relation!r}: probabilities of {count} objects must be ({count}, {count})"
            require(table.shape == (count, count), shape, got=table.shape)
            found = [(a, b, table[a, b]) for a, b in np.argwhere(np.isfinite(table)).tolist() if a != b]
        for row in found:
            if len(row) != 3 or not all(0 <= k < count for k in row[:2]) or not 0 <= row[2] <= 1:
                expected = f"two objects of 0 to {count - 1}, and a probability of 0 to 1"
                raise InputError(f"relation {relation!r}: no such row", got=row, expected=expected)
        rows[relation] = found
    return SuppliedRelations(rows, rest)
