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
    """Memory of at most `most` values; the least recently used makes room."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: dict[Key, Value] = {}

    def get(self, key: Key, find: Callable[[], Value]) -> Value:
        """Value of a key, never None; `find` gives an unknown one."""
        found = self._kept.get(key)
        if found is None:
            found = find()
        with _LOCK:
            self._kept.pop(key, None)
            self._kept[key] = found
            while len(self._kept) > self._most:
                del self._kept[next(iter(self._kept))]
        return found
