"""The pinhole camera: intrinsics, pose and its conventions, the up vector, backprojection and projection.

The camera frame is OpenCV's: x right, y down, z forward, in metres. Pixel
(u, v) is the centre of column u and row v, so that an integer pixel
backprojects along ((u - cx) / fx, (v - cy) / fy, 1).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

UpSource = Literal["given", "declared", "imu", "scene", "plane", "assumed"]
"""How an up vector is known: given by the user, declared by the dataset, measured by an
inertial sensor, agreed by the posed frames of the scene, the normal of a level plane of
this frame, or assumed."""

IMAGE_UP = np.array([0.0, -1.0, 0.0])


FLIPPED = (
    "a negative fy is of a camera whose y is up; poses that speak of it are then reflected: S T S with S = diag(1, -1, "
    "1, 1), which the reader of ICL-NUIM does"
)


def check_focals(fx: float, fy: float) -> None:
    """Check focal lengths; InputError where one is not positive."""
    flipped = fx > 0 > fy
    require(
        fx > 0 and fy > 0,
        "focal lengths must be positive",
        got=f"fx={fx:g}, fy={fy:g}",
        expected=f"fy={-fy:g}, for pictures stored from the top down" if flipped else None,
        cause=FLIPPED if flipped else "is the matrix stored column by column?",
    )


@dataclass(frozen=True)
class Camera:
    """A pinhole camera, its pose and its up vector.

    Attributes
    ----------
    K : (3, 3) float64
        Intrinsics in pixels.
    width, height : int
        Image size in pixels.
    T_world_camera : (4, 4) float64 or None
        Pose: maps camera coordinates to world coordinates, metres.
    up : (3,) float64 or None
        Unit vector against gravity in the CAMERA frame, None where unknown.
    up_source : str or None
        Source of `up`.
    untold : tuple of str
        Options that would say what is unknown of the camera or of the depth's unit; while there are any, the camera
        is a stand-in to look at the frame, and nothing may be measured by it.

    >>> from pipeline import Camera
    >>> from pipeline.geometry import intrinsics
    >>> Camera(intrinsics(570, 570, 320, 240), 640, 480)
    <Camera 640x480, fx=570 fy=570 cx=320 cy=240>
    """

    K: np.ndarray
    width: int
    height: int
    T_world_camera: np.ndarray | None = None
    up: np.ndarray | None = None
    up_source: UpSource | None = None
    untold: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        K = np.asarray(self.K, dtype=np.float64)
        require(K.shape == (3, 3), "intrinsics must be a 3x3 matrix", got=f"shape {K.shape}")
        require(np.isfinite(K).all(), "intrinsics are not finite", got=lambda: np.round(K, 3).tolist())
        check_focals(K[0, 0], K[1, 1])
        require(
            K[2, 2] == 1 and K[2, 0] == 0 and K[2, 1] == 0,
            "the last row of the intrinsics must be 0 0 1",
            got=K[2].tolist(),
            cause="is the matrix stored column by column?",
        )
        object.__setattr__(self, "K", K)
        if self.T_world_camera is not None:
            T = np.asarray(self.T_world_camera, dtype=np.float64)
            require(
                T.shape == (4, 4) and np.isfinite(T).all(),
                "a camera pose must be a finite 4x4 matrix",
                got=f"shape {T.shape}",
            )
            R = T[:3, :3]
            require(
                np.abs(R @ R.T - np.eye(3)).max() <= 1e-2 and np.linalg.det(R) >= 0,
                "the rotation of a camera pose is not a rotation",
                got=lambda: f"det {np.linalg.det(R):.3f}",
                cause="is the matrix transposed, scaled, or left-handed?",
            )
            object.__setattr__(self, "T_world_camera", T)
        if self.up is not None:
            up = np.asarray(self.up, dtype=np.float64)
            norm = float(np.linalg.norm(up))
            require(
                up.shape == (3,) and np.isfinite(norm) and norm >= 1e-9,
                "the up vector must be three finite numbers",
                got=self.up,
            )
            # A unit vector stays as it is to the last bit, so that what was written is what is read.
            object.__setattr__(self, "up", up if abs(norm - 1) < 1e-15 else up / norm)

    def __repr__(self) -> str:
        posed = "" if self.T_world_camera is None else ", posed"
        up = "" if self.up is None else f", up {self.up_source}"
        center = f"cx={self.cx:g} cy={self.cy:g}"
        return f"<Camera {self.width}x{self.height}, fx={self.fx:g} fy={self.fy:g} {center}{posed}{up}>"

    @property
    def fx(self) -> float:
        return float(self.K[0, 0])

    @property
    def fy(self) -> float:
        return float(self.K[1, 1])

    @property
    def cx(self) -> float:
        return float(self.K[0, 2])

    @property
    def cy(self) -> float:
        return float(self.K[1, 2])

    def check_metric(self) -> None:
        """Raise InputError where nothing can be measured, since the camera or the depth's unit is unknown."""
        require(
            not self.untold,
            "nothing can be measured: this recording does not say its camera",
            expected=" and ".join(self.untold),
        )

    def with_up(self, up: np.ndarray, source: UpSource) -> Camera:
        """Copy with an up vector, (3,), camera frame."""
        return replace(self, up=up, up_source=source)


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Matrix of a pinhole camera without skew, (3, 3) float64, pixels."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def depth_at(depth: np.ndarray, u: int, v: int, expected: str = "a pixel of a surface") -> float:
    """Depth at a column and row of (H, W) float32, metres; InputError outside, and where nothing was measured."""
    height, width = depth.shape
    require(
        (0 <= u < width and 0 <= v < height),
        "no such pixel",
        got=f"{u},{v}",
        expected=f"0,0 to {width - 1},{height - 1}",
    )
    require(depth[v, u] > 0, "the pixel has no depth", got=f"{u},{v}", expected=expected)
    return float(depth[v, u])


