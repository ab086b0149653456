"""Accuracy of relation probabilities: multi-label (several relations of a pair may hold) and single-label.

Cells whose true state is U are neither right nor wrong: they are masked, and counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, f1_of, mean_of_defined, numbered, ratio
from pipeline.system.frozen import dataclass

THRESHOLD = 0.5
"""A relation is said to hold where its probability is greater, so that a doubt of exactly one half is a no."""


@dataclass(frozen=True)
class CellOutcomes:
    """Outcome of each cell, (P, R) bool; where all four are false, the cell is U."""

    tp: np.ndarray
    fp: np.ndarray
    fn: np.ndarray
    tn: np.ndarray


@dataclass(frozen=True)
class RelationMetrics:
    """The figures of a multi-label relation scorer."""

    relations: tuple[str, ...]  # The order of everything with shape (R,)
    pairs: int
    positives: np.ndarray  # (R,) int64, cells whose truth is T
    undecided: np.ndarray  # (R,) int64, cells whose truth is U
    tp: np.ndarray  # (R,) int64
    fp: np.ndarray  # (R,) int64
    fn: np.ndarray  # (R,) int64
    precision: np.ndarray  # (R,) float64
    recall: np.ndarray  # (R,) float64
    f1: np.ndarray  # (R,) float64
    average_precision: np.ndarray  # (R,) float64, does not depend on the thresholds
    micro_f1: float  # F1 of the counts of all relations
    macro_f1: float  # Mean F1 over the relations that have one
    element_accuracy: float  # Share of known cells that are right
    all_negative_accuracy: float  # The same for a scorer that always answers no: the share of negatives
    mean_average_precision: float  # Over the relations that have one


def cell_outcomes(p: Any, truth: Any, thresholds: Any = THRESHOLD) -> CellOutcomes:
    """Compare relation probabilities with true states, cell by cell.

    Parameters
    ----------
    p : (P, R) float
        Probability that the relation holds, 0..1.
    truth : (P, R) int8
        1 T, 0 U, -1 F.
    thresholds : float or (R,) float
        A relation is predicted where p is greater.
    """
    p, truth = np.asarray(p), np.asarray(truth)
    text = p > np.asarray(thresholds)
    holds, fails = truth > 0, truth < 0
    return CellOutcomes(text & holds, text & fails, ~text & holds, ~text & fails)


def multi_label_metrics(
    p: Any, truth: Any, thresholds: Any = THRESHOLD, relations: Sequence[str] = DIRECTIONAL
) -> RelationMetrics:
    """Compute every figure of a multi-label relation scorer.

    Parameters are those of `cell_outcomes`; thresholds of `tuned_thresholds` must come from other pairs
    than these, and `relations` names the R columns.

    >>> from pipeline.metrics import multi_label_metrics
    >>> found = multi_label_metrics([[0.9, 0.2], [0.4, 0.7]], [[1, -1], [1, 0]], relations=["on", "in"])
    >>> found.recall.tolist(), round(found.micro_f1, 3)
    ([0.5, nan], 0.667)
    """
    p, truth = np.asarray(p), np.asarray(truth)
    cells = cell_outcomes(p, truth, thresholds)
    tp, fp, fn, tn = (c.sum(axis=0) for c in (cells.tp, cells.fp, cells.fn, cells.tn))
    f1 = f1_of(tp, fp, fn)
    ap = average_precision(p, truth)
    positives, negatives = tp + fn, fp + tn
    known = positives + negatives
    return RelationMetrics(
        relations=tuple(relations),
        pairs=len(p),
        positives=positives,
        undecided=len(p) - known,
        tp=tp,
        fp=fp,
        fn=fn,
        precision=ratio(tp, tp + fp),
        recall=ratio(tp, positives),
        f1=f1,
        average_precision=ap,
        micro_f1=float(f1_of(tp.sum(), fp.sum(), fn.sum())),
        macro_f1=float(mean_of_defined(f1)),
        element_accuracy=float(ratio((tp + tn).sum(), known.sum())),
        all_negative_accuracy=float(ratio(negatives.sum(), known.sum())),
        mean_average_precision=float(mean_of_defined(ap)),
    )


def average_precision(p: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Average precision by relation, (R,): sum of (R_n - R_(n-1)) P_n over falling probabilities; NaN if none holds.

    No interpolation; the definition of scikit-learn's average_precision_score.
    """
    found = np.full(p.shape[1], np.nan)
    for k in range(p.shape[1]):
        _, tp, text, positives = _ranked(p[:, k], truth[:, k])
        if positives:
            found[k] = (np.diff(tp, prepend=0) * (tp / text)).sum() / positives
    return found


