"""Why no right object stood among the candidates: cut by rank, under the threshold, badly placed, or not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import HIT
from pipeline.proposals.base import Detector, Proposals
from pipeline.proposals.selection import suppress
from pipeline.system.errors import InputError

Miss = Literal["RANK", "THRESHOLD", "LOCALISATION", "ABSENT"]
NEAR_MISS = 0.1
"""A box that overlaps at least this much, and less than a half, is of the object but badly placed."""


@dataclass(frozen=True)
class Missed:
    """Why a thing is not among the candidates.

    Attributes
    ----------
    kind : str
        RANK: the detector gave it, but others stood before it (K) or over it (suppression of overlapping boxes).
        THRESHOLD: it gave it with less than the minimum score.
        LOCALISATION: the best box overlaps it by .1 to .5.
        ABSENT: nothing overlaps it by .1.
    overlap : float
        The best IoU of all boxes seen.
    score : float or None
        Of the box that was cut off, or of the best overlapping one.
    rank : int or None
        With RANK: its place from 1 by score, before suppression.
    suppressed : bool
        With RANK: a better-scored box overlapped it too much.
    """

    kind: Miss
    overlap: float
    score: float | None = None
    rank: int | None = None
    suppressed: bool = False


def why_missed(
    frame: Frame,
    name: str,
    right: np.ndarray,
    k: int,
    detector: Detector,
    unfiltered: Callable[[], Detector],
) -> Missed:
    """Look for a right box among all that the detector gives, then among what it drops.

    Parameters
    ----------
    frame : Frame
    name : str
        The class name that was asked.
    right : (M, 4) float
        Boxes of the objects that would have been right, pixels.
    k : int
    detector : Detector
    unfiltered : callable
        Gives the same detector without a minimum score; called only when it is needed.
    """
    seen = _detections(detector, frame, name)
    best = 0.0
    score: float | None = None
    if seen is not None and len(seen):
        overlap = iou_2d(seen.boxes, right).max(axis=1, initial=0.0)
        order = np.argsort(-seen.scores, kind="stable")
        hits = np.flatnonzero(overlap[order] >= HIT)
        if len(hits):
            rank = int(hits[0])
            survives = set(suppress(seen.boxes[order]).tolist())
            return Missed(
                "RANK",
                float(overlap[order[rank]]),
                float(seen.scores[order[rank]]),
                rank + 1,
                not detector.exact and not any(int(h) in survives for h in hits),
            )
        best, score = float(overlap.max()), float(seen.scores[int(overlap.argmax())])
    loose = _detections(unfiltered(), frame, name)
    if loose is not None and len(loose):
        overlap = iou_2d(loose.boxes, right).max(axis=1, initial=0.0)
        if overlap.max() >= HIT:
            at = int(np.where(overlap >= HIT, loose.scores, -1.0).argmax())
            return Missed("THRESHOLD", float(overlap[at]), float(loose.scores[at]))
        if overlap.max() > best:
            best, score = float(overlap.max()), float(loose.scores[int(overlap.argmax())])
    return Missed("LOCALISATION", best, score) if best >= NEAR_MISS else Missed("ABSENT", best)


def _detections(detector: Detector, frame: Frame, name: str) -> Proposals | None:
    """All detections of a name; None where the detector cannot know it."""
    try:
        return detector.detect(frame, [name])
    except InputError:
        return None
