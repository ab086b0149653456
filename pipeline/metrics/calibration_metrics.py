"""Whether probabilities mean what they say: Brier score, expected calibration error, reliability diagrams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.counts import ratio
from pipeline.metrics.inputs import checked_cells, checked_flags, checked_names, checked_probabilities
from pipeline.system.errors import InputError

ECE_BINS = 15


@dataclass(frozen=True)
class ReliabilityDiagram:
    """Probabilities in bins of equal width [k/B, (k+1)/B), the last with its end.

    Attributes
    ----------
    edges : (B + 1,) float64
    count : (B,) int64
    confidence : (B,) float64
        Mean probability; NaN in an empty bin.
    frequency : (B,) float64
        Share of what holds; NaN in an empty bin.
    """

    edges: np.ndarray
    count: np.ndarray
    confidence: np.ndarray
    frequency: np.ndarray

    @property
    def ece(self) -> float:
        """Expected calibration error: |confidence - frequency| over the bins, weighted by count; NaN without any.

        Naeini et al., AAAI 2015.
        """
        gap = np.abs(self.confidence - self.frequency)
        return float(ratio(np.where(self.count > 0, gap * self.count, 0.0).sum(), self.count.sum()))


@dataclass(frozen=True)
class CalibrationMetrics:
    """Calibration of each relation and of all known cells together; NaN where no cell is known.

    Attributes
    ----------
    relations : tuple of str
    brier, ece : (R,) float64
    diagrams : tuple of ReliabilityDiagram
    pooled_brier, pooled_ece : float
    pooled : ReliabilityDiagram
    """

    relations: tuple[str, ...]
    brier: np.ndarray
    ece: np.ndarray
    diagrams: tuple[ReliabilityDiagram, ...]
    pooled_brier: float
    pooled_ece: float
    pooled: ReliabilityDiagram


def reliability_diagram(p: Any, holds: Any, bins: int = ECE_BINS) -> ReliabilityDiagram:
    """Mean probability and frequency by bins of probability.

    For a softmax, `p` is the largest probability of each row and `holds` says
    whether its relation is the true one.

    Parameters
    ----------
    p : (M,) float
        0..1.
    holds : (M,) bool

    Raises
    ------
    InputError
        Lengths differ, probabilities are NaN or outside 0..1, or there is no bin.
    """
    p, holds = _checked(p, holds)
    if bins < 1:
        raise InputError("a reliability diagram needs at least one bin", got=bins)
    index = np.minimum((p * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    confidence = ratio(np.bincount(index, p, bins), count)
    frequency = ratio(np.bincount(index, holds.astype(np.float64), bins), count)
    return ReliabilityDiagram(np.linspace(0.0, 1.0, bins + 1), count, confidence, frequency)


def expected_calibration_error(p: Any, holds: Any, bins: int = ECE_BINS) -> float:
    """`ReliabilityDiagram.ece` of (M,) probabilities and (M,) bool; NaN without any."""
    return reliability_diagram(p, holds, bins).ece


def brier_score(p: Any, holds: Any) -> float:
    """Mean of (p - [holds])² of (M,) probabilities and (M,) bool; NaN without any."""
    p, holds = _checked(p, holds)
    return float(ratio(np.square(p - holds).sum(), len(p)))


def calibration_metrics(
    p: Any, truth: Any, relations: Sequence[str] = DIRECTIONAL, bins: int = ECE_BINS
) -> CalibrationMetrics:
    """Calibration of multi-label relation probabilities.

    Parameters
    ----------
    p : (P, R) float
    truth : (P, R) int8
        1 T, 0 U (takes no part), -1 F.
    relations : sequence of str
        Names of the R columns.

    Raises
    ------
    InputError
        Shapes differ, probabilities are NaN or outside 0..1, or a state is none.
    """
    p, truth = checked_cells(p, truth)
    names = checked_names(relations, p.shape[1])
    known, holds = truth != 0, truth > 0
    diagrams = tuple(
        reliability_diagram(p[known[:, k], k], holds[known[:, k], k], bins) for k in range(p.shape[1])
    )
    squared = np.where(known, np.square(p - holds), 0.0)
    pooled = reliability_diagram(p[known], holds[known], bins)
    return CalibrationMetrics(
        relations=names,
        brier=ratio(squared.sum(axis=0), known.sum(axis=0)),
        ece=np.array([d.ece for d in diagrams]),
        diagrams=diagrams,
        pooled_brier=float(ratio(squared.sum(), known.sum())),
        pooled_ece=pooled.ece,
        pooled=pooled,
    )


def _checked(p: Any, holds: Any) -> tuple[np.ndarray, np.ndarray]:
    p, holds = checked_probabilities(p, dimensions=1), checked_flags(holds, "what holds")
    if p.shape != holds.shape:
        raise InputError("there must be one truth for each probability", got=holds.shape, expected=p.shape)
    return p, holds
