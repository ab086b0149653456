"""Time limit of a computation in a library."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Timer


@dataclass
class Running:
    """A computation; `stopped` once it was told to stop."""

    stopped: bool = False


@contextmanager
def stopped_after(seconds: float, stop: Callable[[], object]) -> Iterator[Running]:
    """Call `stop`, from another thread, where the block takes longer than so many seconds."""
    running = Running()

    def end() -> None:
        running.stopped = True
        stop()

    timer = Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield running
    finally:
        timer.cancel()
