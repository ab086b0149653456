"""Processor time, wall clock and memory: the least of several passes, which another program disturbs least."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

if sys.platform != "win32":
    import resource

ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What libraries of arithmetic take their threads from; processor seconds are compared with one."""
Figure = tuple[str, float | str, float | None]
"""Name of a claim, its value or why there is none, and its floor in the same run."""


@dataclass(frozen=True)
class Setup:
    """What a part is told."""

    quick: bool = False
    peers: str | None = None
    """Folder of other projects' files: see docs/examples/bench_peers.sh."""

    def times(self, full: int, quick: int = 2) -> int:
        """Passes."""
        return quick if self.quick else full


def least(job: Callable[[], Any], times: int, clock: Callable[[], float] = process_time) -> float:
    """Seconds of the cheapest of some passes, after one that is not counted."""
    job()
    return min(seconds(job, clock) for _ in range(max(times, 1)))


def seconds(job: Callable[[], Any], clock: Callable[[], float] = process_time) -> float:
    """Seconds of one pass."""
    start = clock()
    job()
    return clock() - start


def side_by_side(jobs: Sequence[Callable[[], Any]], times: int) -> list[float]:
    """Least processor seconds of each job, their passes in turn, so that all see the same machine."""
    for job in jobs:
        job()
    passes = [[seconds(job) for job in jobs] for _ in range(max(times, 1))]
    return [min(column) for column in zip(*passes, strict=True)]


def child_seconds(commands: Sequence[Sequence[str]], times: int) -> list[float]:
    """Least processor seconds of commands of Python, in turn; the first pass writes bytecode and is not counted.

    Raises RuntimeError: one of them fails.
    """

    def spent() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    found = [float("inf")] * len(commands)
    for k in range(times + 1):
        for at, words in enumerate(commands):
            start = spent()
            ended = subprocess.run([sys.executable, *words], capture_output=True, text=True)
            if ended.returncode not in (0, 1):
                raise RuntimeError(f"{' '.join(words)}: {ended.stderr.strip().splitlines()[-1:]}")
            if k:
                found[at] = min(found[at], spent() - start)
    return found


def resident_mb(process: int | str = "self") -> float:
    """Resident memory in 2**20 bytes; OSError where the system does not tell it."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def synced_row(folder: Path) -> Iterator[None]:
    """Floor of a saved action: every step writes a row into SQLite and waits until the disk has it."""
    with sqlite3.connect(folder / "floor.sqlite", isolation_level=None) as link:
        link.execute("PRAGMA journal_mode=WAL")
        link.execute("PRAGMA synchronous=FULL")
        link.execute("CREATE TABLE IF NOT EXISTS t (x TEXT)")
        while True:
            link.execute("INSERT INTO t VALUES ('a label')")
            yield
