"""Encode pictures as JPEG and PNG bytes, scale them, and cut thumbnails."""

from __future__ import annotations

import base64

import cv2
import numpy as np

THUMB, THUMB_QUALITY = 68, 78
"""Longer side of a thumbnail, pixels, and how well it is kept."""


def jpeg(rgb: np.ndarray, quality: int = 82) -> bytes:
    """Encode a picture ((H, W, 3) uint8, RGB) as JPEG."""
    return cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def jpeg_url(rgb: np.ndarray, widest: int | None = None, quality: int = 95) -> str:
    """JPEG of a picture ((H, W, 3) uint8, RGB) as the address of an image, at most `widest` pixels wide."""
    rgb = rgb if widest is None or rgb.shape[1] <= widest else resized(rgb, widest)
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(rgb, quality)).decode("ascii")


def png(image: np.ndarray, level: int = 1) -> bytes:
    """Encode a picture of OpenCV ((H, W) or (H, W, 3 or 4), BGR or BGRA, uint8 or uint16) as PNG; level 0 to 9."""
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level])[1].tobytes()


def resized(rgb: np.ndarray, width: float) -> np.ndarray:
    """Scale a picture down to a width, in pixels."""
    size = max(1, round(width)), max(1, round(rgb.shape[0] * width / rgb.shape[1]))
    return cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)


def thumbnail(rgb: np.ndarray, bbox: np.ndarray) -> bytes:
    """Cut a square JPEG around a box ((4,) x0, y0, x1, y1, pixels); empty for a box outside the picture."""
    low, high = np.asarray(bbox, np.float64).reshape(2, 2)
    half, center = (high - low).max() * 0.58 + 2, (low + high) / 2
    left, top = np.maximum(center - half, 0).astype(int)
    right, bottom = np.minimum(center + half + 1, rgb.shape[1::-1]).astype(int)
    crop = rgb[top:bottom, left:right]
    if not crop.size:
        return b""
    return jpeg(resized(crop, crop.shape[1] * THUMB / max(crop.shape[:2])), THUMB_QUALITY)
