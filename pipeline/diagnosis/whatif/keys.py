"""Stable names of objects: they mean the same detection after a change of K, of a threshold, of an edit.

"#12" is the detection with the detector's own identity 12. Where the detector
has none, "chair/3" is the third best by score of all it found when asked for
"chair", before anything is suppressed or cut off. The first kind has no slash
and the second always has one, so that no name can be mistaken for another.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.proposals.base import Proposals
from pipeline.system.errors import InputError


def detection_keys(name: str, found: Proposals) -> tuple[str, ...]:
    """The key of each detection of a run for one class name, in the run's order.

    Parameters
    ----------
    name : str
        As it was asked.
    found : Proposals
        All of the run.
    """
    place = np.empty(len(found), np.int64)
    place[np.argsort(-found.scores, kind="stable")] = np.arange(1, len(found) + 1)
    return tuple(
        f"#{number}" if number >= 0 else f"{name}/{at}" for number, at in zip(found.ids.tolist(), place, strict=True)
    )


def object_keys(trace: Trace, found: Mapping[str, Proposals]) -> tuple[str, ...]:
    """The key of each object of a trace that was answered without edits, in the order of `trace.objects`.

    Parameters
    ----------
    found : mapping of str to Proposals
        The detector's whole run for each name of the expression.

    Raises
    ------
    InputError
        The trace is of other detections.
    """
    keys: list[str | None] = [f"#{o.id}" if o.id >= 0 else None for o in trace.objects]
    for name, candidates in trace.candidates.items():
        names, proposals = detection_keys(name, found[name]), found[name]
        taken: set[int] = set()
        for at in candidates.index.tolist():
            if keys[at] is not None:
                continue
            entry = trace.objects[at]
            alike = (proposals.boxes == entry.bbox).all(axis=1) & (proposals.scores == np.float32(entry.score))
            places = [k for k in np.flatnonzero(alike).tolist() if k not in taken]
            if not places:
                raise InputError(f"the trace has an object {name!r} that is not among these detections")
            taken.add(places[0])
            keys[at] = names[places[0]]
    if any(key is None for key in keys):
        raise InputError("the trace has an object that is no candidate of any name")
    return tuple(key for key in keys if key is not None)
