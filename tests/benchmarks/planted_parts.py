"""Parts of a pipeline that are right, and the same parts broken in one way: what planted faults are made of."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xxhash

from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.annotations import AnnotationDetector, box_mask
from pipeline.proposals.base import Detector, Proposals, no_proposals
from pipeline.proposals.simulated import leaked, surroundings
from pipeline.relations.features import Appearance
from pipeline.relations.scorer import RelationScorer, RelationScores
from pipeline.system.errors import InputError

CLEAN_SCORES = (0.80, 0.95)
"""Scores of a detector that is right lie evenly between these."""
WAVE_M = 1.0
"""Wave length of `WrongScorer`, metres: pairs that resemble each other are wrong together."""

Edit = Callable[[Frame, str, Proposals], Proposals]
"""What is done to the detections of a name in a frame."""


@dataclass(frozen=True)
class PlantedDetector:
    """The annotations as a detector that is right, or whose answers are edited in one way.

    Attributes
    ----------
    truth : AnnotationDetector
    seed : int
        Of the scores, which only it, the frame and the object decide.
    edit : callable, optional
    key : str
        Of an edit that changes pixels: lifted objects are kept by it.
    min_score : float
        Detections below it are dropped, after the edit.
    """

    truth: AnnotationDetector
    seed: int = 0
    edit: Edit | None = None
    key: str = ""
    min_score: float = 0.0

    name = "planted"
    exact = False

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return self.truth.vocabulary

    def fingerprint(self) -> str:
        return f"planted:{self.seed}:{self.key}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        if labels is not None and len(labels) != 1:
            raise InputError("a planted detector is asked one name at a time", got=len(labels))
        found = self.truth.detect(frame, labels)
        low, high = CLEAN_SCORES
        scores = [low + (high - low) * share(self.seed, frame.id, int(i), "score") for i in found.ids]
        found = replace(found, scores=np.array(scores, np.float32))
        if self.edit is not None and labels is not None:
            found = self.edit(frame, labels[0], found)
        return found.take(found.scores >= self.min_score)


def share(*key: object) -> float:
    """A figure in (0, 1) that only the key decides."""
    text = "\x1f".join(map(str, key)).encode("utf-8", "surrogatepass")
    return ((xxhash.xxh3_64_intdigest(text) >> 12) + 0.5) / (1 << 52)


@dataclass(frozen=True)
class WrongScorer:
    """A relation scorer that takes the opposite for true, for pairs that lie in some way to each other.

    A pair is one of them where a wave over the vector between the two centres is high; the wave's direction and phase
    follow from the seed. So, as with a network that learnt something wrong, better boxes do not help.

    Attributes
    ----------
    right : RelationScorer
    seed : int
    wrong : float
        Share of pairs, about.
    """

    right: RelationScorer
    seed: int = 0
    wrong: float = 0.5

    @property
    def name(self) -> str:
        return self.right.name

    def score(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        relations: Collection[str] = PAIRWISE,
    ) -> RelationScores:
        found = self.right.score(objects, viewer, appearance, relations)
        center = np.array([(o.lo + o.hi) / 2 for o in objects]).reshape(-1, 3)
        rng = np.random.default_rng([self.seed, 41])
        wave = rng.normal(size=3)
        wave *= 2 * np.pi / WAVE_M / np.linalg.norm(wave)
        high = np.cos((center[None] - center[:, None]) @ wave + rng.uniform(0, 2 * np.pi)) > np.cos(np.pi * self.wrong)
        np.fill_diagonal(high, False)
        return replace(found, probabilities=np.where(high[..., None], 1 - found.probabilities, found.probabilities))


class ShiftedContext(PreparedFrame):
    """A frame in which everything that is detected, but not what is true, is lifted to a wrong place.

    Parameters
    ----------
    context : PreparedFrame
    shift : dict of int to (3,) float64
        Identity of a detection -> how far it is moved along right, up and forward, metres.
    """

    def __init__(self, context: PreparedFrame, shift: dict[int, np.ndarray]) -> None:
        self.__dict__ |= context.__dict__
        self._shift = shift

    def lift(self, proposals: Proposals, detector: Detector) -> tuple[SceneObject, ...]:
        found = super().lift(proposals, detector)
        if detector.exact:
            return found
        return tuple(self._shifted(o) if o.id in self._shift else o for o in found)

    def _shifted(self, o: SceneObject) -> SceneObject:
        moved, lifted = self._shift[o.id], o.lifted
        along = moved @ self.viewer.matrix
        box = None if lifted.box is None else Box3D(lifted.box.center + along, lifted.box.R, lifted.box.size)
        points = (lifted.points + along).astype(lifted.points.dtype)
        return replace(o, lifted=replace(lifted, points=points, box=box, lo=lifted.lo + moved, hi=lifted.hi + moved))


# Edits of one name's detections. `ids` are identities: those of annotations are their indices.


def dropped(ids: Collection[int]) -> Callable[[Frame, Proposals], Proposals]:
    """Without these."""
    return lambda frame, found: found.take(~np.isin(found.ids, list(ids)))


def rescored(
    ids: Collection[int], score: float, others: float | None = None
) -> Callable[[Frame, Proposals], Proposals]:
    """These with another score, and all others too where one is given for them."""

    def edit(frame: Frame, found: Proposals) -> Proposals:
        scores = found.scores if others is None else np.full(len(found), others, np.float32)
        return replace(found, scores=np.where(np.isin(found.ids, list(ids)), score, scores).astype(np.float32))

    return edit


def moved_boxes(ids: Collection[int], sides: float) -> Callable[[Frame, Proposals], Proposals]:
    """The 2D boxes of these shifted by so many of their widths, towards the middle of the picture."""

    def edit(frame: Frame, found: Proposals) -> Proposals:
        boxes = found.boxes.copy()
        here = np.isin(found.ids, list(ids))
        middle, width = boxes[here][:, [0, 2]].mean(axis=1), boxes[here][:, 2] - boxes[here][:, 0]
        step = np.where(middle < frame.width / 2, 1, -1) * sides * width
        boxes[here] += np.stack([step, 0 * step, step, 0 * step], axis=1)
        return replace(found, boxes=boxes)

    return edit


def false_positives(ids: Collection[int], score: float) -> Callable[[Frame, Proposals], Proposals]:
    """Other annotated objects taken for this class."""

    def edit(frame: Frame, found: Proposals) -> Proposals:
        wrong = [a for a in frame.annotations if a.index in ids and a.index not in found.ids]
        if not wrong:
            return found
        if not len(found):
            found = no_proposals(frame.height, frame.width)
        masks = [box_mask(a.bbox, frame.height, frame.width) if a.mask is None else a.mask for a in wrong]
        own = np.stack([a.bbox for a in wrong]).astype(np.float32)
        return Proposals(
            np.concatenate([found.boxes, own]),
            np.concatenate([found.scores, np.full(len(wrong), score, np.float32)]),
            np.concatenate([found.label_index, np.full(len(wrong), len(found.labels))]).astype(np.int64),
            (*found.labels, "mistaken"),
            None if found.masks is None else np.concatenate([found.masks, np.stack(masks)]),
            np.concatenate([found.ids, [a.index for a in wrong]]).astype(np.int64),
            None if found.has_mask is None else np.append(found.has_mask, [a.mask is not None for a in wrong]),
        )

    return edit


def leaking(ids: Collection[int], seed: int) -> Callable[[Frame, Proposals], Proposals]:
    """The masks of these merged with whatever lies on one side of them."""

    def edit(frame: Frame, found: Proposals) -> Proposals:
        if found.masks is None:
            return found
        masks = found.masks.copy()
        for k in np.flatnonzero(np.isin(found.ids, list(ids)) & masks.any(axis=(1, 2))):
            crop = surroundings(masks[k], 1, reach=1.0)
            angle = 2 * np.pi * share(seed, frame.id, int(found.ids[k]), "leak")
            h, w = crop.mask.shape
            masks[k, crop.y : crop.y + h, crop.x : crop.x + w] = leaked(crop.mask, angle, np.ones_like(crop.mask))
        return replace(found, masks=masks)

    return edit
