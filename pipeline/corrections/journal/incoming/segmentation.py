"""Pixels and 2D boxes of COCO annotations, read without trust: polygons, both kinds of run-length codes, rectangles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from pipeline.geometry.masks import decode_run_length, fill_polygons
from pipeline.system.errors import InputError, Shown, require

LONGEST_OUTLINE = 2e6
"""Pixels that all polygons of an object may run through: rasterising takes memory in proportion."""


def rectangle_of(value: Any) -> list[float]:
    """Corners x0, y0, x1, y1 of COCO's x, y, width, height; InputError for none."""
    sound = isinstance(value, list) and len(value) == 4 and all(type(x) in (int, float) for x in value)
    # Beyond 1e9 is no picture; NaN is not below it either.
    require(
        sound and all(abs(x) < 1e9 for x in value) and value[2] > 0 and value[3] > 0,
        "bbox is x, y, width, height above 0",
        got=Shown(value),
    )
    x, y, w, h = map(float, value)
    return [x, y, x + w, y + h]


def bounds_of(corners: np.ndarray) -> list[float]:
    """Bounding rectangle of corners (N, 2)."""
    return [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()]


def near(one: Sequence[float], other: Sequence[float], slack: float) -> bool:
    return all(math.isclose(x, y, abs_tol=slack, rel_tol=0) for x, y in zip(one, other, strict=True))


def mask_of(segmentation: Any, size: tuple[int, int]) -> np.ndarray | None:
    """Mask (H, W) bool of COCO's `segmentation`; None if empty; InputError for no code or polygons of that
    size.
    """
    if segmentation in (None, [], {}):
        return None
    if isinstance(segmentation, dict):
        found, counts = segmentation.get("size"), segmentation.get("counts")
        require(found == list(size), "the mask has another size", got=repr(found)[:40], expected=list(size))
        if isinstance(counts, str) or (isinstance(counts, list) and all(type(n) is int for n in counts)):
            return decode_run_length(size, counts, "the mask")
        raise InputError("a run-length code is a text or a list of whole numbers", got=repr(counts)[:40])
    return polygon_mask(polygons_of(segmentation), size)


def polygons_of(segmentation: Any) -> list[np.ndarray]:
    """Corners (N, 2) float64 of each polygon, N >= 3; InputError for none."""
    require(
        isinstance(segmentation, list),
        "a segmentation is a run-length code or a list of polygons",
        got=Shown(segmentation, 40),
    )
    found = []
    for polygon in segmentation:
        numbers = isinstance(polygon, list) and all(type(x) in (int, float) and abs(x) < 1e9 for x in polygon)
        require(
            numbers and len(polygon) >= 6 and len(polygon) % 2 == 0 and all(map(math.isfinite, polygon)),
            "a polygon is x, y of three corners or more",
            got=Shown(polygon, 40),
        )
        found.append(np.array(polygon, np.float64).reshape(-1, 2))
    return found


def polygon_mask(polygons: list[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """Mask (H, W) bool of the pixels inside any polygon, as in the COCO API."""
    clipped = [np.clip(p, 0, np.array(size[::-1], np.float64)) for p in polygons]
    length = sum(float(np.abs(np.diff(p, axis=0, append=p[:1])).max(axis=1).sum()) + len(p) for p in clipped)
    require(
        length <= LONGEST_OUTLINE,
        "the polygons are too long",
        got=f"{length:.3g} pixels",
        expected=f"{LONGEST_OUTLINE:.3g}",
    )
    return fill_polygons(size, clipped)


def same_outline(mask: np.ndarray, other: np.ndarray, tolerance: float) -> bool:
    """Compare a mask made from polygons with another, but for rounding.

    Polygons know no holes, and drawing moves edges by up to a pixel: differences, holes filled, must lie within
    `tolerance` pixels of the other's edge.
    """
    rows, columns = np.nonzero(mask | other)
    if not len(rows):
        return True
    index = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    # The picture ends where its pixels do: beyond it is outside.
    one, two = (np.pad(m[index], 1) for m in (mask, other))
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
    """True for a single upright rectangular polygon: the export of a 2D box without a mask."""
    if not isinstance(segmentation, list) or len(segmentation) != 1:
        return False
    (corners,) = polygons_of(segmentation)
    if len(corners) == 5 and (corners[0] == corners[4]).all():
        corners = corners[:4]
    sides = [len(np.unique(line)) for line in corners.T]
    return len(corners) == 4 and sides == [2, 2] and len(np.unique(corners, axis=0)) == 4
