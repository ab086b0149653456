"""Databases in memory within the limit `query`, and a process for strangers' SQL.

DuckDB counts most of its memory, and not all; some functions look neither at its limit nor at an interrupt. So a
typed query runs in another process (`python -c` of `COMMAND`), bounded by the system and killed at need. The two talk
in pickled messages: the views, then a question for each answer.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from pipeline.system.errors import InputError, kind_and_text, require
from pipeline.system.frozen import dataclass
from pipeline.system.limits import LIMITS_OPTION, current_limits, shown, shown_above
from pipeline.system.whole_files import scratch_folder

if sys.platform == "linux":
    import resource

if TYPE_CHECKING:
    import duckdb

COMMAND = "import sys; sys.path[:] = {path!r}; from pipeline.system.sql import answer_queries; answer_queries()"
ROWS_AT_ONCE = 1000
Question = tuple[str, tuple[Any, ...]] | None
"""A SELECT with its parameters; None for more rows of the last."""
LARGEST_ROWS = 64 * 10**6
"""Bytes of the rows that are handed over at a time."""
SPILLED = 4
"""So many times the limit may lie on the disk."""
_SYSTEM_SHARE = 1.5
"""So many times the limit the system lets a process of queries take: what DuckDB does not count, and the rows."""
_LOOK_S = 1.0
_TURNED_OFF = (
    "python_enable_replacements",
    "autoinstall_known_extensions",
    "autoload_known_extensions",
    "enable_external_access",
)
"""Settings that are turned off. Not every version has each; the last one, which they all have, shuts the door."""


def database_settings(spill: str) -> dict[str, Any]:
    """Settings of DuckDB within the limit `query`; `spill` is the folder for the overflow."""
    most = current_limits().query
    return {
        "memory_limit": f"{most}B",
        "max_temp_directory_size": f"{SPILLED * most}B",
        "temp_directory": spill,
    }


@contextmanager
def bounded_database() -> Iterator[duckdb.DuckDBPyConnection]:
    """Open an empty database in memory, with a folder for the overflow, removed at the end of the block."""
    import duckdb

    with (
        scratch_folder() as spill,
        duckdb.connect(":memory:", config=database_settings(str(spill))) as connection,
    ):
        yield connection


@dataclass(frozen=True)
class QueryRows:
    """Answer of a query."""

    columns: tuple[str, ...]
    # rows: as they are fetched; to be used while the database is open, and before the next query
    rows: Iterator[tuple[Any, ...]]


class QueryDatabase:
    """Parquet files as views for strangers' SELECTs, which a process of its own answers.

    `tables`: files by the names of the views. `spill`: folder for the overflow. `lacking`: cause that is said where a
    query names another view.
    """

    def __init__(self, tables: Mapping[str, Path], spill: Path, lacking: str) -> None:
        self.tables, self.spill, self.lacking = dict(tables), spill, lacking
        self._process: subprocess.Popen[bytes] | None = None
        self._last = object()

    def select(self, sql: str, parameters: Sequence[Any] = (), seconds: float | None = None) -> QueryRows:
        """Run one SELECT.

        `parameters`: in the places of "?". `seconds`: how long it may take, without the time in which nobody asks for
        rows; at most the limit `query_seconds`.

        Raises InputError: it is not one SELECT, DuckDB refuses it, or it takes more memory or time than it may.
        """
        most = current_limits().query_seconds
        allowed = most if seconds is None else min(seconds, most)
        self._last = query = object()
        columns, left = self._answer((sql, tuple(parameters)), allowed, allowed)
        return QueryRows(columns, self._rows(query, left, allowed))

    def _rows(self, query: object, left: float, allowed: float) -> Iterator[tuple[Any, ...]]:
        while True:
            require(query is self._last, "another query was asked before all rows of this one were read")
            rows, left = self._answer(None, left, allowed)
            if not rows:
                return
            yield from rows

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            # In a session of its own, Ctrl-C in the terminal is for the process that waits.
            self._process = subprocess.Popen(
                [sys.executable, "-c", COMMAND.format(path=sys.path)],
                start_new_session=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            assert self._process.stdin is not None
            pickle.dump((self.tables, str(self.spill)), self._process.stdin)
        return self._process

    def _answer(self, question: Question, left: float, allowed: float) -> tuple[Any, float]:
        """Answer and seconds left; without an answer the process is gone."""
        process, begun = self._started(), time.monotonic()
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Timer(left, process.kill)
        late.daemon = True
        late.start()
        try:
            pickle.dump(question, process.stdin)
            process.stdin.flush()
            kind, answer = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            over = time.monotonic() - begun >= left
            self.close()
            most = current_limits()
            if over:
                raise InputError(
                    "the query takes too long",
                    got=f"more than {allowed:g} s",
                    expected="a narrower one",
                    cause=None
                    if allowed < most.query_seconds
                    else f"or {LIMITS_OPTION} query_seconds={shown_above(2 * most.query_seconds)}",
                ) from error
            raise InputError(
                "the query needs too much memory",
                got="a process that ended without an answer",
                expected=f"at most {shown(most.query)} bytes",
                cause=f"a narrower one, or {LIMITS_OPTION} query={shown_above(2 * most.query)}",
            ) from error
        except BaseException:
            self.close()
            raise
        finally:
            late.cancel()
        if kind == "problem":
            raise InputError(answer, cause=self.lacking if "does not exist" in answer else None)
        return answer, max(left - (time.monotonic() - begun), 0.1)

    def close(self) -> None:
        """End the process; the next query starts another."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for stream in (process.stdin, process.stdout):
                with suppress(OSError):
                    assert stream is not None
                    stream.close()


