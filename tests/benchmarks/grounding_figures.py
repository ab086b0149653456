"""How right boxes are that answer expressions, from arrays: what the figures of records are checked against.

IoU of continuous x0, y0, x1, y1 boxes; a hit from 0.5 on, of the first answer
only. (EmbodiedScan's metric takes any of ten answers, and more than 0.5.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.geometry.boxes import paired_iou_2d
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, mean_of_defined, ratio
from pipeline.system.errors import InputError, require

HIT_IOU = 0.5
SWEEP = np.round(np.arange(1, 20) * 0.05, 2)
"""0.05, 0.10 .. 0.95."""


def checked_boxes(boxes: Any, what: str, may_miss: bool = False) -> np.ndarray:
    """Check boxes, (N, 4) float64, x0, y0, x1, y1 with x1 >= x0 and y1 >= y0; rows of NaN only where `may_miss`."""
    found = np.asarray(boxes)
    if found.size == 0 and found.ndim <= 2:
        found = np.zeros((0, 4))
    require(
        found.ndim == 2 and found.shape[1] == 4 and found.dtype.kind in "iuf",
        f"{what} must be boxes of shape (N, 4)",
        got=f"{found.dtype} {found.shape}",
    )
    found = found.astype(np.float64)
    finite = np.isfinite(found)
    wrong = ~finite.all(axis=1)
    if may_miss:
        wrong &= ~np.isnan(found).all(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        asked = "finite, or NaN as a whole," if may_miss else "finite"
        raise InputError(f"{what} must be {asked}", got=f"{found[row].tolist()} in row {row}")
    swapped = (found[:, 2:] < found[:, :2]).any(axis=1)
    if swapped.any():
        row = int(swapped.argmax())
        raise InputError(
            f"{what} must be x0, y0, x1, y1 with x1 >= x0 and y1 >= y0",
            got=f"{found[row].tolist()} in row {row}",
            cause="is this x, y, width, height?",
        )
    return found


@dataclass(frozen=True)
class GroundingOutcomes:
    """What became of each expression; NaN where a figure does not apply to it.

    Attributes
    ----------
    answered : (N,) bool
        Whether there was a prediction.
    iou : (N,) float64
        With the expression's own target.
    iou_strict, iou_set : (N,) float64
        Largest one with any target that is T, that is T or U; NaN where there is none.
    reference_right, pair_right : (N,) float64
        1 right, 0 wrong, NaN where none was asked for.
    """

    answered: np.ndarray
    iou: np.ndarray
    iou_strict: np.ndarray
    iou_set: np.ndarray
    reference_right: np.ndarray
    pair_right: np.ndarray

    def hits(self, threshold: float = HIT_IOU) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) bool each: of the own target, of a strict answer, of an acceptable one; false where there is none."""
        return self.iou >= threshold, self.iou_strict >= threshold, self.iou_set >= threshold


@dataclass(frozen=True)
class ThresholdSweep:
    """Accuracy by the IoU that makes a hit.

    Attributes
    ----------
    thresholds, single, strict, acceptable : (T,) float64
    """

    thresholds: np.ndarray
    single: np.ndarray
    strict: np.ndarray
    acceptable: np.ndarray


def grounding_outcomes(
    predicted: Any,
    truth: Any,
    strict: Sequence[Any],
    acceptable: Sequence[Any],
    reference_right: Any | None = None,
    pair_right: Any | None = None,
) -> GroundingOutcomes:
    """IoUs of N answers with their targets and acceptable sets.

    Parameters
    ----------
    predicted : (N, 4) float
        Box of the first answer, pixels; a row of NaN is no answer, with IoU 0.
    truth : (N, 4) float
        Box of the expression's own target.
    strict, acceptable : sequence of N (K_i, 4) float
        Boxes of all targets that are T, that are T or U. They should hold the
        own target; an empty one leaves the expression out of that figure.
    reference_right, pair_right : (N,) bool or float, optional
        Whether the reference, the whole pair, is right; NaN where none was asked for.

    Raises
    ------
    InputError
        Numbers of rows that differ, boxes that are not finite or have swapped corners.
    """
    predicted = checked_boxes(predicted, "predicted boxes", may_miss=True)
    truth = checked_boxes(truth, "target boxes")
    if len(truth) != len(predicted):
        raise InputError("there must be one target for each prediction", got=len(truth), expected=len(predicted))
    return GroundingOutcomes(
        answered=~np.isnan(predicted[:, 0]),
        iou=paired_iou_2d(predicted, truth),
        iou_strict=largest_iou(predicted, strict, "strict answers"),
        iou_set=largest_iou(predicted, acceptable, "acceptable answers"),
        reference_right=_judged(reference_right, len(predicted), "reference_right"),
        pair_right=_judged(pair_right, len(predicted), "pair_right"),
    )


