"""The last few values that were found, by key: one bounded memory for all that is read or computed again."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")
_LOCK = Lock()
"""One for all, held for a few instructions only: what has a memory can so be sent to another process."""


class Recent(Generic[Key, Value]):
    """At most `most` values; the one that was asked for longest ago makes room."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: dict[Key, Value] = {}

    def get(self, key: Key, find: Callable[[], Value]) -> Value:
        """The value of a key, which is never None; `find` gives it where it is not known (any more)."""
        found = self._kept.get(key)
        if found is None:
            found = find()
        with _LOCK:
            self._kept.pop(key, None)
            self._kept[key] = found
            while len(self._kept) > self._most:
                del self._kept[next(iter(self._kept))]
        return found
