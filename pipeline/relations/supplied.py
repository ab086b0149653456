"""Relation probabilities given by arrays or a file, never computed anew."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.features import Appearance
from pipeline.relations.scorer import Beyond, RelationScorer, RelationScores
from pipeline.system.errors import InputError, require

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
