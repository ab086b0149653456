"""When the next request may be made: a limit of requests a minute, and a pause that holds for all workers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from pipeline.system.errors import InputError


class Pace:
    """A token bucket that holds one token, so that requests are evenly spaced.

    A bucket of a whole minute's tokens would let twice the limit through in its first minute.

    Parameters
    ----------
    per_minute : float or None
        None sets no limit.
    clock, sleep : callable
        Seconds, and waiting for some.
    """

    def __init__(
        self,
        per_minute: float | None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if per_minute is not None and not 0 < per_minute < float("inf"):
            raise InputError("a limit of requests a minute must be above 0", got=per_minute)
        self.interval = 60.0 / per_minute if per_minute else 0.0
        self._clock, self._sleep = clock, sleep
        self._lock = threading.Lock()
        self._free = clock()

    def wait(self) -> None:
        """Return when the next request may be made."""
        while True:
            with self._lock:
                now = self._clock()
                if now >= self._free:
                    self._free = now + self.interval
                    return
                left = self._free - now
            self._sleep(left)

    def hold(self, seconds: float) -> None:
        """No request of any worker for so long."""
        with self._lock:
            self._free = max(self._free, self._clock() + seconds)
