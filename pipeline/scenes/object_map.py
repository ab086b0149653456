"""Object map of a scene: world objects with names by vote, and where each is seen, hidden, or missing.

Frames come in one after the other, and the same frames always give the same map, whether at once or in several goes;
memory is that of the scene's surfaces. Frames whose pose does not fit the others are reported and left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from pipeline.answering.objects import prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.whole_boxes import CompletedBox
from pipeline.datasets.base import load_pose
from pipeline.language.noun_phrase import same_names
from pipeline.scenes.joining import Join, Joining, elected, seen_objects, vote
from pipeline.scenes.pose_fit import SceneViews, bad_poses
from pipeline.scenes.poses import PoseAgreement, Refinement
from pipeline.scenes.views import PosedView, Visibility
from pipeline.scenes.voxels import Voxels
from pipeline.scenes.world_boxes import ViewBox, joined_box
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

Presence = Literal["seen", "hidden", "out", "missed", "gone"]
"""Of an object in a frame: found; behind something or where nothing was measured; outside the picture; its surface is
seen, and nothing was found there; the place is looked through: it stood there at another time."""
LEAST_IN_VIEW, LEAST_SURFACE, MOST_THROUGH = 0.25, 0.3, 0.5
"""Shares of an object's places: in view for it to be expected; on a surface for it to be missed; looked through for it
to be gone."""
MOST_CONTRADICTED, LEAST_DECIDED = 0.65, 0.2
"""Share of an object's places on a surface or looked through that are looked through, above which it is doubtful: it
was moved a little, or its mask or a pose is wrong. At least the second share of what is in view decides."""
CHANCE = {"gone": 0.02, "contradicted": 0.05}
"""Shares of the frames that have an object in view, up to which they are chance."""
PLACES = 400
"""So many places of an object are looked for in each frame."""
Progress = Callable[[str, int, int], None]
"""Called with a step's name, frames done, and frames in all."""


@dataclass(frozen=True)
class WorldObject:
    """One object of a scene, in all frames."""

    id: int
    label: str  # By vote
    votes: Mapping[str, float]  # Summed scores by class name
    numbers: Mapping[str, int]  # By frame that it is found in, the frame's own number of it
    presence: Mapping[str, Presence]  # By joined frame
    center: tuple[float, float, float]  # Of its seen places, world, metres
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    places: int  # Number of its voxels
    contradicted: int  # Frames that look through more than `MOST_CONTRADICTED` of its decided places
    other_place: int | None = None  # Id of the same thing at its other place, where it was moved

    @property
    def state(self) -> Literal["static", "moved", "doubtful"]:
        """Tell an object whose place frames look through, and one that more miss than find, or that frames contradict.

        Of many frames a few are chance.
        """
        count = Counter(self.presence.values())
        in_view = sum(count.values()) - count["out"]
        doubtful = count["missed"] > len(self.numbers) or self.contradicted > CHANCE["contradicted"] * in_view
        return "moved" if count["gone"] > CHANCE["gone"] * in_view else "doubtful" if doubtful else "static"


@dataclass(frozen=True, eq=False)
class ObjectMap:
    """World objects of a scene, the evidence of each join, and the frames that were left out."""

    scene: str
    settings: Mapping[str, str]  # What the map depends on beside the frames
    listed: tuple[str, ...]  # All frames that were looked at, in order
    declared: Mapping[str, np.ndarray]  # Pose T_world_camera (4, 4) by readable frame, as the dataset has it
    poses: Mapping[str, np.ndarray]  # As used
    agreements: tuple[PoseAgreement, ...]
    refinements: tuple[Refinement, ...]
    left_out: Mapping[str, str]  # By frame, the reason
    joining: Joining  # Sightings and voxels with the ids of before objects were joined at the end
    objects: tuple[WorldObject, ...]

    @property
    def frame_ids(self) -> tuple[str, ...]:
        """Frames that were joined, in order."""
        return tuple(i for i in self.listed if i not in self.left_out)

    @cached_property
    def joins(self) -> tuple[Join, ...]:
        """Evidence of each sighting, in order."""
        ids = self.joining.merged()
        return tuple(replace(join, object_id=ids[join.object_id]) for join in self.joining.joins)

    @cached_property
    def voxels(self) -> Voxels:
        """Places of the objects, by their ids, and of the background."""
        return self.joining.voxels.renamed(self.joining.merged())

    @cached_property
    def up(self) -> np.ndarray:
        """Up of the scene, (3,), world: the mean over its objects' boxes in all frames; NaN without any."""
        ups = [-box.box.R[:, 1] for box in self.joining.boxes if box is not None]
        up = np.mean(ups, axis=0) if ups else np.full(3, np.nan)
        return up / np.linalg.norm(up)

    @cached_property
    def boxes(self) -> Mapping[int, CompletedBox]:
        """Whole boxes by object, world: joined of all views that see it."""
        views: dict[int, list[ViewBox]] = {}
        for join, box in zip(self.joins, self.joining.boxes, strict=True):
            if box is not None:
                views.setdefault(join.object_id, []).append(box)
        return {k: joined_box(own, self.voxels.of(k), self.up) for k, own in views.items()}

    def of_object(self, frame_id: str, number: int) -> WorldObject | None:
        """The object that a frame calls by a number; None for a frame or number without one."""
        return next((o for o in self.objects if o.numbers.get(frame_id) == number), None)


