"""Records of a run on their file: a search, a column or some rows are read when they are asked for, and no more."""

from __future__ import annotations

import atexit
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pipeline.evaluation.records import need_columns, read_records, records_schema
from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error, first_line, require
from pipeline.system.frozen import dataclass
from pipeline.system.limits import current_limits
from pipeline.system.safe_files import open_parquet

UNREAD = "the records of the run cannot be read"
THREADS = 2
"""Of a search: words in half a million different texts take 60 ms in place of 90; more hardly gain."""
if TYPE_CHECKING:
    import duckdb

    Records: TypeAlias = "pa.Table | RecordsFile"


@dataclass(frozen=True, eq=False)
class RecordsFile:
    """Rows of a file that answers as a `pyarrow.Table` does, as far as searches, facets and lists ask.

    Of rows that are taken only the row groups in which they lie are read, one after the other.
    """

    path: Path
    schema: pa.Schema
    num_rows: int
    footer: Any  # a pyarrow.parquet.FileMetaData: of many row groups it takes longer to read than a column
    stamp: tuple[int, int]  # size and time of the file that was opened
    # added: columns that are not in the file, of as many rows: arrays of Arrow, or an `OtherColumn`
    added: dict[str, Any] = field(default_factory=dict)

    @property
    def column_names(self) -> list[str]:
        """Names of the columns of the file, and of those that were added."""
        return self.schema.names

    def append_column(self, name: str, values: Any) -> RecordsFile:
        """Add a column, a `pyarrow.Array` or an `OtherColumn` of as many rows."""
        return replace(self, schema=self.schema.append(pa.field(name, values.type)), added={**self.added, name: values})

    def column(self, name: str) -> Any:
        """One column, a `pyarrow.ChunkedArray`; raises as `take`."""
        return self.select([name]).column(0)

    def select(self, names: Sequence[str], coded: bool = False) -> pa.Table:
        """Some columns of all rows; `coded` and raises as `take`."""
        inside = [n for n in names if n not in self.added]
        with self._opened(inside if coded else ()) as file:
            rows = file.read(columns=inside)
        every = np.arange(self.num_rows)
        return self._table(
            names, coded, rows.column, lambda a: a.take(pa.array(every)) if isinstance(a, OtherColumn) else a
        )

    def take(self, indices: Any, names: Sequence[str] | None = None, coded: bool = False) -> pa.Table:
        """Some rows ((K,) int, in any order), by default with all columns.

        `coded`: texts of the file as dictionaries, as they are written: a third of the time and of the memory.

        Raises InputError: the file is damaged, or another one than it was.
        """
        names = self.column_names if names is None else names
        wanted = np.asarray(indices, np.int64)
        if coded and 4 * len(wanted) > self.num_rows:
            # To join dictionaries of many groups takes longer than to read them whole.
            return self.select(names, coded).take(pa.array(wanted))
        rows, place = np.unique(wanted, return_inverse=True)
        inside = [n for n in names if n not in self.added]
        parts = [self._schema_of(inside, coded).empty_table()]
        with self._opened(inside if coded else ()) as file:
            start = 0
            for group in range(file.num_row_groups):
                stop = start + file.metadata.row_group(group).num_rows
                here = rows[slice(*np.searchsorted(rows, (start, stop)))] - start
                if len(here):
                    parts.append(file.read_row_group(group, columns=inside).select(inside).take(here))
                start = stop
        found = pa.concat_tables(parts).take(place)
        return self._table(names, coded, found.column, lambda added: added.take(pa.array(wanted)))

    @contextmanager
    def _opened(self, coded: Sequence[str]) -> Iterator[Any]:
        with as_input_error(UNREAD, ValueError, OSError, got=first_line, path=self.path):
            require(
                stamp_of(self.path) == self.stamp, "the run was written anew", expected="open it again", path=self.path
            )
            texts = [name for name in coded if self._is_text(name)]
            with open_parquet(self.path, metadata=self.footer, read_dictionary=texts) as file:
                yield file

    def _table(
        self, names: Sequence[str], coded: bool, inside: Callable[[str], Any], beside: Callable[[Any], Any]
    ) -> pa.Table:
        columns = {n: beside(self.added[n]) if n in self.added else inside(n) for n in names}
        return pa.table(columns, schema=self._schema_of(names, coded))

    def _schema_of(self, names: Sequence[str], coded: bool) -> pa.Schema:
        fields, text = [self.schema.field(name) for name in names], pa.dictionary(pa.int32(), pa.string())
        return pa.schema([f.with_type(text) if coded and self._is_text(f.name) else f for f in fields])

    def _is_text(self, name: str) -> bool:
        return name not in self.added and self.schema.field(name).type == pa.string()


@dataclass(frozen=True, eq=False)
class OtherColumn:
    """A column of other records beside rows, read as it is asked for."""

    records: Records
    name: str
    rows: Any  # an int64 array of Arrow: the other row of each; null for none

    @property
    def type(self) -> Any:
        """Type of its values."""
        return self.records.schema.field(self.name).type

    def take(self, indices: Any) -> Any:
        """Values of some rows, a `pyarrow.ChunkedArray`; null for none."""
        rows = self.rows.take(indices)
        there = rows.is_valid().to_numpy(zero_copy_only=False)
        values = some_rows(self.records, rows.drop_null().to_numpy(), [self.name]).column(0).cast(self.type)
        return values.take(pa.array(np.cumsum(there) - 1, mask=~there))


