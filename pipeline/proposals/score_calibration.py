"""Detector scores that mean what they say: Platt's sigmoid on the logit, one for each detector.

s~ = 1 / (1 + exp(-(a * logit(s) + b))) with a > 0, so that the order within a detector stays. What changes is how
sharply a score speaks against the other factors of a pair. Fitted on detections of held-out frames, made as `ask`
makes them: for each name by itself, suppressed, the K best. A detection is a hit where its box has an IoU of at least
0.5 with an annotated object of the class that was asked for.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.metrics.platt import FEWEST_POSITIVES, IDENTITY, Platt, fit_platt, sigmoid
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Detector
from pipeline.proposals.selection import top_k
from pipeline.system.errors import InputError, UnknownClass

if TYPE_CHECKING:
    from pipeline.answering.source import Source

SCORE_LIMIT = 1e-6
"""Scores are clipped to this and one minus this before their logit is taken."""
HIT_IOU = 0.5
RELIABILITY_BINS = 10
FORMAT = "spatialviz-score-calibration-1"

ClassNames = Callable[[Frame], Sequence[str]]


@dataclass(frozen=True)
class FittedFrame:
    """A frame that a calibration was fitted on.

    Attributes
    ----------
    frame, scene : str
    rgb_hash : str
        `Frame.content_hash`: the picture, under whatever name and path it is met again.
    """

    frame: str
    scene: str
    rgb_hash: str


@dataclass(frozen=True)
class ScoreCalibration:
    """A fitted sigmoid, and whose scores it is for.

    Attributes
    ----------
    detector : str or None
        Fingerprint; None for any detector.
    a, b : float
        Slope, above 0, and offset on the logit.
    positives, negatives : int
        Hits and other detections that it was fitted on.
    k : int
        Proposals of each name among them.
    dataset : str or None
        Folder name of the dataset it was fitted on.
    frames : tuple of FittedFrame
        What it was fitted on; empty where that is not known.
    """

    detector: str | None
    a: float
    b: float
    positives: int
    negatives: int
    k: int
    dataset: str | None = None
    frames: tuple[FittedFrame, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        if not (np.isfinite([self.a, self.b]).all() and self.a > 0):
            raise InputError("a score calibration needs a finite slope above 0", got=f"a={self.a}, b={self.b}")

    @property
    def identity(self) -> bool:
        """It changes nothing: there were too few hits or misses to fit it."""
        return (self.a, self.b) == IDENTITY

    def apply(self, scores: np.ndarray) -> np.ndarray:
        """Calibrated scores (N,) float64, in the order of the raw ones (N,)."""
        if self.identity:
            return np.asarray(scores, np.float64)
        return sigmoid(self.a * score_logit(scores) + self.b)

    def check(self, detector: Detector) -> None:
        """Refuse another detector.

        Raises
        ------
        InputError
            The calibration was fitted on the scores of another detector, model or setting.
        """
        if self.detector is not None and not detector.exact and self.detector != detector.fingerprint():
            raise InputError(
                "the score calibration is of another detector",
                got=detector.fingerprint(),
                expected=self.detector,
                cause="another model, recording or minimum score? --force-calibration uses it all the same",
            )

    def for_any(self) -> ScoreCalibration:
        """The same for any detector."""
        return replace(self, detector=None)


class _FittedFrame(BaseModel):
    """An entry of the file's frames."""

    model_config = ConfigDict(extra="ignore")
    frame: str
    scene: str
    rgb_hash: str


class _File(BaseModel):
    """A score calibration as JSON; what else the file says is not looked at."""

    model_config = ConfigDict(extra="ignore")
    format: str = Field(pattern=f"^{FORMAT}$")
    detector: str | None
    a: FiniteFloat = Field(gt=0)
    b: FiniteFloat
    positives: int = Field(ge=0)
    negatives: int = Field(ge=0)
    k: int = Field(ge=1)
    dataset: str | None = None
    frames: tuple[_FittedFrame, ...] = ()