def map_scene(
    pipeline: Pipeline,
    scene: str,
    frame_ids: Iterable[str],
    known: ObjectMap | None = None,
    refined: bool = False,
    progress: Progress = lambda what, done, total: None,
) -> ObjectMap:
    """Join the objects of a scene's posed frames, in the dataset's order.

    Parameters
    ----------
    known : ObjectMap, optional
        A map of the first of these frames, which is gone on from where dataset, poses and detector are the same.
    refined : bool
        Use refined poses where the views agree better with them.

    >>> from pipeline.answering.pipeline import open_pipeline
    >>> from pipeline.scenes.object_map import map_scene
    >>> from pipeline.scenes.views import posed_frames
    >>> demo = open_pipeline("demo")
    >>> made = map_scene(demo, "000001", posed_frames(demo.dataset, "000001/000000"))
    >>> made.of_object("000001/000000", 2).label
    'laptop'
    """
    dataset, listed = pipeline.dataset, tuple(frame_ids)
    settings = {
        "detector": pipeline.needed_detector().fingerprint(),
        "lift": repr(pipeline.config.lift),
        "poses": "refined" if refined else "declared",
    }
    if known is not None and not _continued(pipeline, known, listed, settings):
        known = None
    posed = SceneViews(dataset, refined)
    unread: dict[str, str] = {}
    joining, tried = Joining(), set[str]()
    before: Mapping[str, str] = {}
    if known is not None:
        posed.declared, posed.poses = dict(known.declared), dict(known.poses)
        posed.agreements, before = list(known.agreements), bad_poses(known.agreements)
        posed.refinements = [r for r in known.refinements if refined]
        unread = {i: reason for i, reason in known.left_out.items() if i not in before}
    for done, frame_id in enumerate(listed):
        progress("comparing poses", done, len(listed))
        if known is None or frame_id not in known.listed:
            try:
                posed.add(frame_id)
            except InputError as error:
                unread[frame_id] = str(error)
    bad = bad_poses(posed.agreements)
    lift = replace(pipeline.config.lift, box="upright", boxes="completed")
    if known is not None and before.keys() == bad.keys() & set(known.listed):
        joining, tried = known.joining.copied(), set(known.listed)
    for done, frame_id in enumerate(listed):
        progress("joining objects", done, len(listed))
        if frame_id in posed.poses and frame_id not in {*bad, *tried}:
            try:
                frame = dataset.load(frame_id)
                objects = seen_objects(pipeline, prepare_frame(dataset, frame, lift), posed.poses[frame_id])
                joining.add(PosedView.of(frame, posed.poses[frame_id]), objects)
            except InputError as error:
                unread[frame_id] = str(error)
    left_out = {i: {**bad, **unread}[i] for i in listed if i in bad or i in unread}
    used = [i for i in listed if i not in left_out]
    objects = _objects(joining, used, posed, progress)
    offered = posed.refinements if refined else [r for i in bad if (r := posed.refinement(i, used)) is not None]
    return ObjectMap(
        scene,
        settings,
        listed,
        posed.declared,
        posed.poses,
        tuple(posed.agreements),
        tuple(offered),
        left_out,
        joining,
        objects,
    )


def _continued(pipeline: Pipeline, known: ObjectMap, listed: Sequence[str], settings: Mapping[str, str]) -> bool:
    """Tell whether a map is of the first of these frames, under the same settings and declared poses."""
    if known.settings != settings or known.listed != listed[: len(known.listed)]:
        return False
    poses = ((load_pose(pipeline.dataset, i), pose) for i, pose in known.declared.items())
    return all(now is not None and np.array_equal(now, pose) for now, pose in poses)


