"""Bounded memory of recent values by key."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")
_LOCK = Lock()
"""One for all, held for a few instructions only: what has a memory can so be sent to another process."""


class Recent(Generic[Key, Value]):
    """Memory of at most `most` values; the least recently used makes room.

    With `weigh` it is their weight that is at most `most`, but for the newest value, which always stays.
    """

    def __init__(self, most: int, weigh: Callable[[Key], int] | None = None) -> None:
        self._most = most
        self._weigh = weigh
        self._kept: dict[Key, tuple[Value, int]] = {}
        self._weight = 0

    def get(self, key: Key, find: Callable[[], Value]) -> Value:
        """Value of a key, never None; `find` gives an unknown one."""
        found = self._kept.get(key)
        if found is None:
            found = find(), 1 if self._weigh is None else self._weigh(key)
        with _LOCK:
            self._weight += found[1] - self._kept.pop(key, (None, 0))[1]
            self._kept[key] = found
            while self._weight > self._most and len(self._kept) > 1:
                self._weight -= self._kept.pop(next(iter(self._kept)))[1]
        return found[0]
