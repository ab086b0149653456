"""Detections of a frame matched with its labelled objects, and the relations of all of both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.answering.batch import FrameAnswers
from pipeline.answering.objects import SAME_BOX_IOU, PreparedFrame, SceneObject
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.lifting import LiftedObject, Quality, extents, lift
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.cases import HIT, Case, FrameCases
from pipeline.language.class_sizes import is_thin
from pipeline.language.relation_names import DIRECTIONAL
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.base import told_by_ids
from pipeline.relations.model import OnnxScorer
from pipeline.relations.scorer import RelationScorer, RuleScorer
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    from pipeline.answering.predictions import Predictions

_POINTED = ("paper30", "canon30")

DEFAULT_CONFIDENCE = 0.5
"""Confidence of a recalled object where no right detection is known to take it from."""
MOST_WORDS, FEWEST_SAID = 9, 5
"""Values of a scorer that chooses among words: at most so many, each said of so many pairs of a frame on average."""
OFF_M = 0.05
"""Extents differ by this much, metres, because one box holds what is seen of a thing, and the other all of it."""
BEYOND_USUAL = 2.0
"""A box is unusual that is this many times as far off as those of the same thing in the other lines of the frame."""


def matched(overlap: np.ndarray, alike: np.ndarray | bool = True) -> np.ndarray:
    """(D,) int64: labelled object of each detection, by the best overlap of at least 0.5; -1 for none.

    `overlap` is (D, N) float64; `alike` (D, N) bool: labelled objects of the asked class.
    """
    if not overlap.size:
        return np.full(len(overlap), -1, np.int64)
    overlap = np.where(alike, overlap, 0.0)
    best = overlap.argmax(axis=1)
    return np.where(overlap[np.arange(len(overlap)), best] >= HIT, best, -1)


class FrameEvidence:
    """Detections and labelled objects of a frame in a single list: first D detections, then N labelled objects.

    `confidence`: score of an object that the oracle RECALL adds, 0..1; `cases`: the expressions that will be diagnosed;
    all of the frame by default; `overlap`: (D, N) float64: IoU of the 2D boxes; `match`: (D,) int64: the labelled
    object that each detection is, of whatever class: the best overlap of at least a half; -1 for none; `same`: (D + N,
    D + N) bool: one and the same thing; `same_box`: (D + N, D + N) bool: the same, by identity and 2D box alone,
    whatever the masks; `mask_sizes`: (D + N,) int64: pixels; `roles`: what may fill the roles of expressions, kept by
    `substitution`; `missed`: why objects are missing, kept by `missed`; `before`: evidence before an edit, whose scores
    of the same objects are taken over.
    """

    def __init__(
        self,
        truth: FrameCases,
        answers: FrameAnswers,
        confidence: float = DEFAULT_CONFIDENCE,
        cases: Sequence[Case] | None = None,
        before: FrameEvidence | None = None,
    ) -> None:
        self.truth, self.answers, self.confidence = truth, answers, confidence
        self._cases = truth.cases if cases is None else tuple(cases)
        self.detections, self.labelled = len(answers.objects), len(truth.labels)
        self.overlap = iou_2d(answers.boxes, truth.boxes)
        self.match = matched(self.overlap)
        self.objects = TrueObjects(truth, answers.context)
        d, n = self.detections, self.labelled
        self.same = np.zeros((d + n, d + n), np.bool_)
        self.same[:d, :d] = answers.same
        self.same[:d, d:] = self.overlap >= SAME_BOX_IOU
        self.same[d:, :d] = self.same[:d, d:].T
        self.same[d:, d:] = np.eye(n, dtype=np.bool_)
        self.same_box = self.same.copy()
        if d and not told_by_ids(answers.source.needed_detector()):
            ids = np.array([o.id for o in answers.objects])
            one = (ids[:, None] == ids[None, :]) & (ids[:, None] >= 0)
            boxes_alike = iou_2d(answers.boxes, answers.boxes) >= SAME_BOX_IOU
            self.same_box[:d, :d] &= one | boxes_alike | np.eye(d, dtype=np.bool_)
        sizes = truth.facts["mask_pixels"]
        true_sizes = np.where(np.isfinite(sizes), sizes, 0).astype(np.int64)
        self.mask_sizes = np.concatenate([answers.mask_sizes, true_sizes])
        self.roles: dict[tuple[str, bytes], Any] = {}
        self.missed: dict[tuple[str, bytes], Any] = {}
        self._probabilities: dict[str, np.ndarray] = {}
        self._stand_ins: dict[str, np.ndarray] = {}
        self._known: dict[str, np.ndarray] = {}
        if before is not None and self._is_edit_of(before):
            self.objects = before.objects
            same = [_same_to_scorer(*pair) for pair in zip(before.answers.objects, answers.objects, strict=True)]
            stays = np.concatenate([np.array(same, np.bool_), np.ones(n, np.bool_)])
            both = stays[:, None] & stays
            # Pairs of detections are the answer's own, which may be edited.
            both[:d, :d] = False
            self._known = {r: np.where(both, table, np.nan) for r, table in before._probabilities.items()}

    def _is_edit_of(self, before: FrameEvidence) -> bool:
        own, other = self.answers, before.answers
        same = own.context is other.context and own.source.scorer is other.source.scorer
        return same and self.truth.geometry is before.truth.geometry and self.detections == before.detections

    def object_at(self, index: int) -> SceneObject:
        """Detection at an index, from D on a labelled object with its own pixels; no pixels for a mere box."""
        if index < self.detections:
            return self.answers.objects[index]
        found = self.objects.get(index - self.detections, points=True)
        assert found is not None
        frame = self.answers.context.frame
        return found if found.mask.size else replace(found, mask=np.zeros((frame.height, frame.width), np.bool_))

    def match_at(self, indices: np.ndarray) -> np.ndarray:
        """(K,) int64: labelled object, of whatever class, at each index of the list; -1 for none."""
        return np.asarray(np.concatenate([self.match, np.arange(self.labelled)])[indices], np.int64)

    def probabilities(self, relation: str) -> np.ndarray:
        """(D + N, D + N) float64: scored relation of every pair of interest to the cases.

        Among detections these are the very numbers of the answer. NaN for other pairs, and where geometry is not known.
        """
        if relation not in self._probabilities:
            asked = {relation for case in self._cases for relation in case.relations}
            # The directions cost next to nothing; what looks at points is scored for the objects it is asked of.
            together = [r for r in DIRECTIONAL if r in asked] if relation in DIRECTIONAL else [relation]
            self._score(together or [relation])
        return self._probabilities[relation]

    @property
    def asked_again(self) -> bool:
        """True where the relation scorer can score other geometry."""
        return bool(getattr(self.answers.source.scorer, "asked_again", True))

    def off(self, indices: np.ndarray, shapes: np.ndarray) -> np.ndarray:
        """(K,) bool: detections with extents off their labelled object's by more than a quarter of the larger and
        OFF_M.

        `shapes` (K,) are the labelled objects, -1 for none. Of predictions only where the file gives 3D boxes: the
        basis of its relations.
        """
        line, predictions = self.answers.source.line, self.answers.source.predictions
        known = (shapes >= 0) & (indices < self.detections)
        if line is not None and predictions is not None:
            known &= any(predictions.box_of(line.frame, i) is not None for i in line.objects)
        found = np.zeros(len(indices), np.bool_)
        for k in np.flatnonzero(known).tolist():
            own, true = self.answers.objects[indices[k]].lifted, self.truth.geometry
            lo, hi = true["lo"][shapes[k]], true["hi"][shapes[k]]
            least = np.maximum(OFF_M, np.maximum(own.hi - own.lo, hi - lo) / 4)
            found[k] = (np.abs([own.lo - lo, own.hi - hi]) > least).any()
        return found

    def unusual(self, indices: np.ndarray) -> np.ndarray:
        """(K,) bool: detections with a 3D box much farther from the labelled object than other lines' boxes of the
        frame."""
        line, predictions = self.answers.source.line, self.answers.source.predictions
        found, known = np.zeros(len(indices), np.bool_), enumerate(indices.tolist())
        own = [(k, int(self.match[i])) for k, i in known if i < self.detections and self.match[i] >= 0]
        if line is None or predictions is None or not own:
            return found
        from pipeline.answering.coordinate_conventions import box_2d

        frame, header, truth = self.answers.context.frame, predictions.header, self.truth
        size = (frame.width, frame.height)
        others: dict[int, list[float]] = {}
        for one in predictions.of_frame(line.frame):
            here = {} if one is line else one.objects
            seen = [(i, o.box) for i, o in here.items() if i not in line.objects and o.box is not None]
            boxes = np.array([box_2d(box, header, *size) for _, box in seen]).reshape(-1, 4)
            for (i, _), n in zip(seen, matched(iou_2d(boxes, truth.boxes)).tolist(), strict=True):
                if n >= 0 and (error := self._error(predictions, i, n)) is not None:
                    others.setdefault(n, []).append(error)
        for k, n in own:
            error = self._error(predictions, self.answers.objects[indices[k]].id, n)
            if error is not None and n in others:
                found[k] = error > BEYOND_USUAL * np.median(others[n]) + OFF_M
        return found

    def _error(self, predictions: Predictions, i: int, n: int) -> float | None:
        """Largest distance in metres between the extents of a given 3D box and of a labelled object."""
        from pipeline.answering.coordinate_conventions import try_box

        context = self.answers.context
        given = predictions.box_of(context.frame.id, i)
        box = None if given is None else try_box(given, predictions.header, context.frame.camera, False)
        if box is None:
            return None
        lo, hi = extents(np.empty((0, 3)), box, context.viewer)
        true = self.truth.geometry
        return float(np.abs([lo - true["lo"][n], hi - true["hi"][n]]).max())

    @cached_property
    def words(self) -> np.ndarray:
        """(K,) float64, rising: distinct probabilities of a scorer that chooses among a few words; else none."""
        line, predictions = self.answers.source.line, self.answers.source.predictions
        lines = () if line is None or predictions is None else predictions.of_frame(line.frame)
        every = [r[-1] for one in lines for pairs in (one.relations or {}).values() for r in pairs]
        found = np.unique(every)
        return found if len(found) <= MOST_WORDS and len(every) >= FEWEST_SAID * len(found) else found[:0]

    def follows(self, relation: str) -> bool:
        """True where a scorer that cannot be asked again may depend on its boxes, by the evidence of its file."""
        follows = getattr(getattr(self.answers.source.scorer, "stand_in", None), "follows", None)
        return follows is None or follows(relation)

    def stand_in(self, relation: str) -> np.ndarray | None:
        """Relation matrix as `probabilities`, all by the stand-in of a scorer that cannot be asked again; None for
        ours."""
        if self.asked_again:
            return None
        self.probabilities(relation)
        return self._stand_ins.get(relation)

    def _score(self, relations: Sequence[str]) -> None:
        pipeline, d = self.answers.source, self.detections
        points = any(needs_points(pipeline.scorer, relation) for relation in relations)
        roles = [role for _, roles in self._asked(relations) for role in roles]
        indices = np.unique(np.concatenate([np.zeros(0, np.int64), *roles]))
        given = {relation: self.answers.probabilities(relation) for relation in relations}
        wanted = self._wanted(relations) if isinstance(pipeline.scorer, OnnxScorer) else None
        known = self._known if wanted is not None and self._known.keys() >= set(relations) else {}
        if wanted is not None:
            wanted[:d, :d] &= any(found is None for found in given.values())
            if known:
                wanted &= np.isnan([known[relation] for relation in relations]).any(axis=0)
            indices = np.flatnonzero(wanted.any(axis=0) | wanted.any(axis=1))
        true = {k: self.objects.get(k, points) for k in (indices[indices >= d] - d).tolist()}
        indices = np.array([p for p in indices.tolist() if p < d or true[p - d] is not None], np.int64)
        objects = [self.answers.objects[p] if p < d else true[p - d] for p in indices.tolist()]
        present = [o for o in objects if o is not None]
        kept = [(pipeline, self._probabilities)]
        if not self.asked_again:
            kept.append(
                (replace(pipeline, scorer=getattr(pipeline.scorer, "stand_in", pipeline.scorer)), self._stand_ins)
            )
        for own, tables in kept:
            block = np.ix_(indices, indices)
            only = None if wanted is None else wanted[block]
            scores = own.score(self.answers.context, present, relations, only) if present else None
            for relation in relations:
                table = tables[relation] = np.full((d + self.labelled, d + self.labelled), np.nan)
                if scores is not None:
                    table[block] = scores.of(relation)
                if known:
                    np.copyto(table, known[relation], where=np.isnan(table))
        for relation, found in given.items():
            if found is not None:
                self._probabilities[relation][:d, :d] = found

    def _asked(self, relations: Sequence[str]) -> Iterator[tuple[Case, list[np.ndarray]]]:
        """Cases of these relations, each with the indices of its roles: candidates and labelled objects, rising."""
        for case in self._cases:
            if not case.relations.isdisjoint(relations):
                yield case, [self._role(*role) for role in self.truth.roles(case)]

    def _role(self, name: str, asked: np.ndarray) -> np.ndarray:
        candidates = self.answers.candidates[name].index
        labelled = np.concatenate([self.match[candidates], np.flatnonzero(asked)])
        return np.unique(np.concatenate([candidates, self.detections + labelled[labelled >= 0]]))

    def _wanted(self, relations: Sequence[str]) -> np.ndarray | None:
        """(D + N, D + N) bool: targets with references, as found and as labelled; None for all pairs."""
        wanted = np.zeros((self.detections + self.labelled,) * 2, np.bool_)
        for case, roles in self._asked(relations):
            # In a sentence any two objects may meet.
            if case.meant is not None:
                return None
            wanted[np.ix_(*roles)] = True
        return wanted


def _same_to_scorer(a: SceneObject, b: SceneObject) -> bool:
    return a.lifted is b.lifted and a.label == b.label and np.array_equal(a.bbox, b.bbox)


class TrueObjects:
    """Labelled objects as replacements by LIFT and RECALL, each made on first use.

    `known`: (N,) bool: objects whose geometry is known; `pseudo`: (N,) bool: those of which the label has a box and no
    pixels: points are not to be had.
    """

    def __init__(self, truth: FrameCases, context: PreparedFrame) -> None:
        self._truth, self._context = truth, context
        described = np.concatenate([truth.geometry["lo"], truth.geometry["hi"]], axis=1)
        self.known: np.ndarray = np.asarray(np.isfinite(described).all(axis=1))
        self.pseudo = self.known & np.array([m is None for m in truth.masks], np.bool_)
        self._described: dict[int, SceneObject] = {}
        self._lifted: dict[int, SceneObject] = {}
        self._masks: dict[int, np.ndarray] = {}

    def get(self, k: int, points: bool) -> SceneObject | None:
        """Object, with points on request; None for unknown geometry."""
        if not self.known[k]:
            return None
        if not points or self.pseudo[k]:
            return self._described.setdefault(k, self._described.get(k) or self._describe(k))
        return self._lifted.setdefault(k, self._lifted.get(k) or self._lift(k))

    def mask(self, k: int) -> np.ndarray:
        """(H, W) bool: labelled pixels; the whole 2D box without any."""
        if k not in self._masks:
            frame, code = self._context.frame, self._truth.masks[k]
            shape, where = (frame.height, frame.width), f"labelled object {self._truth.numbers[k]} of frame {frame.id}"
            box = self._truth.boxes[k]
            self._masks[k] = box_mask(box, *shape) if code is None else decode_run_length(shape, code, where)
        return self._masks[k]

    def _describe(self, k: int) -> SceneObject:
        truth = self._truth
        row = {name: values[k] for name, values in truth.geometry.items()}
        try:
            box = Box3D(row["center"], row["R"].reshape(3, 3), row["size"])
        except InputError:
            box = None
        quality = Quality(int(truth.facts["mask_pixels"][k]), 0, 0.0, 0.0, False, float("nan"), False, "annotation")
        lifted = LiftedObject(np.empty((0, 3), np.float32), box, 1.0, row["lo"], row["hi"], None, quality)
        return self._entry(k, np.zeros((0, 0), np.bool_), lifted)

    def _lift(self, k: int) -> SceneObject:
        context, mask = self._context, self.mask(k)
        (lifted,) = lift(
            context.frame.depth,
            context.frame.camera,
            [mask],
            context.viewer,
            config=context.config,
            edges=context.edges,
            boxes=context.boxes,
            thin=[is_thin(self._truth.labels[k])],
        )
        return self._entry(k, mask, lifted) if np.isfinite(lifted.lo).all() else self._describe(k)

    def _entry(self, k: int, mask: np.ndarray, lifted: LiftedObject) -> SceneObject:
        return SceneObject(-1, self._truth.labels[k], 1.0, self._truth.boxes[k].astype(np.float32), mask, lifted)


def needs_points(scorer: RelationScorer, relation: str) -> bool:
    """True for a scorer reading points of objects for a relation, and not extents alone."""
    if relation not in DIRECTIONAL:
        return True
    scorer = getattr(scorer, "stand_in", scorer)
    if isinstance(scorer, OnnxScorer):
        return scorer.name.partition("+")[0] in _POINTED
    return not isinstance(scorer, RuleScorer)
