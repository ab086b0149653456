"""The viewer's level axes: the frame in which relations are judged.

Relations are always the viewer's: right, up and forward are those of someone
who stands where the camera stands, looks where it looks, and holds the head
level. The up vector therefore decides everything; `resolve_up` says how it is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.camera import Camera, UpSource, lift_pixels

IMAGE_UP = np.array([0.0, -1.0, 0.0])
STEEP = 0.94
"""Above this |z . up| the camera looks so steeply that its z axis no longer says where forward is."""
MAX_TILT_DEG = 45.0
MIN_PLANE_SHARE = 0.05
_GRID_POINTS = 4000
_HYPOTHESES = 192


@dataclass(frozen=True)
class ViewerAxes:
    """Level axes at the camera centre, as unit vectors of the camera frame.

    (right, up, forward) is LEFT-handed and serves scalar coordinates only;
    wherever a rotation is expressed, `R_level_camera` is used.

    Attributes
    ----------
    right, up, forward : (3,) float64
    up_source : str
        How `up` is known.
    """

    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    up_source: UpSource

    @cached_property
    def matrix(self) -> np.ndarray:
        """(3, 3): `points @ matrix.T` gives (right, up, forward) coordinates, metres."""
        return np.stack([self.right, self.up, self.forward])

    @cached_property
    def R_level_camera(self) -> np.ndarray:
        """(3, 3) rotation into the right-handed level frame: x right, y down, z forward."""
        return np.stack([self.right, -self.up, self.forward])

    @property
    def pitch(self) -> float:
        """How far the camera looks down, radians."""
        return float(np.arcsin(np.clip(-self.up[2], -1.0, 1.0)))


def viewer_axes(up: np.ndarray, up_source: UpSource = "declared") -> ViewerAxes:
    """The level axes for an up vector ((3,), camera frame).

    Forward is the camera's z made level. Looking nearly straight down (or up),
    forward is where the top (or bottom) of the image points.
    """
    up = np.asarray(up, dtype=np.float64)
    up = up / np.linalg.norm(up)
    z = np.array([0.0, 0.0, 1.0])
    tilt = float(z @ up)
    heading = z if abs(tilt) <= STEEP else -np.sign(tilt) * IMAGE_UP
    forward = heading - (heading @ up) * up
    forward /= np.linalg.norm(forward)
    return ViewerAxes(right=np.cross(forward, up), up=up, forward=forward, up_source=up_source)


def resolve_up(depth: np.ndarray, camera: Camera) -> Camera:
    """The camera with an up vector: its own, else the largest level plane's, else image-up.

    Parameters
    ----------
    depth : (H, W) float32
        Metres.

    Returns
    -------
    Camera
        With `up` set and `up_source` one of declared, imu, plane, assumed.
    """
    if camera.up is not None:
        return camera if camera.up_source else camera.with_up(camera.up, "declared")
    plane = level_plane(depth, camera)
    return camera.with_up(IMAGE_UP, "assumed") if plane is None else camera.with_up(plane, "plane")


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
