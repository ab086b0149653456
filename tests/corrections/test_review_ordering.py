"""A queue in the order of work: no item lost, none moved out of its block, frames together."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from pipeline.corrections.review.worklist import by_frame

ROWS = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 4), st.none() | st.integers(0, 4)), max_size=60)


def _queue(rows: list[tuple[int, int, int | None]]) -> pa.Table:
    return pa.table(
        {
            "frame": pa.array([str(f) for f, _, _ in rows], pa.string()),
            "a": pa.array([a for _, a, _ in rows], pa.int32()),
            "b": pa.array([b for _, _, b in rows], pa.int32()),
            "at": pa.array(range(len(rows)), pa.int64()),
        }
    )


@given(ROWS, st.integers(1, 20))
def test_items_stay_in_their_block_and_frames_together(rows: list[tuple[int, int, int | None]], block: int) -> None:
    found = by_frame(_queue(rows), block)
    at = found.column("at").to_numpy()
    assert sorted(at.tolist()) == list(range(len(rows)))
    np.testing.assert_array_equal(at // block, np.arange(len(rows)) // block)
    frames = found.column("frame").to_pylist()
    for start in range(0, len(rows), block):
        part = frames[start : start + block]
        changes = sum(x != y for x, y in pairwise(part))
        assert changes == len(set(part)) - 1
        # The worst item of a block still comes first.
        assert at[start] == start


def test_the_labels_of_one_pair_stand_together() -> None:
    found = by_frame(_queue([(0, 1, 2), (0, 3, 4), (0, 2, 1), (1, 1, 2)]))
    assert found.column("at").to_pylist() == [0, 2, 1, 3]
