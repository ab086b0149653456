"""Pictures as a model gets them: squared, marked, encoded; and the way back to the frame's pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.geometry.palette import ON_DARK
from pipeline.system.chat import Picture
from pipeline.system.errors import require

PADDING = (122, 116, 104)
"""CLIP's mean colour, with which LLaVA-1.5 makes pictures square (llava/mm_utils.py, expand2square)."""

MARK_COLORS = (ON_DARK["target"], ON_DARK["reference"])


@dataclass(frozen=True)
class View:
    """A frame's picture as it is sent, and where the frame lies in it.

    Attributes
    ----------
    picture : Picture
    offset : (float, float)
        Where the frame's upper left corner is, x and y, pixels of the picture.
    scale : (float, float)
        Pixels of the picture in one of the frame, along x and y.
    frame_size : (int, int)
        Width and height of the frame.
    """

    picture: Picture
    offset: tuple[float, float]
    scale: tuple[float, float]
    frame_size: tuple[int, int]

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
        corners = np.clip((corners - self.offset) / self.scale, 0, self.frame_size)
        return corners.reshape(4).astype(np.float32) if (corners[1] > corners[0]).all() else None


def view_of(rgb: np.ndarray, *, square: bool = True, max_side: int | None = None) -> View:
    """A frame's picture made ready.

    LLaVA-1.5 was trained on pictures padded to a square, and its boxes are shares of that square; some servers pad
    themselves, others cut the middle out. A picture that is square already is treated alike by all.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
    square : bool
        Whether to pad to a square, the frame in its middle.
    max_side : int, optional
        Longest side in pixels; a larger picture is scaled down. LLaVA-1.5 sees no more than 336.
    """
    height, width = Picture(rgb).rgb.shape[:2]
    require(max_side is None or max_side >= 1, "the longest side of a picture must be at least 1 pixel", got=max_side)
    image, longest = rgb, max(height, width)
    if max_side is not None and longest > max_side:
        size = [max(1, round(side * max_side / longest)) for side in (width, height)]
        image = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    inner_height, inner_width = image.shape[:2]
    x = y = 0
    if square and inner_height != inner_width:
        wide, high = (max(inner_height, inner_width) - inner for inner in (inner_width, inner_height))
        x, y = wide // 2, high // 2
        image = cv2.copyMakeBorder(image, y, high - y, x, wide - x, cv2.BORDER_CONSTANT, value=PADDING)
    return View(Picture(image), (x, y), (inner_width / width, inner_height / height), (width, height))


def marked(rgb: np.ndarray, boxes: Sequence[np.ndarray]) -> np.ndarray:
    """(H, W, 3) uint8: a copy with the boxes drawn and numbered from 1.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
    boxes : sequence of (4,) arrays
        x0, y0, x1, y1, pixels.
    """
    image = np.ascontiguousarray(rgb.copy())
    height, width = image.shape[:2]
    scale = max(height, width) / 640
    line, font = max(1, round(2 * scale)), max(0.4, 0.6 * scale)
    for number, box in enumerate(boxes):
        color = MARK_COLORS[number % len(MARK_COLORS)]
        x0, y0, x1, y1 = (int(v) for v in np.clip(np.round(box), 0, (width, height, width, height)))
        cv2.rectangle(image, (x0, y0), (max(x0, x1 - 1), max(y0, y1 - 1)), color, line)
        (w, h), base = cv2.getTextSize(str(number + 1), cv2.FONT_HERSHEY_SIMPLEX, font, 2)
        left, top = min(x0, max(width - w - 6, 0)), min(y0, max(height - h - base - 4, 0))
        cv2.rectangle(image, (left, top), (left + w + 6, top + h + base + 4), color, -1)
        at = (left + 3, top + h + 2)
        cv2.putText(image, str(number + 1), at, cv2.FONT_HERSHEY_SIMPLEX, font, (20, 20, 20), 2, cv2.LINE_AA)
    return image
