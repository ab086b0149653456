"""How right relation probabilities are where exactly one relation of a pair holds (softmax, Semantic Abstraction)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.metrics.counts import f1_of, mean_of_defined, ratio
from pipeline.metrics.inputs import checked_names, checked_probabilities
from pipeline.system.errors import InputError

SUM_TOLERANCE = 1e-3
"""Softmax in half precision adds up to one no better than this."""


@dataclass(frozen=True)
class SingleLabelMetrics:
    """The figures of a single-label relation scorer.

    Attributes
    ----------
    relations : tuple of str
    pairs, unknown : int
        Pairs that count, and pairs left out because their relation is not known.
    confusion : (R, R) int64
        Pairs by true relation (row) and most probable one (column).
    precision, recall, f1 : (R,) float64
        NaN without support: precision of what is never said, recall and F1 of what never holds.
    top1, top2 : float
        Share of pairs whose true relation is the most probable, is among the two most probable.
    macro_f1 : float
        Over the relations that have one.
    """

    relations: tuple[str, ...]
    pairs: int
    unknown: int
    confusion: np.ndarray
    precision: np.ndarray
    recall: np.ndarray
    f1: np.ndarray
    top1: float
    top2: float
    macro_f1: float


def true_ranks(p: Any, truth: Any) -> np.ndarray:
    """How many relations are more probable than the true one; of equals the earlier column comes first.

    Parameters
    ----------
    p : (P, R) float
        Each row a distribution over the relations.
    truth : (P,) int
        Column of the true relation, -1 where it is not known.

    Returns
    -------
    (P,) int64
        0 where the true relation is the most probable one; -1 where it is not known.

    Raises
    ------
    InputError
        Shapes that do not match, NaN, rows that do not add up to 1, or a column that does not exist.
    """
    p, truth = _checked(p, truth)
    own = np.take_along_axis(p, np.maximum(truth, 0)[:, None], axis=1)
    earlier = np.arange(p.shape[1])[None] < truth[:, None]
    return np.where(truth < 0, -1, ((p > own) | ((p == own) & earlier)).sum(axis=1))


def single_label_metrics(p: Any, truth: Any, relations: Sequence[str]) -> SingleLabelMetrics:
    """Every figure of a single-label relation scorer; arguments and errors as in `true_ranks`."""
    p, truth = _checked(p, truth)
    count = p.shape[1]
    names = checked_names(relations, count)
    known = truth >= 0
    ranks = true_ranks(p, truth)[known]
    index = truth[known] * count + p[known].argmax(axis=1)
    confusion = np.bincount(index, minlength=count * count).reshape(count, count)
    right, text, holds = np.diag(confusion), confusion.sum(axis=0), confusion.sum(axis=1)
    f1 = f1_of(right, text - right, holds - right)
    return SingleLabelMetrics(
        relations=names,
        pairs=len(ranks),
        unknown=int((~known).sum()),
        confusion=confusion,
        precision=ratio(right, text),
        recall=ratio(right, holds),
        f1=f1,
        top1=float(ratio((ranks == 0).sum(), len(ranks))),
        top2=float(ratio((ranks < 2).sum(), len(ranks))),
        macro_f1=float(mean_of_defined(f1)),
    )


def _checked(p: Any, truth: Any) -> tuple[np.ndarray, np.ndarray]:
    p, truth = checked_probabilities(p), np.asarray(truth)
    if p.shape[1] == 0:
        raise InputError("probabilities must have a column for each relation", got=p.shape)
    if truth.shape != (len(p),) or truth.dtype.kind not in "iu":
        raise InputError(
            "the truth must be one column a pair", got=f"{truth.dtype} {truth.shape}", expected=f"integers ({len(p)},)"
        )
    if len(truth) and (truth.min() < -1 or truth.max() >= p.shape[1]):
        raise InputError(
            "the truth names a relation that has no column", got=f"{truth.min()} to {truth.max()}",
            expected=f"-1 to {p.shape[1] - 1}",
        )  # fmt: skip
    if len(p) and np.abs(p.sum(axis=1) - 1).max() > SUM_TOLERANCE:
        row = int(np.abs(p.sum(axis=1) - 1).argmax())
        raise InputError(
            "each row of probabilities must add up to 1", got=f"{p[row].sum():.6g} in row {row}", cause="not a softmax?"
        )
    return p, truth.astype(np.int64)
