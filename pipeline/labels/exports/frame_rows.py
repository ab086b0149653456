"""Labels frame by frame: the rows of all four tables, read as a stream."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.labels.reading import Labels
from pipeline.labels.schema import ADDED_COLUMNS
from pipeline.labels.tables import check_version, with_added
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from pipeline.labels.exports.base import Progress

BATCH = 16_384


@dataclass(frozen=True)
class FrameRows:
    """All rows of one frame.

    Attributes
    ----------
    frame : dict
        Its row of the table `frames`.
    objects, expressions : list of dict
    relations : pa.Table
    """

    frame: dict[str, Any]
    objects: list[dict[str, Any]]
    relations: pa.Table
    expressions: list[dict[str, Any]]

    @property
    def index(self) -> int:
        return self.frame["frame_index"]


def table_batches(labels: Labels, name: str, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """A table in pieces of at most 16,384 rows, in order.

    Raises
    ------
    InputError
        The file is damaged or of another schema.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = labels.root / f"{name}.parquet"
    try:
        # Pre-buffering keeps what was read of every row group until the last is done.
        with pq.ParquetFile(path, pre_buffer=False) as file:
            check_version(file.schema_arrow.metadata or {}, name, path)
            held = file.schema_arrow.names
            there = None if columns is None else [n for n in columns if n not in ADDED_COLUMNS or n in held]
            for batch in file.iter_batches(BATCH, columns=there):
                yield with_added(pa.Table.from_batches([batch]), name, columns)
    except (pa.ArrowInvalid, pa.ArrowTypeError, OSError) as error:
        raise InputError("not a readable Parquet file", got=str(error).split("\n")[0], path=path) from error


def iterate_frames(labels: Labels, tell: Progress | None = None) -> Iterator[FrameRows]:
    """Every frame with its rows, broken ones too; memory does not grow with their number.

    Raises
    ------
    InputError
        A table is damaged, out of order, or has rows of a frame that is not listed.
    """
    total = labels.manifest.tables["frames"].rows
    others = {name: _Runs(labels, name) for name in ("objects", "relations", "expressions")}
    for done, (index, rows) in enumerate(_runs(labels, "frames"), start=1):
        if rows.num_rows != 1:
            raise InputError(f"frame_index {index} is listed {rows.num_rows} times", path=labels.root)
        taken = {name: runs.take(index) for name, runs in others.items()}
        yield FrameRows(
            rows.to_pylist()[0], taken["objects"].to_pylist(), taken["relations"], taken["expressions"].to_pylist()
        )
        if tell is not None:
            tell(done, total)
    for runs in others.values():
        runs.finish()


class _Runs:
    """One table, taken frame by frame."""

    def __init__(self, labels: Labels, name: str) -> None:
        from pipeline.labels.tables import arrow_schema

        self._name, self._root = name, labels.root
        self._runs = _runs(labels, name)
        self._none = arrow_schema(name).empty_table()
        self._next = next(self._runs, None)

    def take(self, index: int) -> pa.Table:
        """The rows of a frame, maybe none; indices must rise from call to call."""
        if self._next is None or self._next[0] > index:
            return self._none
        if self._next[0] < index:
            self._unlisted()
        rows = self._next[1]
        self._next = next(self._runs, None)
        return rows

    def finish(self) -> None:
        if self._next is not None:
            self._unlisted()

    def _unlisted(self) -> None:
        assert self._next is not None
        raise InputError(
            f"the table {self._name} has rows of frame_index {self._next[0]}, which is not among the frames",
            path=self._root,
        )


def _runs(labels: Labels, name: str) -> Iterator[tuple[int, pa.Table]]:
    """(frame_index, its rows), in order."""
    import pyarrow as pa

    current, waiting = -1, []
    for batch in table_batches(labels, name):
        index = batch.column("frame_index").to_numpy()
        edges = [0, *(np.flatnonzero(np.diff(index)) + 1).tolist(), len(index)]
        for start, end in pairwise(edges):
            if start == end:
                continue
            found = int(index[start])
            if found < current:
                raise InputError(f"the table {name} is not in the order of its frames", path=labels.root)
            if found != current and waiting:
                yield current, pa.concat_tables(waiting)
                waiting = []
            current = found
            waiting.append(batch.slice(start, end - start))
    if waiting:
        yield current, pa.concat_tables(waiting)
