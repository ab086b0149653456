"""What stops a computation in a library when it takes too long: one thread watches all that run."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

_LOOK_S = 0.1
"""So often it is looked whether something ran out of time; nothing is looked at while nothing runs."""


@dataclass
class Running:
    """A computation; `stopped` once it was told to stop."""

    until: float
    stop: Callable[[], object]
    stopped: bool = False


class _Watch:
    def __init__(self) -> None:
        self.process = os.getpid()
        self.running: dict[int, Running] = {}
        self.numbers = itertools.count()
        self.wake = threading.Event()
        threading.Thread(target=self._look, name="time limit", daemon=True).start()

    def _look(self) -> None:
        while self.wake.wait():
            self.wake.clear()
            while self.running:
                time.sleep(_LOOK_S)
                now = time.monotonic()
                for each in list(self.running.values()):
                    if now > each.until:
                        each.stopped = True
                        with suppress(Exception):  # This thread watches the other ones too.
                            each.stop()


_watch: _Watch | None = None
_lock = threading.Lock()


@contextmanager
def stopped_after(seconds: float, stop: Callable[[], object]) -> Iterator[Running]:
    """Call `stop`, from another thread and until it helps, where the block takes longer than so many seconds."""
    global _watch
    # A forked process has no threads of its parent.
    if _watch is None or _watch.process != os.getpid():
        with _lock:
            if _watch is None or _watch.process != os.getpid():
                _watch = _Watch()
    watch, number = _watch, next(_watch.numbers)
    watch.running[number] = entry = Running(time.monotonic() + seconds, stop)
    watch.wake.set()
    try:
        yield entry
    finally:
        del watch.running[number]
