"""What a hand does to a mask, checked once, and the pixels that come of it.

A pixel belongs to a shape where its centre does; that of pixel (u, v) is
(u + 0.5, v + 0.5).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.answering.objects import PreparedFrame
from pipeline.drawing.depth_region import LEAST, MOST, TOLERANCE, Surface, grown_region, surface_of
from pipeline.proposals.depth_segmenter import DepthSegmenter
from pipeline.proposals.segmenter import Segmenter, mask_at
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked

Kind = Literal["stroke", "polygon", "rectangle", "surface", "depth", "segment", "cut"]
MOST_POINTS = 5000
POINTS: dict[Kind, tuple[int, int]] = {
    "stroke": (1, MOST_POINTS),
    "polygon": (3, MOST_POINTS),
    "rectangle": (2, 2),
    "surface": (2, 2),
    "depth": (1, MOST_POINTS),
    "segment": (1, 16),
    "cut": (2, MOST_POINTS),
}
"""Points that each kind needs, at least and at most. "rectangle" is all between two corners, "surface" what the depth
segmenter finds there, "depth" the surfaces around points, "segment" the
things that the configured segmenter finds at points, "cut" a line across a mask, or around a part of it."""
BEYOND = 1.0
"""A hand may leave the picture by as many times its size."""
CLOSED = 0.12
"""A cut whose ends are this close, as a share of its length, goes around a part."""
THINNEST = 0.7072
"""Radius of the thinnest stroke, pixels: wherever it is put down, the centre of a pixel is within reach."""


@dataclass(frozen=True)
class Gesture:
    """One movement of a hand over a picture."""

    kind: Kind
    points: np.ndarray  # (N, 2) float64: x, y in pixels
    adds: bool = True  # adds pixels to the mask; otherwise takes them from it
    radius: float = 1.0  # of a stroke, pixels
    tolerance: float = TOLERANCE


class _Message(BaseModel):
    """A gesture as it is written in JSON."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    do: Kind
    at: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(max_length=MOST_POINTS)]
    add: bool = True
    radius: Annotated[float, Field(ge=0)] | None = None
    tolerance: Annotated[float, Field(ge=LEAST, le=MOST)] = TOLERANCE


def read_gesture(message: Any, height: int, width: int, *, fractions: bool = True) -> Gesture:
    """A gesture from JSON: {"do", "at": [[x, y], ...], "add", "radius", "tolerance"}.

    `fractions`: points are shares of width and height, a radius is one of the width; otherwise both are pixels.

    Raises InputError: no such message, points outside of the picture, or no such gesture.
    """
    told = checked(_Message.model_validate, message, "not a movement of a tool: {}")
    fewest, most = POINTS[told.do]
    wrong, expected = f"not the points of a {told.do}", "two corners" if most == 2 else f"at least {fewest}"
    require(fewest <= len(told.at) <= most, wrong, got=len(told.at), expected=expected)
    size = np.array([width, height], np.float64)
    points = np.array(told.at, np.float64) * (size if fractions else 1.0)
    inside = ((points >= -BEYOND * size) & (points <= (1 + BEYOND) * size)).all()
    require(inside, "points are outside of the picture", expected=f"{width}x{height} pixels")
    radius = 1.0 if told.radius is None else told.radius * (width if fractions else 1.0)
    require(radius <= max(height, width), "the brush is larger than the picture", got=radius)
    return Gesture(told.do, points, told.add, radius, told.tolerance)


@dataclass
class Canvas:
    """A frame to draw on; what it takes to follow its surfaces is worked out when it is first needed."""

    context: PreparedFrame
    segmenter: Segmenter | None = None  # that takes points

    @cached_property
    def surface(self) -> Surface:
        return surface_of(self.context.frame)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """(H, W) bool: what the depth segmenter finds between two corners (x, y, pixels)."""
        return DepthSegmenter().segment(self.context.frame, np.sort(points, axis=0).ravel()[None], [""])[0][0]


