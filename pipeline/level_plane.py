"""The level plane of a frame: a floor or a table-top, told from walls and ceilings."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.camera import IMAGE_UP, Camera, lift_pixels
from pipeline.errors import InputError
from pipeline.normals import depth_noise, surface_normals

MAX_TILT_DEG = 45.0
MIN_PLANE_SHARE = 0.05
_GRID_POINTS = 4000
_HYPOTHESES = 192

SAME_SURFACE_DEG = 15.0
"""Normals of one surface differ by no more than this."""
MIN_SURFACE_PIXELS = 60


def level_plane(depth: np.ndarray, camera: Camera) -> np.ndarray | None:
    """Normal of the largest plane within 45 degrees of image-up, or None.

    Candidate normals come from the local surface on a coarse pixel grid, so
    that every hypothesis is a real patch of the scene and no random numbers are
    needed; the plane with the most points near it wins and is fitted to them.

    Returns
    -------
    (3,) float64 or None
        Unit vector, camera frame, on the side of image-up.
    """
    height, width = depth.shape
    stride = max(1, int(np.sqrt(height * width / _GRID_POINTS)))
    v, u = np.meshgrid(
        np.arange(stride, height - stride, stride), np.arange(stride, width - stride, stride), indexing="ij"
    )
    z = depth[v, u]
    points = lift_pixels(z.ravel(), camera, v.ravel(), u.ravel()).astype(np.float64).reshape(*v.shape, 3)
    valid = (z > 0.3) & (z < 10.0)
    if valid.sum() < 50:
        return None

    across = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    normal = np.cross(across, down)
    length = np.linalg.norm(normal, axis=-1)
    near = valid[1:-1, 2:] & valid[1:-1, :-2] & valid[2:, 1:-1] & valid[:-2, 1:-1] & valid[1:-1, 1:-1]
    normal = normal / np.maximum(length, 1e-12)[..., None]
    normal *= np.where(normal[..., 1:2] > 0, -1.0, 1.0)
    level = near & (length > 1e-12) & (normal @ IMAGE_UP > np.cos(np.deg2rad(MAX_TILT_DEG)))
    if level.sum() < 10:
        return None

    cloud = points[valid]
    tolerance = 0.008 + 0.004 * cloud[:, 2] ** 2
    candidates, anchors = normal[level], points[1:-1, 1:-1][level]
    pick = np.linspace(0, len(candidates) - 1, min(_HYPOTHESES, len(candidates))).astype(int)
    candidates, anchors = candidates[pick].astype(np.float32), anchors[pick].astype(np.float32)
    offset = np.einsum("hk,hk->h", candidates, anchors)
    support = (np.abs(candidates @ cloud.T.astype(np.float32) - offset[:, None]) < tolerance.astype(np.float32)).sum(1)
    best = int(support.argmax())
    n, d = candidates[best].astype(np.float64), float(offset[best])
    for _ in range(3):
        inliers = np.abs(cloud @ n - d) < tolerance
        if inliers.sum() < max(30, MIN_PLANE_SHARE * len(cloud)):
            return None
        centre = cloud[inliers].mean(axis=0)
        # Far points are noisier by z squared; unweighted they would tilt the plane.
        weight = 1.0 / tolerance[inliers]
        centre = np.average(cloud[inliers], axis=0, weights=weight)
        spread = (cloud[inliers] - centre) * weight[:, None]
        n = np.linalg.svd(spread.T @ spread)[0][:, 2]
        n = n if n @ IMAGE_UP > 0 else -n
        d = float(centre @ n)
    if n @ IMAGE_UP < np.cos(np.deg2rad(MAX_TILT_DEG)):
        return None
    return n


def level_normal_at(depth: np.ndarray, camera: Camera, u: int, v: int) -> np.ndarray:
    """The up vector that a person gives by naming a pixel of a level surface.

    The plane around the pixel is grown to the connected region that lies in it, and fitted to that.

    Parameters
    ----------
    depth : (H, W) float32
        Metres, 0 where missing.
    u, v : int
        Column and row.

    Returns
    -------
    (3,) float64
        Unit normal, camera frame, on the side from which the surface is seen: that of one who looks down on it.

    Raises
    ------
    InputError
        The pixel is outside the picture, has no depth, or lies on no plane.
    """
    height, width = depth.shape
    if not (0 <= u < width and 0 <= v < height):
        raise InputError("no such pixel", got=f"{u},{v}", expected=f"0,0 to {width - 1},{height - 1}")
    if depth[v, u] <= 0:
        raise InputError("the pixel has no depth", got=f"{u},{v}", expected="a pixel of a level surface")
    no_plane = InputError("there is no plane at the pixel", got=f"{u},{v}", expected="a pixel of a level surface")
    normals, known = surface_normals(depth, camera)
    if not known[v, u]:
        raise no_plane
    rows, columns = np.mgrid[:height, :width]
    points = lift_pixels(depth.ravel(), camera, rows.ravel(), columns.ravel()).reshape(height, width, 3)
    tolerance = 3 * depth_noise(depth)
    normal = normals[v, u].astype(np.float64)
    offset = float(points[v, u] @ normal)
    for _ in range(4):
        near = known & (np.abs(points @ normal - offset) < tolerance)
        near &= normals @ normal > np.cos(np.deg2rad(SAME_SURFACE_DEG))
        near[v, u] = True
        _, regions = cv2.connectedComponents(near.view(np.uint8), connectivity=4)
        region = regions == regions[v, u]
        if region.sum() < MIN_SURFACE_PIXELS:
            raise no_plane
        cloud = points[region].astype(np.float64)
        weight = 1.0 / tolerance[region].astype(np.float64)
        centre = np.average(cloud, axis=0, weights=weight)
        spread = (cloud - centre) * weight[:, None]
        normal = np.linalg.svd(spread.T @ spread)[0][:, 2]
        normal = normal if normal @ centre < 0 else -normal
        offset = float(centre @ normal)
    return normal
