"""Sides of a 3D box that a view does not bound: cut by the picture, hidden by something nearer, or turned away."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.geometry.surface import surface_step

SIDES = ("left", "right", "top", "bottom", "near", "far")
"""Of a box with axes near (right, down, forward): its faces at -x, +x, -y, +y, -z and +z."""
RIM = 0.15
"""Share of the box's length beside a face, in which the outline tells of that face."""
REACH = 2
"""Pixels around the outline in which something nearer hides what goes on behind it."""


def open_sides(
    box: Box3D, mask: np.ndarray, depth: np.ndarray, camera: Camera, hidden: np.ndarray | None = None
) -> np.ndarray:
    """Sides where the object may go on beyond its box, (6,) bool, in the order of SIDES.

    Parameters
    ----------
    mask : (H, W) bool
    depth : (H, W) float32
        Metres.
    hidden : (6,) bool, optional
        Sides that are known to be open: those that the fit moved out.

    A side is open where at least half of the outline beside it is at the picture's border, or next to something nearer
    by more than a step of a surface (`normals.surface_step`).
    """
    found = np.zeros(6, np.bool_) if hidden is None else hidden.copy()
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    x0, y0 = max(x - REACH, 0), max(y - REACH, 0)
    inside = mask[y0 : y + h + REACH, x0 : x + w + REACH]
    z = depth[y0 : y + h + REACH, x0 : x + w + REACH]
    v, u = np.nonzero(inside & (cv2.erode(inside.view(np.uint8), _CROSS) == 0) & (z > 0))
    if not len(v):
        return found
    around = np.where(inside | (z <= 0), np.float32(np.inf), z)
    nearest = cv2.erode(around, np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8))[v, u]
    goes_on = nearest < z[v, u] - surface_step(z[v, u])
    goes_on |= (v + y0 == 0) | (u + x0 == 0) | (v + y0 == mask.shape[0] - 1) | (u + x0 == mask.shape[1] - 1)
    along = (lift_pixels(z[v, u], camera, v + y0, u + x0) - box.center) @ box.R / np.maximum(box.size, 1e-6)
    for axis in range(3):
        for side, beside in ((0, along[:, axis] < RIM - 0.5), (1, along[:, axis] > 0.5 - RIM)):
            found[2 * axis + side] |= bool(beside.any() and goes_on[beside].mean() >= 0.5)
    return found


_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
