"""Relations by rule that involve more than two objects: closest, farthest, between."""

from __future__ import annotations

import numpy as np

from pipeline.relations.relations import F, Indices, T, U, measure_pairs


def distances(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """(N, N) float64: metres between the extents of every two objects, 0 where they overlap."""
    return np.linalg.norm(measure_pairs(lo, hi).gap, axis=2)


RANK_MARGIN = 0.03


def superlative_states(
    lo: np.ndarray,
    hi: np.ndarray,
    candidates: Indices,
    references: Indices,
    farthest: bool = False,
    same: np.ndarray | None = None,
) -> np.ndarray:
    """closest or farthest: which candidate is at the end of the row, seen from each reference.

    Parameters
    ----------
    candidates, references : sequences of int
        Objects that compete, and objects they are measured from.
    same : (N, N) bool, optional
        Entries that are one and the same thing; by default each is only itself.

    Returns
    -------
    (C, R) int8
        T for the nearest (farthest) candidate, U for those within 3 cm of it, F for the rest;
        an object is no candidate for itself.
    """
    away = distances(lo, hi)[np.ix_(list(candidates), list(references))]
    centers = (lo + hi) / 2
    apart = np.linalg.norm(centers[list(candidates)][:, None] - centers[list(references)][None], axis=2)
    # Objects that touch the reference all have a gap of 0; centres decide among them.
    measure = np.where(np.isfinite(away), away + 1e-3 * apart, np.nan)
    if farthest:
        measure = -measure
    itself = np.eye(len(lo), dtype=np.bool_) if same is None else same
    measure = np.where(itself[np.ix_(list(candidates), list(references))] | np.isnan(measure), np.inf, measure)
    best = measure.min(axis=0, keepdims=True) if len(measure) else measure
    state = np.where(measure <= best + RANK_MARGIN, U, F)
    # Rounding must not decide between two that are equally far.
    state[measure <= best + 1e-9] = T
    state[~np.isfinite(measure)] = F
    return state.astype(np.int8)


def between_states(lo: np.ndarray, hi: np.ndarray, candidates: Indices, first: Indices, second: Indices) -> np.ndarray:
    """between: the candidate's centre lies in the corridor from one object to another, in plan.

    T where the centre projects onto the middle 70 % of the line between the two
    centres and lies within a quarter of its length of it; U up to the whole line and half its length.

    Returns
    -------
    (C, A, B) int8
    """
    plan = ((lo + hi) / 2)[:, [0, 2]]
    p, a, b = plan[list(candidates)][:, None, None], plan[list(first)][None, :, None], plan[list(second)][None, None]
    line = b - a
    length = np.linalg.norm(line, axis=-1)
    safe = np.maximum(length, 1e-9)
    along = ((p - a) * line).sum(axis=-1) / safe**2
    aside = np.linalg.norm((p - a) - along[..., None] * line, axis=-1) / safe
    off_middle = np.abs(along - 0.5)
    holds, doubtful = (off_middle <= 0.35) & (aside <= 0.25), (off_middle <= 0.5) & (aside <= 0.5)
    state = np.where(holds, T, np.where(doubtful, U, F))
    c, i, j = np.asarray(candidates)[:, None, None], np.asarray(first)[None, :, None], np.asarray(second)[None, None]
    state[np.broadcast_to((c == i) | (c == j) | (i == j) | (length < 1e-6), state.shape)] = F
    return state.astype(np.int8)
