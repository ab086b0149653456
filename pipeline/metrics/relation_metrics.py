"""How right relation probabilities are where several relations of a pair may hold (multi-label).

Cells whose true state is U are neither right nor wrong: they are masked, and counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.counts import f1_of, mean_of_defined, ratio
from pipeline.metrics.inputs import checked_cells, checked_clusters, checked_names, checked_thresholds
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap
from pipeline.system.errors import InputError

THRESHOLD = 0.5
"""A relation is said to hold where its probability is greater, so that a doubt of exactly one half is a no."""


@dataclass(frozen=True)
class CellOutcomes:
    """What became of each cell; where all four are false, the cell is U.

    Attributes
    ----------
    tp, fp, fn, tn : (P, R) bool
    """

    tp: np.ndarray
    fp: np.ndarray
    fn: np.ndarray
    tn: np.ndarray

    def stacked(self) -> np.ndarray:
        """(P, R, 4) float64 of tp, fp, fn, tn."""
        return np.stack([self.tp, self.fp, self.fn, self.tn], axis=-1).astype(np.float64)


@dataclass(frozen=True)
class RelationMetrics:
    """The figures of a multi-label relation scorer.

    Attributes
    ----------
    relations : tuple of str
        The order of everything with shape (R,).
    pairs : int
    positives, negatives, undecided : (R,) int64
        Cells whose truth is T, F, U.
    tp, fp, fn : (R,) int64
    thresholds : (R,) float64
    precision, recall, f1 : (R,) float64
    average_precision : (R,) float64
        Does not depend on the thresholds.
    micro_f1, macro_f1 : float
        F1 of the counts of all relations; mean F1 over the relations that have one.
    element_accuracy : float
        Share of known cells that are right.
    all_negative_accuracy : float
        The same for a scorer that always says no: the share of negatives.
    mean_average_precision : float
        Over the relations that have one.
    undefined : dict
        Relation -> why some of its figures are NaN.
    """

    relations: tuple[str, ...]
    pairs: int
    positives: np.ndarray
    negatives: np.ndarray
    undecided: np.ndarray
    tp: np.ndarray
    fp: np.ndarray
    fn: np.ndarray
    thresholds: np.ndarray
    precision: np.ndarray
    recall: np.ndarray
    f1: np.ndarray
    average_precision: np.ndarray
    micro_f1: float
    macro_f1: float
    element_accuracy: float
    all_negative_accuracy: float
    mean_average_precision: float
    undefined: dict[str, str]


def cell_outcomes(p: Any, truth: Any, thresholds: Any = THRESHOLD) -> CellOutcomes:
    """Right or wrong, cell by cell.

    Parameters
    ----------
    p : (P, R) float
        Probability that the relation holds, 0..1.
    truth : (P, R) int8
        1 T, 0 U, -1 F.
    thresholds : float or (R,) float
        "Holds" is said where p is greater.

    Raises
    ------
    InputError
        Shapes differ, probabilities are NaN or outside 0..1, or a state is none.
    """
    p, truth = checked_cells(p, truth)
    text = p > checked_thresholds(thresholds, p.shape[1])
    holds, fails = truth > 0, truth < 0
    return CellOutcomes(text & holds, text & fails, ~text & holds, ~text & fails)


def multi_label_metrics(
    p: Any, truth: Any, thresholds: Any = THRESHOLD, relations: Sequence[str] = DIRECTIONAL
) -> RelationMetrics:
    """Every figure of a multi-label relation scorer.

    Parameters
    ----------
    p : (P, R) float
    truth : (P, R) int8
    thresholds : float or (R,) float
        As in `cell_outcomes`; those of `tuned_thresholds` must come from other pairs than these.
    relations : sequence of str
        Names of the R columns.

    Raises
    ------
    InputError
        As in `cell_outcomes`, or names that do not match the columns.
    """
    p, truth = checked_cells(p, truth)
    names = checked_names(relations, p.shape[1])
    cut = checked_thresholds(thresholds, p.shape[1])
    cells = cell_outcomes(p, truth, cut)
    tp, fp, fn, tn = (c.sum(axis=0) for c in (cells.tp, cells.fp, cells.fn, cells.tn))
    f1 = f1_of(tp, fp, fn)
    ap = average_precision(p, truth)
    positives, negatives = tp + fn, fp + tn
    known = positives + negatives
    return RelationMetrics(
        relations=names,
        pairs=len(p),
        positives=positives,
        negatives=negatives,
        undecided=len(p) - known,
        tp=tp,
        fp=fp,
        fn=fn,
        thresholds=cut,
        precision=ratio(tp, tp + fp),
        recall=ratio(tp, positives),
        f1=f1,
        average_precision=ap,
        micro_f1=float(f1_of(tp.sum(), fp.sum(), fn.sum())),
        macro_f1=float(mean_of_defined(f1)),
        element_accuracy=float(ratio((tp + tn).sum(), known.sum())),
        all_negative_accuracy=float(ratio(negatives.sum(), known.sum())),
        mean_average_precision=float(mean_of_defined(ap)),
        undefined=_reasons(names, known, positives, tp + fp),
    )


def average_precision(p: Any, truth: Any) -> np.ndarray:
    """AP of each relation: the sum of (R_n - R_(n-1)) P_n over its distinct probabilities, falling.

    No interpolation; the definition of scikit-learn's average_precision_score.

    Parameters
    ----------
    p : (P, R) float
    truth : (P, R) int8

    Returns
    -------
    (R,) float64
        NaN where no cell holds.
    """
    p, truth = checked_cells(p, truth)
    found = np.full(p.shape[1], np.nan)
    for k in range(p.shape[1]):
        _, tp, text, positives = _ranked(p[:, k], truth[:, k])
        if positives:
            found[k] = (np.diff(tp, prepend=0) * (tp / text)).sum() / positives
    return found


def tuned_thresholds(p_validation: Any, truth_validation: Any) -> np.ndarray:
    """The threshold of each relation with the largest F1 on validation pairs.

    It lies half way between two neighbouring probabilities; of thresholds with
    the same F1 the one nearest to 0.5 is taken. A negative one says that the
    relation always holds.

    Parameters
    ----------
    p_validation : (P, R) float
    truth_validation : (P, R) int8

    Returns
    -------
    (R,) float64
        0.5 where no validation cell holds: there is nothing to tune on.
    """
    p, truth = checked_cells(p_validation, truth_validation)
    found = np.full(p.shape[1], THRESHOLD)
    for k in range(p.shape[1]):
        values, tp, text, positives = _ranked(p[:, k], truth[:, k])
        if not positives:
            continue
        f1 = 2 * tp / (text + positives)
        below = np.append(values[1:], 0.0 if values[-1] > 0 else -1.0)
        middle = below + (values - below) / 2
        # Between neighbouring floats the middle is rounded to one of them.
        middle = np.where(middle < values, middle, below)
        best = middle[f1 == f1.max()]
        found[k] = best[np.abs(best - THRESHOLD).argmin()]
    return found


def _ranked(p: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Distinct probabilities of the known cells, falling; down to each, how many hold and how many cells; positives."""
    known = truth != 0
    p, holds = p[known], truth[known] > 0
    order = np.argsort(-p, kind="stable")
    p, holds = p[order], holds[order]
    last = np.flatnonzero(np.append(p[1:] != p[:-1], True)) if len(p) else np.zeros(0, np.int64)
    return p[last], np.cumsum(holds)[last], last + 1, int(holds.sum())


