"""How a picture lies in the input of a detector that a TOML file describes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.proposals.box_config import BoxInput


@dataclass(frozen=True)
class Placement:
    """Where the picture is in the input.

    Attributes
    ----------
    scale_x, scale_y : float
        Input pixels per picture pixel.
    left, top : int
        Input pixels before the picture.
    height, width : int
        Of the input, pixels.
    """

    scale_x: float
    scale_y: float
    left: int
    top: int
    height: int
    width: int

    def to_picture(self, boxes: np.ndarray) -> np.ndarray:
        """(N, 4) boxes in input pixels as boxes in picture pixels."""
        return (boxes - [self.left, self.top] * 2) / ([self.scale_x, self.scale_y] * 2)


def place_picture(rgb: np.ndarray, height: int, width: int, config: BoxInput) -> tuple[np.ndarray, Placement]:
    """The network's input.

    Returns
    -------
    tensor : (1, 3, height, width) or (1, height, width, 3) float32
    placement : Placement
    """
    h, w = rgb.shape[:2]
    inner_h, inner_w = height, width
    if config.fit != "stretch":
        scale = min(height / h, width / w)
        inner_h, inner_w = min(max(round(h * scale), 1), height), min(max(round(w * scale), 1), width)
    left = top = 0
    if config.fit == "letterbox":
        # Of an odd rest the smaller half comes first, as in Ultralytics' own letterbox.
        left, top = round((width - inner_w) / 2 - 0.1), round((height - inner_h) / 2 - 0.1)
    interpolation = cv2.INTER_CUBIC if config.interpolation == "cubic" else cv2.INTER_LINEAR
    resized = rgb if (h, w) == (inner_h, inner_w) else cv2.resize(rgb, (inner_w, inner_h), interpolation=interpolation)
    image = np.full((height, width, 3), config.pad, np.uint8)
    image[top : top + inner_h, left : left + inner_w] = resized
    if config.colour == "BGR":
        image = image[..., ::-1]
    scaled = image.astype(np.float32) * np.float32(config.scale)
    values = (scaled - np.array(config.mean, np.float32)) / np.array(config.std, np.float32)
    if config.layout == "NCHW":
        values = values.transpose(2, 0, 1)
    return np.ascontiguousarray(values[None]), Placement(inner_w / w, inner_h / h, left, top, height, width)
