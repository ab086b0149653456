"""Reasons for a right object missing among the candidates: cut off, below the threshold, badly placed, or not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.needed_score import loose_candidate, needed_score
from pipeline.diagnosis.oracles import OracleScores
from pipeline.diagnosis.verdict import Diagnosis, Missed
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import HIT, Case
from pipeline.proposals.base import Detector, Proposals, suppress
from pipeline.system.errors import InputError


def not_proposed(evidence: FrameEvidence, case: Case, found: OracleScores, diagnosis: Diagnosis) -> Diagnosis | None:
    """OPM-TARGET or OPM-REF, without a right target or a right pair among the candidates; else None."""
    if not found.right[: found.target.found].any():
        missed = missed_of(evidence, case.target, case.acceptable)
        known = _known(evidence, case, found, missed, case.target, case.acceptable)
        return replace(diagnosis, verdict="OPM-TARGET", **known)
    if not found.covered[: found.target.found, : found.reference.found].any():
        pairs = evidence.truth.acceptable_pairs(case)
        shown = found.target.overlap[: found.target.found] >= HIT
        wanted = pairs[np.asarray((shown & np.asarray(pairs.any(axis=1))[None]).any(axis=0))].any(axis=0)
        missed = missed_of(evidence, case.reference, np.flatnonzero(wanted))
        known = _known(evidence, case, found, missed, case.reference, np.flatnonzero(wanted))
        return replace(diagnosis, verdict="OPM-REF", **known)
    return None


def _known(
    evidence: FrameEvidence, case: Case, found: OracleScores, missed: Missed, name: str, objects: np.ndarray
) -> dict[str, Any]:
    """Fields of a verdict on a missing object, `objects` those that would have been right."""
    loose = loose_candidate(evidence, name, objects, NEAR_MISS) if missed.kind == "LOCALISATION" else None
    needed = needed_score(evidence, case, found, loose)
    return {"detail": missed.kind, "missed": missed, "missed_name": name, "needed_score": needed}


def missed_of(evidence: FrameEvidence, name: str, objects: np.ndarray) -> Missed:
    """Reason for missing these labelled objects (indices); made once for all expressions of the frame."""
    key, pipeline = (name, objects.tobytes()), evidence.answers.source
    if key not in evidence.missed:
        evidence.missed[key] = why_missed(
            evidence.answers.context.frame,
            name,
            evidence.truth.boxes[objects],
            pipeline.config.k,
            pipeline.needed_detector(),
            pipeline.unfiltered_detector,
        )
    return evidence.missed[key]


NEAR_MISS = 0.1
"""A box that overlaps at least this much, and less than a half, is of the object but badly placed."""


def why_missed(
    frame: Frame,
    name: str,
    right: np.ndarray,
    k: int,
    detector: Detector,
    unfiltered: Callable[[], Detector],
) -> Missed:
    """Look for a right box among all detections, then among the dropped ones.

    `name`: the class name that was asked; `right`: (M, 4) float: boxes of the objects that would have been right,
    pixels; `unfiltered`: gives the same detector without a minimum score; called only when it is needed.
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
    """Detections of a name; None for a name unknown to the detector."""
    try:
        # An imported file also tells of what did not go on.
        return getattr(detector, "detect_with_dropped", detector.detect)(frame, [name])
    except InputError:
        return None
