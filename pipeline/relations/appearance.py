"""What objects look like in the image: for networks that are given 2D boxes or class names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.system.errors import InputError

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, eq=False)
class Appearance:
    """2D boxes and class names of a list of objects, in its order.

    Attributes
    ----------
    bboxes : (N, 4) float64
        x0, y0, x1, y1, pixels; right and bottom edges exclusive.
    labels : tuple of str
    width, height : int
        Of the image, pixels.
    """

    bboxes: np.ndarray
    labels: tuple[str, ...]
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.bboxes.shape != (len(self.labels), 4):
            raise InputError(
                "boxes and class names differ in number",
                got=f"{self.bboxes.shape} boxes, {len(self.labels)} names",
                expected="(N, 4) boxes and N names",
            )
        if min(self.width, self.height) < 1:
            raise InputError("the image has no size", got=f"{self.width}x{self.height}")

    def take(self, index: Sequence[int]) -> Appearance:
        """Those objects alone, in this order."""
        labels = tuple(self.labels[k] for k in index)
        return Appearance(self.bboxes[list(index)].reshape(-1, 4), labels, self.width, self.height)
