"""Posed views of a scene, and visibility of world points in them.

A world point in a view is out of the picture, where nothing was measured, on the measured surface, hidden behind it, or
in front of it: then the view looks through the place, and either the pose, the depth or the point is wrong, or
something has moved.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from enum import IntEnum
from functools import cached_property

import numpy as np

from pipeline.datasets.base import Dataset, frames_of_scene, load_pose
from pipeline.datasets.cameras import or_note
from pipeline.geometry.camera import Camera, backproject, project, to_world
from pipeline.geometry.cleaning import depth_edges, flying_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.surface import depth_noise, surface_normals
from pipeline.system.errors import FrameUnusable, needed, require
from pipeline.system.frozen import dataclass

LEAST_TOLERANCE_M, NOISES = 0.02, 4.0
"""A point is on a surface within so many metres, or so many standard deviations of a structured-light camera's
depth."""


class Visibility(IntEnum):
    """Place of a world point in a view."""

    OUT = 0
    """Outside the picture, or behind the camera."""
    UNMEASURED = 1
    """Where the view has no depth."""
    SEEN = 2
    """On the measured surface."""
    HIDDEN = 3
    """Behind it."""
    THROUGH = 4
    """In front of it: the view looks through the place."""


@dataclass(frozen=True, eq=False)
class PosedView:
    """Colour and depth of a posed frame.

    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.scenes.views import PosedView
    >>> view = PosedView.of(open_dataset(demo_path()).load("000001/000000"))
    >>> view.at(*view.project(view.points[:1]))
    array([2], dtype=uint8)
    """

    frame_id: str
    rgb: np.ndarray  # (H, W, 3) uint8
    depth: np.ndarray  # (H, W) float32, metres, 0 where nothing was measured
    camera: Camera
    T_world_camera: np.ndarray  # (4, 4) float64, as used

    @classmethod
    def of(cls, frame: Frame, T_world_camera: np.ndarray | None = None) -> PosedView:
        """View of a frame, by its own pose or another; FrameUnusable without either."""
        frame.camera.check_metric()
        own = frame.camera.T_world_camera if T_world_camera is None else T_world_camera
        pose = needed(own, f"frame {frame.id} has no pose", error=FrameUnusable)
        return cls(frame.id, frame.rgb, frame.depth, frame.camera, np.asarray(pose, np.float64))

    def moved(self, T_world_camera: np.ndarray) -> PosedView:
        """View with another pose."""
        made = replace(self, T_world_camera=T_world_camera)
        # What is known of the depth stays.
        made.__dict__.update({name: value for name, value in vars(self).items() if name in ("sharp", "normals")})
        return made

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.depth.shape[0], self.depth.shape[1]

    @cached_property
    def sharp(self) -> np.ndarray:
        """Pixels with a depth of one surface, (H, W) bool: neither at a step of depth nor between two surfaces."""
        return (self.depth > 0) & ~depth_edges(self.depth) & ~flying_pixels(self.depth)

    @property
    def pixels(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the `sharp` pixels, (N,) int64 each."""
        return tuple(np.nonzero(self.sharp))  # pyright: ignore[reportReturnType]

    @cached_property
    def normals(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit normals, (H, W, 3) float32, camera frame, and where they are known, (H, W) bool."""
        normals, known = surface_normals(self.depth, self.camera)
        return normals.astype(np.float32), known

    @property
    def points(self) -> np.ndarray:
        """World points of `pixels`, (N, 3) float32, metres."""
        return self.world(*self.pixels)

    def world(self, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """World points of pixels with a depth, (N, 3) float32, metres."""
        return to_world(backproject(self.depth, self.camera, v, u), self.T_world_camera).astype(np.float32)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows and columns, (N,) int64, -1 outside the picture, and depths z, (N,) float64, metres, of world points."""
        T = np.linalg.inv(self.T_world_camera)
        camera_points = to_world(np.asarray(points, np.float64), T)
        pixel = np.nan_to_num(project(camera_points, self.camera), nan=-1.0, posinf=-1.0, neginf=-1.0)
        u, v = (np.rint(np.clip(pixel[:, k], -1, 1e6)).astype(np.int64) for k in (0, 1))
        inside = (u >= 0) & (v >= 0) & (u < self.camera.width) & (v < self.camera.height) & (camera_points[:, 2] > 0)
        return np.where(inside, v, -1), np.where(inside, u, -1), camera_points[:, 2]

    def at(self, v: np.ndarray, u: np.ndarray, z: np.ndarray, tolerance: float = 1.0) -> np.ndarray:
        """`Visibility` of what `project` gives, (N,) uint8; `tolerance` is a factor of the usual one."""
        measured = np.where(v >= 0, self.depth[v, u], 0)
        slack = tolerance * np.maximum(LEAST_TOLERANCE_M, NOISES * depth_noise(measured))
        found = np.full(len(v), Visibility.SEEN, np.uint8)
        found[z > measured + slack] = Visibility.HIDDEN
        found[z < measured - slack] = Visibility.THROUGH
        found[measured <= 0] = Visibility.UNMEASURED
        found[v < 0] = Visibility.OUT
        return found


def posed_frames(dataset: Dataset, frame_id: str) -> tuple[str, ...]:
    """Frames of a frame's scene that have a pose, in the dataset's order; FrameUnusable for fewer than two.

    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.scenes.views import posed_frames
    >>> posed_frames(open_dataset(demo_path()), "000001/000000")
    ('000001/000000', '000001/000001', '000001/000002')
    """
    ids = frames_of_scene(dataset, frame_id)
    found = tuple(i for i in ids if or_note([], "", load_pose, dataset, i) is not None)
    require(
        len(found) > 1,
        "frames of one scene are joined by their camera poses, and these have none",
        got=f"{len(found)} of {len(ids)} frames with a pose",
        expected="a pose file of the recording's format, or `frames DATASET --poses`",
        path=dataset.root,
        error=FrameUnusable,
    )
    return found


def views_of(dataset: Dataset, frame_ids: Iterable[str]) -> Iterator[PosedView]:
    """Load posed views in turn; InputError for a broken frame."""
    for frame_id in frame_ids:
        yield PosedView.of(dataset.load(frame_id))
