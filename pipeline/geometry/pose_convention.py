"""Conventions of pose matrices, and the camera-to-world pose in OpenCV's axes that each gives."""

from __future__ import annotations

import numpy as np

from pipeline.system.errors import require

STANDARD = "camera-to-world opencv"
"""What every reader takes a pose for: x right, y down, z forward."""
_AXES = {
    "opencv": np.eye(3),
    "opengl": np.diag([1.0, -1.0, -1.0]),
    "ros": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
"""By name the rotation from OpenCV's axes to the file's: OpenGL's y up and z backward, a ROS body's x forward, z up."""
_WAYS = ("camera-to-world", "world-to-camera")
CONVENTIONS = (*(f"{way} {axes}" for axes in _AXES for way in _WAYS), f"{STANDARD} wxyz")
"""All that is known; "wxyz" is of a quaternion that begins with its real part and was read as one that ends with it."""


def check_convention(name: object) -> str:
    """Check a convention's name; InputError for none of `CONVENTIONS`."""
    require(name in CONVENTIONS, "no such pose convention", got=repr(name)[:60], expected=" | ".join(CONVENTIONS))
    return str(name)


def standard_poses(T: np.ndarray, convention: str) -> np.ndarray:
    """T_world_camera in OpenCV's axes, of rigid matrices (..., 4, 4) in another convention."""
    way, axes, *order = convention.split()
    out = np.array(T, np.float64)
    if order:
        out[..., :3, :3] = _reordered(out[..., :3, :3], 1)
    if way == _WAYS[1]:
        out = _inverse(out)
    out[..., :3, :3] = out[..., :3, :3] @ _AXES[axes]
    return out


def composed(first: str, then: str) -> str | None:
    """Convention equal to two in turn; None for none of `CONVENTIONS`."""
    q = np.random.default_rng(0).normal(size=(3, 3))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.linalg.qr(q)[0], q[0]
    T[:3, 0] *= np.linalg.det(T[:3, :3])
    both = standard_poses(standard_poses(T, first), then)
    return next((name for name in CONVENTIONS if np.allclose(standard_poses(T, name), both)), None)


def _inverse(T: np.ndarray) -> np.ndarray:
    out = T.copy()
    R = T[..., :3, :3].swapaxes(-1, -2)
    out[..., :3, :3], out[..., :3, 3:] = R, -R @ T[..., :3, 3:]
    return out


def _reordered(R: np.ndarray, by: int) -> np.ndarray:
    """Rotations, (..., 3, 3), of quaternions read as x y z w whose numbers belong `by` places on."""
    # The quaternion's outer product with itself, from the rotation; its largest column is the quaternion but for scale.
    trace = np.trace(R, axis1=-2, axis2=-1)
    q = np.empty((*R.shape[:-2], 4, 4))
    q[..., :3, :3] = R + R.swapaxes(-1, -2) + (1 - trace)[..., None, None] * np.eye(3)
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        q[..., 3, k] = q[..., k, 3] = R[..., i, j] - R[..., j, i]
    q[..., 3, 3] = 1 + trace
    best = np.diagonal(q, axis1=-2, axis2=-1).argmax(axis=-1)
    xyzw = np.take_along_axis(q, best[..., None, None], axis=-1)[..., 0]
    # Read as x y z w, the numbers w x y z stand one place too early.
    x, y, z, w = np.moveaxis(np.roll(xyzw, -by, axis=-1) / np.linalg.norm(xyzw, axis=-1, keepdims=True), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
