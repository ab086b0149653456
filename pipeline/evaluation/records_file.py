"""Records of a run on their file: a search, a column or some rows are read when they are asked for, and no more."""

from __future__ import annotations

import atexit
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pipeline.evaluation.records import need_columns, read_records, records_schema
from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error, first_line, require
from pipeline.system.limits import current_limits
from pipeline.system.safe_files import open_parquet

UNREAD = "the records of the run cannot be read"
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
    # added: columns that are not in the file, of as many rows
    added: dict[str, Any] = field(default_factory=dict)

    @property
    def column_names(self) -> list[str]:
        """Names of the columns of the file, and of those that were added."""
        return self.schema.names

    def append_column(self, name: str, values: Any) -> RecordsFile:
        """Add a column, a `pyarrow.Array` of as many rows."""
        return replace(self, schema=self.schema.append(pa.field(name, values.type)), added={**self.added, name: values})

    def column(self, name: str) -> Any:
        """One column, a `pyarrow.ChunkedArray`; raises as `read_records`."""
        return self.select([name]).column(0)

    def select(self, names: Sequence[str]) -> pa.Table:
        """Some columns of all rows; raises as `take`."""
        inside = [n for n in names if n not in self.added]
        with self._opened() as file:
            rows = file.read(columns=inside)
        return self._table(names, lambda n: rows.column(n), lambda added: added)

    def take(self, indices: Any, names: Sequence[str] | None = None) -> pa.Table:
        """Some rows ((K,) int, in any order), by default with all columns.

        Raises InputError: the file is damaged, or another one than it was.
        """
        names = self.column_names if names is None else names
        wanted = np.asarray(indices, np.int64)
        rows, place = np.unique(wanted, return_inverse=True)
        inside = [n for n in names if n not in self.added]
        parts = [self._schema_of(inside).empty_table()]
        with self._opened() as file:
            start = 0
            for group in range(file.num_row_groups):
                stop = start + file.metadata.row_group(group).num_rows
                here = rows[slice(*np.searchsorted(rows, (start, stop)))] - start
                if len(here):
                    parts.append(file.read_row_group(group, columns=inside).select(inside).take(here))
                start = stop
        found = pa.concat_tables(parts).take(place)
        return self._table(names, lambda n: found.column(n), lambda added: added.take(pa.array(wanted)))

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        with as_input_error(UNREAD, ValueError, OSError, got=first_line, path=self.path):
            require(
                stamp_of(self.path) == self.stamp, "the run was written anew", expected="open it again", path=self.path
            )
            with open_parquet(self.path, metadata=self.footer) as file:
                yield file

    def _table(self, names: Sequence[str], inside: Callable[[str], Any], beside: Callable[[Any], Any]) -> pa.Table:
        columns = {n: beside(self.added[n]) if n in self.added else inside(n) for n in names}
        return pa.table(columns, schema=self._schema_of(names))

    def _schema_of(self, names: Sequence[str]) -> pa.Schema:
        return pa.schema([self.schema.field(name) for name in names])


def some_rows(records: Records, rows: np.ndarray, names: Sequence[str]) -> pa.Table:
    """Some columns of some rows ((K,) int, in any order)."""
    if isinstance(records, RecordsFile):
        return records.take(rows, names)
    return records.select(list(names)).take(pa.array(rows))


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
    database = duckdb.connect(":memory:", config={"threads": 1, "memory_limit": f"{current_limits().query}B"})
    # The footer of a file with many row groups takes longer to read than a search; a changed file is read anew.
    database.execute("SET GLOBAL parquet_metadata_cache = true")
    return database
