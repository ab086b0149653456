"""An answer under edits beside the one without: what each number was before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif import Outcome

_Names = tuple[str | None, ...]


@dataclass(frozen=True)
class Edited:
    """Both answers.

    Attributes
    ----------
    before, after : Outcome
    judged : Diagnosis or str or None
        The verdict on the one before.
    seconds : float
        What answering again took the core.
    """

    before: Outcome
    after: Outcome
    judged: Diagnosis | str | None
    seconds: float

    def rank_before(self, pair: ScoredPair) -> int | None:
        """The place that a pair of the answer had, from 1; None where it was no candidate."""
        found = self._ranked.get(_named(self.after, pair))
        return None if found is None else found[0]

    def pair_before(self, pair: ScoredPair) -> ScoredPair | None:
        """A pair of the answer as it was."""
        found = self._ranked.get(_named(self.after, pair))
        return None if found is None else found[1]

    def relation_before(self, a: int, b: int, relation: str) -> float | None:
        """P("a RELATION b") as it was, for places in the objects of the answer."""
        places = [self._places.get(self.after.keys[i]) for i in (a, b)]
        scores = self.before.trace.scores
        if None in places or relation not in scores.relations:
            return None
        return float(scores.of(relation)[places[0], places[1]])

    @cached_property
    def _ranked(self) -> dict[_Names, tuple[int, ScoredPair]]:
        ranking = self.before.trace.ranking
        pairs = () if ranking is None else ranking.pairs
        return {_named(self.before, pair): (at, pair) for at, pair in enumerate(pairs, start=1)}

    @cached_property
    def _places(self) -> dict[str, int]:
        return {key: at for at, key in enumerate(self.before.keys)}


def _named(outcome: Outcome, pair: ScoredPair) -> _Names:
    ends = (pair.target, pair.reference, pair.second_reference)
    return tuple(None if i is None else outcome.keys[i] for i in ends)
