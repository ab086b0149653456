"""The tables of labels in DuckDB: SQL straight over the Parquet files, in memory that does not grow with them."""

from __future__ import annotations

import glob
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.labels.reading import Labels
from pipeline.labels.schema import TABLES
from pipeline.labels.tables import read_table
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import duckdb

FRAMES_AT_ONCE = 20_000
"""Frames whose tables are joined in one query: rows lie in the order of frames, so that each query reads its own part
of the files, and no join has to hold a whole table."""


class Database:
    """Merged labels as the views "frames", "objects", "relations" and "expressions".

    Open it with `open_database`.
    """

    def __init__(self, connection: duckdb.DuckDBPyConnection, labels: Labels) -> None:
        self._connection = connection
        self._labels = labels

    def rows(self, sql: str, **values: Any) -> list[tuple[Any, ...]]:
        """All rows of a query; meant for the few rows of an aggregate.

        Raises
        ------
        InputError
            A file turned out to be damaged.
        """
        with self._said_plainly():
            return self._connection.execute(sql, values or None).fetchall()

    def row(self, sql: str, **values: Any) -> dict[str, Any]:
        """The only row of an aggregate, by column."""
        with self._said_plainly():
            found = self._connection.execute(sql, values or None)
            (only,) = found.fetchall()
            return dict(zip([column[0] for column in found.description or ()], only, strict=True))

    def columns(self, sql: str, **values: Any) -> dict[str, np.ndarray]:
        """All rows of a query whose columns hold numbers without nulls, as arrays."""
        with self._said_plainly():
            found = self._connection.execute(sql, values or None).fetchnumpy()
        return {name: np.asarray(column) for name, column in found.items()}

    def frame_ranges(self) -> Iterator[tuple[int, int]]:
        """(first, last) values of `frame_index`, FRAMES_AT_ONCE at a time: for queries that join tables."""
        last = self.rows("SELECT max(frame_index) FROM frames")[0][0]
        for first in range(0, 0 if last is None else last + 1, FRAMES_AT_ONCE):
            yield first, first + FRAMES_AT_ONCE - 1

    @contextmanager
    def _said_plainly(self) -> Iterator[None]:
        import duckdb

        try:
            yield
        except (duckdb.IOException, duckdb.InvalidInputException, duckdb.ConversionException) as error:
            reason = str(error).split("\n")[0]
            raise InputError("the tables of the labels cannot be read", got=reason, path=self._labels.root) from error


@contextmanager
def open_database(labels: Labels) -> Iterator[Database]:
    """Views over the four tables; the schema of each file is checked first.

    Raises
    ------
    InputError
        A table is missing, damaged, of another schema, or lacks a column.
    """
    import duckdb

    # What does not fit into memory goes to disk: beside nothing of the user's, and away at the end.
    with tempfile.TemporaryDirectory(prefix="spatialviz-") as spill:
        connection = duckdb.connect(":memory:", config={"temp_directory": spill})
        try:
            for name in TABLES:
                path = labels.root / f"{name}.parquet"
                # No column is asked for: this reads the footer alone, and checks it.
                read_table(path, name, [])
                connection.read_parquet(glob.escape(str(path))).create_view(name)
            yield Database(connection, labels)
        finally:
            connection.close()


def quoted(name: str) -> str:
    """A column's name in SQL: several relations are key words."""
    return '"' + name.replace('"', '""') + '"'


def quantiles(values: np.ndarray, counts: np.ndarray, shares: tuple[float, ...]) -> list[float]:
    """Nearest-rank quantiles of counted values.

    Parameters
    ----------
    values : (N,) array
        Ascending.
    counts : (N,) int
        How often each occurs; at least one in all.
    shares : tuple of float
        0..1; the quantile of q is the least value that at least a share q does not exceed.
    """
    upto = np.cumsum(counts, dtype=np.int64)
    # Rounded, lest 0.05 * 100 ask for the sixth of a hundred.
    ranks = np.maximum(np.ceil(np.round(np.asarray(shares) * upto[-1], 6)), 1)
    return [float(v) for v in values[np.searchsorted(upto, ranks)]]
