"""A run in DuckDB for questions in SQL: read-only, and shut off from files and network."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.evaluation.compare import read_records
from pipeline.labels.schema import TABLES
from pipeline.labels.tables import read_table
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import duckdb

RECORDS = "records"
LABELS = "labels_"
AT_ONCE = 10_000
"""Rows that are fetched at a time."""


@dataclass(frozen=True)
class Answer:
    """What a query gives.

    Attributes
    ----------
    columns : tuple of str
    rows : iterator of tuple
        As they are fetched; to be used while the database is open.
    """

    columns: tuple[str, ...]
    rows: Iterator[tuple[Any, ...]]


class RunDatabase:
    """The view "records", and "labels_frames", "labels_objects", "labels_relations", "labels_expressions" where the
    labels of the run are still where they were. Open it with `open_run`.

    Attributes
    ----------
    views : tuple of str
    labels : str or None
        Where the labels of the run were.
    """

    def __init__(self, connection: duckdb.DuckDBPyConnection, views: Sequence[str], labels: str | None) -> None:
        self._connection = connection
        self.views, self.labels = tuple(views), labels

    def select(self, sql: str, parameters: Sequence[Any] = ()) -> Answer:
        """Run one SELECT.

        Raises
        ------
        InputError
            It is not one SELECT, or DuckDB refuses it.
        """
        import duckdb

        try:
            statements = self._connection.extract_statements(sql)
        except duckdb.Error as error:
            raise self._refused(error) from error
        if len(statements) != 1 or statements[0].type not in (duckdb.StatementType.SELECT,):
            got = f"{len(statements)} statements" if len(statements) != 1 else statements[0].type.name
            raise InputError("a run is only read", got=got, expected="one SELECT")
        try:
            found = self._connection.execute(statements[0], list(parameters) or None)
        except duckdb.Error as error:
            raise self._refused(error) from error
        return Answer(tuple(c[0] for c in found.description or ()), self._rows(found))

    def _rows(self, found: duckdb.DuckDBPyConnection) -> Iterator[tuple[Any, ...]]:
        import duckdb

        while True:
            try:
                rows = found.fetchmany(AT_ONCE)
            except duckdb.Error as error:
                raise self._refused(error) from error
            if not rows:
                return
            yield from rows

    def _refused(self, error: Exception) -> InputError:
        reason = str(error).split("\nLINE ")[0].split("\n\n")[0]
        missing = LABELS in reason and len(self.views) == 1
        cause = f"the labels of this run are not at {self.labels}" if missing else f"there is {', '.join(self.views)}"
        return InputError("the query cannot be run", got=reason, cause=cause)


@contextmanager
def open_run(run: Path) -> Iterator[RunDatabase]:
    """A run, and its labels, as views of a database that can touch nothing else.

    Raises
    ------
    InputError
        There is no run, or the tables of its labels are damaged.
    """
    import duckdb
    from pyarrow import dataset

    run = Path(run)
    records = read_records(run)
    root = labels_of(run)
    with tempfile.TemporaryDirectory(prefix="spatialviz-") as spill:
        connection = duckdb.connect(":memory:", config={"temp_directory": spill})
        try:
            connection.register(RECORDS, records)
            views = [RECORDS]
            for name in TABLES if root is not None and all((root / f"{n}.parquet").is_file() for n in TABLES) else ():
                assert root is not None
                path = root / f"{name}.parquet"
                # Reads the footer alone, and checks it.
                read_table(path, name, [])
                # Arrow reads these files, piece by piece: DuckDB needs leave for no path, since a path that it may read
                # is one that it may write, by a COPY within a SELECT.
                connection.register(f"{LABELS}{name}", dataset.dataset(path, format="parquet"))
                views.append(f"{LABELS}{name}")
            for setting in ("python_enable_replacements", "autoinstall_known_extensions", "autoload_known_extensions",
                            "enable_external_access"):  # fmt: skip
                # Not every version has each of them; the last one, which they all have, is what shuts the door.
                with suppress(duckdb.CatalogException):
                    connection.execute(f"SET {setting} = false")
            connection.execute("SET lock_configuration = true")
            yield RunDatabase(connection, views, None if root is None else str(root))
        finally:
            connection.close()


def manifest_of(run: Path) -> dict[str, Any]:
    """The manifest of a run; empty where there is none that can be read."""
    try:
        found = json.loads((Path(run) / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def labels_of(run: Path) -> Path | None:
    """Where the labels of a run are; None where its manifest does not say."""
    from pipeline.evaluation import run_folder

    try:
        return Path(run_folder.open_run(run).spec.labels)
    except InputError:
        return None
