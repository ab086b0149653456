"""Batch of expressions on a frame: detections, lifting and relations once, then a ranking for each.

The winner is that of `pipeline.answering.ranking.rank`; only what is shared between the
expressions of a frame is computed once.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from time import process_time

import numpy as np

from pipeline.answering.ask import Trace, joined, propose
from pipeline.answering.objects import PreparedFrame, SceneObject, same_object
from pipeline.answering.pair_table import PairTable, one_object_twice, pair_table, side
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.ranking import Candidates
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.base import Proposals, is_final, told_by_ids
from pipeline.relations.scorer import RelationScores
from pipeline.system.errors import InputError


class FrameAnswers:
    """Frame with all detections for a set of class names.

    `names`: all class names that will be asked for; `relations`: all relations that will be; `clock`: is told what each
    stage took; `candidates`: A name that the detector does not know has none; `unknown`: names that the detector
    refused, and why.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        context: PreparedFrame,
        names: Sequence[str],
        relations: Collection[str] = PAIRWISE,
        clock: StageClock | None = None,
    ) -> None:
        detector = pipeline.needed_detector()
        unknown: dict[str, str] = {}
        found: dict[str, Proposals] = {}
        self.clock = clock or StageClock()
        with self.clock.stage("opm"):
            for name in names:
                try:
                    found[name] = propose(context, detector, name, pipeline.config.k)
                except InputError as error:
                    unknown[name] = str(error)
        calibration = None if is_final(detector) else pipeline.config.score_calibration
        with self.clock.stage("lift"):
            objects, candidates = joined({n: (p, context.lift(p, detector)) for n, p in found.items()}, calibration)
        with self.clock.stage("srm"):
            scores = pipeline.score(context, objects, relations) if objects else None
        nothing = Candidates(np.zeros(0, np.int64), np.zeros(0))
        named = {name: candidates.get(name, nothing) for name in names}
        self._set(pipeline, context, objects, named, scores, unknown)

    def _set(
        self,
        pipeline: Pipeline,
        context: PreparedFrame,
        objects: tuple[SceneObject, ...],
        candidates: dict[str, Candidates],
        scores: RelationScores | None,
        unknown: dict[str, str],
    ) -> None:
        with self.clock.stage("rank"):
            self.same = same_object(objects, told_by_ids(pipeline.needed_detector()))
        rank = pipeline.config.rank.of([o.id for o in objects], self.same)
        if rank is not pipeline.config.rank:
            pipeline = replace(pipeline, config=replace(pipeline.config, rank=rank))
        self.source, self.context, self.objects, self.candidates = pipeline, context, objects, candidates
        self.unknown = unknown
        self.boxes = np.array([o.bbox for o in objects], np.float64).reshape(-1, 4)
        self.mask_sizes = np.array([o.lifted.quality.mask_pixels for o in objects], np.int64)
        self._scores = scores

    @classmethod
    def of_trace(cls, pipeline: Pipeline, context: PreparedFrame, trace: Trace) -> FrameAnswers:
        """Answers of a trace: its own objects, candidates and relations, edited or not."""
        found = cls.__new__(cls)
        found.clock = StageClock()
        found._set(pipeline, context, trace.objects, dict(trace.candidates), trace.scores, {})
        return found

    def probabilities(self, relation: str) -> np.ndarray | None:
        """(D, D) float64: P("a RELATION b") of all detections; None without detections."""
        return None if self._scores is None else self._scores.of(relation)

    def worked_out(self, relation: str, a: int, b: int) -> bool:
        """True for P("a RELATION b") missing in the file of the answers."""
        return self._scores is not None and relation in self._scores.worked_out(a, b)

    def score(self, target: str, relation: str, reference: str) -> PairTable | None:
        """Candidate pairs of an expression; None for a class without detections."""
        targets, references = self.candidates[target], self.candidates[reference]
        if self._scores is None or not len(targets.index) or not len(references.index):
            return None
        config = self.source.config.rank
        indices = targets.index, references.index
        return pair_table(
            side(targets.index, targets.scores, config.target_weight),
            (side(references.index, references.scores, config.reference_weight),),
            self._scores.of(relation)[indices[0][:, None], indices[1]],
            one_object_twice(indices, self.same),
            self.mask_sizes,
            config,
        )


class StageClock:
    """Processor seconds of this process by stage; an inner stage's time does not count for the outer."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._since = 0.0

    def stage(self, name: str) -> StageClock:
        """Context timed as this stage."""
        # Entered for every expression: a generator's context would cost several times as much.
        self._settle()
        self._running.append(name)
        return self

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None:
        self._settle()
        self._running.pop()

    def _settle(self) -> None:
        now = process_time()
        if self._running:
            name = self._running[-1]
            self.seconds[name] = self.seconds.get(name, 0.0) + now - self._since
        self._since = now