def _objects(joining: Joining, used: Sequence[str], posed: SceneViews, progress: Progress) -> tuple[WorldObject, ...]:
    ids = joining.merged()
    voxels, kept = joining.voxels.renamed(ids), sorted(set(ids.values()))
    numbers: dict[int, dict[str, int]] = {k: {} for k in kept}
    votes: dict[int, dict[str, float]] = {}
    for join in joining.joins:
        numbers[ids[join.object_id]][join.frame_id] = join.number
        vote(votes, ids[join.object_id], join)
    places = {k: voxels.of(k) for k in kept}
    looked_for = [places[k][:: max(1, len(places[k]) // PLACES)] for k in kept]
    presence: dict[int, dict[str, Presence]] = {k: {} for k in kept}
    contradicted = dict.fromkeys(kept, 0)
    for done, frame_id in enumerate(used):
        progress("looking for objects", done, len(used))
        for k, (found, share) in zip(kept, presences(posed.view(frame_id), looked_for), strict=True):
            presence[k][frame_id] = "seen" if frame_id in numbers[k] else found
            contradicted[k] += share > MOST_CONTRADICTED
    out = []
    for k in kept:
        own = places[k] if len(places[k]) else np.zeros((1, 3))
        low, high, center = (tuple(np.round(f(own, axis=0), 4).tolist()) for f in (np.min, np.max, np.mean))
        where = (center, low, high, len(places[k]), contradicted[k])
        out.append(WorldObject(k, elected(votes[k]), votes[k], numbers[k], presence[k], *where))
    return _linked(out)


def _linked(objects: Sequence[WorldObject]) -> tuple[WorldObject, ...]:
    """Link the two places of things that were moved: both are looked through in some frame, of the same name, in no
    frame at once, and like nobody else."""
    moved = [o for o in objects if o.state == "moved"]
    alike = same_names([o.label for o in moved])
    rivals = {
        a.id: [b.id for j, b in enumerate(moved) if i != j and alike[i, j] and not a.numbers.keys() & b.numbers.keys()]
        for i, a in enumerate(moved)
    }
    pairs = {a: found[0] for a, found in rivals.items() if len(found) == 1 and rivals[found[0]] == [a]}
    return tuple(replace(o, other_place=pairs.get(o.id)) for o in objects)


def presences(view: PosedView, objects: Sequence[np.ndarray]) -> list[tuple[Presence, float]]:
    """Presence in a view of objects, by their places, (N, 3) each, world, metres, if they are not found there, and the
    share of their decided places that it looks through."""
    if not objects:
        return []
    found = view.at(*view.project(np.concatenate(objects)))
    owner = np.repeat(np.arange(len(objects)), [len(places) for places in objects])
    kinds = len(Visibility)
    counts = np.bincount(owner * kinds + found, minlength=len(objects) * kinds).reshape(-1, kinds)
    return [_presence(row) for row in counts]


def _presence(counts: np.ndarray) -> tuple[Presence, float]:
    inside = int(counts.sum() - counts[Visibility.OUT])
    if inside <= LEAST_IN_VIEW * counts.sum():
        return "out", 0.0
    through, seen = int(counts[Visibility.THROUGH]), int(counts[Visibility.SEEN])
    share = through / (through + seen) if through + seen > LEAST_DECIDED * inside else 0.0
    if through > MOST_THROUGH * inside:
        return "gone", share
    return "missed" if seen > LEAST_SURFACE * inside else "hidden", share


def map_record(made: ObjectMap) -> dict[str, Any]:
    """JSON-able record of a map: objects, joins, agreement of poses by pair, refinements, frames left out.

    All places are in the frame of "reference", metres; an object's "box" is the whole one, see `CompletedBox.record`.
    """
    boxes = {k: {"R": np.round(box.box.R, 6).tolist(), **box.record()} for k, box in made.boxes.items()}
    return {
        "scene": made.scene,
        "reference": {"frame": "world", "unit": "m", "up": np.round(made.up, 6).tolist() if boxes else None},
        "frames": list(made.frame_ids),
        "objects": [
            {**_plain(o), "state": o.state, "box": boxes.get(o.id)}
            # Without depth it has no place.
            | ({} if o.places else dict.fromkeys(("center", "low", "high")))
            for o in made.objects
        ],
        "joins": [{**_plain(j), "doubtful": j.doubtful} for j in made.joins],
        "poses": [{**_plain(p), "agree": None if p.agree is None else round(p.agree, 4)} for p in made.agreements],
        "refinements": [{**_plain(r), "better": r.better} for r in made.refinements],
        "left_out": dict(made.left_out),
    }


def _plain(thing: Any) -> dict[str, Any]:
    return {name: round(value, 6) if isinstance(value, float) else value for name, value in vars(thing).items()}
