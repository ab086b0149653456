"""Masks of a fixed small size, as R-CNN heads give them, pasted into their boxes."""

from __future__ import annotations

import numpy as np

MASK_THRESHOLD = 0.5


def paste_masks(
    masks: np.ndarray, boxes: np.ndarray, height: int, width: int, threshold: float = MASK_THRESHOLD
) -> np.ndarray:
    """(N, height, width) bool: where the mask in each box is at least the threshold.

    What `paste_masks_in_image` of detectron2 computes: the mask is sampled bilinearly at the centre of each pixel,
    pixel centres to pixel centres, and is zero outside (grid_sample with align_corners=False). The bilinear weights
    are a product of one along each axis, so two matrix products do it. Outside its box a mask of probabilities
    stays below a half, so that only the box needs looking at.

    Parameters
    ----------
    masks : (N, h, w) float
        Probabilities.
    boxes : (N, 4) float
        x0, y0, x1, y1 in pixels, within the picture.
    threshold : float
        At least 0.5.
    """
    pasted = np.zeros((len(masks), height, width), np.bool_)
    for k, (x0, y0, x1, y1) in enumerate(boxes.astype(np.float64)):
        left, top = max(int(np.floor(x0)), 0), max(int(np.floor(y0)), 0)
        right, bottom = min(int(np.ceil(x1)), width), min(int(np.ceil(y1)), height)
        if right <= left or bottom <= top or x1 <= x0 or y1 <= y0:
            continue
        rows = _weights(np.arange(top, bottom), y0, y1, masks.shape[1])
        columns = _weights(np.arange(left, right), x0, x1, masks.shape[2])
        pasted[k, top:bottom, left:right] = rows @ masks[k].astype(np.float64) @ columns.T >= threshold
    return pasted


def _weights(pixels: np.ndarray, low: float, high: float, cells: int) -> np.ndarray:
    """(P, cells) weights of a mask's cells at pixel centres along one axis of a box."""
    place = (pixels + 0.5 - low) / (high - low) * cells - 0.5
    return np.maximum(1 - np.abs(place[:, None] - np.arange(cells)), 0)
