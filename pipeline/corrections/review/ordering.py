"""The order in which a queue is worked through: worst first, but not a new picture for every label."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pyarrow as pa

BLOCK = 60
"""Items that are as good as equally doubtful: what differs little in rank may be looked at in any order."""


def by_frame(queue: pa.Table, block: int = BLOCK) -> pa.Table:
    """The queue with the items of a frame next to each other within every `block` items.

    Frames stand in the order of their first item of the block, and the items of
    a frame, pair by pair, in the order in which the pair's first one stood.
    """
    if not queue.num_rows:
        return queue
    rank = np.arange(queue.num_rows)
    part = rank // max(block, 1)
    frame = np.unique(queue.column("frame").to_numpy(zero_copy_only=False), return_inverse=True)[1]
    a = queue.column("a").to_numpy().astype(np.int64)
    b = np.nan_to_num(queue.column("b").to_numpy(zero_copy_only=False).astype(np.float64), nan=-1).astype(np.int64)
    of_frame = _first(rank, part, frame)
    of_pair = _first(rank, part, frame, np.minimum(a, b), np.maximum(a, b))
    return queue.take(np.lexsort((rank, of_pair, of_frame, part)))


def _first(rank: np.ndarray, *keys: np.ndarray) -> np.ndarray:
    """(N,) int: the rank of the first row that agrees in all keys."""
    _, group = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)
    first = np.full(int(group.max()) + 1, len(rank), np.int64)
    np.minimum.at(first, group.ravel(), rank)
    return first[group.ravel()]
