"""Encoded pictures that the page's addresses name by their content."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict

KEPT_BYTES = 96 * 2**20
"""Limit of kept pictures; a dropped picture is remade by the next drawing."""


class Images:
    """Encoded pictures by a hash of their bytes."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, bytes] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def url(self, data: bytes, kind: str) -> str:
        """Store a picture and return its address; `kind` is "jpg" or "png"."""
        name = f"{hashlib.sha256(data).hexdigest()[:32]}.{kind}"
        with self._lock:
            if name not in self._kept:
                self._bytes += len(data)
                self._kept[name] = data
            self._kept.move_to_end(name)
            while self._bytes > KEPT_BYTES and len(self._kept) > 1:
                self._bytes -= len(self._kept.popitem(last=False)[1])
        return f"app/image/{name}"

    def let_go(self) -> None:
        """Drop all pictures: nobody shows them."""
        with self._lock:
            self._kept.clear()
            self._bytes = 0

    def get(self, name: str) -> bytes | None:
        with self._lock:
            return self._kept.get(name)


IMAGES = Images()
"""Pictures of this program; hashed names reveal nothing, and cannot be guessed."""
