"""The most memory that a process and its children hold at a time."""

from __future__ import annotations

import os
import threading
from pathlib import Path

INTERVAL_S = 0.1


class PeakMemory:
    """A context that watches this process and all that it starts (Linux; elsewhere nothing is known).

    Counted are proportional set sizes, in which a page that several processes share counts once.

    Attributes
    ----------
    megabytes : float or None
        The highest sum that was seen, in 2**20 bytes.
    processes : int
        How many processes there were at that time.
    """

    def __init__(self) -> None:
        self.megabytes: float | None = None
        self.processes = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> PeakMemory:
        self._look()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._look()

    def _watch(self) -> None:
        while not self._stop.wait(INTERVAL_S):
            self._look()

    def _look(self) -> None:
        sizes = [size for size in map(_proportional_size, _family(os.getpid())) if size is not None]
        total = sum(sizes) / 1024
        if sizes and (self.megabytes is None or total > self.megabytes):
            self.megabytes, self.processes = total, len(sizes)


def _family(root: int) -> list[int]:
    """The process numbers of a process and all its descendants; only its own where there is no /proc."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name, in brackets, may hold anything; the parent is the second field after it.
            parent = int(entry.read_text().rsplit(")", 1)[1].split()[1])
        except (OSError, ValueError, IndexError):
            continue
        children.setdefault(parent, []).append(int(entry.parent.name))
    found = [root]
    for process in found:
        found += children.get(process, [])
    return found


def _proportional_size(process: int) -> int | None:
    """Kibibytes; None for a process that is gone or may not be looked at."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    except (OSError, ValueError, StopIteration):
        return None
