"""The viewer's level axes: the frame in which relations are judged.

Relations are always the viewer's: right, up and forward are those of someone
who stands where the camera stands, looks where it looks, and holds the head
level. The up vector therefore decides everything; `resolve_up` says how it is known. Distances are measured along the
same axes.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pipeline.geometry.camera import IMAGE_UP, Camera, UpSource, depth_at, lift_pixels
from pipeline.geometry.level_plane import assumed, decided, up_hypotheses
from pipeline.system.frozen import dataclass

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


PARTS = ("right", "up", "forward")
WAYS = (("right", "left"), ("up", "down"), ("forward", "back"))
PLACES = 3
"""Digits of a metre in words."""


@dataclass(frozen=True)
class Measurement:
    """Vector from one surface point to another."""

    # tuple of (int, int), column and row of the first and of the second
    pixels: tuple[tuple[int, int], tuple[int, int]]
    points: np.ndarray  # (2, 3) float64, metres, camera frame
    parts: np.ndarray  # (3,) float64, from the first to the second along the viewer's right, up and forward, metres

    @property
    def distance(self) -> float:
        """Straight distance, metres."""
        return float(np.linalg.norm(self.parts))

    @property
    def words(self) -> tuple[str, str, str]:
        """Parts in words: "0.524 m left", "0.103 m up", "1.207 m back"."""
        right, up, forward = (
            f"{abs(part):.{PLACES}f} m {words[int(part < 0)]}" for words, part in zip(WAYS, self.parts, strict=True)
        )
        return right, up, forward

    def record(self) -> dict[str, object]:
        """JSON of `spatialviz relations --measure --json`, metres."""
        parts = {name: round(float(part), 4) for name, part in zip(PARTS, self.parts, strict=True)}
        return {
            "pixels": [list(pixel) for pixel in self.pixels],
            "points": self.points.round(4).tolist(),
            "distance": round(self.distance, 4),
            **parts,
        }


def surface_point(depth: np.ndarray, camera: Camera, pixel: tuple[int, int]) -> np.ndarray:
    """Surface point of a pixel (u, v), (3,) float64, metres, camera frame; InputError without depth."""
    u, v = pixel
    z = depth_at(depth, u, v)
    return lift_pixels(np.array([z]), camera, np.array([v]), np.array([u]))[0].astype(np.float64)


def measure(
    depth: np.ndarray, camera: Camera, viewer: ViewerAxes, first: tuple[int, int], second: tuple[int, int]
) -> Measurement:
    """Measure the distance between the surface points of two pixels (column, row), metres.

    `depth` is (H, W) float32, metres, 0 where missing. InputError where a pixel is outside the picture or has no
    depth, or the camera is only a stand-in (`Camera.untold`).
    """
    camera.check_metric()
    points = np.stack([surface_point(depth, camera, pixel) for pixel in (first, second)])
    return Measurement((first, second), points, viewer.matrix @ (points[1] - points[0]))
