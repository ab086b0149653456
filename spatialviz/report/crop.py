"""Crop of an answer: the part of a frame around its boxes, in the colours of their roles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from pipeline.geometry.palette import RGB
from spatialviz.report.picture import dashed

MARGIN = 0.14
LEAST = 0.3
"""How much of a frame's width a picture shows at least."""
GROUND = (14, 16, 20)
Stroke = Literal["thick", "thin", "dashed"]


@dataclass(frozen=True)
class Outline:
    """Box to draw."""

    box: np.ndarray  # (4,) float64: x0, y0, x1, y1, pixels of the frame
    color: RGB
    style: Stroke = "thick"  # "thick", "thin" or "dashed": colours are doubled by it


def answer_crop(rgb: np.ndarray, outlines: Sequence[Outline], size: tuple[int, int] = (360, 270)) -> np.ndarray:
    """Crop a picture to all boxes with a margin, and draw the boxes.

    `rgb`: (H, W, 3) uint8; `outlines`: without any the whole frame is shown; `size`: width and height, pixels. Returns
    (size[1], size[0], 3) uint8.
    """
    height, width = rgb.shape[:2]
    ends = np.array([o.box for o in outlines], np.float64).reshape(-1, 4)
    low, high = np.array([0.0, 0.0]), np.array([width, height], np.float64)
    if len(ends):
        low, high = ends[:, :2].min(axis=0), ends[:, 2:].max(axis=0)
    # As wide as it must be, in the shape of the picture.
    span = np.maximum((high - low) * (1 + 2 * MARGIN), LEAST * width * np.array([1, size[1] / size[0]]))
    scale = min(np.array(size) / np.minimum(span, np.maximum(high - low, [width, height])))
    shown = np.array(size) / scale
    corner = (low + high) / 2 - shown / 2
    # Inside the frame where it fits, else in its middle.
    room = np.array([width, height]) - shown
    corner = np.where(room >= 0, np.clip(corner, 0, np.maximum(room, 0)), room / 2)
    move = np.array([[scale, 0, -corner[0] * scale], [0, scale, -corner[1] * scale]])
    image = cv2.warpAffine(rgb, move, size, borderMode=cv2.BORDER_CONSTANT, borderValue=GROUND)
    for outline in outlines:
        x0, y0, x1, y1 = (outline.box.reshape(2, 2) - corner).ravel() * scale
        corners = np.clip([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], -2000, 4000)
        lines = np.stack([corners[:-1], corners[1:]], axis=1)
        lines = np.round(dashed(lines, 16.0) if outline.style == "dashed" else lines).astype(np.int32)
        wide = 3 if outline.style == "thick" else 2
        for color, thick in (((0, 0, 0), wide + 2), (outline.color, wide)):
            cv2.polylines(image, list(lines), False, color, thick, cv2.LINE_AA)
    return image
