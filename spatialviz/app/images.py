"""Pictures of the page: kept by their content, and fetched by the browser once."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict

import cv2
import numpy as np

KEPT_BYTES = 96 * 2**20
"""The pictures used last are kept up to so much; one that is gone is made again with the next drawing."""


class Images:
    """Encoded pictures by a name that is made from their bytes."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, bytes] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def url(self, data: bytes, kind: str) -> str:
        """Keep a picture, and say where the page finds it; `kind` is "jpg" or "png"."""
        name = f"{hashlib.sha256(data).hexdigest()[:32]}.{kind}"
        with self._lock:
            if name not in self._kept:
                self._bytes += len(data)
                self._kept[name] = data
            self._kept.move_to_end(name)
            while self._bytes > KEPT_BYTES and len(self._kept) > 1:
                self._bytes -= len(self._kept.popitem(last=False)[1])
        return f"/app/image/{name}"

    def get(self, name: str) -> bytes | None:
        """The picture of a name."""
        with self._lock:
            return self._kept.get(name)


IMAGES = Images()
"""Of this program. A name says nothing of what it shows, and nobody finds one without having the picture."""


def jpeg(rgb: np.ndarray, quality: int = 82) -> bytes:
    """A picture ((H, W, 3) uint8, RGB), encoded."""
    return cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def jpeg_url(rgb: np.ndarray, quality: int = 82) -> str:
    """Where the page finds a picture ((H, W, 3) uint8, RGB)."""
    return IMAGES.url(jpeg(rgb, quality), "jpg")


def png_url(bgra: np.ndarray) -> str:
    """Where the page finds a picture with transparency ((H, W, 4) uint8, BGRA)."""
    return IMAGES.url(cv2.imencode(".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes(), "png")