def answer_queries() -> None:
    """Answer questions of standard input on standard output, to the end of input or of the asking process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    out = os.fdopen(os.dup(1), "wb")
    # Nothing else may come between the answers.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    connection: Any = None
    found: Any = None
    opening = pickle.load(sys.stdin.buffer)
    with suppress(EOFError):
        while True:
            question = pickle.load(sys.stdin.buffer)
            try:
                connection = connection or _opened(*opening)
                if question is None:
                    _send(out, ("rows", found.fetchmany(ROWS_AT_ONCE)))
                else:
                    found = _selected(connection, *question)
                    _send(out, ("columns", tuple(c[0] for c in found.description or ())))
            except Exception as error:
                _send(out, ("problem", _problem(error)))


def _send(out: BinaryIO, answer: tuple[str, Any]) -> None:
    data = pickle.dumps(answer)
    if len(data) > LARGEST_ROWS:
        words = InputError(
            "the rows of the answer are too large",
            got=f"{shown(len(data))} bytes of {len(answer[1]):,} rows",
            expected=f"at most {shown(LARGEST_ROWS)}",
            cause="fewer columns, or substr(...) of a long text",
        )
        data = pickle.dumps(("problem", str(words)))
    out.write(data)
    out.flush()


def _opened(tables: Mapping[str, Path], spill: str) -> duckdb.DuckDBPyConnection:
    """Database of Parquet files as views without access to anything else."""
    import duckdb
    from pyarrow import OSFile, dataset

    connection = duckdb.connect(":memory:", config=database_settings(spill))
    for name, path in tables.items():
        # Arrow reads these files, piece by piece: DuckDB needs leave for no path, since a path that it may read is one
        # that it may write, by a COPY within a SELECT. They stay open, wherever they go.
        rows = dataset.ParquetFileFormat().make_fragment(OSFile(str(path)))
        connection.register(name, dataset.FileSystemDataset([rows], rows.physical_schema, rows.format))
    for setting in _TURNED_OFF:
        with suppress(duckdb.CatalogException):
            connection.execute(f"SET {setting} = false")
    connection.execute("SET lock_configuration = true")
    _bound_by_the_system()
    return connection


def _bound_by_the_system() -> None:
    """Bound this process's memory above the present size, on Linux."""
    if sys.platform != "linux":
        return
    with open("/proc/self/status", encoding="ascii", errors="replace") as status:
        held = next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmData"))
    most = held + int(_SYSTEM_SHARE * current_limits().query)
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _selected(connection: duckdb.DuckDBPyConnection, sql: str, parameters: Sequence[Any]) -> Any:
    import duckdb

    statements = connection.extract_statements(sql)
    if len(statements) != 1 or statements[0].type not in (duckdb.StatementType.SELECT,):
        got = f"{len(statements)} statements" if len(statements) != 1 else statements[0].type.name
        raise InputError("a run is only read", got=got, expected="one SELECT")
    return connection.execute(statements[0], list(parameters) or None)


def _problem(error: Exception) -> str:
    """Error on one line."""
    import duckdb

    most = current_limits().query
    full = isinstance(error, MemoryError | duckdb.OutOfMemoryException)
    if full or "max_temp_directory_size" in str(error):
        where = f"at most {shown(most)} bytes in memory and {shown(SPILLED * most)} on the disk"
        cause = f"a narrower one, or {LIMITS_OPTION} query={shown_above(2 * most)}"
        return str(InputError("the query needs too much memory", expected=where, cause=cause))
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, duckdb.Error):
        return str(InputError("the query cannot be run", got=str(error).split("\nLINE ")[0].split("\n\n")[0]))
    return str(InputError("the query cannot be run", got=kind_and_text(error)))


def _end_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)
