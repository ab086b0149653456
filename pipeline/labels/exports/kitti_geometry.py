"""KITTI's boxes and calibration for a camera that may be tilted.

KITTI describes a box by its size, the middle of its bottom face and one angle
about the vertical, in a camera frame whose y axis points straight down. Our
cameras look down at the scene. So everything is written in the *level* camera
frame: the same centre of projection, turned by `ViewerAxes.R_level_camera` so
that y is along gravity and z is the level viewing direction. It takes the place
of KITTI's rectified frame:

    R0_rect = R_level_camera
    P2      = K · R_level_cameraᵀ          (3x4, last column 0)
    Tr_velo_to_cam = identity              ("velodyne" is our camera frame)

so that `P2 · X` projects a point of a label into the unchanged picture, as the
devkit does it, and `P2 · R0_rect · Tr_velo_to_cam · y` a point of our camera
frame. With a level camera P2 is [K | 0]. With a tilted one P2[0, 0] is not the
focal length: tools that take P2 apart, instead of multiplying by it, must use
K = P2[:, :3] · R0_rect.

Our upright boxes have axes near (right, down, forward) and sizes (width, height,
depth) along them; KITTI's l, h, w are these three. `rotation_y` is KITTI's: the
box's first axis is (cos ry, 0, -sin ry) in the level frame.
"""

from __future__ import annotations

import numpy as np

from pipeline.geometry.viewer import IMAGE_UP, viewer_axes

UPRIGHT = 1e-7
"""How far the second axis of a box may stand off the vertical, as a sine."""


def level_rotation(up: list[float] | None) -> np.ndarray:
    """(3, 3) rotation from the camera frame into the level camera frame; image-up where `up` is unknown."""
    return viewer_axes(IMAGE_UP if up is None else np.asarray(up)).R_level_camera


def projection(K: list[float] | None, R_level_camera: np.ndarray) -> np.ndarray:
    """P2, (3, 4): pixels from points of the level camera frame. Without intrinsics, those of a unit camera."""
    intrinsic = np.eye(3) if K is None else np.asarray(K, np.float64).reshape(3, 3)
    return np.hstack([intrinsic @ R_level_camera.T, np.zeros((3, 1))])


def to_kitti(
    center: np.ndarray, R: np.ndarray, size: np.ndarray, R_level_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """A box of the camera frame as KITTI has it.

    Returns
    -------
    (dimensions, location, rotation_y) or None
        (h, w, l) metres; middle of the bottom face in the level camera frame,
        metres; radians in -pi..pi. None where the box is not upright.
    """
    own = R_level_camera @ R
    if own[1, 1] <= 0 or max(abs(own[0, 1]), abs(own[2, 1])) > UPRIGHT:
        return None
    location = R_level_camera @ center + np.array([0.0, size[1] / 2, 0.0])
    return size[[1, 2, 0]], location, float(np.arctan2(-own[2, 0], own[0, 0]))


def from_kitti(
    dimensions: np.ndarray, location: np.ndarray, rotation_y: float, R_level_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(center, R, size) in the camera frame: the inverse of `to_kitti`."""
    h, w, length = dimensions
    c, s = np.cos(rotation_y), np.sin(rotation_y)
    own = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    center = R_level_camera.T @ (location - np.array([0.0, h / 2, 0.0]))
    return center, R_level_camera.T @ own, np.array([length, h, w])


def observation_angle(location: np.ndarray, rotation_y: float) -> float:
    """KITTI's alpha, radians in -pi..pi: the angle about the vertical at which the camera sees the box."""
    alpha = rotation_y - np.arctan2(location[0], location[2])
    return float((alpha + np.pi) % (2 * np.pi) - np.pi)