def largest_iou(predicted: Any, sets: Sequence[Any], what: str = "answers") -> np.ndarray:
    """Largest IoU of each of (N, 4) predictions with the boxes of its own set.

    Parameters
    ----------
    predicted : (N, 4) float
        Rows of NaN are no prediction.
    sets : sequence of N (K_i, 4) float

    Returns
    -------
    (N,) float64
        NaN where the set is empty.
    """
    predicted = checked_boxes(predicted, "predicted boxes", may_miss=True)
    if len(sets) != len(predicted):
        raise InputError(f"there must be a set of {what} for each prediction", got=len(sets), expected=len(predicted))
    arrays = [np.asarray(s, np.float64) if len(s) else np.zeros((0, 4)) for s in sets]
    for row, array in enumerate(arrays):
        if array.ndim != 2 or array.shape[1] != 4:
            raise InputError(f"{what} must be boxes of shape (K, 4)", got=f"{array.shape} in row {row}")
    boxes = checked_boxes(np.concatenate(arrays) if arrays else np.zeros((0, 4)), what)
    sizes = np.array([len(a) for a in arrays], np.int64)
    found = np.full(len(predicted), np.nan)
    filled = np.flatnonzero(sizes)
    if len(filled):
        iou = paired_iou_2d(predicted.repeat(sizes, axis=0), boxes)
        found[filled] = np.maximum.reduceat(iou, (np.cumsum(sizes) - sizes)[filled])
    return found


def threshold_sweep(outcomes: GroundingOutcomes, thresholds: Any = SWEEP) -> ThresholdSweep:
    """Share of the expressions with an IoU of at least each threshold; NaN where no expression counts.

    Parameters
    ----------
    thresholds : (T,) float
        Above 0: an IoU of 0 is never a hit.
    """
    cut = np.atleast_1d(np.asarray(thresholds, np.float64))
    if cut.ndim != 1 or not ((cut > 0) & (cut <= 1)).all():
        raise InputError("thresholds of IoU must lie above 0 and up to 1", got=cut.tolist())
    return ThresholdSweep(cut, *(_shares(iou, cut) for iou in (outcomes.iou, outcomes.iou_strict, outcomes.iou_set)))


def _shares(iou: np.ndarray, cut: np.ndarray) -> np.ndarray:
    known = np.sort(iou[~np.isnan(iou)])
    if not len(known):
        return np.full(len(cut), np.nan)
    return (len(known) - np.searchsorted(known, cut, side="left")) / len(known)


def mean_iou(outcomes: GroundingOutcomes) -> tuple[float, float, float]:
    """Mean IoU with the own target, with the best strict answer, with the best acceptable one; fractions, 0..1."""
    a, b, c = mean_of_defined(np.stack([outcomes.iou, outcomes.iou_strict, outcomes.iou_set])).tolist()
    return a, b, c


def _judged(right: Any | None, n: int, what: str) -> np.ndarray:
    if right is None:
        return np.full(n, np.nan)
    found = np.asarray(right)
    if found.shape != (n,) or found.dtype.kind not in "biuf":
        raise InputError(f"{what} must be one truth value a row", got=f"{found.dtype} {found.shape}", expected=(n,))
    found = found.astype(np.float64)
    if not ((found == 0) | (found == 1) | np.isnan(found)).all():
        raise InputError(f"{what} must be 0, 1 or NaN")
    return found


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
