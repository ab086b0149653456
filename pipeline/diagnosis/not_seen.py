"""Objects that an answer needs and its frame does not show, though other frames do: told by the map of the scene.

Where the right object is outside the picture or hidden, no detector could have found it, and none is blamed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pipeline.datasets.base import Dataset
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.verdict import NOT_SEEN, Diagnosis, Unseen
from pipeline.geometry.camera import to_world
from pipeline.language.naming import match, same_class
from pipeline.scenes.map_files import read_maps
from pipeline.scenes.object_map import ObjectMap, WorldObject
from pipeline.system.frozen import dataclass

NEAREST = 3
"""So many of the frames that see an object are named."""
SLACK_M = 0.1
"""A labelled centre so far from the places of an object of the map is still its own: a map knows surfaces."""


@dataclass(frozen=True)
class SceneMaps:
    """Object maps by scene, by which verdicts tell what a frame does not show."""

    maps: Mapping[str, ObjectMap]

    @cached_property
    def of_frame(self) -> dict[str, ObjectMap]:
        """Map by joined frame."""
        return {frame_id: made for made in self.maps.values() for frame_id in made.frame_ids}

    def judged(self, d: Diagnosis) -> Diagnosis:
        """Verdict NOT-SEEN in place of one that blames the detector for an object that is not in view; else the same.

        The right objects are those of the map whose sighting is the labelled one, or at whose place it is labelled.
        """
        made = self.of_frame.get(d.truth.frame)
        if made is None or d.missed is None or d.missed_name is None:
            return d
        found = [_labelled(made, d, int(k), d.missed_name) for k in _wanted(d)]
        unseen = _unseen(made, d.truth.frame, d.missed_name, [o for each in found for o in each])
        return d if unseen is None or not all(found) else not_seen(d, unseen)

    def answered(self, found: Answer) -> Answer:
        """Answer with the verdict NOT-SEEN, where one applies.

        Where no truth of the frame judges it, a name decides of which the map has objects, and the frame shows none.
        """
        if found.diagnosis is not None:
            return replace(found, diagnosis=self.judged(found.diagnosis))
        trace = found.trace
        made = None if trace is None else self.of_frame.get(trace.frame.id)
        if trace is None or made is None:
            return found
        labels = tuple(dict.fromkeys(o.label for o in made.objects))
        # Where nothing is known of the truth, a thing that was found may be one that the map lacks.
        for name in trace.missing if found.unjudged is None else trace.query.labels:
            meant = match(name, labels)
            unseen = _unseen(made, trace.frame.id, name, [o for o in made.objects if o.label in meant])
            if unseen is not None:
                return replace(found, unseen=unseen)
        return found


def not_seen(d: Diagnosis, unseen: Unseen) -> Diagnosis:
    """Verdict NOT-SEEN in place of one that blames the detector; the same where none is blamed."""
    if d.missed is None:
        return d
    d = replace(d, verdict=NOT_SEEN, detail=unseen.detail, missed=None, needed_score=None, unseen=unseen)
    return replace(d, story=unseen.story("right"))


def answer_unseen(found: Answer, unseen: Unseen | None) -> Answer:
    """Answer with the verdict NOT-SEEN by evidence that was kept, where it still lacks what is not in view."""
    d = found.diagnosis
    if unseen is None or (d is None and found.trace is None):
        return found
    if d is not None:
        return replace(found, diagnosis=not_seen(d, unseen))
    return replace(found, unseen=unseen)


def open_scene_maps(folder: str | Path, dataset: Dataset | None = None) -> SceneMaps:
    """Read the maps of a folder that `spatialviz map` wrote, of a dataset if told; errors as of `read_maps`."""
    return SceneMaps(read_maps(Path(folder), dataset))


def _wanted(d: Diagnosis) -> np.ndarray:
    """Labelled objects of the missing role that would have been right, (K,) int64."""
    if d.verdict == "OPM-TARGET":
        return d.case.acceptable
    return np.flatnonzero(d.truth.acceptable_pairs(d.case).any(axis=0))


def _labelled(made: ObjectMap, d: Diagnosis, k: int, name: str) -> list[WorldObject]:
    """Objects of the map that a labelled one may be: its sighting, else those of its name at its place."""
    own = made.of_object(d.truth.frame, int(d.truth.numbers[k]))
    if own is not None and same_class(own.label, name):
        return [own]
    if "center" not in d.truth.geometry:
        return []
    center = to_world(d.truth.geometry["center"][k][None], made.poses[d.truth.frame])[0]
    there = [o for o in made.objects if (abs(center - np.clip(center, o.low, o.high)) <= SLACK_M).all()]
    return [o for o in there if same_class(o.label, name)]


def _unseen(made: ObjectMap, frame_id: str, name: str, objects: Sequence[WorldObject]) -> Unseen | None:
    """Evidence that a frame shows none of these objects, and others do; of the one that most frames see."""
    found = [o for o in objects if o.numbers]
    if not found or any(o.presence.get(frame_id) not in ("out", "hidden") for o in objects):
        return None
    own = max(found, key=lambda o: len(o.numbers))
    here = made.poses[frame_id][:3, 3]
    frames = sorted(own.numbers, key=lambda other: float(np.linalg.norm(made.poses[other][:3, 3] - here)))
    # What was meant may be called otherwise here: what is said is of the thing.
    name = name if same_class(own.label, name) else own.label
    return Unseen(name, own.id, own.presence[frame_id].upper(), tuple(frames[:NEAREST]))
