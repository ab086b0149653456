"""The objects that are shown with an answer, each with its name: all of the frame, and what only the question found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.frame_store import LoadedFrame
from pipeline.answering.objects import SceneObject
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.rerun import Outcome


@dataclass(frozen=True)
class Shown:
    """The objects that somebody looks at: all of the frame, and those only the question found.

    Attributes
    ----------
    objects : tuple of SceneObject
    names : tuple of str
        "mug·3": the class and the place in the list (the dataset's own where the objects are the dataset's).
    place : dict of int to int
        Place in the trace's objects -> place in `objects`.
    """

    objects: tuple[SceneObject, ...]
    names: tuple[str, ...]
    place: Mapping[int, int]


NOTHING = Shown((), (), {})
"""Of a broken frame."""


def shown_objects(loaded: LoadedFrame, trace: Trace | None, exact: bool, before: Trace | None = None) -> Shown:
    """All objects of a frame, then those that only the question's own detector runs found.

    What an edit took out of the question keeps the name that the answer `before` gave it.
    """
    objects = list(loaded.objects)
    by_id = {o.id: i for i, o in enumerate(objects) if o.id >= 0}
    for entry in () if before is None else before.objects:
        if entry.id in by_id:
            objects[by_id[entry.id]] = entry
    place: dict[int, int] = {}
    for i, entry in enumerate(() if trace is None else trace.objects):
        at = place[i] = by_id.get(entry.id, len(objects))
        # The question's name and score are those the answer was made with.
        objects[at : at + 1] = [entry]
    return Shown(tuple(objects), tuple(o.name(i, exact) for i, o in enumerate(objects)), place)


def with_confidences(shown: Shown, edits: Edits, outcome: Outcome) -> Shown:
    """The objects with the scores that edits give them under the name they go by."""
    objects = list(shown.objects)
    for (name, key), p in edits.confidences.items():
        candidates = outcome.trace.candidates.get(name)
        if candidates is not None and key in outcome.keys:
            at = outcome.keys.index(key)
            place, here = shown.place[at], np.flatnonzero(candidates.index == at)
            if len(here) and candidates.labels[here[0]] == objects[place].label:
                objects[place] = replace(objects[place], score=p)
    return replace(shown, objects=tuple(objects))
