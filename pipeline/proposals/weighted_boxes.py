"""Weighted boxes fusion: boxes of several detectors become one where they overlap.

Solovyev, Wang and Gabruseva, "Weighted boxes fusion: ensembling boxes from different object detection models", Image
and Vision Computing 107, 2021 (arXiv:1910.13302), with weight 1 for every detector. The authors' library needs numba
and pandas and has had no release since 2022; the tests hold figures that it gave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.geometry.boxes import iou_2d

FUSION_IOU = 0.55
"""The paper's threshold."""


@dataclass(frozen=True)
class FusedBoxes:
    """Clusters of boxes, the most certain first.

    Attributes
    ----------
    boxes : (C, 4) float64
        Means of the members' boxes, weighted by their scores.
    scores : (C,) float64
        Means of their scores, less where few detectors found the thing.
    classes : (C,) int64
    members : tuple of (M,) int64
        Places in the input of each cluster's boxes, the highest score first.
    """

    boxes: np.ndarray
    scores: np.ndarray
    classes: np.ndarray
    members: tuple[np.ndarray, ...]


def falling(boxes: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """(N,) int64: places by falling score; what is tied stands by its box, and not as it came."""
    return np.lexsort((*np.asarray(boxes, np.float64).reshape(-1, 4).T[::-1], -np.asarray(scores)))


def fuse_boxes(
    boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray, detectors: np.ndarray, iou: float = FUSION_IOU
) -> FusedBoxes:
    """Weighted boxes fusion of the boxes of several detectors, within each class.

    Parameters
    ----------
    boxes : (N, 4) float
        x0, y0, x1, y1 of all detectors.
    scores : (N,) float
        0..1.
    classes : (N,) int
        Numbers from 0.
    detectors : (K,) int
        How many detectors could have found each class. A cluster of fewer boxes loses score in proportion.
    iou : float
        A box joins the cluster whose mean overlaps it most, and by more than this.
    """
    boxes, scores = np.asarray(boxes, np.float64).reshape(-1, 4), np.asarray(scores, np.float64)
    means = np.empty_like(boxes)
    kinds = np.full(len(boxes), -1, np.int64)
    members: list[list[int]] = []
    for i in falling(boxes, scores).tolist():
        count = len(members)
        overlap = np.where(kinds[:count] == classes[i], iou_2d(boxes[i], means[:count])[0], 0.0)
        best = int(overlap.argmax()) if count else -1
        if best < 0 or overlap[best] <= iou:
            best = count
            members.append([])
            kinds[best] = classes[i]
        members[best].append(i)
        means[best] = _mean(boxes[members[best]], scores[members[best]])
    count = len(members)
    clusters = tuple(np.array(m, np.int64) for m in members)
    fused = np.array([scores[m].mean() for m in clusters]).reshape(count)
    could = np.maximum(np.asarray(detectors)[kinds[:count]], 1)
    fused *= np.minimum([len(m) for m in clusters], could) / could
    order = falling(means[:count], fused)
    return FusedBoxes(means[:count][order], fused[order], kinds[:count][order], tuple(clusters[k] for k in order))


def _mean(boxes: np.ndarray, scores: np.ndarray) -> np.ndarray:
    weights = scores if scores.sum() > 0 else np.ones(len(scores))
    mean = weights @ boxes / weights.sum()
    # Rounding may put it a hair outside what it is the mean of.
    return np.clip(mean, boxes.min(axis=0), boxes.max(axis=0))
