"""One up vector for all posed frames of a scene, by a vote of some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock
from weakref import WeakKeyDictionary

import numpy as np

from pipeline.datasets.base import Dataset, frames_of_scene, load_picture, scene_of
from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.level_plane import MIN_SCORE, UpHypothesis, decided, up_hypotheses
from pipeline.geometry.viewer import resolve_up
from pipeline.system.errors import InputError

MAX_VOTERS = 12
"""So many frames of a scene are asked, spread evenly over it."""
AGREE_DEG = 10.0
MIN_AGREEING = 2
VOTE_LEAD = 1.5
"""The winner must have so many times the votes of any other direction."""


@dataclass(frozen=True)
class SceneVote:
    """What the posed frames of a scene say of its up.

    Attributes
    ----------
    scene : str
    up : (3,) float64 or None
        Unit vector of the world; None where they do not agree, or too few of them say anything.
    agreeing, voting : int
        Frames that support this up and say nothing else, and frames that say anything.
    disagreeing : tuple of (str, float)
        Frames whose own planes decide for another up, and by how many degrees.
    """

    scene: str
    up: np.ndarray | None
    agreeing: int
    voting: int
    disagreeing: tuple[tuple[str, float], ...] = ()


Voter = tuple[str, np.ndarray, tuple[UpHypothesis, ...]]
"""A frame's id, its R_world_camera (3, 3), and its hypotheses, the best first."""


def vote(scene: str, voters: Sequence[Voter]) -> SceneVote:
    """The direction of the world for which the hypotheses of the frames speak most, each frame once."""
    told = [[h for h in found if h.told] for _, _, found in voters]
    ups = [np.array([R @ h.up for h in found]).reshape(-1, 3) for (_, R, _), found in zip(voters, told, strict=True)]
    scores = [np.array([h.score for h in found]) for found in told]
    voting = sum(bool((s >= MIN_SCORE).any()) for s in scores)
    if voting < MIN_AGREEING:
        return SceneVote(scene, None, 0, voting)
    candidates = np.concatenate(ups)
    alike = np.cos(np.deg2rad(AGREE_DEG))
    totals = np.zeros(len(candidates))
    for own, score in zip(ups, scores, strict=True):
        if len(own):
            totals += np.where(candidates @ own.T > alike, score, 0.0).max(axis=1)
    winner = candidates[int(totals.argmax())]
    rivals = totals[candidates @ winner <= np.cos(np.deg2rad(2 * AGREE_DEG))]
    supporting = [np.where(own @ winner > alike, score, 0.0) for own, score in zip(ups, scores, strict=True)]
    up = sum((weight @ own for own, weight in zip(ups, supporting, strict=True)), np.zeros(3))
    up /= np.linalg.norm(up)
    angles = [(name, _degrees(R @ own.up, up)) for name, R, found in voters if (own := decided(found)) is not None]
    disagreeing = tuple((name, angle) for name, angle in angles if angle > AGREE_DEG)
    others = {name for name, _ in disagreeing}
    agreeing = sum(
        bool((weight >= MIN_SCORE).any()) and name not in others
        for (name, _, _), weight in zip(voters, supporting, strict=True)
    )
    sure = agreeing >= max(MIN_AGREEING, len(disagreeing) + 1) and totals.max() >= VOTE_LEAD * rivals.max(initial=0.0)
    return SceneVote(scene, up, agreeing, voting, disagreeing) if sure else SceneVote(scene, None, agreeing, voting)


def scene_vote(dataset: Dataset, frame_id: str) -> SceneVote:
    """The vote of the scene that a frame belongs to, taken once per dataset and process.

    It depends on the scene alone, not on the frame that asks, so that every process finds the same.
    Frames that are broken or have no pose do not vote.
    """
    scene = scene_of(dataset, frame_id)
    with _LOCK:
        known = _VOTES.setdefault(dataset, {})
        if scene not in known:
            known[scene] = vote(scene, _voters(dataset, frame_id))
        return known[scene]


_LOCK = Lock()
_VOTES: WeakKeyDictionary[Dataset, dict[str, SceneVote]] = WeakKeyDictionary()


def _voters(dataset: Dataset, frame_id: str) -> list[Voter]:
    ids = frames_of_scene(dataset, frame_id)
    voters: list[Voter] = []
    if len(ids) < MIN_AGREEING:
        return voters
    for place in np.unique(np.linspace(0, len(ids) - 1, min(MAX_VOTERS, len(ids))).astype(int)).tolist():
        try:
            frame = load_picture(dataset, ids[place])
        except InputError:
            continue
        if frame.camera.T_world_camera is not None:
            found = up_hypotheses(frame.depth, frame.camera)
            voters.append((frame.id, frame.camera.T_world_camera[:3, :3], found))
    return voters


def resolved_camera(dataset: Dataset, frame: Frame) -> Camera:
    """The frame's camera with its up vector; a frame with a pose and without an up takes its scene's."""
    camera = frame.camera
    if camera.up is not None or camera.T_world_camera is None:
        return resolve_up(frame.depth, camera)
    return resolve_up(frame.depth, camera, scene_vote(dataset, frame.id).up)


def own_disagreement(frame: Frame, vote: SceneVote) -> float | None:
    """By how many degrees a frame's own planes decide against its scene's up; None where they do not."""
    T = frame.camera.T_world_camera
    own = None if T is None or vote.up is None else decided(up_hypotheses(frame.depth, frame.camera))
    if own is None or T is None or vote.up is None:
        return None
    angle = _degrees(T[:3, :3] @ own.up, vote.up)
    return angle if angle > AGREE_DEG else None


def _degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1.0, 1.0))))
