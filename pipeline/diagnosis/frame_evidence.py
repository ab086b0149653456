"""What was detected in a frame joined with what is true of it: who is who, and the relations of all of them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from pipeline.boxes import Box3D, iou_2d
from pipeline.evaluation.answering import FrameAnswers
from pipeline.evaluation.cases import FrameCases
from pipeline.evaluation.records import HIT
from pipeline.lifting import LiftedObject, Quality
from pipeline.objects import SAME_BOX_IOU, SceneObject
from pipeline.proposals.annotations import AnnotationDetector, box_mask
from pipeline.relations import PAIRWISE

DEFAULT_CONFIDENCE = 0.5
"""Confidence of a recalled object where no right detection is known to take it from."""


class FrameEvidence:
    """A frame's detections and its labelled objects, in one list: first the D detections, then the N labelled ones.

    Parameters
    ----------
    truth : FrameCases
    answers : FrameAnswers
    relations : collection of str
        Those that expressions of the frame ask for.
    confidence : float
        Score of an object that the oracle RECALL adds, 0..1.

    Attributes
    ----------
    overlap : (D, N) float64
        IoU of the 2D boxes.
    match : (D,) int64
        The labelled object that each detection is, of whatever class: the best overlap of at least a half; -1 for none.
    known : (N,) bool
        Labelled objects whose true geometry is at hand.
    pseudo : (N,) bool
        Those of them whose geometry is the box of the label, because the dataset has no pixels of them.
    same : (D + N, D + N) bool
        One and the same thing.
    same_box : (D + N, D + N) bool
        The same, by identity and 2D box alone, whatever the masks.
    mask_sizes : (D + N,) int64
        Pixels.
    """

    def __init__(
        self,
        truth: FrameCases,
        answers: FrameAnswers,
        relations: Collection[str] = PAIRWISE,
        confidence: float = DEFAULT_CONFIDENCE,
    ) -> None:
        self.truth, self.answers, self.confidence = truth, answers, confidence
        self._relations = tuple(relations)
        self.detections, self.labelled = len(answers.objects), len(truth.labels)
        self.overlap = iou_2d(answers.boxes, truth.boxes)
        best = self.overlap.argmax(axis=1) if self.labelled else np.zeros(self.detections, np.int64)
        found = self.overlap[np.arange(self.detections), best] >= HIT if self.labelled else np.zeros(0, np.bool_)
        self.match = np.where(found, best, -1) if self.labelled else np.full(self.detections, -1, np.int64)
        self.true_objects, self.pseudo = _true_objects(truth, answers)
        self.known = np.array([o is not None for o in self.true_objects], np.bool_)
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
        true_sizes = [0 if o is None else o.lifted.quality.mask_pixels for o in self.true_objects]
        self.mask_sizes = np.concatenate([answers.mask_sizes, np.array(true_sizes, np.int64)])
        self._probabilities: dict[str, np.ndarray] = {}

    def match_at(self, places: np.ndarray) -> np.ndarray:
        """(K,) int64: the labelled object, of whatever class, at each place of the list; -1 for none."""
        return np.concatenate([self.match, np.arange(self.labelled)])[places]

    def probabilities(self, relation: str) -> np.ndarray:
        """(D + N, D + N) float64: the scorer's word on every ordered pair; NaN where geometry is not known.

        Among detections these are the very numbers of the answer.
        """
        if not self._probabilities:
            self._score()
        return self._probabilities[relation]

    def _score(self) -> None:
        d, total = self.detections, self.detections + self.labelled
        objects = [*self.answers.objects, *(o for o in self.true_objects if o is not None)]
        places = np.concatenate([np.arange(d), d + np.flatnonzero(self.known)]).astype(np.int64)
        scores = self.answers.source.score(self.answers.context, objects, self._relations) if objects else None
        for relation in self._relations:
            table = np.full((total, total), np.nan)
            if scores is not None:
                table[np.ix_(places, places)] = scores.of(relation)
            own = self.answers.probabilities(relation)
            if own is not None:
                table[:d, :d] = own
            self._probabilities[relation] = table


def _true_objects(truth: FrameCases, answers: FrameAnswers) -> tuple[tuple[SceneObject | None, ...], np.ndarray]:
    """The labelled objects in 3D by their own pixels, else by the label's box; and which are of the second kind."""
    context = answers.context
    everything = AnnotationDetector().detect(context.frame, None)
    place = {int(number): k for k, number in enumerate(everything.ids)}
    here = [k for k in (place.get(int(number)) for number in truth.numbers) if k is not None]
    lifted = iter(context.lift(everything.take(np.array(here, np.int64)), AnnotationDetector())) if here else iter(())
    found: list[SceneObject | None] = []
    pseudo = np.zeros(len(truth.numbers), np.bool_)
    for k, number in enumerate(truth.numbers):
        entry = next(lifted) if int(number) in place else None
        if entry is not None and entry.lifted.box is not None and iou_2d(entry.bbox, truth.boxes[k])[0, 0] >= HIT:
            found.append(entry)
            continue
        boxed = _from_label(truth, k, answers)
        pseudo[k] = boxed is not None
        found.append(boxed)
    return tuple(found), pseudo


def _from_label(truth: FrameCases, k: int, answers: FrameAnswers) -> SceneObject | None:
    """A labelled object as its label has it: a box and extents, no points."""
    row = {name: values[k] for name, values in truth.geometry.items()}
    if not all(np.isfinite(values).all() for values in row.values()):
        return None
    frame = answers.context.frame
    mask = box_mask(truth.boxes[k], frame.height, frame.width)
    box = Box3D(row["center"], row["R"].reshape(3, 3), row["size"])
    quality = Quality(int(mask.sum()), 0, 0.0, 0.0, False, float(row["center"][2]), False, "box")
    lifted = LiftedObject(np.empty((0, 3), np.float32), box, 1.0, row["lo"], row["hi"], "box", None, quality)
    return SceneObject(-1, truth.labels[k], 1.0, truth.boxes[k].astype(np.float32), mask, lifted)