def drawn(gesture: Gesture, height: int, width: int, canvas: Canvas | None = None) -> np.ndarray:
    """Pixels meant by a gesture.

    `canvas`: for what follows the depth. Returns (H, W) bool.

    Raises InputError: it means no pixel, or the depth is not at hand.
    """
    require(gesture.kind != "cut", "a cut means no pixels")
    if gesture.kind in _FLAT:
        mask = _FLAT[gesture.kind](gesture, height, width)
    elif canvas is None:
        raise InputError(f"a {gesture.kind} region needs the pictures", cause="name the dataset")
    elif gesture.kind == "surface":
        mask = canvas.inside(gesture.points)
    elif gesture.kind == "segment":
        expected = "--segmenter sam, sam2 or efficientsam"
        segmenter = needed(canvas.segmenter, "no segmenter is open that takes points", expected=expected)
        mask = mask_at(segmenter, canvas.context.frame, gesture.points)
    else:
        mask = grown_region(canvas.surface, gesture.points, gesture.tolerance)
    require(mask.any(), f"this {gesture.kind} holds no pixel")
    return mask


def applied(mask: np.ndarray, gesture: Gesture, canvas: Canvas | None = None) -> np.ndarray:
    """A mask ((H, W) bool) after a gesture; raises as `drawn`."""
    height, width = mask.shape
    pixels = drawn(gesture, height, width, canvas)
    return mask | pixels if gesture.adds else mask & ~pixels


def goes_around(points: np.ndarray) -> bool:
    """Tell whether the ends of a cut meet around a part."""
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return len(points) > 3 and float(np.linalg.norm(points[0] - points[-1])) < CLOSED * length


def stroke_mask(points: np.ndarray, radius: float, height: int, width: int) -> np.ndarray:
    """(H, W) bool covered by a round brush.

    `points` (N, 2) float: x, y of its middle, pixels; one point is a disc. `radius`: pixels; at least `THINNEST`.
    Returns (H, W) bool: pixels whose centre is no further than `radius` from the line.
    """
    mask = np.zeros((height, width), np.bool_)
    radius = max(float(radius), THINNEST)
    line = np.asarray(points, np.float64).reshape(-1, 2)
    starts, ends = (line[:-1], line[1:]) if len(line) > 1 else (line, line)
    limit = np.array([width, height])
    low = np.clip(np.floor(np.minimum(starts, ends) - radius), 0, limit).astype(np.int64)
    high = np.clip(np.ceil(np.maximum(starts, ends) + radius), 0, limit).astype(np.int64)
    for (ax, ay), (bx, by), (x0, y0), (x1, y1) in zip(starts, ends, low, high, strict=True):
        if x1 <= x0 or y1 <= y0:
            continue
        x, y = np.arange(x0, x1) + (0.5 - ax), (np.arange(y0, y1) + (0.5 - ay))[:, None]
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        t = np.clip((x * dx + y * dy) / square, 0, 1) if square > 0 else 0.0
        mask[y0:y1, x0:x1] |= (x - t * dx) ** 2 + (y - t * dy) ** 2 <= radius * radius
    return mask


def polygon_mask(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """The inside of a polygon by the even-odd rule, each pixel by its centre.

    `cv2.fillPoly` would add the pixels that the outline touches.

    `points` (N, 2) float: corners x, y, pixels, in the picture or beyond it; the last is joined to the first. Returns
    (H, W) bool.
    """
    a = np.asarray(points, np.float64).reshape(-1, 2)
    b = np.roll(a, -1, axis=0)
    rows = np.arange(height)[:, None] + 0.5
    row, edge = np.nonzero((a[:, 1] <= rows) != (b[:, 1] <= rows))
    (ax, ay), (bx, by) = a[edge].T, b[edge].T
    x = ax + (row + 0.5 - ay) * ((bx - ax) / (by - ay))
    first = np.clip(np.ceil(x - 0.5), 0, width).astype(np.int64)
    crossings = np.bincount(row * (width + 1) + first, minlength=height * (width + 1)).reshape(height, width + 1)
    return (np.cumsum(crossings[:, :width], axis=1) & 1).astype(np.bool_)


def rectangle_mask(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """(H, W) bool: the pixels between two opposite corners, x, y in pixels, in any order."""
    (x0, y0), (x1, y1) = np.sort(np.asarray(points, np.float64).reshape(2, 2), axis=0)
    return polygon_mask(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), height, width)


_FLAT: dict[Kind, Callable[[Gesture, int, int], np.ndarray]] = {
    "stroke": lambda gesture, height, width: stroke_mask(gesture.points, gesture.radius, height, width),
    "polygon": lambda gesture, height, width: polygon_mask(gesture.points, height, width),
    "rectangle": lambda gesture, height, width: rectangle_mask(gesture.points, height, width),
}
"""Kinds that follow no depth."""
