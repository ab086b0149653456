"""How good relation probabilities are, against states that are known.

Only pairs of different objects count, and of their cells only those that are T
or F in truth: U is neither right nor wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL, RELATIONS
from pipeline.metrics.calibration_metrics import calibration_metrics, expected_calibration_error
from pipeline.metrics.intervals import mean_of_defined, ratio
from pipeline.metrics.relation_metrics import multi_label_metrics, single_label_metrics
from pipeline.relations.relations import measure_pairs

CLEAR_GAP_M = 0.10


def evaluate(
    probabilities: Sequence[np.ndarray], truth: Sequence[np.ndarray], rule: Sequence[np.ndarray] | None = None
) -> dict[str, Any]:
    """Every figure of a relation scorer.

    Parameters
    ----------
    probabilities : sequence of (N, N, 6) float
        Of each view, in the order of DIRECTIONAL.
    truth : sequence of (N, N, 6) int8
        Exact states.
    rule : sequence of (N, N, 6) int8, optional
        States of the noisy view; adds the cells on which it and the truth differ.

    Returns
    -------
    dict
        `relations` (name -> precision, recall, f1, positives), `micro_f1`,
        `macro_f1`, `element_accuracy`, `all_negative_accuracy` (what a scorer
        gets that always says no), `positives_per_pair`, `doubtful_share`,
        `brier`, `ece`, `pairs`, and with `rule` `differing` (cells, errors,
        rule_errors, rule_opposite: see `differing_cells`). None where a figure
        has no meaning, as precision where no relation was found to hold.
    """
    p, t = _cells(probabilities).astype(np.float64), _cells(truth).astype(np.int8)
    metrics, calibration = multi_label_metrics(p, t), calibration_metrics(p, t)
    relations = {
        name: {
            "precision": _defined(metrics.precision[k]),
            "recall": _defined(metrics.recall[k]),
            "f1": _defined(metrics.f1[k]),
            "positives": int(metrics.positives[k]),
        }
        for k, name in enumerate(DIRECTIONAL)
    }
    report: dict[str, Any] = {
        "pairs": metrics.pairs,
        "relations": relations,
        "micro_f1": _defined(metrics.micro_f1),
        "macro_f1": _defined(metrics.macro_f1),
        "element_accuracy": _defined(metrics.element_accuracy),
        "all_negative_accuracy": _defined(metrics.all_negative_accuracy),
        "positives_per_pair": _defined(ratio(metrics.positives.sum(), len(t))),
        "doubtful_share": _defined(ratio(metrics.undecided.sum(), t.size)),
        "brier": _defined(calibration.pooled_brier),
        "ece": _defined(calibration.pooled_ece),
    }
    if rule is not None:
        report["differing"] = differing_cells(p, t, _cells(rule))
    return report


def evaluate_classes(
    probabilities: Sequence[np.ndarray], truth: Sequence[np.ndarray], prior: Sequence[float], vocabulary: Sequence[str]
) -> dict[str, Any]:
    """Every figure of a network that says which one relation fits a pair.

    Parameters
    ----------
    probabilities : sequence of (N, N, R) float
        Of each view, softmax over the vocabulary, the prior not divided out.
    truth : sequence of (N, N) int
        Place of the one true relation; -1 for pairs that take no part.
    prior : sequence of float
        Share of each class in training.
    vocabulary : sequence of str

    Returns
    -------
    dict
        `pairs`, `top1`, `top2`, `top1_prior_divided` (argmax of p / prior),
        `mean_recall` over classes that occur, `most_frequent` (what always
        saying the most frequent class gets), `log_loss`, `ece` of the
        probability of the answer, and `relations` (name -> precision,
        recall, f1, positives). None where a figure has no meaning.
    """
    rows = [(p[t >= 0], t[t >= 0]) for p, t in zip(probabilities, truth, strict=True)]
    p = np.concatenate([np.zeros((0, len(vocabulary))), *(p for p, _ in rows)])
    t = np.concatenate([np.zeros(0, np.int64), *(t for _, t in rows)]).astype(np.int64)
    metrics = single_label_metrics(p, t, vocabulary)
    weighted = p / np.asarray(prior, np.float64)
    divided = single_label_metrics(weighted / weighted.sum(axis=1, keepdims=True), t, vocabulary)
    holds = metrics.confusion.sum(axis=1)
    return {
        "pairs": metrics.pairs,
        "relations": {
            name: {
                "precision": _defined(metrics.precision[k]),
                "recall": _defined(metrics.recall[k]),
                "f1": _defined(metrics.f1[k]),
                "positives": int(holds[k]),
            }
            for k, name in enumerate(vocabulary)
        },
        "top1": _defined(metrics.top1),
        "top2": _defined(metrics.top2),
        "top1_prior_divided": _defined(divided.top1),
        "mean_recall": _defined(mean_of_defined(metrics.recall)),
        "most_frequent": _defined(ratio(holds.max(), metrics.pairs)),
        "log_loss": _defined(ratio(-np.log(np.maximum(p[np.arange(len(t)), t], 1e-12)).sum(), len(t))),
        "ece": _defined(expected_calibration_error(p.max(axis=1), p.argmax(axis=1) == t)),
    }


def _cells(views: Sequence[np.ndarray]) -> np.ndarray:
    """(pairs, 6) of all views, the diagonals left out."""
    rows = [view[~np.eye(len(view), dtype=np.bool_)] for view in views]
    return np.concatenate(rows) if rows else np.zeros((0, len(DIRECTIONAL)))


def _defined(figure: Any) -> float | None:
    return float(figure) if math.isfinite(figure) else None


def differing_cells(p: np.ndarray, truth: np.ndarray, rule: np.ndarray) -> dict[str, int]:
    """Cells that are T or F in truth and on which the rule, given the noisy view, says something else.

    Returns
    -------
    dict
        cells; errors (of the probabilities, by 0.5); rule_errors (by 0.5: a U
        counts as "no", which is right where the truth is F); rule_opposite (the
        rule says F for T or T for F).
    """
    cells = (truth != 0) & (rule != truth)
    holds = truth > 0
    return {
        "cells": int(cells.sum()),
        "errors": int((cells & ((p > 0.5) != holds)).sum()),
        "rule_errors": int((cells & ((rule > 0) != holds)).sum()),
        "rule_opposite": int((cells & (rule == -truth)).sum()),
    }


def clear_cut(lo: np.ndarray, hi: np.ndarray, by_centers: bool = False) -> np.ndarray:
    """Which relation of each ordered pair is beyond dispute.

    Parameters
    ----------
    lo, hi : (N, 3) float
        Exact extents along (right, up, forward), metres.
    by_centers : bool
        The dominant axis is that of the largest difference of centres, and not
        that of the largest gap.

    Returns
    -------
    (N, N) int64
        Place in DIRECTIONAL of the relation along the dominant axis, where the
        extents are more than 10 cm apart along it; -1 elsewhere.
    """
    measured = measure_pairs(lo, hi)
    axis = np.abs(measured.delta if by_centers else measured.gap).argmax(axis=2)
    gap = np.take_along_axis(measured.gap, axis[..., None], axis=2)[..., 0]
    of_axis = {RELATIONS[name].axis: k for k, name in enumerate(DIRECTIONAL)}
    negative, positive = (np.array([of_axis[k, side] for k in range(3)])[axis] for side in (-1, 1))
    return np.where(np.abs(gap) <= CLEAR_GAP_M, -1, np.where(gap > 0, positive, negative))


def clear_cut_report(
    probabilities: Sequence[np.ndarray],
    extents: Sequence[tuple[np.ndarray, np.ndarray]],
    by_centers: bool = False,
) -> dict[str, Any]:
    """Of the clear-cut relations of all views: how many are likely (p > 0.5), how many doubted, how many opposite ones.

    Returns
    -------
    dict
        clear_cut (their number), holds, doubted, opposite (shares of it; None where there is none).
    """
    asked, opposed = [], []
    for p, (lo, hi) in zip(probabilities, extents, strict=True):
        which = clear_cut(lo, hi, by_centers)
        a, b = np.nonzero(which >= 0)
        asked.append(p[a, b, which[a, b]])
        opposed.append(p[b, a, which[a, b]])
    own, other = np.concatenate([*asked, []]), np.concatenate([*opposed, []])
    return {
        "clear_cut": len(own),
        "holds": _defined(ratio((own > 0.5).sum(), len(own))),
        "doubted": _defined(ratio((own == 0.5).sum(), len(own))),
        "opposite": _defined(ratio((other > 0.5).sum(), len(other))),
    }
