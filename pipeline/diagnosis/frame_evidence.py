"""What was detected in a frame joined with what is true of it: who is who, and the relations of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.answering.answering import FrameAnswers
from pipeline.answering.objects import SAME_BOX_IOU
from pipeline.diagnosis.true_objects import TrueObjects, needs_points
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, Case, FrameCases
from pipeline.language.relation_names import DIRECTIONAL

DEFAULT_CONFIDENCE = 0.5
"""Confidence of a recalled object where no right detection is known to take it from."""


class FrameEvidence:
    """A frame's detections and its labelled objects, in one list: first the D detections, then the N labelled ones.

    Parameters
    ----------
    truth : FrameCases
    answers : FrameAnswers
    confidence : float
        Score of an object that the oracle RECALL adds, 0..1.
    cases : sequence of Case, optional
        The expressions that will be diagnosed; all of the frame by default.

    Attributes
    ----------
    overlap : (D, N) float64
        IoU of the 2D boxes.
    match : (D,) int64
        The labelled object that each detection is, of whatever class: the best overlap of at least a half; -1 for none.
    objects : TrueObjects
    same : (D + N, D + N) bool
        One and the same thing.
    same_box : (D + N, D + N) bool
        The same, by identity and 2D box alone, whatever the masks.
    mask_sizes : (D + N,) int64
        Pixels.
    roles : dict
        What may fill the places of expressions, kept by `substitution`.
    """

    def __init__(
        self,
        truth: FrameCases,
        answers: FrameAnswers,
        confidence: float = DEFAULT_CONFIDENCE,
        cases: Sequence[Case] | None = None,
    ) -> None:
        self.truth, self.answers, self.confidence = truth, answers, confidence
        self._cases = truth.cases if cases is None else tuple(cases)
        self.detections, self.labelled = len(answers.objects), len(truth.labels)
        self.overlap = iou_2d(answers.boxes, truth.boxes)
        self.match = np.full(self.detections, -1, np.int64)
        if self.overlap.size:
            best = self.overlap.argmax(axis=1)
            found = self.overlap[np.arange(self.detections), best] >= HIT
            self.match = np.where(found, best, -1)
        self.objects = TrueObjects(truth, answers.context)
        d, n = self.detections, self.labelled
        self.same = np.zeros((d + n, d + n), np.bool_)
        self.same[:d, :d] = answers.same
        self.same[:d, d:] = self.overlap >= SAME_BOX_IOU
        self.same[d:, :d] = self.same[:d, d:].T
        self.same[d:, d:] = np.eye(n, dtype=np.bool_)
        self.same_box = self.same.copy()
        if d and not answers.source.needed_detector().exact:
            ids = np.array([o.id for o in answers.objects])
            one = (ids[:, None] == ids[None, :]) & (ids[:, None] >= 0)
            boxes_alike = iou_2d(answers.boxes, answers.boxes) >= SAME_BOX_IOU
            self.same_box[:d, :d] &= one | boxes_alike | np.eye(d, dtype=np.bool_)
        sizes = truth.facts["mask_pixels"]
        true_sizes = np.where(np.isfinite(sizes), sizes, 0).astype(np.int64)
        self.mask_sizes = np.concatenate([answers.mask_sizes, true_sizes])
        self.roles: dict[tuple[str, bytes], Any] = {}
        self._probabilities: dict[str, np.ndarray] = {}

    @property
    def known(self) -> np.ndarray:
        """(N,) bool: labelled objects whose true geometry is known."""
        return self.objects.known

    def match_at(self, places: np.ndarray) -> np.ndarray:
        """(K,) int64: the labelled object, of whatever class, at each place of the list; -1 for none."""
        return np.asarray(np.concatenate([self.match, np.arange(self.labelled)])[places], np.int64)

    def probabilities(self, relation: str) -> np.ndarray:
        """(D + N, D + N) float64: the scorer's word on every pair that the cases of this relation are about.

        Among detections these are the very numbers of the answer. NaN for other pairs, and where geometry is not known.
        """
        if relation not in self._probabilities:
            asked = {case.relation for case in self._cases}
            # The directions cost next to nothing; what looks at points is scored for the objects it is asked of.
            together = [r for r in DIRECTIONAL if r in asked] if relation in DIRECTIONAL else [relation]
            self._score(together or [relation])
        return self._probabilities[relation]

    def _score(self, relations: Sequence[str]) -> None:
        source, d = self.answers.source, self.detections
        points = any(needs_points(source.scorer, relation) for relation in relations)
        places = self._involved(relations)
        true = {k: self.objects.get(k, points) for k in (places[places >= d] - d).tolist()}
        places = np.array([p for p in places.tolist() if p < d or true[p - d] is not None], np.int64)
        objects = [self.answers.objects[p] if p < d else true[p - d] for p in places.tolist()]
        present = [o for o in objects if o is not None]
        scores = source.score(self.answers.context, present, relations) if present else None
        for relation in relations:
            table = np.full((d + self.labelled, d + self.labelled), np.nan)
            if scores is not None:
                table[np.ix_(places, places)] = scores.of(relation)
            own = self.answers.probabilities(relation)
            if own is not None:
                table[:d, :d] = own
            self._probabilities[relation] = table

    def _involved(self, relations: Sequence[str]) -> np.ndarray:
        """Places of the candidates and labelled objects that the cases of these relations are about, rising."""
        candidates = [np.zeros(0, np.int64)]
        labelled = np.zeros(self.labelled, np.bool_)
        for case in self._cases:
            if case.relation not in relations:
                continue
            for name, example in ((case.target, case.target_object), (case.reference, case.reference_object)):
                index = self.answers.candidates[name].index
                candidates.append(index)
                labelled |= self.truth.alike[example]
        places = np.unique(np.concatenate(candidates))
        matched = self.match[places]
        labelled[matched[matched >= 0]] = True
        return np.concatenate([places, self.detections + np.flatnonzero(labelled)])
