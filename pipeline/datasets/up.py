"""Up vectors of frames for any reader: user settings, and votes of scenes.

One up vector for all posed frames of a scene comes of a vote of some of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from threading import Lock
from weakref import WeakKeyDictionary

import numpy as np

from pipeline.datasets.base import (
    ChangedFrames,
    Dataset,
    frames_of_scene,
    load_picture,
    load_pose,
    readable_frames,
    resolve_frame,
    scene_of,
    unknown_id,
)
from pipeline.datasets.cameras import or_note
from pipeline.datasets.settings import SOURCES, GivenUp, Settings, Vector, parse_level_at
from pipeline.geometry.camera import IMAGE_UP, Camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.level_plane import (
    MIN_SCORE,
    UpHypothesis,
    decided,
    far_from_level,
    level_normal_at,
    up_hypotheses,
)
from pipeline.geometry.viewer import resolve_up
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

FAR_FROM_DECLARED_DEG = 5.0
"""An up that was told is worth a note where it is so far off the one that the dataset declares."""
LOOKED_AT = 5
"""So many frames are asked for a pose where an up vector does not say its frame."""


class UpGiven(ChangedFrames):
    """A dataset with user-set up vectors.

    What was told of a frame holds for it, and by the poses for its whole scene; then what was told of the whole
    dataset; then `world_up` of the settings, which declares it; then what the reader says.
    """

    def __init__(self, inner: Dataset, settings: Settings, frame_up: Mapping[str, Vector]) -> None:
        super().__init__(inner)
        self.settings = settings
        self.frame_up = dict(frame_up)
        for frame_id in self.frame_up:
            if frame_id not in inner.frame_ids:
                raise unknown_id(inner.frame_ids, frame_id, inner.root)

    @cached_property
    def up(self) -> GivenUp | None:
        """Up of the whole dataset, with the frame resolved."""
        given = self.settings.up
        if given is None or given.frame is not None:
            return given
        return replace(given, frame="world" if self.posed else "camera")

    @cached_property
    def posed(self) -> bool | None:
        """Presence of a pose among the inspected frames; None where none is readable."""
        ids, found = self.inner.frame_ids, None
        spread = np.linspace(0, len(ids) - 1, min(LOOKED_AT, len(ids))).astype(int).tolist()
        for frame in readable_frames(self.inner.load, [ids[index] for index in spread]):
            found = frame.camera.T_world_camera is not None
            if found:
                return True
        return found

    @cached_property
    def _scene_up(self) -> dict[str, np.ndarray]:
        """World up by scene from user-set posed frames; the last setting counts."""
        poses = {frame_id: or_note([], "", load_pose, self.inner, frame_id) for frame_id in self.frame_up}
        posed = [(frame_id, pose) for frame_id, pose in poses.items() if pose is not None]
        return {scene_of(self.inner, i): pose[:3, :3] @ np.asarray(self.frame_up[i]) for i, pose in posed}

    def changed(self, frame: Frame) -> Frame:
        """Frame with the user-set up vector."""
        camera, settings, notes = self._camera(frame), self.settings, frame.notes
        if camera is frame.camera:
            if camera.up is None and (self.up is not None or settings.world_up is not None):
                which = f"up {self.up}" if self.up is not None else "world_up"
                notes = (*notes, f"{which} is of the world, and this frame has no pose: it is not used")
        elif settings.up is not None and settings.up.frame is None:
            notes = (*notes, f"up {settings.up} is taken as {self.up}")
        return frame.by_camera(camera, (*notes, *self.doubts(frame)))

    def _camera(self, frame: Frame) -> Camera:
        """Camera of a frame with the user-set up, else the dataset's."""
        camera, pose, up = frame.camera, frame.camera.T_world_camera, self.up
        scene_up = self._scene_up.get(scene_of(self.inner, frame.id)) if self.frame_up else None
        if frame.id in self.frame_up:
            return camera.with_up(np.asarray(self.frame_up[frame.id]), "given")
        if pose is not None and scene_up is not None:
            return camera.with_up(pose[:3, :3].T @ scene_up, "given")
        if up is not None and up.frame == "camera":
            return camera.with_up(np.asarray(up.vector), "given")
        if up is not None and pose is not None:
            return camera.with_up(pose[:3, :3].T @ np.asarray(up.vector), "given")
        return self._own(camera)

    def _own(self, camera: Camera) -> Camera:
        """Camera with the dataset's declared up, if any."""
        pose, world_up = camera.T_world_camera, self.settings.world_up
        if world_up is None or pose is None:
            return camera
        return camera.with_up(pose[:3, :3].T @ np.asarray(world_up), "declared")

    def doubts(self, frame: Frame) -> tuple[str, ...]:
        """Evidence in a frame against the user-set up."""
        given, own = self._camera(frame), self._own(frame.camera)
        if given.up is None or given.up_source != "given":
            return ()
        found = []
        off = far_from_level(frame.depth, frame.camera, given.up) if frame.id in self.frame_up else None
        if off is not None:
            found.append(f"the up that was set is {off:.0f} degrees off the level planes of the frame")
        off = 0.0 if own.up is None else float(np.rad2deg(np.arccos(np.clip(given.up @ own.up, -1, 1))))
        if off > FAR_FROM_DECLARED_DEG:
            how = SOURCES[own.up_source or "declared"]
            found.append(f"the up that was set is {off:.0f} degrees off the dataset's own: {how}")
        return tuple(found)


