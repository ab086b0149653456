"""Instances of labelled objects: their ids in the object maps of their scenes, and their whole boxes there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.datasets.base import Dataset
from pipeline.geometry.masks import LazyMask
from pipeline.geometry.viewer import ViewerAxes
from pipeline.proposals.base import Detector
from pipeline.scenes.map_files import read_maps
from pipeline.scenes.object_map import ObjectMap
from pipeline.scenes.world_boxes import seen_by
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

_UNPAINTED = np.zeros((0, 0), np.bool_)


@dataclass(frozen=True)
class Instances:
    """By frame and number of a labelled object, its id in the scene."""

    of_frame: Mapping[str, Mapping[int, int]]
    maps: Mapping[str, ObjectMap] = field(default_factory=dict)
    """By joined frame, its scene's."""

    def completed(
        self, frame_id: str, objects: Sequence[SceneObject], exact: bool, viewer: ViewerAxes
    ) -> tuple[SceneObject, ...]:
        """Objects of a frame with the whole boxes of their scene, where several of its views tell of them."""
        if (made := self.maps.get(frame_id)) is None:
            return tuple(objects)
        ids, out = self.of_frame.get(frame_id, {}), []
        for place, entry in enumerate(objects):
            whole = made.boxes.get(ids.get(entry.id if exact else place, -1))
            if whole is not None and whole.views > 1 and entry.box is not None:
                whole = replace(seen_by(whole, made.poses[frame_id], viewer), seen=entry.box)
                entry = LazyMask.held_by(replace(entry, mask=_UNPAINTED, whole=whole), entry.held)
            out.append(entry)
        return tuple(out)


def open_instances(folder: str, detector: Detector, dataset: Dataset) -> Instances:
    """Read the maps of a folder; InputError for none, for another dataset's, or another detector's objects."""
    found: dict[str, dict[int, int]] = {}
    maps: dict[str, ObjectMap] = {}
    for scene, made in read_maps(Path(folder), dataset).items():
        # What follows the bar is of masks, and changes no numbers.
        by, own = (text.partition("|")[0] for text in (made.settings.get("detector", ""), detector.fingerprint()))
        require(by == own, f"the map of {scene} is of another detector's objects", got=by, expected=own, path=folder)
        maps |= dict.fromkeys(made.frame_ids, made)
        for entry in made.objects:
            for frame_id, number in entry.numbers.items():
                found.setdefault(frame_id, {})[number] = entry.id
    return Instances(found, maps)
