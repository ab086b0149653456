"""Selecting expressions: balanced over relations and classes, capped by frame, decided by each row's own hash.

The choice depends on the rows as a set: not on their order, nor on how they were sharded.
"""

from __future__ import annotations

import numpy as np

from pipeline.labels.config import SelectConfig
from pipeline.labels.expressions import row_hash

SCARCE = 20
"""The rarest relation counts as at least so many, so that one odd row does not empty the rest."""


def select(
    ids: np.ndarray,
    frame: np.ndarray,
    relation: np.ndarray,
    target: np.ndarray,
    reference: np.ndarray,
    config: SelectConfig,
) -> np.ndarray:
    """Which candidates are kept.

    First, one of each question: candidates of a frame with equal target,
    relation and reference say the same sentence. Then `per_frame` of each
    frame, rarest relation first. Then every relation gets its quota, filled
    in turn from its target classes.

    Parameters
    ----------
    ids : (N,) uint64
        The rows' hashes.
    frame, relation, target, reference : (N,) int
        Codes of what the rows say.
    config : SelectConfig

    Returns
    -------
    (N,) bool
    """
    n = len(ids)
    if not n:
        return np.zeros(0, np.bool_)
    # A second hash, so that another selection seed chooses others of the same candidates.
    order_key = _mixed(ids, row_hash(config.seed, "select"))
    kept = _rank((frame, relation, target, reference), order_key) == 0
    if config.per_frame is not None:
        rows = np.flatnonzero(kept)
        within = _rank((frame[rows], relation[rows]), order_key[rows])
        order = np.lexsort((order_key[rows], within, frame[rows]))
        place = _running_count(frame[rows][order])
        kept[rows[order[place >= config.per_frame]]] = False
    rows = np.flatnonzero(kept)
    quota = _quotas(np.bincount(relation[rows], minlength=relation.max() + 1), config)
    within = _rank((relation[rows], target[rows]), order_key[rows])
    order = np.lexsort((order_key[rows], within, relation[rows]))
    place = _running_count(relation[rows][order])
    kept[rows[order[place >= quota[relation[rows][order]]]]] = False
    return kept


def _mixed(ids: np.ndarray, seed: int) -> np.ndarray:
    """(N,) uint64: the splitmix64 finaliser of each hash with a seed (Steele et al., 2014)."""
    with np.errstate(over="ignore"):
        x = ids.astype(np.uint64) ^ np.uint64(seed)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return x ^ (x >> np.uint64(31))


def _rank(groups: tuple[np.ndarray, ...], key: np.ndarray) -> np.ndarray:
    """(N,) place of each row among those of its group, by key."""
    order = np.lexsort((key, *reversed(groups)))
    new = np.zeros(len(key), np.bool_)
    for group in groups:
        sorted_group = group[order]
        new[1:] |= sorted_group[1:] != sorted_group[:-1]
    ranks = np.empty(len(key), np.int64)
    ranks[order] = _count_since(new)
    return ranks


def _running_count(sorted_group: np.ndarray) -> np.ndarray:
    """Place of each row in its run of equal values."""
    new = np.zeros(len(sorted_group), np.bool_)
    new[1:] = sorted_group[1:] != sorted_group[:-1]
    return _count_since(new)


def _count_since(new: np.ndarray) -> np.ndarray:
    start = np.where(new, np.arange(len(new)), 0)
    return np.arange(len(new)) - np.maximum.accumulate(start) if len(new) else start


def _quotas(counts: np.ndarray, config: SelectConfig) -> np.ndarray:
    """How many of each relation: no more than `balance` times the rarest, and level within `total`."""
    quota = counts.copy()
    present = counts > 0
    if config.balance is not None and present.any():
        rarest = max(int(counts[present].min()), SCARCE)
        quota = np.minimum(quota, int(config.balance * rarest))
    if config.total is None or quota.sum() <= config.total:
        return quota
    # Fill all relations to one level; what a rare one leaves goes to the others.
    low, high = 0, int(quota.max())
    while low < high:
        level = (low + high + 1) // 2
        low, high = (level, high) if np.minimum(quota, level).sum() <= config.total else (low, level - 1)
    levelled = np.minimum(quota, low)
    rest = config.total - int(levelled.sum())
    levelled[np.flatnonzero(quota > low)[:rest]] += 1
    return levelled