def with_given_up(dataset: Dataset, settings: Settings, level_at: str | None = None) -> Dataset:
    """Dataset with the up of the settings; unchanged without any. `level_at`: "FRAME:U,V", or "U,V" of the first frame:
    the surface at this pixel is level."""
    frame_up = dict(settings.frame_up)
    if level_at is not None:
        key, u, v = parse_level_at(level_at)
        frame = dataset.load(resolve_frame(dataset, 0 if key is None else key))
        x, y, z = level_normal_at(frame.depth, frame.camera, u, v).tolist()
        frame_up.pop(frame.id, None)
        frame_up[frame.id] = (x, y, z)
    if settings.up is None and settings.world_up is None and not frame_up:
        return dataset
    given = UpGiven(dataset, settings, frame_up)
    require(
        settings.up is None or settings.up.frame != "world" or given.posed is not False,
        "up is set in the world, and no frame has a pose in it",
        got=settings.up,
        expected="camera:X,Y,Z, or --level-at U,V",
        path=dataset.root,
    )
    return given


def with_frame_up(dataset: Dataset, frame_id: str, up: Vector) -> UpGiven:
    """Dataset with `up` (camera frame) set for a frame."""
    known = dataset if isinstance(dataset, UpGiven) else UpGiven(dataset, Settings(), {})
    others = {other: v for other, v in known.frame_up.items() if other != frame_id}
    return UpGiven(known.inner, known.settings, {**others, frame_id: up})


def told_up(dataset: Dataset) -> tuple[GivenUp | None, dict[str, Vector]]:
    """User-set up of the dataset and of single frames, for `write_settings`."""
    return (dataset.up, dataset.frame_up) if isinstance(dataset, UpGiven) else (None, {})


def told_doubts(dataset: Dataset) -> dict[str, tuple[str, ...]]:
    """Evidence against the user-set up, by frame."""
    if not isinstance(dataset, UpGiven):
        return {}
    frames = readable_frames(dataset.inner.load, tuple(dataset.frame_up) or dataset.frame_ids[:1])
    return {frame.id: doubts for frame in frames if (doubts := dataset.doubts(frame))}


MAX_VOTERS = 12
"""So many frames of a scene are asked, spread evenly over it."""
AGREE_DEG = 10.0
MIN_AGREEING = 2
VOTE_LEAD = 1.5
"""The winner must have so many times the votes of any other direction."""


