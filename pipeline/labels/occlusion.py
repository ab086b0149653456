"""How far something stands in front of an object: measured along the border of its mask."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.lifting import Evidence, Pixel

NEARER_M = 0.05
REACH = 2
"""Pixels beyond the mask that are looked at: the first ones are often mixed."""


def occluded_share(evidence: Evidence, depth: np.ndarray) -> float:
    """Share of the mask's border beside which something is at least 5 cm nearer than the object there.

    Parameters
    ----------
    evidence : Evidence
        The pixels of the mask.
    depth : (H, W) float32
        Metres.

    Returns
    -------
    float
        0..1; 0 where no pixel beside the mask has depth.
    """
    height, width = depth.shape
    h, w = evidence.codes.shape
    top, left = min(REACH, evidence.y0), min(REACH, evidence.x0)
    bottom, right = min(REACH, height - evidence.y0 - h), min(REACH, width - evidence.x0 - w)
    inside = (evidence.codes != Pixel.OUTSIDE).view(np.uint8)
    mask = cv2.copyMakeBorder(inside, top, bottom, left, right, cv2.BORDER_CONSTANT, value=0)
    z = depth[evidence.y0 - top : evidence.y0 + h + bottom, evidence.x0 - left : evidence.x0 + w + right]
    kernel = np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)
    ring = (cv2.dilate(mask, kernel) > 0) & (mask == 0) & (z > 0)
    own = np.where(mask > 0, z, 0).astype(np.float32)
    beside = cv2.dilate(own, kernel)
    ring &= beside > 0
    total = int(ring.sum())
    return float((z[ring] < beside[ring] - NEARER_M).sum() / total) if total else 0.0
