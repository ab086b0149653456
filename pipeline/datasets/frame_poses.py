"""Camera poses that files of single frames name beside a camera's numbers: a key and a 3x4 or 4x4 matrix.

ARKit's cameras, which 3D Scanner App writes as `cameraPoseARFrame`, are camera-to-world with x right, y up and z
back, in a world whose y is up: https://developer.apple.com/documentation/arkit/arcamera/transform.
"""

from __future__ import annotations

import re

import numpy as np

from pipeline.datasets.cameras import inverse, named_numbers, or_note, pose_from_matrix
from pipeline.datasets.files import Blob
from pipeline.system.errors import needed
from pipeline.system.frozen import dataclass

OPENCV_OF_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenCV's camera frame to OpenGL's: y and z are turned round."""
ARKIT = "cameraposearframe"
_WAYS = (
    (False, (ARKIT, "camera_?to_?world", "cam_?to_?world", "c2w", "cam(era)?2world", "t_?w(orld)?_?c(am(era)?)?")),
    (False, ("camera_?pose", "cam_?pose", "pose", "pose_?matrix", "transform", "transform_?matrix", "transformation")),
    (True, ("world_?to_?cam(era)?", "w2c", "world2cam(era)?", "t_?c(am(era)?)?_?w(orld)?")),
    (True, ("extrinsics?", "extrinsics?_?matrix", "view_?matrix")),
)
"""What poses are called, the clearest names first, and whether they are world-to-camera."""
_OPENGL = re.compile(rf"{ARKIT}|transform_?matrix", re.IGNORECASE)
"""Names of makers whose cameras have OpenGL's axes: ARKit, and the frames of nerfstudio and instant-ngp."""
_CAMERAS = re.compile(r"(cam(era)?|frame|meta(data)?|data|colou?r|rgb|depth|image|arkit)?", re.IGNORECASE)
"""What a pose may stand below, to be the camera's and not an object's."""


@dataclass(frozen=True)
class NamedPose:
    """The key of a pose in the files of frames, and what it means."""

    key: str
    inverted: bool  # Whether it is world-to-camera

    @property
    def arkit(self) -> bool:
        """Test whether its world has y up, as ARKit's."""
        return self.key.rpartition(".")[2].lower() == ARKIT

    @property
    def opengl(self) -> bool:
        """Test whether the camera's axes are OpenGL's."""
        return bool(_OPENGL.fullmatch(self.key.rpartition(".")[2]))

    @property
    def words(self) -> str:
        """Words of what it is taken for, and what `--poses` then tells."""
        way = "world-to-camera" if self.inverted else "camera-to-world"
        axes = f"{'ARKit' if self.arkit else 'OpenGL'}'s axes" if self.opengl else "OpenCV's axes"
        turned = self.inverted or self.opengl
        return f"{way} with {axes}: --poses tells {'what is then still to be turned' if turned else 'another way'}"

    def read(self, path: Blob) -> np.ndarray:
        """T_world_camera (4, 4) of a frame's file, metres; InputError where it has none, or no rigid one."""
        T = pose_from_matrix(needed(_square(dict(named_numbers(path)).get(self.key)), f"no {self.key}", path=path))
        T = inverse(T) if self.inverted else T
        return T @ OPENCV_OF_OPENGL if self.opengl else T


def pose_named(path: Blob) -> NamedPose | None:
    """The pose that a file names; None where it names none."""
    last = {
        key: key.rpartition(".")[2]
        for key, numbers in named_numbers(path)
        if numbers.size in (12, 16) and _CAMERAS.fullmatch(key.rpartition(".")[0].rpartition(".")[2])
    }
    names = ((inverted, name) for inverted, names in _WAYS for name in names)
    found = (NamedPose(k, way) for way, name in names for k in last if re.fullmatch(name, last[k], re.IGNORECASE))
    return next(found, None)


def rigid_matrices(path: Blob) -> list[str]:
    """Keys of a file that hold what may be a pose."""
    return [k for k, numbers in named_numbers(path) if or_note([], "", _rigid, numbers) is not None]


def _rigid(numbers: np.ndarray) -> np.ndarray:
    return pose_from_matrix(needed(_square(numbers), "no matrix"))


def _square(numbers: np.ndarray | None) -> np.ndarray | None:
    """A matrix (4, 4) of 12 numbers row by row, or of 16 in either order, by the place of 0 0 0 1."""
    if numbers is None or numbers.size not in (12, 16):
        return None
    T = np.append(numbers, [0, 0, 0, 1])[:16].reshape(4, 4)
    by_columns = T[:, 3].tolist() == [0, 0, 0, 1] and T[3].tolist() != [0, 0, 0, 1]
    return T.T if by_columns else T
