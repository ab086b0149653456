"""A run for questions in SQL, which a process of its own answers: it can touch nothing else, and is killed in time."""

from __future__ import annotations

import pickle
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

from pipeline.evaluation.records import read_records
from pipeline.evaluation.run_folder import RECORDS_FILE, labels_of
from pipeline.labels.reading import read_table
from pipeline.labels.schema import TABLES
from pipeline.system.errors import InputError, require
from pipeline.system.limits import LIMITS_OPTION, current_limits, shown, shown_above
from pipeline.system.sql import COMMAND
from pipeline.system.whole_files import scratch_folder

RECORDS = "records"
LABELS = "labels_"


@dataclass(frozen=True)
class QueryRows:
    """What a query gives."""

    columns: tuple[str, ...]
    # rows: as they are fetched; to be used while the database is open, and before the next query
    rows: Iterator[tuple[Any, ...]]


class RunDatabase:
    """The view "records", and "labels_frames", "labels_objects", "labels_relations", "labels_expressions" where the
    labels of the run are still where they were. Open it with `open_database`.

    `labels`: where the labels of the run were.
    """

    def __init__(self, tables: Mapping[str, Path], spill: Path, labels: str | None) -> None:
        self.views, self.labels = tuple(tables), labels
        self._opening = (dict(tables), (RECORDS,), str(spill))
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
            rows, left = self._answer((None, ()), left, allowed)
            if not rows:
                return
            yield from rows

    def _answer(self, question: tuple[str | None, Sequence[Any]], left: float, allowed: float) -> tuple[Any, float]:
        """Answer and seconds left; without an answer the process is gone."""
        process, begun = self._started(), time.monotonic()
        assert process.stdin is not None
        assert process.stdout is not None
        late = Timer(left, process.kill)
        late.daemon = True
        late.start()
        try:
            pickle.dump(question, process.stdin)
            process.stdin.flush()
            kind, answer = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            over = time.monotonic() - begun >= left
            self.close()
            most = current_limits().query_seconds
            if over:
                raise InputError(
                    "the query takes too long",
                    got=f"more than {allowed:g} s",
                    expected="a narrower one",
                    cause=f"or {LIMITS_OPTION} query_seconds={shown_above(2 * most)}" if allowed == most else None,
                ) from error
            most = current_limits().query
            raise InputError(
                "the query needs too much memory",
                got="a process that ended without an answer",
                expected=f"at most {shown(most)} bytes",
                cause=f"a narrower one, or {LIMITS_OPTION} query={shown_above(2 * most)}",
            ) from error
        except BaseException:
            self.close()
            raise
        finally:
            late.cancel()
        if kind == "problem":
            raise self._refused(answer)
        return answer, max(left - (time.monotonic() - begun), 0.1)

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
            pickle.dump(self._opening, self._process.stdin)
        return self._process

    def _refused(self, problem: str) -> InputError:
        if "does not exist" not in problem:
            return InputError(problem)
        missing = LABELS in problem and len(self.views) == 1
        cause = f"the labels of this run are not at {self.labels}" if missing else f"there is {', '.join(self.views)}"
        return InputError(problem, cause=cause)

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


@contextmanager
def open_database(run: Path) -> Iterator[RunDatabase]:
    """Open a run and its labels as views of a database without access to anything else.

    Raises InputError: there is no run, or the tables of its labels are damaged.
    """
    run = Path(run)
    read_records(run, [])
    tables = {RECORDS: run / RECORDS_FILE}
    root = labels_of(run)
    if root is not None and all((root / f"{n}.parquet").is_file() for n in TABLES):
        for name in TABLES:
            tables[f"{LABELS}{name}"] = root / f"{name}.parquet"
            # Reads the footer alone, and checks it.
            read_table(root / f"{name}.parquet", name, [])
    with scratch_folder() as spill:
        database = RunDatabase(tables, spill, None if root is None else str(root))
        try:
            yield database
        finally:
            database.close()
