"""Each expression a second time by the detector's own scores, where they are calibrated.

Detections, boxes and relations are those of the first answer; only the ranking differs.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.answering.answering import FrameAnswers
from pipeline.evaluation.records import DETECTIONS, RAW, matched, record
from pipeline.labels.cases import Case, FrameCases
from pipeline.language.expression import Query

if TYPE_CHECKING:
    import pyarrow as pa


def by_raw_scores(answers: FrameAnswers) -> FrameAnswers | None:
    """The same frame with the detector's own scores; None where they are not calibrated."""
    if answers.source.config.score_calibration is None or answers.source.needed_detector().exact:
        return None
    raw = copy.copy(answers)
    raw.candidates = {
        name: found if found.raw_scores is None else replace(found, scores=found.raw_scores)
        for name, found in answers.candidates.items()
    }
    return raw


def raw_columns(
    case: Case,
    truth: FrameCases,
    answers: FrameAnswers,
    raw: FrameAnswers,
    parsed: tuple[Query | None, str | None],
    overlap: np.ndarray,
) -> dict[str, Any]:
    """What an expression's row says of the raw scores: the answer by them, and which detections are hits.

    A hit has an IoU of at least 0.5 with a labelled object of the class that was asked for; `overlap` is that of each
    detection with each labelled object, (D, N) float64.
    """
    second = record(case, truth, raw, parsed, overlap)
    found: dict[str, Any] = {f"raw_{name}": second[name] for name in RAW}
    ends = (("target", case.target, case.target_object), ("reference", case.reference, case.reference_object))
    for end, name, labelled in ends:
        own, plain = answers.candidates[name], raw.candidates[name]
        alike = np.broadcast_to(truth.alike[labelled], (len(own.index), len(truth.labels)))
        hits = matched(overlap[own.index], alike) >= 0
        lists = (plain.scores.tolist(), own.scores.tolist(), hits.tolist())
        found |= {f"{end}_{what}": values for what, values in zip(DETECTIONS, lists, strict=True)}
    return found


def is_calibrated(records: pa.Table) -> bool:
    """Whether the records hold the answers by raw scores too; those of earlier releases do not."""
    return "raw_iou" in records.column_names and records.column("raw_iou").null_count < records.num_rows


def raw_records(records: pa.Table) -> pa.Table:
    """The records with the answers by the detector's own scores in place of those that were given.

    Columns of the ranking itself (probabilities, margins) stay those of the calibrated one.
    """
    for name in RAW:
        place = records.column_names.index(name)
        records = records.set_column(place, records.schema.field(name), records.column(f"raw_{name}"))
    return records


@dataclass(frozen=True)
class DetectorScores:
    """All detections of a run, each once: a name is asked once of a frame.

    Attributes
    ----------
    raw, calibrated : (D,) float64
    hits : (D,) bool
    frames, scenes : (D,) str
        Of each.
    """

    raw: np.ndarray
    calibrated: np.ndarray
    hits: np.ndarray
    frames: np.ndarray
    scenes: np.ndarray

    @property
    def clusters(self) -> np.ndarray:
        """(D,) what resembles each other: the scene; the frame where there is one scene only."""
        return self.scenes if len(np.unique(self.scenes)) > 1 else self.frames


def detector_scores(records: pa.Table) -> DetectorScores:
    """The detections that calibrated records tell of."""
    parts: dict[tuple[str, str], tuple[Any, Any, Any, str]] = {}
    for end in ("target", "reference"):
        columns = ("frame", end, *(f"{end}_{what}" for what in DETECTIONS), "scene")
        for frame, name, *rest in zip(*(records.column(c).to_pylist() for c in columns), strict=True):
            if rest[0] is not None:
                parts.setdefault((frame, name), tuple(rest))
    lengths = [len(part[0]) for part in parts.values()]
    raw, calibrated = (
        np.array([x for part in parts.values() for x in part[k]], np.float64) for k in (0, 1)
    )
    hits = np.array([x for part in parts.values() for x in part[2]], np.bool_)
    frames = np.repeat(np.array([frame for frame, _ in parts], np.str_), lengths)
    return DetectorScores(raw, calibrated, hits, frames, np.repeat(np.array([p[3] for p in parts.values()]), lengths))