def _reasons(names: tuple[str, ...], known: np.ndarray, positives: np.ndarray, text: np.ndarray) -> dict[str, str]:
    found = {}
    for name, cells, hold, claimed in zip(names, known.tolist(), positives.tolist(), text.tolist(), strict=True):
        if not cells:
            found[name] = "no cell is known (all are U, or there is none)"
        elif not hold:
            found[name] = f"it holds in none of {cells} known cells"
        elif not claimed:
            found[name] = "it was never said to hold: no precision"
    return found


@dataclass(frozen=True)
class RelationEstimates:
    """Figures of `RelationMetrics` with intervals, or differences of two scorers.

    Attributes
    ----------
    relations : tuple of str
    precision, recall, f1 : tuple of Estimate
        R each.
    micro_f1, macro_f1, element_accuracy : Estimate
        A resample without a relation takes its macro mean over the others.
    """

    relations: tuple[str, ...]
    precision: tuple[Estimate, ...]
    recall: tuple[Estimate, ...]
    f1: tuple[Estimate, ...]
    micro_f1: Estimate
    macro_f1: Estimate
    element_accuracy: Estimate


def relation_estimates(
    cells: CellOutcomes,
    clusters: Any,
    *,
    other: CellOutcomes | None = None,
    relations: Sequence[str] = DIRECTIONAL,
    config: BootstrapConfig | None = None,
) -> RelationEstimates:
    """Intervals of all figures from one set of resamples.

    Parameters
    ----------
    cells : CellOutcomes
        Of P pairs and R relations, from `cell_outcomes`.
    clusters : (P,) int or str
        Scene of each pair, or frame where there is one scene.
    other : CellOutcomes, optional
        Another scorer's on the same pairs and the same truth: the estimates are
        then the figures of `cells` less those of `other`.
    relations : sequence of str
    config : BootstrapConfig, optional

    Raises
    ------
    InputError
        Not one cluster a pair, or a scorer that was measured against another truth.
    """
    shape = cells.tp.shape
    names = checked_names(relations, shape[1])
    if other is not None and not (
        shape == other.tp.shape
        and np.array_equal(cells.tp | cells.fn, other.tp | other.fn)
        and np.array_equal(cells.fp | cells.tn, other.fp | other.tn)
    ):
        raise InputError("two scorers can only be compared on the same pairs and the same truth")
    # Sums by cluster first: a million pairs with four numbers for each relation would be hundreds of megabytes.
    index, count = checked_clusters(clusters, shape[0])
    known = cells.tp | cells.fp | cells.fn | cells.tn
    by_relation = np.stack([_sums(known[..., k], index, count) for k in range(shape[1])], axis=1)
    some = np.repeat(_sums(np.asarray(known.any(axis=1)), index, count)[:, None], 3, axis=1)
    rows = np.concatenate([by_relation] * 3 + [some], axis=1)
    found = bootstrap(
        _by_cluster(cells, index, count),
        np.arange(count),
        _figures,
        counted=rows > 0,
        other=None if other is None else _by_cluster(other, index, count),
        config=config,
    )
    found = [replace(e, n=int(n)) for e, n in zip(found, rows.sum(axis=0), strict=True)]
    r = len(names)
    precision, recall, f1 = (tuple(found[k * r : (k + 1) * r]) for k in range(3))
    return RelationEstimates(names, precision, recall, f1, *found[3 * r :])


def _by_cluster(cells: CellOutcomes, index: np.ndarray, count: int) -> np.ndarray:
    """(C, R, 4) float64: how many of tp, fp, fn, tn each cluster has."""
    kinds = (cells.tp, cells.fp, cells.fn, cells.tn)
    columns = [np.stack([_sums(kind[:, k], index, count) for kind in kinds], axis=1) for k in range(cells.tp.shape[1])]
    return np.stack(columns, axis=1)


def _sums(flags: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    return np.bincount(index[flags], minlength=count).astype(np.float64)


def _figures(sums: np.ndarray) -> np.ndarray:
    """(S, 3 R + 3) from sums (S, R, 4): precision, recall, F1 of each relation, micro-F1, macro-F1, accuracy."""
    tp, fp, fn, _ = np.moveaxis(sums, -1, 0)
    f1 = f1_of(tp, fp, fn)
    pooled = sums.sum(axis=1)
    overall = (f1_of(*pooled.T[:3]), mean_of_defined(f1), ratio(pooled[:, 0] + pooled[:, 3], pooled.sum(axis=1)))
    return np.concatenate([ratio(tp, tp + fp), ratio(tp, tp + fn), f1, np.stack(overall, axis=1)], axis=1)
