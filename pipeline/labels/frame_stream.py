"""Tables of labels read as a stream, frame by frame; memory does not grow with their length."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from heapq import merge
from itertools import groupby, pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error, first_line, require
from pipeline.system.safe_files import open_parquet

if TYPE_CHECKING:
    from pipeline.labels.reading import Labels

BATCH = 16_384
Rows = TypeVar("Rows")


def table_batches(labels: Labels, name: str, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """A table in pieces of at most 16,384 rows, in order.

    Raises InputError: the file is damaged or of another schema.
    """
    from pipeline.labels.reading import check_version, sound_rows

    path = labels.root / f"{name}.parquet"
    with (
        as_input_error(
            "not a readable Parquet file", pa.ArrowInvalid, pa.ArrowTypeError, OSError, got=first_line, path=path
        ),
        # Pre-buffering keeps what was read of every row group until the last is done.
        open_parquet(path, pre_buffer=False) as file,
    ):
        check_version(file.schema_arrow.metadata or {}, name, path)
        there = set(file.schema_arrow.names)
        for batch in file.iter_batches(BATCH, columns=columns and [n for n in columns if n in there]):
            batch.validate(full=True)
            yield sound_rows(pa.Table.from_batches([batch]), name, columns, path=path)


def frame_blocks(labels: Labels, name: str) -> Iterator[pa.Table]:
    """A table in blocks of whole frames.

    Raises InputError: the file is damaged, of another schema, or not in the order of its frames.
    """
    tail: pa.Table | None = None
    for batch in table_batches(labels, name):
        rows = batch if tail is None else pa.concat_tables([tail, batch])
        index = rows.column("frame_index").to_numpy()
        in_order = bool((np.diff(index) >= 0).all())
        require(in_order, f"the table {name} is not in the order of its frames", path=labels.root)
        # The rows of the last frame may go on in the next batch.
        cut = int(np.searchsorted(index, index[-1])) if len(index) else 0
        if cut:
            yield rows.slice(0, cut)
        tail = rows.slice(cut)
    if tail is not None and tail.num_rows:
        yield tail


def frame_spans(index: np.ndarray) -> list[tuple[int, int, int]]:
    """Runs of equal frames in (N,) frame indices, in order: (frame, first row, row after the last)."""
    edges = [*np.flatnonzero(np.diff(index, prepend=-1)).tolist(), len(index)]
    return [(int(index[start]), start, stop) for start, stop in pairwise(edges)]


def frame_tables(labels: Labels, name: str) -> Iterator[tuple[int, str, pa.Table]]:
    """Rows of each frame: (frame, table's name, rows); raises as `frame_blocks`."""
    for block in frame_blocks(labels, name):
        for frame, start, stop in frame_spans(block.column("frame_index").to_numpy()):
            yield frame, name, block.slice(start, stop - start)


def by_frame(*tables: Iterable[tuple[int, str, Rows]]) -> Iterator[tuple[int, dict[str, Rows]]]:
    """Rows of several tables together, frame by frame; a table without rows of a frame is left out."""
    for frame, parts in groupby(merge(*tables, key=itemgetter(0)), itemgetter(0)):
        yield frame, {name: rows for _, name, rows in parts}
