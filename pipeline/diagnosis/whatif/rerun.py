"""Rerun of an answer with edits, computing only the affected parts.

`rerun` gives the trace that the whole pipeline gives with those edits. Kept are
the detector's whole runs, every lifted object, and the relations of all pairs
that were scored; a dragged box costs its own points and the pairs it stands in.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from pipeline.answering.ask import Trace, joined, ranked, timed
from pipeline.answering.detector_prompts import detections
from pipeline.answering.objects import PreparedFrame, SceneObject, same_object
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.ranking import Candidates, RelationLookup
from pipeline.diagnosis.whatif.edits import AddedObject, Edits, PlacedBox
from pipeline.diagnosis.whatif.pair_tables import PairTables, detection_keys, identity, score_pairs
from pipeline.geometry.lifting import LiftedObject, lift
from pipeline.geometry.masks import RunLength, mask_box
from pipeline.language.class_sizes import is_thin
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Attachment
from pipeline.proposals.base import Proposals, is_final, told_by_ids, top_k_indices
from pipeline.relations import make_scorer
from pipeline.relations.relations import Profile
from pipeline.relations.scorer import RelationScorer, RelationScores
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

_T = TypeVar("_T")
PairKeys = tuple[str, str | None, str | None]
_MOST_KEPT, _MOST_TABLES = {"context": 3, "scorer": 3, "selected": 64, "same": 4}, 6
"""What a dragged slider would make without end; of objects so many contexts full are kept."""


@dataclass(frozen=True)
class Outcome:
    """Answer under edits."""

    trace: Trace
    keys: tuple[str, ...]  # Of `trace.objects`, in their order
    pairs_scored: int  # Unordered pairs whose relations were computed for this answer

    def pair_keys(self, pair: ScoredPair) -> PairKeys:
        """Keys of a pair's objects: target, reference, the other end of "between"."""
        reference, second = (None if i is None else self.keys[i] for i in (pair.reference, pair.second_reference))
        return self.keys[pair.target], reference, second

    @property
    def winner(self) -> PairKeys | None:
        """Keys of the best pair; None without an answer."""
        ranking = self.trace.ranking
        return None if ranking is None else self.pair_keys(ranking.pairs[0])

    @cached_property
    def ranked(self) -> dict[PairKeys, tuple[int, ScoredPair]]:
        """Ranked pairs by the keys of their objects, each after its rank, from 1."""
        pairs = () if self.trace.ranking is None else self.trace.ranking.pairs
        return {self.pair_keys(pair): (at, pair) for at, pair in enumerate(pairs, start=1)}


class Baseline:
    """Question about a frame, with every result independent of edits. Safe to use from several threads.

    `text`: the expression; `found`: the detector's whole run for each name, before suppression and K; `keys`: of
    `found`; `outcome`: the answer without edits.
    """

    def __init__(self, pipeline: Pipeline, context: PreparedFrame, text: str) -> None:
        pipeline = pipeline.asked(context.frame.id, text)
        self.source, self.context, self.text = pipeline, context, text
        self.detector = pipeline.needed_detector()
        start = perf_counter()
        self.query = pipeline.read(text)
        read = perf_counter()
        self.found, self.query = detections(context.frame, self.detector, self.query, pipeline.synonyms)
        self.seconds = {"parse": read - start, "opm": perf_counter() - read}
        self.keys = {name: detection_keys(name, found) for name, found in self.found.items()}
        self._lock = RLock()
        self._shelves: defaultdict[str, OrderedDict[Hashable, Any]] = defaultdict(OrderedDict)
        self.tables: dict[tuple[tuple[Any, ...], bool], PairTables] = {}
        self._most_objects = _MOST_KEPT["context"] * max(1, sum(len(keys) for keys in self.keys.values()))
        self.outcome = rerun(self, Edits())

    @property
    def all_keys(self) -> frozenset[str]:
        """Keys of all detections open to edits of this question."""
        return frozenset(key for keys in self.keys.values() for key in keys)

    def made(self, kind: str, slot: Hashable, make: Callable[[], _T], *inputs: Any) -> _T:
        """Value last made in a slot, if of equal inputs; else made anew. Of each kind the oldest is dropped."""
        shelf = self._shelves[kind]
        before = shelf.get(slot)
        if before is None or not all(map(_alike, before[0], inputs)):
            shelf[slot] = inputs, make()
        shelf.move_to_end(slot)
        while len(shelf) > _MOST_KEPT.get(kind, self._most_objects):
            shelf.popitem(last=False)
        return shelf[slot][1]

    def scorer(self, spec: str | None) -> RelationScorer:
        """Relation scorer of an edit; InputError for an unusable scorer."""
        if spec is None:
            return self.source.scorer
        name: str | Path = spec if spec in ("rule", "trained") else Path(spec)
        return self.made("scorer", spec, lambda: make_scorer(name))

    def same(self, objects: tuple[SceneObject, ...]) -> np.ndarray:
        """Pairs of identical objects, by ids, 2D boxes and masks, independent of dragged boxes."""
        marks = tuple((o.id, o.bbox.tobytes(), id(o.mask), o.lifted.quality.mask_source) for o in objects)
        # The objects are kept too, so that the numbers of their masks stay their own.
        exact = told_by_ids(self.detector)
        return self.made("same", len(objects), lambda: (objects, same_object(objects, exact)), marks)[1]


