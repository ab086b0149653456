"""Waiting in tests for what other threads and processes do.

A machine under load may let one of them rest for many seconds, so that a wait is for a condition, never for a time,
and its end is far beyond what a test that works ever needs.
"""

from __future__ import annotations

import time
from collections.abc import Callable

LONG_S = 300.0
"""Only a test that fails waits as long."""


def wait_until(holds: Callable[[], object]) -> bool:
    """Whether something comes to hold; looked at again and again, for LONG_S at most."""
    end = time.monotonic() + LONG_S
    while not (held := bool(holds())) and time.monotonic() < end:
        time.sleep(0.02)
    return held
