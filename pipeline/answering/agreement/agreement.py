"""How far two detectors agree on a frame: which detections are of one thing, and which only one of them made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Proposals
from pipeline.proposals.class_names import knows, same_names
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    from pipeline.answering.objects import SceneObject

MIN_IOU = 0.5
"""Two detections that overlap less are not of one thing."""


@dataclass(frozen=True)
class Layer:
    """What one detector found in a frame.

    Attributes
    ----------
    boxes : (N, 4) float
        x0, y0, x1, y1 in pixels.
    scores : (N,) float
    labels : tuple of str
    masks : tuple of ((H, W) bool or None)
        None where there is only the box.
    names : tuple of str or None
        What the detector can find; None where that is anything.
    """

    boxes: np.ndarray
    scores: np.ndarray
    labels: tuple[str, ...]
    masks: tuple[np.ndarray | None, ...]
    names: tuple[str, ...] | None = None

    def __len__(self) -> int:
        return len(self.labels)


def layer_of_proposals(found: Proposals, names: Sequence[str] | None = None) -> Layer:
    """A detector's proposals as a layer; `names` are those it was asked for."""
    has = np.ones(len(found), np.bool_) if found.has_mask is None else found.has_mask
    masks = tuple(found.masks[i] if found.masks is not None and has[i] else None for i in range(len(found)))
    labels = tuple(found.label(i) for i in range(len(found)))
    return Layer(found.boxes, found.scores, labels, masks, None if names is None else tuple(names))


def layer_of_objects(objects: Sequence[SceneObject], names: Sequence[str] | None = None) -> Layer:
    """Lifted proposals as a layer, in their order."""
    # Pixels that an annotated 3D box picked out are no mask of a detector.
    masks = tuple(None if o.lifted.quality.mask_source in ("box", "box3d") else o.mask for o in objects)
    boxes = np.array([o.bbox for o in objects], np.float64).reshape(-1, 4)
    scores = np.array([o.score for o in objects], np.float64)
    return Layer(boxes, scores, tuple(o.label for o in objects), masks, None if names is None else tuple(names))


@dataclass(frozen=True)
class FrameAgreement:
    """Two layers of one frame, matched.

    Attributes
    ----------
    labels_a, labels_b : tuple of str
    scores_a, scores_b : (N,), (M,) float64
    pairs : (P, 2) int64
        Places in `a` and in `b` of detections of one thing; each detection is in one pair at most.
    iou : (P,) float64
        By masks where both have one, else by boxes.
    same : (P,) bool
        Both gave it the same name.
    beyond_a, beyond_b : (N,), (M,) bool
        In no pair, and of a class that the other detector does not know: no disagreement.
    nearest_a, nearest_b : (N,), (M,) float64
        The greatest overlap with anything of the other detector.
    """

    labels_a: tuple[str, ...]
    labels_b: tuple[str, ...]
    scores_a: np.ndarray
    scores_b: np.ndarray
    pairs: np.ndarray
    iou: np.ndarray
    same: np.ndarray
    beyond_a: np.ndarray
    beyond_b: np.ndarray
    nearest_a: np.ndarray
    nearest_b: np.ndarray

    @property
    def only_a(self) -> np.ndarray:
        """(K,) int64: what only the first found, though the other knows the class; the highest score first."""
        return _alone(self.scores_a, self.pairs[:, 0], self.beyond_a)

    @property
    def only_b(self) -> np.ndarray:
        """(K,) int64: what only the second found, though the other knows the class; the highest score first."""
        return _alone(self.scores_b, self.pairs[:, 1], self.beyond_b)

    @property
    def named_otherwise(self) -> np.ndarray:
        """(K,) int64: places in `pairs` of things that the two name differently, the highest scores first."""
        found = np.flatnonzero(~self.same)
        return found[np.argsort(-self.pair_scores[found].max(axis=1), kind="stable")]

    @property
    def pair_scores(self) -> np.ndarray:
        """(P, 2) float64: the scores of each pair."""
        return np.stack([self.scores_a[self.pairs[:, 0]], self.scores_b[self.pairs[:, 1]]], axis=1)


