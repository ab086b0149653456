"""The viewer's level axes: the frame in which relations are judged.

Relations are always the viewer's: right, up and forward are those of someone
who stands where the camera stands, looks where it looks, and holds the head
level. The up vector therefore decides everything; `resolve_up` says how it is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.geometry.camera import IMAGE_UP, Camera, UpSource
from pipeline.geometry.level_plane import assumed, decided, up_hypotheses

STEEP = 0.94
"""Above this |z . up| the camera looks so steeply that its z axis no longer says where forward is."""


@dataclass(frozen=True)
class ViewerAxes:
    """Level axes at the camera centre, as unit vectors of the camera frame.

    (right, up, forward) is LEFT-handed and serves scalar coordinates only;
    wherever a rotation is expressed, `R_level_camera` is used.
    """

    right: np.ndarray  # (3,) float64
    up: np.ndarray  # (3,) float64
    forward: np.ndarray  # (3,) float64
    up_source: UpSource  # Source of `up`
    up_doubt: str = ""  # What the frame itself says against it, in words; "" for nothing

    @cached_property
    def matrix(self) -> np.ndarray:
        """Matrix, (3, 3): `points @ matrix.T` gives (right, up, forward) coordinates, metres."""
        return np.stack([self.right, self.up, self.forward])

    @cached_property
    def R_level_camera(self) -> np.ndarray:
        """Rotation, (3, 3), into the right-handed level frame: x right, y down, z forward."""
        return np.stack([self.right, -self.up, self.forward])

    @property
    def pitch(self) -> float:
        """Downward pitch of the camera, radians."""
        return float(np.arcsin(np.clip(-self.up[2], -1.0, 1.0)))


def viewer_axes(up: np.ndarray, up_source: UpSource = "declared", up_doubt: str = "") -> ViewerAxes:
    """Level axes for an up vector, (3,), camera frame.

    Forward is the camera's z made level. Looking nearly straight down (or up),
    forward is where the top (or bottom) of the image points.

    >>> import numpy as np
    >>> from pipeline.geometry import viewer_axes
    >>> axes = viewer_axes(np.array([0, -np.cos(0.5), -np.sin(0.5)]))
    >>> round(axes.pitch, 3), axes.right.round(3).tolist()
    (0.5, [1.0, 0.0, 0.0])
    """
    up = np.asarray(up, dtype=np.float64)
    up = up / np.linalg.norm(up)
    z = np.array([0.0, 0.0, 1.0])
    tilt = float(z @ up)
    heading = z if abs(tilt) <= STEEP else -np.sign(tilt) * IMAGE_UP
    forward = heading - (heading @ up) * up
    forward /= np.linalg.norm(forward)
    return ViewerAxes(right=np.cross(forward, up), up=up, forward=forward, up_source=up_source, up_doubt=up_doubt)


def resolve_up(depth: np.ndarray, camera: Camera, scene_up: np.ndarray | None = None) -> Camera:
    """Camera with an up vector: own, else the scene's, else of a level plane, else assumed.

    `scene_up`, (3,), is the up of the frame's scene in the world (see `pipeline.datasets.up`); it needs a pose.
    """
    if camera.up is not None:
        return camera if camera.up_source else camera.with_up(camera.up, "declared")
    if scene_up is not None and camera.T_world_camera is not None:
        return camera.with_up(camera.T_world_camera[:3, :3].T @ scene_up, "scene")
    found = up_hypotheses(depth, camera)
    best = decided(found)
    return camera.with_up(assumed(found), "assumed") if best is None else camera.with_up(best.up, "plane")
