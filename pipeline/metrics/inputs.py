"""Inputs of the metrics: checked once, refused in one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.system.errors import InputError, require


def checked_probabilities(p: Any, what: str = "probabilities", dimensions: int = 2) -> np.ndarray:
    """Check `p` to be finite within 0..1, with `dimensions` axes: float64."""
    found = np.asarray(p)
    if found.dtype.kind not in "fiub" or found.ndim != dimensions:
        shape = "(P, R)" if dimensions == 2 else "(M,)"
        raise InputError(f"{what} must be numbers of shape {shape}", got=f"{found.dtype} {found.shape}")
    found = _finite(found, what)
    if found.size and (found.min() < 0 or found.max() > 1):
        raise InputError(
            f"{what} must lie within 0..1", got=f"{found.min():.6g} to {found.max():.6g}", cause="are these logits?"
        )
    return found


def checked_cells(p: Any, truth: Any) -> tuple[np.ndarray, np.ndarray]:
    """Check (P, R) probabilities, and (P, R) states of relations, int8: 1 T, 0 U, -1 F."""
    p, states = checked_probabilities(p), np.asarray(truth)
    require(p.shape[1] != 0, "probabilities must have a column for each relation", got=p.shape, expected="R >= 1")
    require(
        states.shape == p.shape,
        "the truth has another shape than the probabilities",
        got=states.shape,
        expected=p.shape,
    )
    require(
        states.dtype.kind in "iu",
        "states of relations must be integers",
        got=states.dtype,
        expected="1 (T), 0 (U) or -1 (F)",
        cause="a truth without U is np.where(holds, 1, -1)",
    )
    if states.size and (states.min() < -1 or states.max() > 1):
        raise InputError("states of relations must be 1 (T), 0 (U) or -1 (F)", got=f"{states.min()} to {states.max()}")
    return p, states.astype(np.int8)


def checked_thresholds(thresholds: Any, relations: int) -> np.ndarray:
    """Thresholds, (R,) float64, from a number or (R,) numbers."""
    found = np.asarray(thresholds, np.float64)
    require(
        found.shape in ((), (relations,)) and np.isfinite(found).all(),
        "thresholds must be one number, or one a relation",
        got=found.tolist(),
        expected=(relations,),
    )
    return np.broadcast_to(found, (relations,)).copy()


def checked_names(names: Sequence[str], count: int) -> tuple[str, ...]:
    """Names of relations, a name for each column."""
    require(
        len(names) == count, "relations must have a name for each column", got=f"{len(names)} names", expected=count
    )
    return tuple(names)


def checked_flags(flags: Any, what: str) -> np.ndarray:
    """Flags, (N,) bool, from bools or numbers 0 and 1."""
    found = np.asarray(flags)
    require(
        found.ndim == 1 and found.dtype.kind in "biuf" and ((found == 0) | (found == 1)).all(),
        f"{what} must be true or false for each row",
        got=f"{found.dtype} {found.shape}",
    )
    return found.astype(np.bool_)


def checked_numbers(values: Any, what: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """Check numbers to be finite: float64, (N,) or of `shape`."""
    found = np.asarray(values)
    require(
        found.dtype.kind in "biuf" and not (found.ndim != 1 if shape is None else found.shape != shape),
        f"{what} must be numbers of shape {shape or '(N,)'}",
        got=f"{found.dtype} {found.shape}",
    )
    return _finite(found, what)


def _finite(values: np.ndarray, what: str) -> np.ndarray:
    found = values.astype(np.float64)
    odd = np.count_nonzero(~np.isfinite(found))
    require(not odd, f"{what} must be finite", got=f"{odd} NaN or infinite of {found.size}")
    return found


def checked_clusters(clusters: Any, rows: int) -> tuple[np.ndarray, int]:
    """Cluster number of each row, (N,) int64, in the order of the sorted ids, and the number of clusters."""
    ids = np.asarray(clusters)
    require(ids.shape == (rows,), "clusters must be one id a row", got=ids.shape, expected=(rows,))
    if ids.dtype.kind == "O" and all(isinstance(one, str) for one in ids):
        ids = ids.astype(np.str_)
    require(
        not (rows and ids.dtype.kind not in "iubU"),
        "ids of clusters must be texts or integers",
        got=ids.dtype,
        cause="is one missing?",
    )
    names, index = np.unique(ids, return_inverse=True)
    return index.astype(np.int64), len(names)
