"""Fit a picture into a network's input without changing its aspect ratio, and come back."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Letterbox:
    """How a picture lies in the network's input.

    Attributes
    ----------
    scale : float
        Input pixels per picture pixel.
    left, top : int
        Where the picture begins in the input, pixels.
    width, height : int
        Size of the picture in the input, pixels.
    """

    scale: float
    left: int
    top: int
    width: int
    height: int

    def to_picture(self, boxes: np.ndarray, picture_height: int, picture_width: int) -> np.ndarray:
        """(N, 4) boxes in input pixels as boxes in picture pixels, clipped to the picture."""
        boxes = (boxes - np.array([self.left, self.top] * 2, np.float32)) / self.scale
        return np.clip(boxes, 0, np.array([picture_width, picture_height] * 2)).astype(np.float32)


def letterbox(rgb: np.ndarray, height: int, width: int, pad: int = 114) -> tuple[np.ndarray, Letterbox]:
    """The picture scaled to fit (height, width), centred, the rest filled with grey.

    Returns
    -------
    image : (height, width, 3) uint8
    placement : Letterbox
    """
    h, w = rgb.shape[:2]
    scale = min(height / h, width / w)
    inner_w, inner_h = min(max(round(w * scale), 1), width), min(max(round(h * scale), 1), height)
    left, top = round((width - inner_w) / 2 - 0.1), round((height - inner_h) / 2 - 0.1)
    image = np.full((height, width, 3), pad, np.uint8)
    resized = rgb
    if (inner_h, inner_w) != (h, w):
        resized = cv2.resize(rgb, (inner_w, inner_h), interpolation=cv2.INTER_LINEAR)
    image[top : top + inner_h, left : left + inner_w] = resized
    return image, Letterbox(scale, left, top, inner_w, inner_h)
