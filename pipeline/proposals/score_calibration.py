"""Calibration of detector scores: Platt's sigmoid on the logit, per detector.

s~ = 1 / (1 + exp(-(a * logit(s) + b))) with a > 0, so that the order within a detector stays. What changes is how
sharply a score speaks against the other factors of a pair. Fitted on detections of held-out frames, made as `ask`
makes them: for each name by itself, suppressed, the K best. A detection is a hit where its box has an IoU of at least
0.5 with an annotated object of the class that was asked for.
"""

from __future__ import annotations

import json
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.metrics.calibration_metrics import IDENTITY, Platt, fit_platt, sigmoid
from pipeline.proposals.base import Detector
from pipeline.system.errors import as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked
from pipeline.system.safe_files import read_json
from pipeline.system.whole_files import write_whole

SCORE_LIMIT = 1e-6
"""Scores are clipped to this and one minus this before their logit is taken."""
HIT_IOU = 0.5
RELIABILITY_BINS = 10
FORMAT = "spatialviz-score-calibration-1"


@dataclass(frozen=True)
class FittedFrame:
    """A frame used for fitting a calibration.

    Attributes
    ----------
    rgb_hash : str
        `Frame.content_hash`: the picture, under whatever name and path it is met again.
    """

    frame: str
    scene: str
    rgb_hash: str


@dataclass(frozen=True)
class ScoreCalibration:
    """A fitted sigmoid for a detector's scores.

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

    Examples
    --------
    >>> import numpy as np
    >>> from pipeline.proposals import ScoreCalibration
    >>> calibration = ScoreCalibration(None, a=2.0, b=1.0, positives=80, negatives=60, k=10)
    >>> calibration.apply(np.array([0.2, 0.5])).round(3)
    array([0.145, 0.731])
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
        require(
            (np.isfinite([self.a, self.b]).all() and self.a > 0),
            "a score calibration needs a finite slope above 0",
            got=f"a={self.a}, b={self.b}",
        )
        for name, least in (("positives", 0), ("negatives", 0), ("k", 1)):
            require(getattr(self, name) >= least, f"a score calibration needs {name} of at least {least}")

    @property
    def identity(self) -> bool:
        """Test for the identity: too few hits or misses to fit."""
        return (self.a, self.b) == IDENTITY

    def apply(self, scores: np.ndarray) -> np.ndarray:
        """Calibrated scores (N,) float64, for raw scores (N,)."""
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
        require(
            self.detector is None or detector.exact or self.detector == detector.fingerprint(),
            "the score calibration is of another detector",
            got=lambda: detector.fingerprint(),
            expected=self.detector,
            cause="another model, recording or minimum score? --force-calibration uses it all the same",
        )

    def for_any(self) -> ScoreCalibration:
        """Calibration for any detector."""
        return replace(self, detector=None)


def save_calibration(calibration: ScoreCalibration, path: str | Path, report: dict[str, Any] | None = None) -> None:
    """Write a calibration as JSON atomically, with an optional `report`."""
    record = {"format": FORMAT, **asdict(calibration)} | ({} if report is None else {"report": report})
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    write_whole(Path(path), text.encode(), "the score calibration")


def load_calibration(path: str | Path) -> ScoreCalibration:
    """Read a calibration written by `save_calibration`.

    Raises
    ------
    InputError
        The file cannot be read, or is no score calibration.
    """
    path = Path(path)
    with (
        as_input_error("the score calibration cannot be read", ValueError, got=str, path=path),
        as_input_error("the score calibration cannot be read", OSError, got=lambda e: e.strerror, path=path),
    ):
        content = read_json(path)
    wrong = "this is no score calibration, by its {}"
    from pydantic import Field, TypeAdapter, create_model

    marked = create_model("marked", format=(str, Field(pattern=f"^{FORMAT}$")))
    checked(marked.model_validate, content, wrong, path)
    return checked(TypeAdapter(ScoreCalibration).validate_python, content, wrong, path)


def score_logit(scores: np.ndarray) -> np.ndarray:
    """(N,) float64 logits of scores (N,), clipped to 1e-6 and 1 - 1e-6."""
    s = np.clip(np.asarray(scores, np.float64), SCORE_LIMIT, 1 - SCORE_LIMIT)
    return np.log(s) - np.log1p(-s)


def fit_scores(scores: np.ndarray, hits: np.ndarray) -> Platt:
    """Fit Platt's sigmoid to detector scores; identity with fewer than 50 hits or misses, or a falling slope.

    Parameters
    ----------
    scores : (N,) float
        0..1.
    hits : (N,) bool
    """
    return fit_platt(score_logit(scores), np.asarray(hits, np.bool_))
