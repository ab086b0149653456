"""A mask without the empty picture around it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class MaskCrop:
    """The part of a picture's mask that is not empty.

    Attributes
    ----------
    x, y : int
        Its upper left pixel in the picture.
    mask : (h, w) bool
    """

    x: int
    y: int
    mask: np.ndarray

    @property
    def box(self) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 of the mask, exclusive right and bottom edges; empty where the mask is."""
        x, y, w, h = cv2.boundingRect(self.mask.view(np.uint8))
        return self.x + x, self.y + y, self.x + x + w, self.y + y + h

    def paint(self, picture: np.ndarray) -> None:
        """Set its pixels in an empty mask of the whole picture, (H, W) bool."""
        h, w = self.mask.shape
        picture[self.y : self.y + h, self.x : self.x + w] = self.mask
