"""Which detections go on: minimum score, non-maximum suppression, the top K."""

from __future__ import annotations

import numpy as np

from pipeline.boxes import iou_2d
from pipeline.proposals.base import Proposals

NMS_IOU = 0.5


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
