"""Selection of expressions among all candidates: what each frame keeps, and the quotas of relations over all."""

from __future__ import annotations

from math import inf

import numpy as np

from pipeline.labels.labelling import row_hash
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class SelectConfig:
    """Which of all candidate expressions are kept."""

    total: int | None = None
    """At most so many; None for as many as the other rules allow."""
    per_frame: int | None = 40
    """At most so many of one frame."""
    balance: float | None = 3.0
    """No relation has more than so many times the expressions of the rarest one; None keeps the relations as they
    come."""
    seed: int = 0
    telling: bool = True
    """Leave out what is true of every object of the target's class, where there are several: such a sentence tells
    nothing apart."""

    def __post_init__(self) -> None:
        for name in ("total", "per_frame"):
            value = getattr(self, name)
            require(value is None or value >= 1, f"{name} must be at least 1", got=value)
        require(
            self.balance is None or 1 <= self.balance < inf, "balance must be a number of at least 1", got=self.balance
        )


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
    """Choose the candidates to keep.

    First, one of each question: candidates of a frame with equal target,
    relation and reference say the same sentence. Then `per_frame` of each
    frame, rarest relation first. Then every relation gets its quota, filled
    in turn from its target classes.

    `ids` (N,) uint64: the rows' hashes. `frame`, `relation`, `target`, `reference` (N,) int: codes of what the rows
    say. Returns (N,) bool.
    """
    kept = kept_of_frames(ids, frame, relation, target, reference, config)
    kept[kept] = kept_by_quota(order_key_of(ids[kept], config), relation[kept], target[kept], config)
    return kept


def kept_of_frames(
    ids: np.ndarray,
    frame: np.ndarray,
    relation: np.ndarray,
    target: np.ndarray,
    reference: np.ndarray,
    config: SelectConfig,
) -> np.ndarray:
    """(N,) bool: one of each question, and of those at most `per_frame` of each frame; arguments as of `select`."""
    order_key = order_key_of(ids, config)
    kept = _rank((frame, relation, target, reference), order_key) == 0
    if config.per_frame is not None and len(ids):
        _keep_few(kept, order_key, frame, relation, np.full(frame.max() + 1, config.per_frame))
    return kept


def kept_by_quota(order_key: np.ndarray, relation: np.ndarray, target: np.ndarray, config: SelectConfig) -> np.ndarray:
    """(N,) bool: rows of which every relation gets its quota, by (N,) uint64 keys of the order among equals."""
    kept = np.ones(len(relation), np.bool_)
    counts = np.bincount(relation, minlength=1)
    quotas = _quotas(counts, config)
    # One relation after the other: sorting takes memory many times the rows.
    for code in np.flatnonzero(quotas < counts):
        rows = np.flatnonzero(relation == code)
        few = np.ones(len(rows), np.bool_)
        _keep_few(few, order_key[rows], np.zeros(len(rows), np.int8), target[rows], quotas[code : code + 1])
        kept[rows[~few]] = False
    return kept


def _keep_few(kept: np.ndarray, order_key: np.ndarray, of: np.ndarray, in_turn: np.ndarray, most: np.ndarray) -> None:
    """Keep at most so many rows of each `of`, with `in_turn` taking turns; `kept` (N,) bool is changed."""
    rows = np.flatnonzero(kept)
    within = _rank((of[rows], in_turn[rows]), order_key[rows])
    order = np.lexsort((order_key[rows], within, of[rows]))
    group = of[rows][order]
    kept[rows[order[_running_count(group) >= most[group]]]] = False


def order_key_of(ids: np.ndarray, config: SelectConfig) -> np.ndarray:
    """A second hash, so that another selection seed chooses others of the same candidates."""
    return _mixed(ids, row_hash(config.seed, "select"))


def _mixed(ids: np.ndarray, seed: int) -> np.ndarray:
    """(N,) uint64: the splitmix64 finaliser of each hash with a seed (Steele et al., 2014)."""
    with np.errstate(over="ignore"):
        x = ids.astype(np.uint64) ^ np.uint64(seed)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return x ^ (x >> np.uint64(31))


def _rank(groups: tuple[np.ndarray, ...], key: np.ndarray) -> np.ndarray:
    """(N,) rank of each row within the row's group, by key."""
    order = np.lexsort((key, *reversed(groups)))
    ranks = np.empty(len(key), np.int32)
    ranks[order] = _running_count(*(group[order] for group in groups))
    return ranks


def _running_count(*columns: np.ndarray) -> np.ndarray:
    """(N,) how many rows of equal values come right before each."""
    at = np.arange(len(columns[0]), dtype=np.int32)
    new = np.any([np.diff(column, prepend=column[:1]) != 0 for column in columns], axis=0)
    return at - np.maximum.accumulate(np.where(new, at, 0))


def _quotas(counts: np.ndarray, config: SelectConfig) -> np.ndarray:
    quota = counts.copy()
    present = counts > 0
    if config.balance is not None and present.any():
        rarest = max(int(counts[present].min()), SCARCE)
        quota = np.minimum(quota, config.balance * rarest).astype(quota.dtype)
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
