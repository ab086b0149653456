"""Pixels in a file of edits: run-length codes, polygons, rectangles, strokes, or seeds of a surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from pipeline.corrections.drawing.depth_region import TOLERANCE
from pipeline.corrections.drawing.gestures import Canvas, drawn, gesture_of

SHAPES = ("polygon", "rectangle", "strokes", "seeds")


class Stroke(BaseModel):
    """Where a round brush went; pixels."""

    model_config = ConfigDict(extra="forbid", strict=True)

    points: list[list[float]]
    radius: float


class Shapes(BaseModel):
    """Pixels by one of several shapes; all numbers are pixels, x before y.

    Attributes
    ----------
    polygon : list of [x, y]
    rectangle : list of four numbers
        x0, y0, x1, y1; of a new object the surface of the depth segmenter inside.
    strokes : list of Stroke
    seeds : list of [x, y]
        The surfaces that these lie on.
    tolerance : float
        Of the seeds.
    """

    polygon: list[list[float]] | None = None
    rectangle: list[float] | None = None
    strokes: list[Stroke] | None = None
    seeds: list[list[float]] | None = None
    tolerance: float = TOLERANCE

    @property
    def shaped(self) -> bool:
        """Whether there is a shape."""
        return any(getattr(self, name) is not None for name in SHAPES)

    @model_validator(mode="after")
    def _one(self) -> Shapes:
        given = [name for name in SHAPES if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"only one of {', '.join(given)} can be meant")
        if self.rectangle is not None and len(self.rectangle) != 4:
            raise ValueError("a rectangle has four numbers")
        if self.strokes == []:
            raise ValueError("there are no strokes")
        return self

    def pixels(self, height: int, width: int, canvas: Canvas | None, *, surface: bool = False) -> np.ndarray:
        """(H, W) bool of the shape; InputError where it has no pixels or what it needs is not at hand."""
        if self.strokes is not None:
            each = [gesture_of("stroke", s.points, height, width, radius=s.radius) for s in self.strokes]
            return np.logical_or.reduce([drawn(g, height, width) for g in each])
        if self.polygon is not None:
            found = gesture_of("polygon", self.polygon, height, width)
        elif self.rectangle is not None:
            corners = [self.rectangle[:2], self.rectangle[2:]]
            found = gesture_of("surface" if surface else "rectangle", corners, height, width)
        else:
            found = gesture_of("depth", self.seeds, height, width, tolerance=self.tolerance)
        return drawn(found, height, width, canvas)


Mode = Literal["add", "remove", "replace"]


def combined(mask: np.ndarray, pixels: np.ndarray, mode: Mode) -> np.ndarray:
    """A mask with other pixels added to it, taken from it, or in its place."""
    if mode == "add":
        return mask | pixels
    return mask & ~pixels if mode == "remove" else pixels


def needs_pictures(actions: Sequence[Any]) -> bool:
    """Whether one of the actions follows the depth of a picture."""
    shapes = [a for a in actions if isinstance(a, Shapes)]
    return any(a.seeds is not None or (a.rectangle is not None and not hasattr(a, "object")) for a in shapes)
