"""The point cloud of a frame as it is sent to a page: made once, whoever looks at it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.answering.objects import PreparedFrame
from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.lifting import flying_pixels

MAX_POINTS = 320_000
BAND_RATIO = 1.3
"""Points are drawn in bands of depth, each with its own point size, so that near
and far surfaces look equally closed from the sensor."""
FAR = 12.0


@dataclass(frozen=True, eq=False)
class Cloud:
    """The points of a frame.

    Attributes
    ----------
    v, u : (N,) int64
        Pixels.
    points : (N, 3) float32
        In the shown frame: x right, y forward, z up, metres.
    levels : (B,) int64
        Bands of depth: powers of BAND_RATIO.
    bands : tuple of (M,) int64
        The points of each band.
    stride : int
        One pixel in so many is shown, each way.
    """

    v: np.ndarray
    u: np.ndarray
    points: np.ndarray
    levels: np.ndarray
    bands: tuple[np.ndarray, ...]
    stride: int


def cloud_of(context: PreparedFrame) -> Cloud:
    """The cloud of a frame, without pixels that fly between two surfaces."""
    frame, viewer = context.frame, context.viewer
    to_show = np.stack([viewer.right, viewer.forward, viewer.up])
    stride = max(1, int(np.ceil(np.sqrt(frame.width * frame.height / MAX_POINTS))))
    v, u = np.meshgrid(np.arange(0, frame.height, stride), np.arange(0, frame.width, stride), indexing="ij")
    z = frame.depth[v, u]
    keep = (z > 0) & (z < FAR) & ~flying_pixels(frame.depth)[v, u]
    v, u, z = v[keep], u[keep], z[keep]
    points = (lift_pixels(z, frame.camera, v, u) @ to_show.T.astype(np.float32)).astype(np.float32)
    band = np.floor(np.log(np.maximum(z, 1e-3)) / np.log(BAND_RATIO)).astype(int)
    levels = np.unique(band)
    return Cloud(v, u, points, levels, tuple(np.flatnonzero(band == level) for level in levels), stride)