def _alike(a: Any, b: Any) -> bool:
    """True for one input, or equal ones of plain values."""
    return a is b or (isinstance(a, PlacedBox | RunLength | tuple) and a == b)


def foreign_keys(baseline: Baseline, edits: Edits) -> tuple[str, ...]:
    """Edited objects outside the question's detections; their edits have no effect here."""
    added = {key for key, entry in edits.added.items() if entry.name in baseline.found}
    return tuple(sorted(edits.keys - baseline.all_keys - added))


def rerun(baseline: Baseline, edits: Edits) -> Outcome:
    """Answer again with edits.

    With `Edits()` this is `Pipeline.ask`'s own trace; only the timings differ:
    they say what this answer cost, what was kept costs nothing.
    """
    rule = baseline.source.config.rank.rule
    require(
        rule is None or (rule.model is not None and rule.answered is None) or not edits,
        "what edits do to this answer is not known: the predictions do not tell what ranked it, or their scores do not "
        "follow from what they were given for",
        expected="relations (level 3) of docs/predictions.md",
    )
    with baseline._lock:
        return _rerun(baseline, edits)


def _rerun(baseline: Baseline, edits: Edits) -> Outcome:
    config, detector = baseline.source.config, baseline.detector
    context = _context(baseline, edits)
    stages = {"parse": baseline.seconds["parse"], "frame": context.seconds}
    found = {}
    keys: dict[int, str] = {}
    with timed(stages, "opm"):
        indices = {name: _selected(baseline, edits, name) for name in baseline.found}
    calibration = None if is_final(detector) else config.score_calibration
    with timed(stages, "lift"):
        for name, at in indices.items():
            entries = [_edited(baseline, context, edits, name, int(k)) for k in at]
            keys |= {id(entry): baseline.keys[name][k] for entry, k in zip(entries, at.tolist(), strict=True)}
            # Masks are megabytes, and joining looks only at who is who.
            bare = replace(baseline.found[name], masks=None, has_mask=None, segmented=None).take(at)
            for key, new in edits.added.items():
                if new.name == name:
                    entry = _added(baseline, context, edits, key, new)
                    entries, keys[id(entry)], bare = [*entries, entry], key, _joined_by(bare, entry)
            found[name] = bare, entries
        objects, candidates = joined(found, calibration)
        object_keys = tuple(keys[id(o)] for o in objects)
        candidates = _with_confidences(candidates, object_keys, edits)
    scorer = baseline.scorer(edits.scorer)
    with timed(stages, "srm"):
        tables = _tables(baseline, context, edits, scorer, objects)
        scores = _with_relations(tables.scores, object_keys, edits)
    trace = Trace(
        frame=context.frame,
        viewer=context.viewer,
        query=baseline.query,
        objects=objects,
        candidates=candidates,
        scores=scores,
        timings=stages,
        detector=detector.name,
        scorer=scorer.name,
        exact=detector.exact,
        numbers=context.numbers(detector),
        score_calibration=calibration,
    )
    rank_config = replace(config.rank, **edits.rank)
    trace = ranked(trace, rank_config, baseline.same, lambda lookup: with_superlatives(lookup, object_keys, edits))
    return Outcome(trace, object_keys, tables.scored)


