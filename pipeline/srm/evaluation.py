"""How good relation probabilities are, against states that are known.

Only pairs of different objects count, and of their cells only those that are T
or F in truth: U is neither right nor wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.relations import DIRECTIONAL, measure_pairs

CLEAR_GAP_M = 0.10
ECE_BINS = 15


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
        rule_errors, rule_opposite: see `differing_cells`).
    """
    p, t = _cells(probabilities), _cells(truth)
    known = t != 0
    holds, said = t > 0, p > 0.5
    tp, fp, fn = ((c & known).sum(axis=0) for c in (said & holds, said & ~holds, ~said & holds))
    relations = {
        name: {
            "precision": _share(tp[k], tp[k] + fp[k]),
            "recall": _share(tp[k], tp[k] + fn[k]),
            "f1": _share(2 * tp[k], 2 * tp[k] + fp[k] + fn[k]),
            "positives": int(tp[k] + fn[k]),
        }
        for k, name in enumerate(DIRECTIONAL)
    }
    right = (said == holds)[known]
    report: dict[str, Any] = {
        "pairs": len(p),
        "relations": relations,
        "micro_f1": _share(2 * tp.sum(), 2 * tp.sum() + fp.sum() + fn.sum()),
        "macro_f1": float(np.mean([r["f1"] for r in relations.values()])),
        "element_accuracy": _share(right.sum(), right.size),
        "all_negative_accuracy": _share((known & ~holds).sum(), known.sum()),
        "positives_per_pair": _share((known & holds).sum(), len(t)),
        "doubtful_share": _share((~known).sum(), known.size),
        "brier": _share(np.square(p - holds)[known].sum(), known.sum()),
        "ece": expected_calibration_error(p[known], holds[known]),
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
        probability of the answer, and `relations` (name -> precision, recall, f1, positives).
    """
    rows = [(p[t >= 0], t[t >= 0]) for p, t in zip(probabilities, truth, strict=True)]
    p = np.concatenate([np.zeros((0, len(vocabulary))), *(p for p, _ in rows)])
    t = np.concatenate([np.zeros(0, np.int64), *(t for _, t in rows)]).astype(np.int64)
    said = p.argmax(axis=1)
    second = np.argsort(-p, axis=1, kind="stable")[:, :2]
    relations = {}
    for k, name in enumerate(vocabulary):
        hit, answered, asked = ((said == k) & (t == k)).sum(), (said == k).sum(), (t == k).sum()
        relations[name] = {
            "precision": _share(hit, answered),
            "recall": _share(hit, asked),
            "f1": _share(2 * hit, answered + asked),
            "positives": int(asked),
        }
    own = p[np.arange(len(t)), t]
    return {
        "pairs": len(t),
        "relations": relations,
        "top1": _share((said == t).sum(), len(t)),
        "top2": _share((second == t[:, None]).any(axis=1).sum(), len(t)),
        "top1_prior_divided": _share(((p / np.asarray(prior)).argmax(axis=1) == t).sum(), len(t)),
        "mean_recall": float(np.mean([r["recall"] for r in relations.values() if r["positives"]] or [0.0])),
        "most_frequent": _share(np.bincount(t, minlength=1).max(), len(t)),
        "log_loss": _share(-np.log(np.maximum(own, 1e-12)).sum(), len(t)),
        "ece": expected_calibration_error(p.max(axis=1), said == t) if len(t) else 0.0,
    }


def _cells(views: Sequence[np.ndarray]) -> np.ndarray:
    """(pairs, 6) of all views, the diagonals left out."""
    rows = [view[~np.eye(len(view), dtype=np.bool_)] for view in views]
    return np.concatenate(rows) if rows else np.zeros((0, len(DIRECTIONAL)))


def _share(part: Any, whole: Any) -> float:
    return float(part) / float(whole) if whole else 0.0


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


def expected_calibration_error(p: np.ndarray, holds: np.ndarray, bins: int = ECE_BINS) -> float:
    """Mean distance of probability and frequency over equal bins of probability, weighted by their content."""
    if not p.size:
        return 0.0
    place = np.minimum((p * bins).astype(np.int64), bins - 1)
    count = np.bincount(place, minlength=bins)
    gap = np.bincount(place, p, bins) - np.bincount(place, holds.astype(np.float64), bins)
    return float(np.abs(gap).sum() / count.sum())


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
    negative = np.array([DIRECTIONAL.index(name) for name in ("left", "below", "front")])[axis]
    positive = np.array([DIRECTIONAL.index(name) for name in ("right", "above", "behind")])[axis]
    return np.where(np.abs(gap) <= CLEAR_GAP_M, -1, np.where(gap > 0, positive, negative))


def clear_cut_report(
    probabilities: Sequence[np.ndarray],
    extents: Sequence[tuple[np.ndarray, np.ndarray]],
    by_centers: bool = False,
) -> dict[str, float]:
    """Of the clear-cut relations of all views: how many are likely (p > 0.5), how many doubted, how many opposite ones.

    Returns
    -------
    dict
        clear_cut (their number), holds, doubted, opposite (shares of it).
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
        "holds": _share((own > 0.5).sum(), len(own)),
        "doubted": _share((own == 0.5).sum(), len(own)),
        "opposite": _share((other > 0.5).sum(), len(other)),
    }
