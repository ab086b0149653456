"""Masks of another program or detector for the boxes of one: which segment belongs to which box."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms, match
from pipeline.proposals.base import Detector


class DetectorSegmenter:
    """Runs a detector for everything it knows and gives each box the mask that fits it.

    Parameters
    ----------
    detector : Detector
        Any that gives masks; proposals of it that are only a box are not used.
    synonyms : Synonyms, optional
    """

    def __init__(self, detector: Detector, synonyms: Synonyms | None = None) -> None:
        self.detector = detector
        self.synonyms = synonyms

    @property
    def name(self) -> str:
        return self.detector.name

    def fingerprint(self) -> str:
        return f"masks:{self.detector.fingerprint()}"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """(N, H, W) bool masks by greatest overlap of the boxes (at least one half), names first; and which were found.

        Raises
        ------
        InputError
            What the detector raises.
        """
        found = self.detector.detect(frame, None)
        masks = found.masks
        if masks is None:
            found, masks = found.take(np.zeros(0, np.int64)), np.zeros((0, frame.height, frame.width), np.bool_)
        elif found.has_mask is not None:
            found, masks = found.take(found.has_mask), masks[found.has_mask]
        names = tuple(found.label(i) for i in range(len(found)))
        segments = Segments(found.boxes, names, lambda i: masks[i])
        return segment_from(segments, boxes, labels, (frame.height, frame.width), self.synonyms)


MIN_IOU = 0.5
"""A segment whose bounding box overlaps a box less than this is not its segment."""


@dataclass(frozen=True)
class Segments:
    """Masks of a frame that belong to no box yet.

    Attributes
    ----------
    boxes : (S, 4) float
        Bounding boxes, x0, y0, x1, y1 in pixels.
    labels : tuple of (str or None)
        Their class names, where known.
    mask : callable
        The (H, W) bool mask of segment number i; only those that are needed are made.
    """

    boxes: np.ndarray
    labels: tuple[str | None, ...]
    mask: Callable[[int], np.ndarray]


def assign(
    boxes: np.ndarray, labels: Sequence[str], segments: Segments, synonyms: Synonyms | None = None
) -> np.ndarray:
    """The segment of each box, each used at most once, so that the sum of the overlaps is greatest.

    A segment of the box's own class name goes before one of another or no
    name. Equal overlaps are decided by the share of the segment's box inside the box.

    Returns
    -------
    (N,) int64
        Numbers of segments; -1 where none overlaps enough.
    """
    from scipy.optimize import linear_sum_assignment

    chosen = np.full(len(boxes), -1, np.int64)
    if not len(boxes) or not len(segments.boxes):
        return chosen
    overlap = iou_2d(boxes, segments.boxes)
    value = overlap + 1e-3 * share_inside(segments.boxes, boxes).T
    value += 2.0 * _same_name(labels, segments.labels, synonyms)
    value = np.where(overlap >= MIN_IOU, value, 0.0)
    row, column = linear_sum_assignment(value, maximize=True)
    fits = value[row, column] > 0
    chosen[row[fits]] = column[fits]
    return chosen


def segment_from(
    segments: Segments, boxes: np.ndarray, labels: Sequence[str], shape: tuple[int, int], synonyms: Synonyms | None
) -> tuple[np.ndarray, np.ndarray]:
    """Masks (N, H, W) and has_mask (N,) of boxes, as `Segmenter.segment` returns them."""
    chosen = assign(np.asarray(boxes, np.float64).reshape(-1, 4), labels, segments, synonyms)
    masks, has_mask = np.zeros((len(chosen), *shape), np.bool_), np.zeros(len(chosen), np.bool_)
    for i in np.flatnonzero(chosen >= 0):
        masks[i] = segments.mask(int(chosen[i]))
        has_mask[i] = masks[i].any()
    return masks, has_mask


def share_inside(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """(S, N): which share of each of `inner` lies in each of `outer`."""
    low = np.maximum(inner[:, None, :2], outer[None, :, :2])
    high = np.minimum(inner[:, None, 2:], outer[None, :, 2:])
    shared = np.maximum(high - low, 0).prod(axis=2)
    area = np.maximum(inner[:, 2:] - inner[:, :2], 0).prod(axis=1)
    return np.divide(shared, area[:, None], out=np.zeros_like(shared), where=area[:, None] > 0)


def _same_name(labels: Sequence[str], names: Sequence[str | None], synonyms: Synonyms | None) -> np.ndarray:
    """(N, S) bool: the segment's name is one that the box's name means."""
    known = tuple(dict.fromkeys(n for n in names if n))
    meant = {label: set(match(label, known, synonyms)) for label in dict.fromkeys(labels)}
    return np.array([[name in meant[label] for name in names] for label in labels], np.bool_).reshape(
        len(labels), len(names)
    )
