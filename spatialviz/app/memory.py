"""Keep a long-running process small: pictures and clouds come and go in megabytes on many threads."""

from __future__ import annotations

import ctypes

_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8
"""Parameters of glibc's mallopt(3)."""


def return_freed_memory() -> None:
    """Ask glibc to hand large freed blocks back to the system and to keep few arenas; elsewhere nothing happens.

    By default glibc raises its threshold to the largest block that was ever
    freed, and from then on keeps such blocks in one pool for each thread.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    mallopt(_M_MMAP_THRESHOLD, 1 << 20)
    mallopt(_M_ARENA_MAX, 2)
