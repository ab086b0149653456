"""What segmenters do to masks: a little too large or too small, cut, or leaked into what is behind."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.masks import MaskCrop

LEAST_LEFT = 0.25
"""An erosion that leaves less of a mask than this share does not take place: what is found is never nothing."""
LEAK_REACH = 0.3
"""How far a leak reaches beyond each edge of the object's box, in box sides."""


def surroundings(mask: np.ndarray, margin: float, reach: float = LEAK_REACH) -> MaskCrop:
    """The surroundings of a mask ((H, W) bool): its box, widened by `margin` pixels or `reach` of its sides."""
    height, width = mask.shape
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    dx, dy = int(np.ceil(max(margin, reach * w))), int(np.ceil(max(margin, reach * h)))
    x0, y0 = max(x - dx, 0), max(y - dy, 0)
    return MaskCrop(x0, y0, mask[y0 : min(y + h + dy, height), x0 : min(x + w + dx, width)].copy())


def resized(mask: np.ndarray, pixels: int) -> np.ndarray:
    """A mask ((h, w) bool) dilated by so many pixels, or eroded where they are negative."""
    if pixels == 0:
        return mask
    # OpenCV takes a square apart into rows and columns; a disc of this size would take twenty times as long.
    kernel = np.ones((2 * abs(pixels) + 1,) * 2, np.uint8)
    changed = (cv2.dilate if pixels > 0 else cv2.erode)(mask.view(np.uint8), kernel).view(np.bool_)
    return changed if changed.sum() >= LEAST_LEFT * mask.sum() else mask


def truncated(mask: np.ndarray, angle: float, share: float) -> np.ndarray:
    """The part of a mask ((h, w) bool) on one side of a straight cut that leaves `share` of its pixels.

    `angle`, in radians, is the direction along which the cut pixels lie.
    """
    v, u = np.nonzero(mask)
    along = u * np.cos(angle) + v * np.sin(angle)
    stays = along <= np.quantile(along, share)
    cut = np.zeros_like(mask)
    cut[v[stays], u[stays]] = True
    return cut


def leaked(mask: np.ndarray, angle: float, free: np.ndarray) -> np.ndarray:
    """A mask ((h, w) bool) merged with all that is `free` ((h, w) bool) around it on one side.

    The side is that of `angle`, in radians, as seen from the mask's centre; the leak fills what is given there.
    """
    v, u = np.nonzero(mask)
    rows, columns = np.ogrid[: mask.shape[0], : mask.shape[1]]
    side = (columns - u.mean()) * np.cos(angle) + (rows - v.mean()) * np.sin(angle) > 0
    return mask | (side & free)
