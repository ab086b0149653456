"""Other pixels for an object: grown or shrunk, a rectangle, or those of the label."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.cases import FrameCases
from pipeline.system.errors import InputError

MOST_PIXELS = 200
"""A mask is grown or shrunk by no more at once."""
SAME = 0.1
"""The labelled object that overlaps most is meant where its 2D box overlaps by as much (IoU): badly placed boxes are
what another mask is for."""


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """A mask grown by a disc of a radius, or shrunk where it is negative.

    Parameters
    ----------
    mask : (H, W) bool
    pixels : int
        -200..200.

    Raises
    ------
    InputError
        A radius out of range.
    """
    if abs(pixels) > MOST_PIXELS:
        raise InputError("a mask grows by so many pixels at most", got=pixels, expected=f"at most {MOST_PIXELS}")
    if pixels == 0:
        return mask
    step = np.arange(-abs(pixels), abs(pixels) + 1)
    disc = (step[:, None] ** 2 + step[None] ** 2 <= pixels**2).astype(np.uint8)
    change, beyond = (cv2.dilate, 0) if pixels > 0 else (cv2.erode, 1)
    # What lies beyond the picture's edge neither adds to a mask nor takes from it.
    changed = change(mask.view(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=beyond)
    return changed.astype(np.bool_)


def rectangle(height: int, width: int, corners: tuple[float, float, float, float]) -> np.ndarray:
    """(H, W) bool: the pixels between two corners, x0, y0, x1, y1 as fractions of width and height in any order.

    Raises
    ------
    InputError
        The rectangle holds no pixel.
    """
    x0, y0, x1, y1 = corners
    if not np.isfinite([x0, y0, x1, y1]).all():
        raise InputError("the corners of a rectangle must be finite", got=corners)
    xs, ys = sorted((x0, x1)), sorted((y0, y1))
    left, right = (int(np.clip(round(x * width), 0, width)) for x in xs)
    top, bottom = (int(np.clip(round(y * height), 0, height)) for y in ys)
    mask = np.zeros((height, width), np.bool_)
    mask[top:bottom, left:right] = True
    if not mask.any():
        raise InputError("the rectangle holds no pixel", got=corners)
    return mask


def labelled_mask(truth: FrameCases, bbox: np.ndarray, height: int, width: int) -> np.ndarray | None:
    """(H, W) bool: the labelled pixels of the object that a 2D box is of; None where no such object has any."""
    if not len(truth.boxes):
        return None
    overlap = iou_2d(bbox, truth.boxes)[0]
    k = int(overlap.argmax())
    code = truth.masks[k]
    if overlap[k] < SAME or code is None:
        return None
    return decode_run_length((height, width), code, f"labelled object {truth.numbers[k]} of frame {truth.frame}")
