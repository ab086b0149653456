"""Masks as other tools write them: polygons and both kinds of run-length codes, read without trust."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np

from pipeline.geometry.masks import decode_run_length
from pipeline.system.errors import InputError

LONGEST_OUTLINE = 2e6
"""Pixels that all polygons of an object may run through: rasterising takes memory in proportion."""


def mask_of(segmentation: Any, size: tuple[int, int]) -> np.ndarray | None:
    """(H, W) bool of COCO's `segmentation`; None where it is empty or absent.

    Raises
    ------
    InputError
        It is neither a run-length code of that size nor a list of polygons.
    """
    if segmentation in (None, [], {}):
        return None
    if isinstance(segmentation, dict):
        found, counts = segmentation.get("size"), segmentation.get("counts")
        if found != list(size):
            raise InputError("the mask has another size", got=repr(found)[:40], expected=list(size))
        if isinstance(counts, str) or (isinstance(counts, list) and all(type(n) is int for n in counts)):
            return decode_run_length(size, counts, "the mask")
        raise InputError("a run-length code is a text or a list of whole numbers", got=repr(counts)[:40])
    return polygon_mask(polygons_of(segmentation), size)


def polygons_of(segmentation: Any) -> list[np.ndarray]:
    """(N, 2) float64 corners of each polygon, N >= 3; InputError where it is none."""
    if not isinstance(segmentation, list):
        raise InputError("a segmentation is a run-length code or a list of polygons", got=repr(segmentation)[:40])
    found = []
    for polygon in segmentation:
        numbers = isinstance(polygon, list) and all(type(x) in (int, float) and abs(x) < 1e9 for x in polygon)
        if not numbers or len(polygon) < 6 or len(polygon) % 2 or not all(map(math.isfinite, polygon)):
            raise InputError("a polygon is x, y of three corners or more", got=repr(polygon)[:40])
        found.append(np.array(polygon, np.float64).reshape(-1, 2))
    return found


def polygon_mask(polygons: list[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: the pixels inside any of the polygons, as the COCO API has them."""
    from pycocotools import mask as coco

    height, width = size
    clipped = [np.clip(p, 0, np.array([width, height], np.float64)) for p in polygons]
    length = sum(float(np.abs(np.diff(p, axis=0, append=p[:1])).max(axis=1).sum()) + len(p) for p in clipped)
    if length > LONGEST_OUTLINE:
        raise InputError("the polygons are too long", got=f"{length:.3g} pixels", expected=f"{LONGEST_OUTLINE:.3g}")
    encoded: Any = coco.merge(coco.frPyObjects([p.ravel().tolist() for p in clipped], height, width))
    return coco.decode(encoded).astype(np.bool_)


def same_outline(mask: np.ndarray, other: np.ndarray, tolerance: float) -> bool:
    """Whether a mask made from polygons is another mask, but for rounding.

    Polygons know no holes, and what draws them moves edges by up to a pixel:
    what one has beyond the other, holes filled, must lie within `tolerance`
    pixels of the other's edge.
    """
    rows, columns = np.nonzero(mask | other)
    if not len(rows):
        return True
    place = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    # The picture ends where its pixels do: beyond it is outside.
    one, two = (np.pad(m[place], 1) for m in (mask, other))
    more, less = two & ~_filled(one), one & ~_filled(two)
    beyond = cv2.distanceTransform((~one).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    within = cv2.distanceTransform(one.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return bool((beyond[more] <= tolerance).all() and (within[less] <= tolerance).all())


def _filled(mask: np.ndarray) -> np.ndarray:
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(found, outlines, -1, 1, cv2.FILLED)
    return found.astype(np.bool_)


def is_rectangle(segmentation: Any) -> bool:
    """Whether it is one polygon, an upright rectangle: how a 2D box is exported where there is no mask."""
    if not isinstance(segmentation, list) or len(segmentation) != 1:
        return False
    (corners,) = polygons_of(segmentation)
    if len(corners) == 5 and (corners[0] == corners[4]).all():
        corners = corners[:4]
    xs, ys = np.unique(corners[:, 0]), np.unique(corners[:, 1])
    return len(corners) == 4 and len(xs) == len(ys) == 2 and len(np.unique(corners, axis=0)) == 4
