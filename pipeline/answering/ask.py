"""Ask a frame: an expression through all four stages, keeping every intermediate result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from time import perf_counter

import numpy as np

from pipeline.answering.detector_prompts import detections
from pipeline.answering.evidence import SceneEvidence
from pipeline.answering.objects import PreparedFrame, SceneObject, appearance_of, same_object
from pipeline.answering.pair_table import TIE, ScoredPair
from pipeline.answering.ranking import Candidates, RankConfig, Ranking, RelationLookup, rank
from pipeline.geometry.cleaning import LiftConfig
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.expression import Reader, parse
from pipeline.language.lexicon import wording
from pipeline.language.naming import Synonyms
from pipeline.language.tree import Attachment, Node, Query
from pipeline.proposals.base import Detector, Proposals, is_final, told_by_ids, top_k
from pipeline.proposals.score_calibration import ScoreCalibration
from pipeline.relations.scorer import (
    BEYOND_PAIRS,
    RelationScorer,
    RelationScores,
    RuleScorer,
    probabilities_beyond,
)
from pipeline.system.errors import Unsupported, require
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class AskConfig:
    """Settings of an answer."""

    k: int = 10  # Proposals that go on for each name; a detector whose detections are the truth is not cut
    lift: LiftConfig = field(default_factory=LiftConfig)
    rank: RankConfig = field(default_factory=RankConfig)
    relations: tuple[str, ...] | None = None  # What the expression may use; None for everything the scorer knows
    # Makes P(x | name) of the scores of a detector that is not exact; the objects keep their raw scores
    score_calibration: ScoreCalibration | None = None

    def __post_init__(self) -> None:
        require(self.k >= 1, "at least one proposal must go on for each name", got=f"k={self.k}")


@dataclass(frozen=True)
class Trace:
    """Trace of a question: every stage's input and output."""

    frame: Frame  # With the up vector that was used
    viewer: ViewerAxes
    query: Query  # The parsed expression with all its readings
    objects: tuple[SceneObject, ...]  # All proposals of all names, lifted; each thing once
    candidates: dict[str, Candidates]  # Class name as asked -> places in `objects` and scores
    scores: RelationScores
    # Seconds by stage: parse, frame (up vector and depth edges, once for a frame), opm, lift, srm, prm; and masks, what
    # a segmenter took where it was run
    timings: dict[str, float]
    detector: str
    scorer: str
    exact: bool  # The objects are the dataset's own
    # What made the candidates' scores of the detector's; None where they are its own
    score_calibration: ScoreCalibration | None = None
    ranking: Ranking | None = None  # None where a class was not found
    # The answer in words where it was given elsewhere without what ranked it: then the first pair is it, if it is one
    # of the objects, and numbers of the pairs are no part of it
    answered: str | None = None
    own_scores: bool = False  # An imported ranking that is not the product of the factors
    # by identity the place of a thing among all that the detector finds in the frame, by which it is called; empty
    # where that is not known without looking
    numbers: Mapping[int, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        pairs = 0 if self.ranking is None else len(self.ranking.pairs)
        return f"<Trace {self.query.text!r} on {self.frame.id!r}: {len(self.objects)} objects, {pairs} pairs>"

    def name(self, index: int) -> str:
        """Name of an object in tables: "mug·4"."""
        entry = self.objects[index]
        return entry.name(self.numbers.get(entry.id, index), self.exact)

    def under(self, name: str, index: int) -> SceneObject:
        """Object with its label and score under a name of the question.

        A detector may take the same object for a cup and, less surely, for a bowl.
        """
        found = self.candidates[name]
        at = int(np.flatnonzero(found.index == index)[0])
        label = found.labels[at] if found.labels else self.objects[index].label
        return replace(self.objects[index], label=label, score=float(found.detector_scores[at]))

    def names_in(self, pair: ScoredPair) -> dict[int, str]:
        """Names of the question for the objects of a pair, by place in `objects`."""
        found = {pair.target: self.root.label}
        for link in pair.links:
            for place, name in zip((link.b, link.c), link.names, strict=False):
                if place is not None:
                    found.setdefault(place, name)
        return found

    @property
    def missing(self) -> tuple[str, ...]:
        """Class names that were not found, among the required ones."""
        return tuple(name for name in self.query.needed if not len(self.candidates[name].index))

    @property
    def root(self) -> Node:
        """Target with its whole description, in the chosen reading."""
        return (self.query.default if self.ranking is None else self.ranking.reading).root

    @property
    def asked(self) -> Attachment | None:
        """Target's first relation to another object, that of the ranked pairs; None without a relation."""
        return self.root.pairwise

    @property
    def relation(self) -> str:
        """Canonical name of the ranked relation; empty without one."""
        return "" if self.asked is None else self.asked.relation

    @property
    def inverse(self) -> bool:
        """True for a relation held from the reference to the target."""
        return self.asked is not None and self.asked.inverse

    @property
    def phrase(self) -> str:
        """Words of the ranked relation between two nouns; empty without one."""
        return "" if self.asked is None else wording(self.asked.relation, inverse=self.asked.inverse)

    @property
    def tied(self) -> tuple[int, ...]:
        """Places of the objects equally fit for a question without a relation, if several fit."""
        if self.ranking is None or self.asked is not None:
            return ()
        best, *others = self.ranking.pairs
        alike = [p.target for p in others if best.log_score - p.log_score < TIE] if best.holds else []
        return (best.target, *alike) if alike else ()


def ask(
    frame: Frame | PreparedFrame,
    text: str,
    detector: Detector,
    *,
    scorer: RelationScorer | None = None,
    config: AskConfig | None = None,
    class_names: Sequence[str] = (),
    synonyms: Synonyms | None = None,
    reader: Reader = parse,
) -> Trace:
    """Answer an expression such as "mug left of the laptop".

    `frame`: A context keeps what does not depend on the question between calls; `scorer`: the geometric rule where none
    is given; `class_names`: names the parser should keep whole ("front door"); `reader`: what reads the expression; the
    grammar where none is given.

    >>> from pipeline.answering import open_pipeline
    >>> pipeline = open_pipeline("demo")
    >>> trace = ask(pipeline.frames[0], "mug left of the laptop", pipeline.needed_detector())
    >>> [trace.name(k) for k in (trace.ranking.pairs[0].target, trace.ranking.pairs[0].reference)]
    ['mug·3', 'laptop·2']
    """
    config = config or AskConfig()
    scorer = scorer or RuleScorer()
    timings: dict[str, float] = {}
    with timed(timings, "parse"):
        query = reader(
            text,
            class_names=tuple(class_names) or (detector.vocabulary or ()),
            relations=config.relations,
            synonyms=synonyms,
        )
    calibration = None if is_final(detector) else config.score_calibration
    context = frame if isinstance(frame, PreparedFrame) else PreparedFrame(frame, config.lift)
    timings["frame"] = context.seconds
    before = getattr(detector, "seconds", 0.0)
    with timed(timings, "opm"):
        runs, query = detections(context.frame, detector, query, synonyms)
        found = {name: of_run(run, detector, config.k) for name, run in runs.items()}
    masks = getattr(detector, "seconds", 0.0) - before
    if masks:
        timings |= {"opm": timings["opm"] - masks, "masks": masks}
    with timed(timings, "lift"):
        objects, candidates = joined({n: (p, context.lift(p, detector)) for n, p in found.items()}, calibration)
    with timed(timings, "srm"):
        scores = scorer.score([o.lifted for o in objects], context.viewer, appearance_of(objects, context.frame))
    trace = Trace(
        frame=context.frame,
        viewer=context.viewer,
        query=query,
        objects=objects,
        candidates=candidates,
        scores=scores,
        timings=timings,
        detector=detector.name,
        scorer=scorer.name,
        exact=detector.exact,
        numbers=context.numbers(detector),
        score_calibration=calibration,
    )
    return ranked(trace, config.rank, lambda objects: same_object(objects, told_by_ids(detector)))


def ranked(
    trace: Trace,
    config: RankConfig,
    same: Callable[[tuple[SceneObject, ...]], np.ndarray],
    edited: Callable[[RelationLookup], RelationLookup] = lambda lookup: lookup,
) -> Trace:
    """Rank a trace; without candidates of a class unchanged.

    `same`: gives (N, N) bool, which of the objects are one and the same thing; `edited`: changes the relation
    probabilities that the ranking asks for.
    """
    rule = config.rule
    if rule is not None:
        trace = replace(trace, answered=rule.answered, own_scores=rule.own_scores)
    if trace.missing or (rule is not None and rule.answered is not None and not rule.given):
        return trace
    with timed(trace.timings, "prm"):
        alike = same(trace.objects)
        lookup = edited(relation_lookup(trace.scores, trace.objects, alike))
        sizes = np.array([o.lifted.quality.mask_pixels for o in trace.objects])
        config = config.of([o.id for o in trace.objects], alike)
        evidence = SceneEvidence(trace.objects, trace.frame, trace.viewer)
        ranking = rank(trace.query.readings, trace.candidates, lookup, alike, sizes, config, evidence)
    return replace(trace, ranking=ranking)


@contextmanager
def timed(timings: dict[str, float], stage: str) -> Iterator[None]:
    """Add the seconds of a block to a stage."""
    start = perf_counter()
    yield
    timings[stage] = timings.get(stage, 0.0) + perf_counter() - start


def propose(context: PreparedFrame, detector: Detector, name: str, k: int) -> Proposals:
    """Proposals of a class name: the best K, or all of an exact detector."""
    return of_run(detector.detect(context.frame, [name]), detector, k)


def of_run(proposals: Proposals, detector: Detector, k: int) -> Proposals:
    """Proposals of a whole run: the best K, or all of an exact detector."""
    return proposals if is_final(detector) else top_k(proposals, k)


def joined(
    found: Mapping[str, tuple[Proposals, Sequence[SceneObject]]], calibration: ScoreCalibration | None
) -> tuple[tuple[SceneObject, ...], dict[str, Candidates]]:
    """Join lifted proposals, each name's in their order: each detection once for each of its labels."""
    objects: list[SceneObject] = []
    # By label too: a network that knows names must score a thing as the question calls it, whatever else is asked.
    known: dict[tuple[int, str], int] = {}
    candidates: dict[str, Candidates] = {}
    for name, (proposals, lifted) in found.items():
        index = []
        for entry in lifted:
            key = entry.id, entry.label
            at = known.get(key) if entry.id >= 0 else None
            if at is None:
                at = len(objects)
                objects.append(entry)
                if entry.id >= 0:
                    known[key] = at
            index.append(at)
        labels = tuple(proposals.label(i) for i in range(len(proposals)))
        raw = proposals.scores.astype(np.float64)
        scores = raw if calibration is None else calibration.apply(raw)
        candidates[name] = Candidates(np.array(index, np.int64), scores, labels, raw)
    return tuple(objects), candidates


def relation_lookup(scores: RelationScores, objects: Sequence[SceneObject], same: np.ndarray) -> RelationLookup:
    """Relation probabilities of a list of objects, in the form of the ranking."""
    lifted, ids = [o.lifted for o in objects], [o.id for o in objects]

    def lookup(attachment: Attachment, heads: np.ndarray, ends: Sequence[np.ndarray]) -> np.ndarray:
        relation = attachment.relation
        if relation in BEYOND_PAIRS:
            return probabilities_beyond(relation, lifted, heads, ends, same, scores.beyond.get(relation), ids)
        require(
            relation in scores.relations,
            f"the relation scorer has no {relation!r}",
            expected=", ".join(scores.relations),
            error=Unsupported,
        )
        table = scores.of(relation)
        # "the table holding the lamp" asks for the lamp on the table.
        return table[np.ix_(ends[0], heads)].T if attachment.inverse else table[np.ix_(heads, ends[0])]

    return lookup