def tuned_thresholds(p: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Threshold of each relation with the largest F1 on validation pairs, (R,); 0.5 where no cell holds.

    It lies half way between two neighbouring probabilities; of thresholds with
    the same F1 the one nearest to 0.5 is taken. A negative one says that the
    relation always holds.
    """
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
    """Distinct probabilities of the known cells, falling; down to each, positives and cells; all positives."""
    known = truth != 0
    p, holds = p[known].astype(np.float64), truth[known] > 0
    order = np.argsort(-p, kind="stable")
    p, holds = p[order], holds[order]
    last = np.flatnonzero(np.append(p[1:] != p[:-1], True)) if len(p) else np.zeros(0, np.int64)
    return p[last], np.cumsum(holds)[last], last + 1, int(holds.sum())


@dataclass(frozen=True)
class RelationEstimates:
    """Figures of `RelationMetrics` with intervals, or differences of two scorers."""

    relations: tuple[str, ...]
    precision: tuple[Estimate, ...]  # R each
    recall: tuple[Estimate, ...]
    f1: tuple[Estimate, ...]
    micro_f1: Estimate  # A resample without a relation takes its macro mean over the others
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
    """Estimate intervals of all figures from one set of resamples.

    Parameters
    ----------
    cells : CellOutcomes
        Of P pairs and R relations, from `cell_outcomes`.
    clusters : (P,) int or str
        Scene of each pair, or frame where there is one scene.
    other : CellOutcomes, optional
        Another scorer's on the same pairs and the same truth: the estimates are
        then the figures of `cells` less those of `other`.
    """
    # Sums by cluster first: a million pairs with four numbers for each relation would be hundreds of megabytes.
    index, count = numbered(clusters)
    known = cells.tp | cells.fp | cells.fn | cells.tn
    sums = _by_cluster(cells, index, count)
    some = np.repeat(_sums(np.asarray(known.any(axis=1)), index, count)[:, None], 3, axis=1)
    rows = np.concatenate([sums.sum(axis=2)] * 3 + [some], axis=1)
    found = bootstrap(
        sums,
        np.arange(count),
        _figures,
        counted=rows > 0,
        other=None if other is None else _by_cluster(other, index, count),
        config=config,
    )
    found = [replace(e, n=int(n)) for e, n in zip(found, rows.sum(axis=0), strict=True)]
    *by_relation, micro, macro, accuracy = found
    count = len(relations)
    precision, recall, f1 = (tuple(by_relation[k : k + count]) for k in range(0, 3 * count, count))
    return RelationEstimates(tuple(relations), precision, recall, f1, micro, macro, accuracy)


def _by_cluster(cells: CellOutcomes, index: np.ndarray, count: int) -> np.ndarray:
    """Counts of tp, fp, fn, tn by cluster and relation, (C, R, 4) float64."""
    kinds = (cells.tp, cells.fp, cells.fn, cells.tn)
    columns = [np.stack([_sums(kind[:, k], index, count) for kind in kinds], axis=1) for k in range(cells.tp.shape[1])]
    return np.stack(columns, axis=1)


def _sums(flags: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    return np.bincount(index[flags], minlength=count).astype(np.float64)


def _figures(sums: np.ndarray) -> np.ndarray:
    """Figures (S, 3 R + 3) of sums (S, R, 4): precision, recall, F1 by relation, micro-F1, macro-F1, accuracy."""
    tp, fp, fn, _ = np.moveaxis(sums, -1, 0)
    f1 = f1_of(tp, fp, fn)
    pooled = sums.sum(axis=1)
    overall = (f1_of(*pooled.T[:3]), mean_of_defined(f1), ratio(pooled[:, 0] + pooled[:, 3], pooled.sum(axis=1)))
    return np.concatenate([ratio(tp, tp + fp), ratio(tp, tp + fn), f1, np.stack(overall, axis=1)], axis=1)


@dataclass(frozen=True)
class SingleLabelMetrics:
    """The figures of a single-label relation scorer."""

    pairs: int  # Pairs that count: with a known relation
    confusion: np.ndarray  # (R, R) int64, pairs by true relation (row) and most probable one (column)
    precision: np.ndarray  # (R,) float64, NaN for what is never predicted
    recall: np.ndarray  # (R,) float64, NaN for what never holds
    f1: np.ndarray  # (R,) float64, NaN for what never holds
    top1: float  # Share of pairs whose true relation is the most probable
    top2: float  # Share of pairs whose true relation is among the two most probable


def true_ranks(p: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Rank of the true relation by probability, (P,) int64, 0 for the most probable, -1 where unknown.

    `p`, (P, R), has a distribution in each row, and of equals the earlier column comes first; `truth`, (P,), is the
    column of the true relation, -1 where unknown.
    """
    own = np.take_along_axis(p, np.maximum(truth, 0)[:, None], axis=1)
    earlier = np.arange(p.shape[1])[None] < truth[:, None]
    return np.where(truth < 0, -1, ((p > own) | ((p == own) & earlier)).sum(axis=1))


def single_label_metrics(p: np.ndarray, truth: np.ndarray) -> SingleLabelMetrics:
    """Compute every figure of a single-label relation scorer; arguments as in `true_ranks`."""
    count = p.shape[1]
    known = truth >= 0
    ranks = true_ranks(p, truth)[known]
    index = truth[known] * count + p[known].argmax(axis=1)
    confusion = np.bincount(index, minlength=count * count).reshape(count, count)
    right, text, holds = np.diag(confusion), confusion.sum(axis=0), confusion.sum(axis=1)
    return SingleLabelMetrics(
        pairs=len(ranks),
        confusion=confusion,
        precision=ratio(right, text),
        recall=ratio(right, holds),
        f1=f1_of(right, text - right, holds - right),
        top1=float(ratio((ranks == 0).sum(), len(ranks))),
        top2=float(ratio((ranks < 2).sum(), len(ranks))),
    )
