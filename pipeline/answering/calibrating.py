"""Score calibration on detections of annotated frames, as hits and misses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.datasets.base import scene_of
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.metrics.calibration_metrics import (
    FEWEST_POSITIVES,
    IDENTITY,
    brier_score,
    expected_calibration_error,
    reliability_diagram,
    sigmoid,
)
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Detector, top_k
from pipeline.proposals.score_calibration import (
    HIT_IOU,
    RELIABILITY_BINS,
    SCORE_LIMIT,
    FittedFrame,
    ScoreCalibration,
    fit_scores,
    score_logit,
)
from pipeline.system.errors import InputError, UnknownClass, require

ClassNames = Callable[[Frame], Sequence[str]]


def annotated_names(frame: Frame) -> tuple[str, ...]:
    """Classes in a frame, the names asked by expressions about it."""
    return tuple(dict.fromkeys(a.label for a in frame.annotations))


def collect_hits(
    source: Pipeline,
    frame_ids: Sequence[str],
    class_names: ClassNames = annotated_names,
    *,
    progress: Callable[[int, int], None] | None = None,
    skipped: Callable[[str, str], None] | None = None,
    used: Callable[[Frame], None] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Collect detections as `ask` gets them, with their hits.

    `source`: A dataset with annotations, and a detector; `frame_ids`: broken frames are left out, with their reason to
    `skipped`; `class_names`: the names to be asked for in a frame, each by itself; names that the detector does not
    know are left out; `progress`: called with (frames done, frames in all); `used`: called with each frame that was not
    left out. Returns `scores` (N,) float64; `hits` (N,) bool; `frames` (N,) int64: which of `frame_ids` each is of.
    """
    detector = source.needed_detector()
    require(not detector.exact, f"the detections of {detector.name!r} are the truth: there is nothing to calibrate")
    require(source.dataset.class_names, "a calibration needs a dataset with annotations", path=source.dataset.root)
    truth = AnnotationDetector(source.dataset.class_names, source.synonyms)
    parts: list[tuple[np.ndarray, np.ndarray, int]] = []
    for n, frame_id in enumerate(frame_ids):
        try:
            frame = source.dataset.load(frame_id)
            parts += [(*pair, n) for pair in _of_frame(frame, detector, truth, class_names(frame), source.config.k)]
            if used is not None:
                used(frame)
        except InputError as error:
            if skipped is not None:
                skipped(frame_id, str(error))
        if progress is not None:
            progress(n + 1, len(frame_ids))
    return (
        np.concatenate([np.zeros(0), *(s for s, _, _ in parts)]),
        np.concatenate([np.zeros(0, np.bool_), *(h for _, h, _ in parts)]),
        np.concatenate([np.zeros(0, np.int64), *(np.full(len(s), n) for s, _, n in parts)]),
    )


def _of_frame(
    frame: Frame, detector: Detector, truth: AnnotationDetector, names: Sequence[str], k: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    pairs = []
    for name in names:
        try:
            found = top_k(detector.detect(frame, [name]), k)
        except UnknownClass:
            continue
        overlap = iou_2d(found.boxes, truth.detect(frame, [name]).boxes)
        pairs.append((found.scores.astype(np.float64), (overlap >= HIT_IOU).any(axis=1)))
    return pairs


def calibrate_scores(
    source: Pipeline,
    frame_ids: Sequence[str],
    class_names: ClassNames = annotated_names,
    *,
    progress: Callable[[int, int], None] | None = None,
    skipped: Callable[[str, str], None] | None = None,
) -> tuple[ScoreCalibration, dict[str, Any]]:
    """Fit a detector's calibration on frames, and measure its effect by halves.

    The figures `after` are of each half of the frames, in their order, under the sigmoid that was fitted on the
    other half; the calibration itself is fitted on all.

    Returns
    -------
    report : dict
        `frames`, `detections`, `hits`, `fitted` (False for the identity), `before` and `after`: each with `brier`,
        `ece` (15 bins), `log_loss` and `reliability`, a list of {low, high, count, score, hits} by bin of score.
    """
    fitted_on: list[FittedFrame] = []
    dataset = source.dataset

    def note(frame: Frame) -> None:
        fitted_on.append(FittedFrame(frame.id, scene_of(dataset, frame.id), frame.content_hash))

    scores, hits, frames = collect_hits(source, frame_ids, class_names, progress=progress, skipped=skipped, used=note)
    require(len(scores), "the detector found nothing in these frames", cause="are they the right ones?")
    a, b = fit_scores(scores, hits)
    fingerprint = source.needed_detector().fingerprint()
    calibration = ScoreCalibration(
        fingerprint,
        a,
        b,
        int(hits.sum()),
        int((~hits).sum()),
        source.config.k,
        dataset.root.resolve().name,
        tuple(fitted_on),
    )
    first = frames < (len(frame_ids) + 1) // 2
    after = scores.astype(np.float64)
    for fold in (first, ~first):
        slope, offset = fit_scores(scores[~fold], hits[~fold])
        if (slope, offset) != IDENTITY:
            after[fold] = sigmoid(slope * score_logit(scores[fold]) + offset)
    report = {
        "frames": len(np.unique(frames)),
        "detections": len(scores),
        "hits": int(hits.sum()),
        "fewest": FEWEST_POSITIVES,
        "fitted": not calibration.identity,
        "before": reliability(scores, hits),
        "after": reliability(after, hits),
    }
    return calibration, report


def reliability(p: np.ndarray, hits: np.ndarray) -> dict[str, Any]:
    """Calibration figures of scores (N,) in 0..1, given the hits (N,) bool."""
    diagram = reliability_diagram(p, hits, RELIABILITY_BINS)
    rows = [
        {
            "low": round(float(diagram.edges[k]), 6),
            "high": round(float(diagram.edges[k + 1]), 6),
            "count": int(diagram.count[k]),
            "score": round(float(diagram.confidence[k]), 4),
            "hits": round(float(diagram.frequency[k]), 4),
        }
        for k in np.flatnonzero(diagram.count)
    ]
    q = np.clip(p, SCORE_LIMIT, 1 - SCORE_LIMIT)
    return {
        "brier": brier_score(p, hits),
        "ece": expected_calibration_error(p, hits),
        "log_loss": float(-np.where(hits, np.log(q), np.log1p(-q)).mean()),
        "reliability": rows,
    }
