"""Databases in memory within the limit `query`, and a process for strangers' SQL.

DuckDB counts most of its memory, and not all; some functions look neither at its limit nor at an interrupt. So a typed
query runs in another process (`python -c` of `COMMAND`), bounded by the system and killed at need. The two talk in
pickled messages: the settings, then a question for each answer.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from pipeline.system.errors import InputError, kind_and_text
from pipeline.system.limits import LIMITS_OPTION, current_limits, shown, shown_above
from pipeline.system.safe_files import read_parquet
from pipeline.system.whole_files import scratch_folder

if sys.platform == "linux":
    import resource

if TYPE_CHECKING:
    import duckdb

COMMAND = "import sys; sys.path[:] = {path!r}; from pipeline.system.sql import answer_queries; answer_queries()"
ROWS_AT_ONCE = 1000
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


def answer_queries() -> None:
    """Answer questions of standard input on standard output, to the end of input or of the asking process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    out = os.fdopen(os.dup(1), "wb")
    # Nothing else may come between the answers.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    tables, held, spill = pickle.load(sys.stdin.buffer)
    questions = _questions(sys.stdin.buffer)
    try:
        connection = _opened(tables, held, spill)
    except Exception as error:
        _send(out, ("problem", _problem(error)))
        return
    found: Any = None
    for sql, parameters in questions:
        try:
            if sql is None:
                rows = found.fetchmany(ROWS_AT_ONCE)
                _send(out, ("rows", rows))
            else:
                found = _selected(connection, sql, parameters)
                _send(out, ("columns", tuple(c[0] for c in found.description or ())))
        except Exception as error:
            _send(out, ("problem", _problem(error)))


def _questions(source: BinaryIO) -> Iterator[tuple[str | None, Sequence[Any]]]:
    """Each SELECT with its parameters; None for more rows of the last."""
    with suppress(EOFError):
        while True:
            yield pickle.load(source)


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


def _opened(tables: Mapping[str, Path], held: Collection[str], spill: str) -> duckdb.DuckDBPyConnection:
    """Database of Parquet files as views, some held in memory, without access to anything else."""
    import duckdb
    from pyarrow import dataset

    connection = duckdb.connect(":memory:", config=database_settings(spill))
    for name, path in tables.items():
        # Arrow reads these files, piece by piece: DuckDB needs leave for no path, since a path that it may read is one
        # that it may write, by a COPY within a SELECT.
        connection.register(name, read_parquet(path) if name in held else dataset.dataset(path, format="parquet"))
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
