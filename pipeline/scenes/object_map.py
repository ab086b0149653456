"""Object map of a scene: world objects with names by vote, and where each is seen, hidden, or missing.

Frames come in one after the other, and the same frames always give the same map; memory is that of the scene's
surfaces. Frames whose pose does not fit the others are reported and left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from pipeline.answering.objects import prepare_frame
from pipeline.answering.pipeline import Pipeline
from pipeline.scenes.joining import Join, Joining, seen_objects
from pipeline.scenes.poses import PoseAgreement, agreement, compared, fits, misfits
from pipeline.scenes.views import View, Visibility
from pipeline.scenes.voxels import Voxels
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

Presence = Literal["seen", "hidden", "out", "missed", "gone"]
"""Of an object in a frame: found; behind something or where nothing was measured; outside the picture; its surface is
seen, and nothing was found there; the place is looked through: it stood there at another time."""
LEAST_IN_VIEW, LEAST_SURFACE, MOST_THROUGH = 0.1, 0.3, 0.5
"""Shares of an object's places: in view for it to be expected; on a surface for it to be missed; looked through for it
to be gone."""


@dataclass(frozen=True)
class WorldObject:
    """One object of a scene, in all frames."""

    id: int
    label: str  # By vote
    votes: Mapping[str, float]  # Summed scores by class name
    numbers: Mapping[str, int]  # By frame that it is found in, the frame's own number of it
    presence: Mapping[str, Presence]  # By frame
    center: tuple[float, float, float]  # Of its seen places, world, metres
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    places: int  # Number of its voxels

    @property
    def state(self) -> Literal["static", "moved", "doubtful"]:
        """Tell an object that some frame looks through, and one that a single frame shows where others should."""
        if "gone" in self.presence.values():
            return "moved"
        missed = sum(p == "missed" for p in self.presence.values())
        return "doubtful" if missed > len(self.numbers) else "static"


@dataclass(frozen=True, eq=False)
class SceneMap:
    """World objects of a scene, the evidence of each join, and the frames that were left out."""

    scene: str
    frame_ids: tuple[str, ...]  # That were joined
    objects: tuple[WorldObject, ...]
    joins: tuple[Join, ...]
    agreements: tuple[PoseAgreement, ...]
    left_out: Mapping[str, str]  # By frame, the reason
    voxels: Voxels

    def of_object(self, frame_id: str, number: int) -> WorldObject | None:
        """The object that a frame calls by a number; None for a frame or number without one."""
        return next((o for o in self.objects if o.numbers.get(frame_id) == number), None)


def map_scene(
    pipeline: Pipeline,
    scene: str,
    frame_ids: Iterable[str],
    poses: Mapping[str, np.ndarray] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> SceneMap:
    """Join the objects of a scene's posed frames; `poses` replace those that are declared.

    >>> from pipeline.answering.pipeline import open_pipeline
    >>> from pipeline.scenes.object_map import map_scene
    >>> from pipeline.scenes.views import posed_frames
    >>> demo = open_pipeline("demo")
    >>> made = map_scene(demo, "000001", posed_frames(demo.dataset, "000001/000000"))
    >>> made.of_object("000001/000000", 2).label
    'laptop'
    """
    ids, left_out = tuple(frame_ids), {}
    views: dict[str, View] = {}
    for frame_id in ids:
        try:
            views[frame_id] = View.of(pipeline.dataset.load(frame_id), (poses or {}).get(frame_id))
        except InputError as error:
            left_out[frame_id] = str(error)
    found = tuple(agreement(*(list(views.values())[k] for k in pair)) for pair in compared(len(views)))
    best = fits(found)
    least = misfits(list(best.values()))
    joining, used = Joining(), list[str]()
    for done, (frame_id, view) in enumerate(views.items()):
        progress(done, len(views))
        if best.get(frame_id, 1.0) < least:
            left_out[frame_id] = (
                f"its pose does not fit the other frames: surfaces agree by {best[frame_id]:.2f}, usual is {least:.2f} and more"
            )
            continue
        prepared = prepare_frame(pipeline.dataset, pipeline.dataset.load(frame_id), pipeline.config.lift)
        joining.add(view, seen_objects(pipeline, prepared))
        used.append(frame_id)
    joining.merged()
    objects = _objects(joining, [views[i] for i in used])
    return SceneMap(scene, tuple(used), objects, tuple(joining.joins), found, left_out, joining.voxels)


def _objects(joining: Joining, views: Sequence[View]) -> tuple[WorldObject, ...]:
    numbers: dict[int, dict[str, int]] = {k: {} for k in joining.votes}
    for join in joining.joins:
        numbers[join.object_id][join.frame_id] = join.number
    out = []
    for k in sorted(joining.votes):
        places = joining.voxels.of(k)
        presence = {v.frame_id: "seen" if v.frame_id in numbers[k] else presence_of(v, places) for v in views}
        low, high, center = (
            tuple(np.round(f(places, axis=0), 4).tolist()) if len(places) else (0.0, 0.0, 0.0)
            for f in (np.min, np.max, np.mean)
        )
        votes = dict(joining.votes[k].most_common())
        out.append(WorldObject(k, joining.name(k), votes, numbers[k], presence, center, low, high, len(places)))
    return tuple(out)


def presence_of(view: View, places: np.ndarray) -> Presence:
    """Presence in a view of an object that is not found there, by its places, (N, 3), world, metres."""
    counts = np.bincount(view.at(*view.project(places)), minlength=len(Visibility))
    inside = len(places) - counts[Visibility.OUT]
    if inside < max(1, LEAST_IN_VIEW * len(places)):
        return "out"
    if counts[Visibility.THROUGH] > MOST_THROUGH * inside:
        return "gone"
    return "missed" if counts[Visibility.SEEN] > LEAST_SURFACE * inside else "hidden"


def map_record(made: SceneMap) -> dict[str, Any]:
    """JSON-able record of a map: `objects`, `frames`, `left_out`, and `poses`, the agreement of each compared pair."""
    return {
        "scene": made.scene,
        "frames": list(made.frame_ids),
        "objects": [
            {
                "id": o.id,
                "label": o.label,
                "state": o.state,
                "votes": {name: round(score, 4) for name, score in o.votes.items()},
                "frames": dict(o.numbers),
                "presence": dict(o.presence),
                "center": list(o.center),
                "low": list(o.low),
                "high": list(o.high),
            }
            for o in made.objects
        ],
        "joins": [
            {
                "frame": j.frame_id,
                "number": j.number,
                "object": j.object_id,
                "new": j.new,
                "iou": round(j.iou, 4),
                "second": round(j.second, 4),
                "known": round(j.known, 4),
                "same_name": j.same_name,
                "doubtful": j.doubtful,
            }
            for j in made.joins
        ],
        "poses": [
            {
                "frames": [p.one, p.other],
                "agree": None if p.agree is None else round(p.agree, 4),
                "shared": round(p.shared, 4),
            }
            for p in made.agreements
        ],
        "left_out": dict(made.left_out),
        "names": dict(Counter(o.label for o in made.objects)),
    }
