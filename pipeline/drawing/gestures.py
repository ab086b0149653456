"""What a hand does to a mask, checked once, and the pixels that come of it.

A pixel belongs to a shape where its centre does; that of pixel (u, v) is
(u + 0.5, v + 0.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from pipeline.answering.objects import PreparedFrame
from pipeline.drawing.depth_region import LEAST, MOST, TOLERANCE, Surface, grown_region, surface_of
from pipeline.proposals.depth_segmenter import DepthSegmenter
from pipeline.system.errors import InputError, Shown, require

Kind = Literal["stroke", "polygon", "rectangle", "surface", "depth", "cut"]
FEWEST: dict[Kind, int] = {"stroke": 1, "polygon": 3, "rectangle": 2, "surface": 2, "depth": 1, "cut": 2}
"""Points that each kind needs. "rectangle" is all between two corners, "surface" what the depth segmenter finds there,
"depth" the surfaces around points, "cut" a line across a mask, or around a part of it."""
MOST_POINTS = 5000
BEYOND = 1.0
"""A hand may leave the picture by as many times its size."""
CLOSED = 0.12
"""A cut whose ends are this close, as a share of its length, goes around a part."""
THINNEST = 0.7072
"""Radius of the thinnest stroke, pixels: wherever it is put down, the centre of a pixel is within reach."""


@dataclass(frozen=True)
class Gesture:
    """One movement of a hand over a picture.

    Raises InputError: an unknown kind, a wrong number of points, or a radius or tolerance out of range.
    """

    kind: Kind
    points: np.ndarray  # (N, 2) float64: x, y in pixels
    adds: bool = True  # adds pixels to the mask; otherwise takes them from it
    radius: float = 1.0  # of a stroke, pixels
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        require(self.kind in FEWEST, "no such tool", got=repr(self.kind)[:40], expected=" | ".join(FEWEST))
        require(isinstance(self.adds, bool), "a tool adds or removes: true or false", got=repr(self.adds)[:40])
        points = self.points
        fewest, exact = FEWEST[self.kind], self.kind in ("rectangle", "surface")
        if len(points) < fewest or (exact and len(points) != fewest):
            expected = "two corners" if exact else f"at least {fewest}"
            raise InputError(f"not the points of a {self.kind}", got=len(points), expected=expected)
        require(
            len(points) <= MOST_POINTS,
            f"a {self.kind} has too many points",
            got=len(points),
            expected=f"at most {MOST_POINTS}",
        )
        require(
            math.isfinite(self.radius) and self.radius >= 0,
            "the radius of a brush must be a positive number",
            got=self.radius,
        )
        require(
            LEAST <= self.tolerance <= MOST,
            "the tolerance is out of range",
            got=self.tolerance,
            expected=f"{LEAST} to {MOST}",
        )


def gesture_of(kind: Any, points: Any, height: int, width: int, *, fractions: bool = False, **more: Any) -> Gesture:
    """A gesture from numbers that nobody has checked.

    `points`: pixels, or with `fractions` shares of width and height; a radius is then a share of the width. `more`:
    `adds`, `radius`, `tolerance` of the gesture.

    Raises InputError: points outside of the picture, or no such gesture.
    """
    require(
        not isinstance(points, (list, tuple)) or len(points) <= MOST_POINTS,
        "too many points",
        got=lambda: len(points),
        expected=f"at most {MOST_POINTS}",
    )
    try:
        found = np.array(points, np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.zeros(0)
    require(found.ndim == 2 and found.shape[1:] == (2,), "points must be a list of [x, y]", got=Shown(points))
    require(np.isfinite(found).all(), "points must be finite numbers")
    scale = np.array([width, height], np.float64)
    if fractions:
        found = found * scale
    require(
        not (found < -BEYOND * scale).any() and not (found > (1 + BEYOND) * scale).any(),
        "points are outside of the picture",
        expected=f"{width}x{height} pixels",
    )
    for name in ("radius", "tolerance"):
        require(
            name not in more or (not isinstance(more[name], bool) and isinstance(more[name], (int, float))),
            f"the {name} must be a number",
            got=repr(more.get(name))[:40],
        )
    if "radius" in more:
        more["radius"] = float(more["radius"]) * (width if fractions else 1)
        require(not more["radius"] > max(height, width), "the brush is larger than the picture", got=more["radius"])
    return Gesture(kind if isinstance(kind, str) else repr(kind), found, **more)  # pyright: ignore[reportArgumentType]


def read_gesture(message: Any, height: int, width: int) -> Gesture:
    """A gesture as the page sends it: {"do", "at": [[x, y], ...], "add", "radius", "tolerance"}, in fractions.

    Raises InputError: no such message, or no such gesture.
    """
    require(
        isinstance(message, Mapping) and not set(message) - {"do", "at", "add", "radius", "tolerance"},
        "not a movement of a tool",
        got=Shown(message),
    )
    more = {name: message[name] for name in ("radius", "tolerance") if name in message}
    return gesture_of(
        message.get("do"), message.get("at"), height, width, fractions=True, adds=message.get("add", True), **more
    )


@dataclass
class Canvas:
    """A frame to draw on; what it takes to follow its surfaces is worked out when it is first needed."""

    context: PreparedFrame

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        return self.context.frame.height, self.context.frame.width

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
