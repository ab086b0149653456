"""Distance between two surface points, chosen by their pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.geometry.camera import Camera, depth_at, lift_pixels
from pipeline.geometry.viewer import ViewerAxes

PARTS = ("right", "up", "forward")
WAYS = (("right", "left"), ("up", "down"), ("forward", "back"))
PLACES = 3
"""Digits of a metre in words."""


@dataclass(frozen=True)
class Measurement:
    """Vector from one surface point to another."""

    # tuple of (int, int), column and row of the first and of the second
    pixels: tuple[tuple[int, int], tuple[int, int]]
    points: np.ndarray  # (2, 3) float64, metres, camera frame
    parts: np.ndarray  # (3,) float64, from the first to the second along the viewer's right, up and forward, metres

    @property
    def distance(self) -> float:
        """Straight distance, metres."""
        return float(np.linalg.norm(self.parts))

    @property
    def words(self) -> tuple[str, str, str]:
        """Parts in words: "0.524 m left", "0.103 m up", "1.207 m back"."""
        right, up, forward = (
            f"{abs(part):.{PLACES}f} m {words[int(part < 0)]}" for words, part in zip(WAYS, self.parts, strict=True)
        )
        return right, up, forward

    def record(self) -> dict[str, object]:
        """JSON of `spatialviz relations --measure --json`, metres."""
        parts = {name: round(float(part), 4) for name, part in zip(PARTS, self.parts, strict=True)}
        return {
            "pixels": [list(pixel) for pixel in self.pixels],
            "points": self.points.round(4).tolist(),
            "distance": round(self.distance, 4),
            **parts,
        }


def surface_point(depth: np.ndarray, camera: Camera, pixel: tuple[int, int]) -> np.ndarray:
    """Surface point of a pixel (u, v), (3,) float64, metres, camera frame; InputError without depth."""
    u, v = pixel
    z = depth_at(depth, u, v)
    return lift_pixels(np.array([z]), camera, np.array([v]), np.array([u]))[0].astype(np.float64)


def measure(
    depth: np.ndarray, camera: Camera, viewer: ViewerAxes, first: tuple[int, int], second: tuple[int, int]
) -> Measurement:
    """Measure the distance between the surface points of two pixels (column, row), metres.

    `depth` is (H, W) float32, metres, 0 where missing. InputError where a pixel is outside the picture or has no
    depth, or the camera is only a stand-in (`Camera.untold`).
    """
    camera.check_metric()
    points = np.stack([surface_point(depth, camera, pixel) for pixel in (first, second)])
    return Measurement((first, second), points, viewer.matrix @ (points[1] - points[0]))
