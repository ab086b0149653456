"""A frame's surface in blocks of pixels: as much as its large planes need."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from pipeline.camera import Camera, lift_pixels
from pipeline.normals import surface_normals

PARALLEL_DEG = 8.0
UPRIGHT_DEG = 10.0
UPRIGHT = float(np.sin(np.deg2rad(UPRIGHT_DEG)))

NEAREST_M, FARTHEST_M = 0.15, 10.0
GRID_BLOCKS = 12_000
VOTERS = 4000


@dataclass(frozen=True)
class SurfaceBlocks:
    """What is seen in each block of pixels that has a depth.

    Attributes
    ----------
    points, normals : (N, 3) float32
        Camera frame, metres; the normals point towards the camera.
    flat : (N,) bool
        Whether the normal is known.
    v, u : (N,) int64
        Row and column of the block.
    shape : (int, int)
        Rows and columns of blocks.
    """

    points: np.ndarray
    normals: np.ndarray
    flat: np.ndarray
    v: np.ndarray
    u: np.ndarray
    shape: tuple[int, int]

    @cached_property
    def voters(self) -> np.ndarray:
        """Some of the flat normals, evenly: enough to weigh directions; planes are fitted to all points."""
        normals = self.normals[self.flat]
        return normals[:: max(1, len(normals) // VOTERS)]


def surface_blocks(depth: np.ndarray, camera: Camera) -> SurfaceBlocks:
    """Means over blocks of pixels, of inverse depth: in it a plane stays a plane."""
    height, width = depth.shape
    side = max(1, round(float(np.sqrt(height * width / GRID_BLOCKS))))
    rows, columns = height // side, width // side
    cut = depth[: rows * side, : columns * side]
    has = (cut > NEAREST_M) & (cut < FARTHEST_M)
    inverse = np.divide(1.0, cut, out=np.zeros(cut.shape, np.float32), where=has)
    filled = cv2.resize(has.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    mean = cv2.resize(inverse, (columns, rows), interpolation=cv2.INTER_AREA)
    z = np.divide(filled, mean, out=np.zeros_like(mean), where=filled > 0.5)
    K = camera.K.copy()
    K[:2] /= side
    K[:2, 2] -= (side - 1) / (2 * side)
    blocks = Camera(K, columns, rows)
    normals, known = surface_normals(z, blocks, radius=2)
    v, u = np.nonzero(z > 0)
    return SurfaceBlocks(lift_pixels(z[v, u], blocks, v, u), normals[v, u], known[v, u], v, u, (rows, columns))


def plane_tolerance(points: np.ndarray) -> np.ndarray:
    """(N,) metres within which points ((N, 3)) lie in a plane."""
    return 0.008 + 0.006 * points[:, 2] ** 2
