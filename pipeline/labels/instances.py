"""Instances of labelled objects: their ids in the object maps of their scenes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pipeline.proposals.base import Detector
from pipeline.scenes.map_files import read_maps
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class Instances:
    """By frame and number of a labelled object, its id in the scene."""

    of_frame: Mapping[str, Mapping[int, int]]


def open_instances(folder: str, detector: Detector) -> Instances:
    """Read the maps of a folder; InputError for none, or for maps of another detector's objects."""
    found: dict[str, dict[int, int]] = {}
    for scene, made in read_maps(Path(folder)).items():
        # What follows the bar is of masks, and changes no numbers.
        by, own = (text.partition("|")[0] for text in (made.settings.get("detector", ""), detector.fingerprint()))
        require(by == own, f"the map of {scene} is of another detector's objects", got=by, expected=own, path=folder)
        for entry in made.objects:
            for frame_id, number in entry.numbers.items():
                found.setdefault(frame_id, {})[number] = entry.id
    return Instances(found)