def _context(baseline: Baseline, edits: Edits) -> PreparedFrame:
    """Frame under the edited cleaning; the viewer and the pixels stay."""
    config = replace(baseline.context.config, **edits.lift)
    if config == baseline.context.config:
        return baseline.context
    return baseline.made("context", config, lambda: PreparedFrame(baseline.context.frame, config))


def _selected(baseline: Baseline, edits: Edits, name: str) -> np.ndarray:
    """Indices of a name's detections in the whole run after K and suppression."""
    found, keys = baseline.found[name], baseline.keys[name]
    hidden = frozenset(key for key in edits.hidden if key in keys)
    k = edits.k or baseline.source.config.k
    least = edits.min_score or 0.0

    def select() -> np.ndarray:
        shown = np.flatnonzero([key not in hidden for key in keys]).astype(np.int64)
        if is_final(baseline.detector):
            return shown
        bare = replace(found, masks=None, has_mask=None, segmented=None)
        return shown[top_k_indices(bare.take(shown), k, min_score=least)]

    return baseline.made("selected", (name, hidden, k, least), select)


def _edited(baseline: Baseline, context: PreparedFrame, edits: Edits, name: str, at: int) -> SceneObject:
    """Detection in 3D, with the edits of its mask and its box."""
    key = baseline.keys[name][at]
    config = context.config
    mask, box = edits.masks.get(key), edits.boxes.get(key)

    def lifted() -> SceneObject:
        return context.lift(baseline.found[name].take(np.array([at])), baseline.detector)[0]

    entry = baseline.made("lifted", (config, name, at), lifted)
    if mask is not None:
        entry = _repainted(baseline, context, entry, key, mask)
    if box is None:
        return entry
    thing = entry.lifted
    moved = baseline.made("moved", (config, key), lambda: thing.moved_to(box.box(), context.viewer), thing, box)
    return replace(entry, lifted=moved)


def _added(baseline: Baseline, context: PreparedFrame, edits: Edits, key: str, new: AddedObject) -> SceneObject:
    """Object that no detection is, in 3D by its pixels, or where they were edited by the edited ones."""
    nothing = np.zeros((context.frame.height, context.frame.width), np.bool_)
    blank = baseline.made("blank", (key, new.name), lambda: _blank(context, new.name, nothing))
    entry = _repainted(baseline, context, blank, key, edits.masks.get(key, new.mask))
    if key in edits.boxes:
        entry = replace(entry, lifted=entry.lifted.moved_to(edits.boxes[key].box(), context.viewer))
    return replace(entry, score=new.p)


def _blank(context: PreparedFrame, name: str, mask: np.ndarray) -> SceneObject:
    """Object without pixels."""
    frame = context.frame
    (thing,) = lift(frame.depth, frame.camera, [mask], context.viewer, config=context.config, edges=context.edges)
    return SceneObject(-1, name, 0.0, np.zeros(4, np.float32), mask, thing)


def _joined_by(found: Proposals, entry: SceneObject) -> Proposals:
    """Detections of a name and another one after them."""
    return Proposals(
        np.concatenate([found.boxes, entry.bbox[None]]),
        np.append(found.scores, np.float32(entry.score)),
        np.append(found.label_index, len(found.labels)),
        (*found.labels, entry.label),
        None,
        np.append(found.ids, -1),
    )


