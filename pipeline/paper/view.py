"""Pictures as a model gets them: squared and encoded; and the way back to the frame's pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.system.chat import ChatPicture

PADDING = (122, 116, 104)
"""CLIP's mean colour, with which LLaVA-1.5 makes pictures square (llava/mm_utils.py, expand2square)."""


@dataclass(frozen=True)
class View:
    """Picture of a frame as it is sent."""

    picture: ChatPicture
    offset: tuple[int, int]
    """x and y of the frame's upper left corner, pixels of the picture."""
    frame_size: tuple[int, int]
    """Width and height of the frame."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture."""
        height, width = self.picture.rgb.shape[:2]
        return width, height

    def to_frame(self, box: Sequence[float]) -> np.ndarray | None:
        """A box as shares of the picture, in the frame's pixels.

        Returns
        -------
        (4,) float32 or None
            x0, y0, x1, y1, cut at the frame's edges; None where it lies in the padding.
        """
        corners = np.array(box, np.float64).reshape(2, 2) * self.size
        corners = np.clip(corners - self.offset, 0, self.frame_size)
        return corners.reshape(4).astype(np.float32) if (corners[1] > corners[0]).all() else None


def view_of(rgb: np.ndarray) -> View:
    """Picture of a frame ((H, W, 3) uint8) padded to a square, the frame in its middle.

    LLaVA-1.5 was trained on pictures padded to a square, and its boxes are shares of that square; some servers pad
    themselves, others cut the middle out. A picture that is square already is treated alike by all.
    """
    height, width = ChatPicture(rgb).rgb.shape[:2]
    wide, high = (max(height, width) - inner for inner in (width, height))
    x, y = wide // 2, high // 2
    image = cv2.copyMakeBorder(rgb, y, high - y, x, wide - x, cv2.BORDER_CONSTANT, value=PADDING)
    return View(ChatPicture(image), (x, y), (width, height))
