"""Shapes on pictures, with smooth edges: rounded panels, pictures with rounded corners, and the mark of a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from pipeline.geometry.palette import RGB

Box = tuple[int, int, int, int]
"""Left, top, width and height, pixels."""
SMOOTH = 4
"""Edges are drawn so many times as large."""


@lru_cache(maxsize=64)
def rounded(width: int, height: int, radius: int) -> np.ndarray:
    """Cover of a rectangle with round corners, (height, width, 1) float32, 0..1."""
    w, h, r = (SMOOTH * n for n in (width, height, min(radius, width // 2, height // 2)))
    cover = np.zeros((h, w), np.uint8)
    cv2.rectangle(cover, (r, 0), (w - r - 1, h - 1), 255, -1)
    cv2.rectangle(cover, (0, r), (w - 1, h - r - 1), 255, -1)
    for x in (r, w - r - 1):
        for y in (r, h - r - 1):
            cv2.circle(cover, (x, y), r, 255, -1)
    return cv2.resize(cover, (width, height), interpolation=cv2.INTER_AREA)[..., None].astype(np.float32) / 255


def paste(image: np.ndarray, part: np.ndarray | RGB, where: Box, radius: int = 0, strength: float = 1.0) -> None:
    """Put a picture, (height, width, 3), or a colour on another, with round corners; `where` lies inside."""
    x, y, width, height = where
    ground, cover = image[y : y + height, x : x + width], rounded(width, height, radius) * np.float32(strength)
    ground[:] = np.round(ground * (1 - cover) + np.asarray(part, np.float32) * cover).astype(np.uint8)


def panel(image: np.ndarray, where: Box, radius: int, fill: RGB, edge: RGB, line: int = 1) -> None:
    """Draw a rounded panel with an edge."""
    x, y, width, height = where
    paste(image, edge, where, radius)
    paste(image, fill, (x + line, y + line, width - 2 * line, height - 2 * line), radius - line)


CROSS = (((0.34, 0.34), (0.66, 0.66)), ((0.66, 0.34), (0.34, 0.66)))
CHECK = (((0.28, 0.52), (0.44, 0.68)), ((0.44, 0.68), (0.73, 0.34)))
POINT = (((0.5, 0.26), (0.5, 0.56)), ((0.5, 0.73), (0.5, 0.73)))
LEVEL = (((0.32, 0.5), (0.68, 0.5)),)


def strokes(
    image: np.ndarray, lines: Sequence[Sequence[tuple[float, float]]], where: Box, color: RGB, thick: int
) -> None:
    """Draw lines, in shares of a box."""
    x, y, width, height = where
    ends = np.array(lines) * [width, height] + [x, y]
    cv2.polylines(image, list(np.round(ends * 16).astype(np.int32)), False, color, thick, cv2.LINE_AA, shift=4)