def _repainted(
    baseline: Baseline, context: PreparedFrame, entry: SceneObject, key: str, code: RunLength
) -> SceneObject:
    """Object by other pixels; an object found by several names is lifted once, and stays a single object."""
    frame, thin = context.frame, is_thin(entry.label)

    def relift() -> tuple[np.ndarray, LiftedObject]:
        what, shape = f"the mask of {key}", (frame.height, frame.width)
        require(
            code.size == shape, f"{what} is of another picture size", got=list(code.size), expected=f"{list(shape)}"
        )
        mask = code.decoded(shape, what)
        found = lift(
            frame.depth, frame.camera, [mask], context.viewer, config=context.config, edges=context.edges, thin=[thin]
        )
        return mask, found[0]

    mask, lifted = baseline.made("relifted", (context.config, key, thin), relift, code)
    bbox = np.array(mask_box(mask), np.float32) if mask.any() else entry.bbox
    return replace(entry, mask=mask, bbox=bbox, lifted=lifted)


def _with_confidences(candidates: dict[str, Candidates], keys: tuple[str, ...], edits: Edits) -> dict[str, Candidates]:
    result = dict(candidates)
    for name, own in candidates.items():
        # The score of an added object is final: no calibration is of it.
        added = {key: entry.p for key, entry in edits.added.items()}
        at_keys = [keys[at] for at in own.index.tolist()]
        given = [edits.confidences.get((name, key), added.get(key, np.nan)) for key in at_keys]
        told = np.isfinite(np.array(given, np.float64))
        scores, raw = (np.where(told, given, p) for p in (own.scores, own.detector_scores))
        result[name] = replace(own, scores=scores, raw_scores=raw)
    return result


def _tables(
    baseline: Baseline,
    context: PreparedFrame,
    edits: Edits,
    scorer: RelationScorer,
    objects: tuple[SceneObject, ...],
) -> PairTables:
    """Scores of all pairs, from the last of this kind and from the unedited ones."""
    profile = replace(Profile(), **edits.profile)
    plain = not edits.boxes and not edits.masks and not edits.added
    kind = (context.config, edits.scorer, profile)
    indices = {identity(o) for o in objects}
    known = [t for t in (baseline.tables.get((kind, p)) for p in (False, True)) if t is not None]
    # By other thresholds a network says the same of the same objects.
    known = known or [t for (of, _), t in baseline.tables.items() if of[:2] == kind[:2] and indices <= t.index.keys()]
    before = max(known, key=lambda t: len(indices & t.index.keys()), default=None)
    tables = score_pairs(objects, context.viewer, context.frame, scorer, profile, before)
    widest = baseline.tables.get((kind, True))
    # What was scored for a larger K serves a smaller one again.
    if not plain or widest is None or len(tables.objects) >= len(widest.objects):
        baseline.tables.pop((kind, plain), None)
        baseline.tables[kind, plain] = tables
        while len(baseline.tables) > _MOST_TABLES:
            del baseline.tables[next(iter(baseline.tables))]
    return tables


def _with_relations(scores: RelationScores, keys: tuple[str, ...], edits: Edits) -> RelationScores:
    known, index = ({name: k for k, name in enumerate(names)} for names in (scores.relations, keys))
    probabilities = scores.probabilities.copy()
    for (relation, a, b), p in edits.relations.items():
        require(
            relation in (*PAIRWISE, "closest", "farthest"),
            "there is no probability of this relation for two objects",
            got=repr(relation),
            expected=", ".join((*PAIRWISE, "closest", "farthest")),
        )
        if relation in known and a in index and b in index:
            probabilities[index[a], index[b], known[relation]] = p
    return replace(scores, probabilities=probabilities)


def with_superlatives(lookup: RelationLookup, keys: tuple[str, ...], edits: Edits) -> RelationLookup:
    """Relation look-up with edited probabilities of closest and farthest, absent from the tables."""
    given = {k: p for k, p in edits.relations.items() if k[0] in ("closest", "farthest")}
    index = {key: at for at, key in enumerate(keys)}

    def edited(attachment: Attachment, heads: np.ndarray, ends: Any) -> np.ndarray:
        found = lookup(attachment, heads, ends)
        for (relation, a, b), p in given.items():
            if relation == attachment.relation and a in index and b in index:
                at = np.ix_(np.flatnonzero(heads == index[a]), np.flatnonzero(ends[0] == index[b]))
                found[at] = p
        return found

    return edited
