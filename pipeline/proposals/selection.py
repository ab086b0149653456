"""Which detections go on: minimum score, non-maximum suppression, the top K."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.proposals.base import Proposals

NMS_IOU = 0.5
MAX_CANDIDATES = 1000
"""Boxes of a class that go into non-maximum suppression at most, best first."""


def top_k(proposals: Proposals, k: int, *, min_score: float = 0.0, nms_iou: float = NMS_IOU) -> Proposals:
    """The K best proposals after class-agnostic non-maximum suppression, best first."""
    return proposals.take(top_k_places(proposals, k, min_score=min_score, nms_iou=nms_iou))


def top_k_places(proposals: Proposals, k: int, *, min_score: float = 0.0, nms_iou: float = NMS_IOU) -> np.ndarray:
    """(M,) int64: the places of the proposals that `top_k` takes."""
    order = np.argsort(-proposals.scores, kind="stable")
    order = order[proposals.scores[order] >= min_score]
    return order[suppress(proposals.boxes[order], nms_iou)][:k]


def suppress(boxes: np.ndarray, nms_iou: float = NMS_IOU) -> np.ndarray:
    """Indices of the boxes that survive, given boxes ((N, 4)) in order of falling score."""
    overlap = iou_2d(boxes, boxes) > nms_iou
    alive = np.ones(len(boxes), np.bool_)
    for i in range(len(boxes)):
        if alive[i]:
            alive[i + 1 :] &= ~overlap[i, i + 1 :]
    return np.flatnonzero(alive)


def class_wise(
    boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray, k: int, *, nms_iou: float = NMS_IOU
) -> np.ndarray:
    """(M,) int64: the best `k` of each class after non-maximum suppression within it, best first.

    Parameters
    ----------
    boxes : (N, 4) float
    scores : (N,) float
    classes : (N,) int
    """
    order = np.argsort(-scores, kind="stable")
    kept = [np.zeros(0, np.int64)]
    for one in np.unique(classes):
        own = order[classes[order] == one][:MAX_CANDIDATES]
        kept.append(own[suppress(boxes[own], nms_iou)][:k])
    chosen = np.concatenate(kept)
    return chosen[np.argsort(-scores[chosen], kind="stable")]
