"""Figures made of counts; NaN where they have no meaning."""

from __future__ import annotations

from typing import Any

import numpy as np


def ratio(part: Any, whole: Any) -> np.ndarray:
    """`part` / `whole` of arrays of any shape, float64; NaN where `whole` is 0."""
    part, whole = np.broadcast_arrays(np.asarray(part, np.float64), np.asarray(whole, np.float64))
    return np.divide(part, whole, out=np.full(part.shape, np.nan), where=whole != 0)


def f1_of(tp: Any, fp: Any, fn: Any) -> np.ndarray:
    """F1 = 2 tp / (2 tp + fp + fn); NaN where nothing holds (tp + fn = 0), whatever was said: it has no support."""
    doubled, support = 2.0 * np.asarray(tp, np.float64), np.asarray(tp, np.float64) + fn
    return ratio(doubled, np.where(support > 0, doubled + fp + fn, 0.0))


def mean_of_defined(values: np.ndarray) -> np.ndarray:
    """Mean over the last axis of what is not NaN; NaN where all is."""
    defined = ~np.isnan(values)
    return ratio(np.where(defined, values, 0.0).sum(axis=-1), defined.sum(axis=-1))