def some_rows(records: Records, rows: np.ndarray | None, names: Sequence[str], coded: bool = False) -> pa.Table:
    """Some columns of some rows ((K,) int, in any order), or of all; `coded` as of a `RecordsFile`."""
    if isinstance(records, RecordsFile):
        return records.select(names, coded) if rows is None else records.take(rows, names, coded)
    found = records.select(list(names))
    return found if rows is None else found.take(pa.array(rows))


def text_codes(column: Any) -> tuple[list[str | None], np.ndarray]:
    """Texts that occur in a `pyarrow.ChunkedArray`, None for null, and (N,) int: the place of each row's among them."""
    if not pa.types.is_dictionary(column.type):
        column = column.cast("string").dictionary_encode()
    found = column.combine_chunks()
    names: list[str | None] = [*found.dictionary.to_pylist(), None]
    codes = found.indices.fill_null(len(names) - 1).to_numpy(zero_copy_only=False)
    used = np.bincount(codes, minlength=len(names)) > 0
    places = (np.cumsum(used) - 1).astype(np.min_scalar_type(len(names)))
    return [name for name, there in zip(names, used.tolist(), strict=True) if there], places[codes]


def texts_of(records: Records, name: str) -> np.ndarray:
    """Texts of a column, (N,) object; None for null."""
    names, codes = text_codes(some_rows(records, None, [name], coded=True).column(0))
    return np.array([*names, None], object)[codes]


def paired_rows(first: Records, second: Records, keys: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """(K,) int64 twice: rows of two runs with the same keys, in the order of the second; of several the last first."""
    with _database().cursor() as connection:
        given, sources = [], []
        for name, records in (("one", first), ("other", second)):
            if isinstance(records, RecordsFile):
                given.append(_literal(records.path))
                sources.append("(SELECT *, file_row_number AS place FROM read_parquet(?, file_row_number = true))")
            else:
                connection.register(name, records.select(keys).append_column("place", [np.arange(records.num_rows)]))
                sources.append(name)
        same = " AND ".join(f"a.{key} IS NOT DISTINCT FROM b.{key}" for key in keys)
        found = connection.execute(
            f"SELECT max(a.place) AS first, b.place AS second FROM {sources[0]} a JOIN {sources[1]} b ON {same}"
            " GROUP BY b.place ORDER BY b.place",
            given,
        ).fetchnumpy()
    return np.asarray(found["first"], np.int64), np.asarray(found["second"], np.int64)


def open_records(run: Path) -> Records:
    """Records of a run folder: on their file, but of an older release with columns of other types in memory.

    Raises InputError: as `read_records`.
    """
    read_records(run, [])
    path, known = Path(run) / "records.parquet", records_schema()
    stamp = stamp_of(path)
    with open_parquet(path) as file:
        schema, footer = file.schema_arrow, file.metadata
    need_columns(schema.names, path)
    alike = all(f.name not in known.names or known.field(f.name).type == f.type for f in schema)
    return RecordsFile(path, schema.remove_metadata(), footer.num_rows, footer, stamp) if alike else read_records(run)


def stamp_of(path: Path) -> tuple[int, int]:
    """Size and time of a file."""
    told = path.stat()
    return told.st_size, told.st_mtime_ns


def rows_where(
    records: Records, where: str, parameters: Sequence[Any], columns: Sequence[str], order: Sequence[str] = ()
) -> np.ndarray:
    """(N,) int64: indices of the rows with a condition of SQL over these columns, in the run's order or as asked."""
    held, given, source, row = list(columns), [], "held", "held_row"
    if isinstance(records, RecordsFile):
        held, given = [name for name in columns if name in records.added], [_literal(records.path)]
        source, row = "read_parquet(?, file_row_number = true)", "file_row_number"
        if held:
            source = f"{source} JOIN held ON file_row_number = held_row"
    with _database().cursor() as connection:
        if held:
            rows = records.select(held).append_column("held_row", [np.arange(records.num_rows)])
            connection.register("held", rows)
        sql = f"SELECT {row} AS location FROM {source} WHERE {where} ORDER BY {', '.join([*order, row])}"
        found = connection.execute(sql, [*given, *parameters]).fetchnumpy()
    return np.asarray(found["location"], np.int64)


def _literal(path: Path) -> str:
    """Path in which no character stands for others."""
    return re.sub(r"([*?\[])", r"[\1]", str(path.absolute()))


@lru_cache(maxsize=1)
def _database() -> duckdb.DuckDBPyConnection:
    """Keep an empty database: opening takes longer than a search."""
    import duckdb

    # One that outlives the interpreter makes DuckDB print what it leaks.
    atexit.register(_database.cache_clear)
    database = duckdb.connect(":memory:", config={"threads": THREADS, "memory_limit": f"{current_limits().query}B"})
    # The footer of a file with many row groups takes longer to read than a search; a changed file is read anew.
    database.execute("SET GLOBAL parquet_metadata_cache = true")
    return database