def agree(a: Layer, b: Layer, *, min_iou: float = MIN_IOU, synonyms: Synonyms | None = None) -> FrameAgreement:
    """Match the detections of two detectors one to one.

    Of all ways to pair detections that overlap by `min_iou` or more, the one with the most pairs of the same name,
    among these the one with the most pairs, among these the one with the greatest sum of overlaps. So the counts depend
    neither on the order of the detections nor on which detector comes first.

    Parameters
    ----------
    a, b : Layer
        Of the same frame.
    min_iou : float
        Above 0, at most 1.
    synonyms : Synonyms, optional
        Which names mean the same.

    Raises
    ------
    InputError
        An overlap out of range, or masks of different size.
    """
    if not 0 < min_iou <= 1:
        raise InputError("the least overlap must be above 0 and at most 1", got=min_iou)
    overlap = overlaps(a, b)
    same = same_names(a.labels, b.labels, synonyms)
    pairs = matched(overlap, same, min_iou)
    i, j = pairs.T
    return FrameAgreement(
        a.labels,
        b.labels,
        np.asarray(a.scores, np.float64),
        np.asarray(b.scores, np.float64),
        pairs,
        overlap[i, j],
        same[i, j],
        _beyond(a, b, i, synonyms),
        _beyond(b, a, j, synonyms),
        overlap.max(axis=1, initial=0.0),
        overlap.max(axis=0, initial=0.0),
    )


def matched(overlap: np.ndarray, same: np.ndarray, min_iou: float) -> np.ndarray:
    """(P, 2) int64: the best one-to-one pairs of overlaps (N, M) and `same` names (N, M) bool, as `agree` says."""
    from scipy.optimize import linear_sum_assignment

    allowed = (overlap >= min_iou) & (overlap > 0)
    if not allowed.any():
        return np.zeros((0, 2), np.int64)
    # More than all overlaps together can sum up to: so a pair more always outweighs them, and a name outweighs both.
    much = min(overlap.shape) + 1.0
    value = np.where(allowed, overlap + much + much * much * same, 0.0)
    row, column = linear_sum_assignment(value, maximize=True)
    fits = allowed[row, column]
    return np.stack([row[fits], column[fits]], axis=1).astype(np.int64)


def overlaps(a: Layer, b: Layer) -> np.ndarray:
    """(N, M) float64: intersection over union, by masks where both have one, else by boxes."""
    found = iou_2d(a.boxes, b.boxes)
    rows = [i for i, mask in enumerate(a.masks) if mask is not None]
    columns = [j for j, mask in enumerate(b.masks) if mask is not None]
    if not rows or not columns:
        return found
    from pycocotools import mask as coco

    masks_a, masks_b = ([m for m in layer.masks if m is not None] for layer in (a, b))
    sizes = {m.shape for m in (*masks_a, *masks_b)}
    if len(sizes) > 1:
        raise InputError("the masks of two detectors must be of one size", got=" and ".join(map(str, sorted(sizes))))
    codes_a, codes_b = ([coco.encode(np.asfortranarray(m.view(np.uint8))) for m in ms] for ms in (masks_a, masks_b))
    iou = coco.iou(codes_a, codes_b, [0] * len(codes_b))
    found[np.ix_(rows, columns)] = np.nan_to_num(np.asarray(iou, np.float64))
    return found


def _beyond(own: Layer, other: Layer, paired: np.ndarray, synonyms: Synonyms | None) -> np.ndarray:
    known = {label: knows(other.names, label, synonyms) for label in set(own.labels)}
    beyond = np.array([not known[label] for label in own.labels], np.bool_)
    beyond[paired] = False
    return beyond


def _alone(scores: np.ndarray, paired: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    alone = ~beyond
    alone[paired] = False
    found = np.flatnonzero(alone)
    return found[np.argsort(-scores[found], kind="stable")]