def save_calibration(calibration: ScoreCalibration, path: str | Path, report: dict[str, Any] | None = None) -> None:
    """Write a calibration as JSON, whole or not at all; `report` (see `calibrate_scores`) goes with it."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    record = {"format": FORMAT, **asdict(calibration)} | ({} if report is None else {"report": report})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def load_calibration(path: str | Path) -> ScoreCalibration:
    """Read what `save_calibration` wrote.

    Raises
    ------
    InputError
        The file cannot be read, or is no score calibration.
    """
    path = Path(path)
    try:
        content = _File.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError("the score calibration cannot be read", got=reason, path=path) from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(p) for p in first["loc"]) or "the top"
        raise InputError(f"this is no score calibration, by its {place}", got=first["msg"], path=path) from error
    frames = tuple(FittedFrame(f.frame, f.scene, f.rgb_hash) for f in content.frames)
    return ScoreCalibration(**content.model_dump(exclude={"format", "frames"}), frames=frames)


def score_logit(scores: np.ndarray) -> np.ndarray:
    """(N,) float64 logits of scores (N,), clipped to 1e-6 and 1 - 1e-6."""
    s = np.clip(np.asarray(scores, np.float64), SCORE_LIMIT, 1 - SCORE_LIMIT)
    return np.log(s) - np.log1p(-s)


def fit_scores(scores: np.ndarray, hits: np.ndarray) -> Platt:
    """Platt's sigmoid for detector scores; the identity with fewer than 50 hits or 50 misses, or where it would fall.

    Parameters
    ----------
    scores : (N,) float
        0..1.
    hits : (N,) bool
    """
    return fit_platt(score_logit(scores), np.asarray(hits, np.bool_))


def annotated_names(frame: Frame) -> tuple[str, ...]:
    """The classes that are in a frame: what expressions about it ask for."""
    return tuple(dict.fromkeys(a.label for a in frame.annotations))


def collect_hits(
    source: Source,
    frame_ids: Sequence[str],
    class_names: ClassNames = annotated_names,
    *,
    progress: Callable[[int, int], None] | None = None,
    skipped: Callable[[str, str], None] | None = None,
    used: Callable[[Frame], None] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Detections as `ask` gets them, and which of them are hits.

    Parameters
    ----------
    source : Source
        A dataset with annotations, and a detector.
    frame_ids : sequence of str
        Broken frames are left out, with their reason to `skipped`.
    class_names : callable
        The names to be asked for in a frame, each by itself; names that the detector does not know are left out.
    progress : callable, optional
        Called with (frames done, frames in all).
    used : callable, optional
        Called with each frame that was not left out.

    Returns
    -------
    scores : (N,) float64
    hits : (N,) bool
    frames : (N,) int64
        Which of `frame_ids` each is of.

    Raises
    ------
    InputError
        There is no detector, it is the truth itself, or the dataset has no annotations.
    """
    detector = source.needed_detector()
    if detector.exact:
        raise InputError(f"the detections of {detector.name!r} are the truth: there is nothing to calibrate")
    if not source.dataset.class_names:
        raise InputError("a calibration needs a dataset with annotations", path=source.dataset.root)
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
    source: Source,
    frame_ids: Sequence[str],
    class_names: ClassNames = annotated_names,
    *,
    progress: Callable[[int, int], None] | None = None,
    skipped: Callable[[str, str], None] | None = None,
) -> tuple[ScoreCalibration, dict[str, Any]]:
    """Fit a detector's calibration on frames, and measure honestly what it does.

    The figures `after` are of each half of the frames, in their order, under the sigmoid that was fitted on the
    other half; the calibration itself is fitted on all.

    Returns
    -------
    calibration : ScoreCalibration
    report : dict
        `frames`, `detections`, `hits`, `fitted` (False for the identity), `before` and `after`: each with `brier`,
        `ece` (15 bins), `log_loss` and `reliability`, a list of {low, high, count, score, hits} by bin of score.
    """
    # The labels import the jobs, which import this.
    from pipeline.datasets.base import scene_of

    fitted_on: list[FittedFrame] = []
    dataset = source.dataset

    def note(frame: Frame) -> None:
        fitted_on.append(FittedFrame(frame.id, scene_of(dataset, frame.id), frame.content_hash))

    scores, hits, frames = collect_hits(source, frame_ids, class_names, progress=progress, skipped=skipped, used=note)
    if not len(scores):
        raise InputError("the detector found nothing in these frames", cause="are they the right ones?")
    a, b = fit_scores(scores, hits)
    fingerprint = source.needed_detector().fingerprint()
    calibration = ScoreCalibration(
        fingerprint, a, b, int(hits.sum()), int((~hits).sum()), source.config.k, dataset.root.resolve().name,
        tuple(fitted_on),
    )  # fmt: skip
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
    """How well scores (N,) in 0..1 say how often they are right, given the hits (N,) bool."""
    # The evaluation asks questions itself, and so imports what imports this.
    from pipeline.metrics.calibration_metrics import brier_score, expected_calibration_error, reliability_diagram

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
