"""Objects shown with an answer, each with its name: all of the frame, and those found by the question alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from pipeline.answering.ask import Trace
from pipeline.answering.frame_store import LoadedFrame
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair


@dataclass(frozen=True)
class ShownObjects:
    """Objects of a view: all of the frame, and those found by the question alone."""

    objects: tuple[SceneObject, ...]
    # "mug·3": the class and the place in the list (the dataset's own where the objects are the dataset's).
    names: tuple[str, ...]
    place: Mapping[int, int]  # place in the trace's objects -> place in `objects`

    def in_roles(self, trace: Trace, pair: ScoredPair) -> ShownObjects:
        """Objects with each of a pair under the name and the score of its role.

        A detector may take the same object for a mug and, less surely, for a laptop; its number stays.
        """
        objects = list(self.objects)
        for i, name in trace.names_in(pair).items():
            objects[self.place[i]] = trace.under(name, i)
        return replace(self, objects=tuple(objects), names=_named(objects, trace.exact))


NOTHING = ShownObjects((), (), {})
"""Of a broken frame."""


def shown_objects(loaded: LoadedFrame, trace: Trace | None, exact: bool, before: Trace | None = None) -> ShownObjects:
    """Objects of a frame, then those found by the question's own detector runs alone.

    An object found under several names has its surest name, until looked at as a part of a pair
    (`ShownObjects.in_roles`). An object taken out by an edit keeps its name of the answer `before`.
    """
    objects = list(loaded.objects)
    by_id = {o.id: i for i, o in enumerate(objects) if o.id >= 0}
    for _, entry in () if before is None else _most_surely(before):
        if entry.id in by_id:
            objects[by_id[entry.id]] = entry
    place: dict[int, int] = {}
    for i, entry in () if trace is None else _most_surely(trace):
        at = place[i] = by_id.get(entry.id, len(objects))
        objects[at : at + 1] = [entry]
    return ShownObjects(tuple(objects), _named(objects, exact), place)


def _most_surely(trace: Trace) -> Iterator[tuple[int, SceneObject]]:
    """Places of a trace's objects, each with its object under its surest name."""
    best: dict[int, tuple[float, SceneObject]] = {}
    for name, found in trace.candidates.items():
        for i, score in zip(found.index.tolist(), found.scores.tolist(), strict=True):
            number = trace.objects[i].id
            key = number if number >= 0 else -1 - i
            if key not in best or score > best[key][0]:
                best[key] = score, trace.under(name, i)
    for i, entry in enumerate(trace.objects):
        yield i, best.get(entry.id if entry.id >= 0 else -1 - i, (0.0, entry))[1]


def _named(objects: list[SceneObject], exact: bool) -> tuple[str, ...]:
    return tuple(o.name(i, exact) for i, o in enumerate(objects))
