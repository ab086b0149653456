"""Plan view of the cameras of a posed scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.datasets.base import Dataset, load_picture, readable_frames, scene_of
from pipeline.datasets.up import scene_vote
from pipeline.geometry.frame import Frame

MOST_CAMERAS = 120
"""Of a longer scene so many are shown, evenly spread over its frames."""
NEIGHBOURS = 20_000
"""So many frames of either side are asked for their scene."""


@dataclass(frozen=True, eq=False)
class CameraPlan:
    """The cameras of a scene from above."""

    scene: str
    frame_ids: tuple[str, ...]  # Of the frames with a pose, in the dataset's order
    positions: np.ndarray  # (N, 2) float: Metres; the first axis is that in which the cameras are spread most
    headings: np.ndarray  # (N, 2) float: Where they look, of length one; 0, 0 for one that looks straight up or down

    def record(self) -> dict[str, object]:
        """Plan as JSON."""
        return {
            "scene": self.scene,
            "frames": list(self.frame_ids),
            "positions": np.round(self.positions, 3).tolist(),
            "headings": np.round(self.headings, 3).tolist(),
        }


def camera_plan(
    dataset: Dataset, frame_id: str, most: int = MOST_CAMERAS, load: Callable[[str], Frame] | None = None
) -> CameraPlan | None:
    """Plan of the cameras in a frame's scene; None with fewer than two poses.

    Up is what the frames declare, else what they vote for, else what the cameras hold upwards. At most `most` frames
    are read for their poses; a scene whose first frame has none is taken for one without.
    """
    at, scene = dataset.frame_ids.index(frame_id), scene_of(dataset, frame_id)
    start = max(0, at - NEIGHBOURS)
    ids = [i for i in dataset.frame_ids[start : at + NEIGHBOURS] if scene_of(dataset, i) == scene]
    chosen = {ids[k] for k in np.linspace(0, len(ids) - 1, min(most, len(ids))).astype(int)} | {frame_id}
    poses: dict[str, np.ndarray] = {}
    ups: list[np.ndarray] = []
    for frame in readable_frames(load or (lambda i: load_picture(dataset, i)), (i for i in ids if i in chosen)):
        pose, up = frame.camera.T_world_camera, frame.camera.up
        if pose is None:
            if not poses:
                return None
            continue
        poses[frame.id] = pose
        ups += [] if up is None else [pose[:3, :3] @ up]
    if len(poses) < 2:
        return None
    matrices = np.stack(list(poses.values()))
    if not ups and (voted := scene_vote(dataset, frame_id).up) is not None:
        ups = [voted]
    up = np.mean(ups or -matrices[:, :3, 1], axis=0)
    return CameraPlan(scene, tuple(poses), *_from_above(matrices, up / max(float(np.linalg.norm(up)), 1e-9)))


def _from_above(poses: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) positions and headings of poses ((N, 4, 4), world, metres) along the level axes of most and least spread.
    The second axis is the first turned left, seen from above."""
    centered = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)
    level = centered - np.outer(centered @ up, up)
    first = np.linalg.svd(level)[2][0]
    if np.abs(level).max() < 1e-6 or abs(first @ up) > 0.5:
        first = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = first - (first @ up) * up
    axes = np.stack([first / np.linalg.norm(first), np.cross(up, first / np.linalg.norm(first))], axis=1)
    headings = poses[:, :3, 2] @ axes
    lengths = np.linalg.norm(headings, axis=1, keepdims=True)
    return level @ axes, np.where(lengths > 1e-3, headings / np.maximum(lengths, 1e-9), 0.0)
