"""Surface normals of a depth map, from a plane fitted around each pixel."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.camera import Camera

MIN_SHARE = 0.4
"""A plane is fitted where at least this share of the window has a depth."""
MAX_RESIDUAL = 2.5
"""And where the depths lie this close to it, in standard deviations of the sensor's noise."""


def depth_noise(z: np.ndarray) -> np.ndarray:
    """Standard deviation of a structured-light camera's depth at depth z, metres.

    Quadratic in z (Khoshelham and Elberink 2012), with a floor of 1 mm for the
    quantisation and the registration to the colour image.
    """
    return np.float32(0.001) + np.float32(0.0012) * (np.float32(0.4) + z * z)


def surface_step(depth: np.ndarray) -> np.ndarray:
    """Largest depth difference of neighbouring pixels of a surface, at these depths: max(3 cm, 3 %), metres."""
    return np.maximum(np.float32(0.03), np.float32(0.03) * depth)


def surface_normals(
    depth: np.ndarray, camera: Camera, radius: int = 4, noise: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals by least squares in inverse depth, where a plane is an affine function of the pixel.

    Parameters
    ----------
    depth : (H, W) float32
        Metres, 0 where missing.
    radius : int
        The window has 2 * radius + 1 pixels a side.
    noise : float
        Noise of the sensor, in multiples of `depth_noise`.

    Returns
    -------
    normals : (H, W, 3) float32
        Towards the camera, camera frame.
    known : (H, W) bool
        False where the window holds too few depths or is no plane (a depth edge, strong curvature).
    """
    height, width = depth.shape
    side = 2 * radius + 1
    has = depth > 0
    count = _sum(has.astype(np.float64), side)
    safe = np.maximum(count, 1)
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape, np.float64), where=has)
    x = np.where(has, (np.arange(width) - camera.cx)[None, :] / camera.fx, 0.0)
    y = np.where(has, (np.arange(height) - camera.cy)[:, None] / camera.fy, 0.0)
    mx, my, mq = (_sum(a, side) / safe for a in (x, y, inverse))
    xx = _sum(x * x, side) / safe - mx * mx
    yy = _sum(y * y, side) / safe - my * my
    xy = _sum(x * y, side) / safe - mx * my
    qx = _sum(inverse * x, side) / safe - mq * mx
    qy = _sum(inverse * y, side) / safe - mq * my
    qq = _sum(inverse * inverse, side) / safe - mq * mq
    determinant = np.maximum(xx * yy - xy * xy, 1e-18)
    a = (qx * yy - qy * xy) / determinant
    b = (qy * xx - qx * xy) / determinant
    # 1/z = a x + b y + c with x = X/Z, y = Y/Z is the plane a X + b Y + c Z = 1.
    plane = np.stack([a, b, mq - a * mx - b * my], axis=-1)
    length = np.sqrt((plane * plane).sum(axis=-1))
    residual = np.sqrt(np.maximum(qq - a * qx - b * qy, 0.0))
    # The noise of 1/z is that of z divided by z squared.
    known = has & (count >= MIN_SHARE * side * side) & (length > 1e-9)
    known &= residual < MAX_RESIDUAL * noise * depth_noise(depth) * inverse * inverse
    return (-plane / np.maximum(length, 1e-9)[..., None]).astype(np.float32), known


def _sum(values: np.ndarray, side: int) -> np.ndarray:
    return cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