def backproject(depth: np.ndarray, camera: Camera, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Backproject pixels (u, v) to camera-frame points, by the whole depth map.

    Parameters
    ----------
    depth : (H, W) float32
        Metres along z.
    v, u : (N,) int
        Rows and columns.

    Returns
    -------
    (N, 3) float32
        Metres, camera frame. Pixels without depth (0) come back as zeros.

    >>> import numpy as np
    >>> from pipeline.geometry import Camera, backproject, intrinsics, project
    >>> camera = Camera(intrinsics(500, 500, 320, 240), 640, 480)
    >>> points = backproject(np.full((480, 640), 2, np.float32), camera, np.array([240]), np.array([420]))
    >>> points.tolist(), project(points, camera).tolist()
    ([[0.4000000059604645, 0.0, 2.0]], [[420.0000014901161, 240.0]])
    """
    return lift_pixels(depth[v, u], camera, v, u)


def lift_pixels(z: np.ndarray, camera: Camera, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Backproject pixels of known depths z, (N,), to camera-frame points, (N, 3) float32, metres."""
    z = np.asarray(z, dtype=np.float32)
    points = np.empty((len(z), 3), dtype=np.float32)
    points[:, 0] = (np.asarray(u, dtype=np.float32) - np.float32(camera.cx)) * z / np.float32(camera.fx)
    points[:, 1] = (np.asarray(v, dtype=np.float32) - np.float32(camera.cy)) * z / np.float32(camera.fy)
    points[:, 2] = z
    return points


def project(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Project camera-frame points, (..., 3), metres, to pixels (u, v), (..., 2) float64; NaN behind the image plane."""
    points = np.asarray(points, dtype=np.float64)
    z = points[..., 2]
    safe = np.where(z > 1e-9, z, np.nan)
    return np.stack(
        [camera.fx * points[..., 0] / safe + camera.cx, camera.fy * points[..., 1] / safe + camera.cy],
        axis=-1,
    )


def to_world(points: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    """Transform camera-frame points, (..., 3), to the world, metres."""
    return points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]


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
    return rotations(np.roll(xyzw, -by, axis=-1) / np.linalg.norm(xyzw, axis=-1, keepdims=True))


def rotations(xyzw: np.ndarray) -> np.ndarray:
    """Rotations, (..., 3, 3), of unit quaternions, (..., 4), x y z w (Shoemake 1985)."""
    x, y, z, w = np.moveaxis(xyzw, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
