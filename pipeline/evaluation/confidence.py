"""How confident the detector is where it is right: the score of an object that the oracle RECALL adds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.answering.ask import propose
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.opening import Pipeline
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, FrameCases, read_cases
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    from pipeline.labels.reading import Labels

LOOKED_AT = 64
"""Frames that are looked at, spread evenly over those with expressions: to detect in all would double the cost."""


def right_scores(source: Pipeline, context: PreparedFrame, truth: FrameCases) -> np.ndarray:
    """(M,) float64: scores of all candidates that are objects of the class that was asked for, over a frame's names."""
    detector = source.needed_detector()
    calibration = None if detector.exact else source.config.score_calibration
    asked = {case.target: case.target_object for case in truth.cases}
    asked |= {case.reference: case.reference_object for case in truth.cases}
    found = [np.zeros(0)]
    for name, example in asked.items():
        try:
            proposals = propose(context, detector, name, source.config.k)
        except InputError:
            continue
        hit = (iou_2d(proposals.boxes, truth.boxes[truth.alike[example]]) >= HIT).any(axis=1)
        scores = proposals.scores[hit].astype(np.float64)
        found.append(scores if calibration is None else calibration.apply(scores))
    return np.concatenate(found)


def median_confidence(source: Pipeline, labels: Labels, looked_at: int = LOOKED_AT) -> tuple[float | None, int]:
    """The median score of right candidates and how many there were; None where there was none.

    Parameters
    ----------
    source : Pipeline
    labels : Labels
    looked_at : int
        Frames that are looked at, spread evenly.
    """
    import pyarrow.parquet as pq

    column = pq.read_table(labels.root / "expressions.parquet", columns=["frame_index"]).column(0)
    frames = np.unique(column.to_numpy())
    if not len(frames):
        return None, 0
    chosen = frames[np.unique(np.linspace(0, len(frames) - 1, min(looked_at, len(frames))).astype(int))]
    found = [np.zeros(0)]
    for index in chosen.tolist():
        for truth in read_cases(labels, index, index + 1):
            try:
                context = prepare_frame(source.dataset, source.dataset.load(truth.frame), source.config.lift)
                found.append(right_scores(source, context, truth))
            except InputError:
                continue
    scores = np.concatenate(found)
    return (float(np.median(scores)) if len(scores) else None), len(scores)
