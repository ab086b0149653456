"""Memory: garbage left alone, and freed pages given back to the system; glibc keeps those between used blocks."""

from __future__ import annotations

import ctypes
import gc
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Parameters of glibc's mallopt(3)."""
TRIM_SECONDS = 20.0
"""Looking through the heap takes some ten milliseconds of one thread."""
_trimming = threading.Lock()
_trimmed = 0.0


def return_freed_memory() -> None:
    """Ask glibc to return the largest freed blocks and its heap's end, and to keep few arenas; no effect elsewhere.

    By default glibc raises its threshold to the largest block that was ever
    freed, and from then on keeps such blocks in one pool for each thread. The
    arrays of a frame, of some megabytes, stay below: mapped and returned one
    by one, they cost a frame more time than its points; `trim` returns them.
    """
    for parameter, value in ((_M_MMAP_THRESHOLD, 1 << 23), (_M_TRIM_THRESHOLD, 1 << 25), (_M_ARENA_MAX, 2)):
        _glibc("mallopt", parameter, value)


def trim() -> None:
    """Return free pages between used blocks, at most every `TRIM_SECONDS`."""
    global _trimmed
    if time.monotonic() - _trimmed > TRIM_SECONDS and _trimming.acquire(blocking=False):
        try:
            _glibc("malloc_trim", 0)
            _trimmed = time.monotonic()
        finally:
            _trimming.release()


def collect() -> None:
    """Collect reference cycles, such as closed pages, and return their memory."""
    gc.collect()
    _glibc("malloc_trim", 0)


@contextmanager
def uncollected() -> Iterator[None]:
    """Look for no garbage while something is imported: none of it is any, and looking takes a tenth of the time. What
    is there afterwards is left out of later collections."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _glibc(name: str, *values: int) -> None:
    try:
        function = getattr(ctypes.CDLL(None), name)
    except (OSError, AttributeError, TypeError):
        return
    function(*values)
