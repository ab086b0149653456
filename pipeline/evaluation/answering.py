"""Answering many expressions of one frame: detections, lifting and relations once, then a ranking for each.

The winner is that of `pipeline.ranking.rank`; only what is shared between the
expressions of a frame is computed once.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.ask import Trace, merged, propose
from pipeline.errors import InputError
from pipeline.evaluation.stage_clock import StageClock
from pipeline.jobs import Source
from pipeline.objects import FrameContext, SceneObject, same_object
from pipeline.proposals.base import Proposals
from pipeline.ranking import MIN_RELATION, MIN_SCORE, TIE, Candidates
from pipeline.relations import PAIRWISE
from pipeline.srm.scorer import RelationScores


@dataclass(frozen=True)
class Pair:
    """A target and a reference among the candidates, with the factors of their score.

    Attributes
    ----------
    target, reference : int
        Places in the frame's objects as detected.
    p_target, p_reference, p_relation : float
    log_score : float
        S of the ranking.
    """

    target: int
    reference: int
    p_target: float
    p_reference: float
    p_relation: float
    log_score: float


@dataclass(frozen=True)
class Scored:
    """All candidate pairs of one expression.

    Attributes
    ----------
    targets, references : Candidates
    p_relation, log_score : (T, R) float64
        -inf where the two are one thing.
    """

    targets: Candidates
    references: Candidates
    p_relation: np.ndarray
    log_score: np.ndarray

    def pair(self, i: int, j: int) -> Pair:
        """Candidate target i with candidate reference j."""
        return Pair(
            int(self.targets.index[i]),
            int(self.references.index[j]),
            float(self.targets.scores[i]),
            float(self.references.scores[j]),
            float(self.p_relation[i, j]),
            float(self.log_score[i, j]),
        )


class FrameAnswers:
    """A frame with everything detected in it for a set of class names.

    Parameters
    ----------
    source : Source
    context : FrameContext
    names : sequence of str
        All class names that will be asked for.
    relations : collection of str
        All relations that will be.
    clock : StageClock, optional
        Is told what each stage took.

    Attributes
    ----------
    objects : tuple of SceneObject
    candidates : dict of str to Candidates
        A name that the detector does not know has none.
    unknown : dict of str to str
        Names that the detector refused, and why.
    """

    def __init__(
        self,
        source: Source,
        context: FrameContext,
        names: Sequence[str],
        relations: Collection[str] = PAIRWISE,
        clock: StageClock | None = None,
    ) -> None:
        detector = source.needed_detector()
        unknown: dict[str, str] = {}
        found: dict[str, Proposals] = {}
        self.clock = clock or StageClock()
        with self.clock.stage("opm"):
            for name in names:
                try:
                    found[name] = propose(context, detector, name, source.config.k)
                except InputError as error:
                    unknown[name] = str(error)
        calibration = None if detector.exact else source.config.score_calibration
        with self.clock.stage("lift"):
            objects, candidates = merged(context, detector, found, calibration)
        with self.clock.stage("srm"):
            scores = source.score(context, objects, relations) if objects else None
        nothing = Candidates(np.zeros(0, np.int64), np.zeros(0))
        named = {name: candidates.get(name, nothing) for name in names}
        self._set(source, context, objects, named, scores, unknown)

    def _set(
        self,
        source: Source,
        context: FrameContext,
        objects: tuple[SceneObject, ...],
        candidates: dict[str, Candidates],
        scores: RelationScores | None,
        unknown: dict[str, str],
    ) -> None:
        self.source, self.context, self.objects, self.candidates = source, context, objects, candidates
        self.unknown = unknown
        self.boxes = np.array([o.bbox for o in objects], np.float64).reshape(-1, 4)
        self.mask_sizes = np.array([o.lifted.quality.mask_pixels for o in objects], np.int64)
        with self.clock.stage("rank"):
            self.same = same_object(objects, source.needed_detector().exact)
        self._scores = scores

    @classmethod
    def of_trace(cls, source: Source, context: FrameContext, trace: Trace) -> FrameAnswers:
        """The answers that a trace holds: its own objects, candidates and relations, edited or not."""
        found = cls.__new__(cls)
        found.clock = StageClock()
        found._set(source, context, trace.objects, dict(trace.candidates), trace.scores, {})
        return found

    def probabilities(self, relation: str) -> np.ndarray | None:
        """(D, D) float64: P("a RELATION b") of all detections; None where nothing was detected."""
        return None if self._scores is None else self._scores.of(relation)

    def score(self, target: str, relation: str, reference: str) -> Scored | None:
        """All candidate pairs of an expression; None where a class was not found."""
        targets, references = self.candidates[target], self.candidates[reference]
        if self._scores is None or not len(targets.index) or not len(references.index):
            return None
        config = self.source.config.rank
        p = self._scores.of(relation)[np.ix_(targets.index, references.index)]
        own, other = (np.log(np.clip(c.scores, MIN_SCORE, 1 - MIN_SCORE)) for c in (targets, references))
        # In the order in which the ranking adds them, so that S is the same to the last bit.
        relation_and_reference = (
            config.relation_weight * np.log(np.maximum(p, MIN_RELATION)) + config.reference_weight * other[None, :]
        )
        log_score = config.target_weight * own[:, None] + relation_and_reference
        log_score[self.same[np.ix_(targets.index, references.index)]] = -np.inf
        return Scored(targets, references, p, log_score)

    def best(self, scored: Scored, allowed: np.ndarray | None = None) -> tuple[int, int] | None:
        """The first pair by the ranking's order; of the allowed ones ((T, R) bool) where they are given."""
        score = scored.log_score if allowed is None else np.where(allowed, scored.log_score, -np.inf)
        top = score.max(initial=-np.inf)
        if not np.isfinite(top):
            return None
        # Scores within the rounding of a tie of the winner compete by the tie rules.
        i, j = np.nonzero(np.round(score / TIE) >= np.round(top / TIE))
        if len(i) > 1:
            targets, references = scored.targets.index[i], scored.references.index[j]
            keys = (references, targets, -self.mask_sizes[targets], -scored.targets.scores[i], -scored.p_relation[i, j])
            first = np.lexsort(keys)[0]
            i, j = i[first : first + 1], j[first : first + 1]
        return int(i[0]), int(j[0])


def alone(candidates: Candidates) -> int | None:
    """The best target without any relation (OPM only), as a place in the frame's objects."""
    return int(candidates.index[int(np.argmax(candidates.scores))]) if len(candidates.index) else None