@dataclass(frozen=True)
class SceneVote:
    """Vote of the posed frames of a scene on up."""

    scene: str
    up: np.ndarray | None
    """(3,) float64 or None: Unit vector of the world; None where they do not agree, or too few of them say anything."""
    agreeing: int
    voting: int  # Frames that support this up and say nothing else, and frames that say anything
    disagreeing: tuple[tuple[str, float], ...] = ()
    """tuple of (str, float): Frames whose own planes decide for another up, and by how many degrees."""


Voter = tuple[str, np.ndarray, tuple[UpHypothesis, ...]]
"""A frame's id, its R_world_camera (3, 3), and its hypotheses, the best first."""


def vote(scene: str, voters: Sequence[Voter]) -> SceneVote:
    """World direction with the most support by the frames' hypotheses, a vote per frame."""
    certain = [[h for h in found if h.certain] for _, _, found in voters]
    ups = [np.array([R @ h.up for h in found]).reshape(-1, 3) for (_, R, _), found in zip(voters, certain, strict=True)]
    scores = [np.array([h.score for h in found]) for found in certain]
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
    opposed = totals[candidates @ winner <= np.cos(np.deg2rad(2 * AGREE_DEG))]
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
    sure = agreeing >= max(MIN_AGREEING, len(disagreeing) + 1) and totals.max() >= VOTE_LEAD * opposed.max(initial=0.0)
    return SceneVote(scene, up, agreeing, voting, disagreeing) if sure else SceneVote(scene, None, agreeing, voting)


def scene_vote(dataset: Dataset, frame_id: str) -> SceneVote:
    """Vote of a frame's scene, cached per dataset and process. It depends on the scene alone, not on the frame that
    asks, so that every process finds the same. Frames that are broken or have no pose do not vote."""
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
    spread = np.unique(np.linspace(0, len(ids) - 1, min(MAX_VOTERS, len(ids))).astype(int)).tolist()
    for frame in readable_frames(partial(load_picture, dataset), [ids[index] for index in spread]):
        if frame.camera.T_world_camera is not None:
            found = up_hypotheses(frame.depth, frame.camera)
            voters.append((frame.id, frame.camera.T_world_camera[:3, :3], found))
    return voters


def resolved_camera(dataset: Dataset, frame: Frame) -> Camera:
    """Camera of a frame with an up vector; posed frames without up take the scene's."""
    camera = frame.camera
    if camera.untold:
        # Planes of a camera that is only a stand-in are none of the scene's.
        return camera if camera.up is not None else camera.with_up(IMAGE_UP, "assumed")
    if camera.up is not None or camera.T_world_camera is None:
        return resolve_up(frame.depth, camera)
    return resolve_up(frame.depth, camera, scene_vote(dataset, frame.id).up)


def own_disagreement(frame: Frame, vote: SceneVote) -> float | None:
    """Angle, degrees, of a frame's own planes against the scene's up; None without disagreement."""
    T = frame.camera.T_world_camera
    own = None if T is None or vote.up is None else decided(up_hypotheses(frame.depth, frame.camera))
    if own is None or T is None or vote.up is None:
        return None
    angle = _degrees(T[:3, :3] @ own.up, vote.up)
    return angle if angle > AGREE_DEG else None


OFF_SCENE = "degrees off the up of its scene"


def scene_doubt(dataset: Dataset, frame: Frame, camera: Camera) -> str:
    """Disagreement of a frame's planes with the scene's up, in words; "" without any."""
    if camera.T_world_camera is None or camera.up_source not in ("scene", "plane", "assumed"):
        return ""
    vote = scene_vote(dataset, frame.id)
    off = own_disagreement(frame, vote)
    most = f"{vote.agreeing} of {vote.voting} frames that were asked"
    return "" if off is None else f"its own level plane is {off:.0f} {OFF_SCENE}, on which {most} agree"


def _degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1.0, 1.0))))
