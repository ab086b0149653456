"""SRM: what scores relations. The rule scorer is the first; a trained network has the same interface."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import DIRECTIONAL, PAIRWISE
from pipeline.relations.arrangement import between_states, superlative_states
from pipeline.relations.features import Appearance
from pipeline.relations.relations import PROFILE, Indices, judged_relations, pairwise_states

RULE_PROBABILITY = {1: 0.95, 0: 0.50, -1: 0.05}
"""T, U and F as probabilities."""


@dataclass(frozen=True)
class RelationScores:
    """Every relation of every ordered pair of a list of objects.

    Attributes
    ----------
    relations : tuple of str
    states : (N, N, R) int8
        The rule's verdicts: 1 T, 0 U, -1 F.
    probabilities : (N, N, R) float64
        P("a RELATION b") at [a, b].
    scored_by : dict
        Relation -> name of what scored it ("rule" where no network has a head for it).
    """

    relations: tuple[str, ...]
    states: np.ndarray
    probabilities: np.ndarray
    scored_by: dict[str, str]

    def __repr__(self) -> str:
        return f"<RelationScores of {len(self.probabilities)} objects: {', '.join(self.relations)}>"

    def of(self, relation: str) -> np.ndarray:
        """(N, N) probabilities of one relation."""
        return self.probabilities[..., self.relations.index(relation)]


class RelationScorer(Protocol):
    """Gives each relation of each ordered pair a probability."""

    @property
    def name(self) -> str: ...

    def score(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        relations: Collection[str] = PAIRWISE,
    ) -> RelationScores:
        """The scores of all ordered pairs; InputError where the scorer needs the appearance and has none.

        Only `relations` need be scored: on, in and near look at all points, and cost the most.
        """
        ...


@dataclass(frozen=True)
class RuleScorer:
    """The geometric rule profile, T .95, U .5, F .05."""

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
    """States as probabilities, same shape, float64."""
    return np.array([RULE_PROBABILITY[-1], RULE_PROBABILITY[0], RULE_PROBABILITY[1]])[states.astype(np.int64) + 1]


def stacked_extents(objects: Sequence[LiftedObject]) -> tuple[np.ndarray, np.ndarray]:
    """lo and hi of all objects, each (N, 3) float64."""
    if not objects:
        return np.zeros((0, 3)), np.zeros((0, 3))
    return np.stack([o.lo for o in objects]), np.stack([o.hi for o in objects])


def superlative_probabilities(
    objects: Sequence[LiftedObject],
    relation: str,
    candidates: Indices,
    references: Indices,
    same: np.ndarray | None = None,
) -> np.ndarray:
    """(C, R) probabilities of "candidate closest to / farthest from reference"; always by rule."""
    lo, hi = stacked_extents(objects)
    return rule_probabilities(
        superlative_states(lo, hi, candidates, references, farthest=relation == "farthest", same=same)
    )


def between_probabilities(
    objects: Sequence[LiftedObject], candidates: Indices, first: Indices, second: Indices
) -> np.ndarray:
    """(C, A, B) probabilities of "candidate between a and b"; always by rule."""
    lo, hi = stacked_extents(objects)
    return rule_probabilities(between_states(lo, hi, candidates, first, second))
