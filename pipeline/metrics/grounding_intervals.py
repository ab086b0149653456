"""Grounding metrics with intervals, and what two systems differ by on the same expressions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.metrics.counts import ratio
from pipeline.metrics.grounding_metrics import HIT_IOU, GroundingOutcomes
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class GroundingEstimates:
    """Grounding metrics, or differences of two systems. Fractions, 0..1.

    Attributes
    ----------
    accuracy_single, accuracy_strict, accuracy_set : Estimate
        Share of hits: of the own target, of a strict answer, of an acceptable one.
    mean_iou_single, mean_iou_strict, mean_iou_set : Estimate
        Mean IoU with the own target; mean of the largest IoU with the set.
    reference_accuracy, pair_accuracy : Estimate
    answered : Estimate
        Share of expressions with a prediction.
    """

    accuracy_single: Estimate
    accuracy_strict: Estimate
    accuracy_set: Estimate
    mean_iou_single: Estimate
    mean_iou_strict: Estimate
    mean_iou_set: Estimate
    reference_accuracy: Estimate
    pair_accuracy: Estimate
    answered: Estimate


def grounding_estimates(
    outcomes: GroundingOutcomes,
    clusters: Any,
    *,
    other: GroundingOutcomes | None = None,
    threshold: float = HIT_IOU,
    config: BootstrapConfig | None = None,
) -> GroundingEstimates:
    """All grounding metrics, from one set of resamples.

    Parameters
    ----------
    outcomes : GroundingOutcomes
        Of N expressions, from `grounding_outcomes`.
    clusters : (N,) int or str
        Scene of each expression, or frame where there is one scene.
    other : GroundingOutcomes, optional
        Another system's on the same expressions: the estimates are then the
        metrics of `outcomes` less those of `other`.
    threshold : float
        IoU from which on a box is a hit.
    config : BootstrapConfig, optional

    Raises
    ------
    InputError
        Not one cluster an expression, or systems that were not asked the same.
    """
    if not 0 < threshold <= 1:
        raise InputError("the IoU of a hit must lie above 0 and up to 1", got=threshold)
    values = _values(outcomes, threshold)
    applies = ~np.isnan(values)
    rows, second = _rows(values), None
    if other is not None:
        theirs = _values(other, threshold)
        if not np.array_equal(applies, ~np.isnan(theirs)):
            raise InputError("two systems can only be compared on the same expressions and the same acceptable answers")
        second = _rows(theirs)
    found = bootstrap(rows, clusters, _ratios, counted=applies, other=second, config=config)
    return GroundingEstimates(*found)


def _values(outcomes: GroundingOutcomes, threshold: float) -> np.ndarray:
    """(N, 9) float64 in the order of GroundingEstimates; NaN where a figure does not apply."""
    ious = np.stack([outcomes.iou, outcomes.iou_strict, outcomes.iou_set], axis=1)
    hits = np.where(np.isnan(ious), np.nan, ious >= threshold)
    rest = np.stack([outcomes.reference_right, outcomes.pair_right, outcomes.answered.astype(np.float64)], axis=1)
    return np.concatenate([hits, ious, rest], axis=1)


def _rows(values: np.ndarray) -> np.ndarray:
    applies = ~np.isnan(values)
    return np.stack([np.where(applies, values, 0.0), applies.astype(np.float64)], axis=2)


def _ratios(sums: np.ndarray) -> np.ndarray:
    return ratio(sums[..., 0], sums[..., 1])
