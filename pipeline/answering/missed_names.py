"""What a detector does see in a frame where it does not find what was asked for."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from pipeline.answering.ask import Trace
from pipeline.answering.opening import Pipeline
from pipeline.proposals import Segmented
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class MissedNames:
    """What may help where a name was not found.

    Attributes
    ----------
    below : dict of str to float
        Names that were not found, with the best score below the detector's minimum.
    seen : dict of str to int
        What the detector finds in the frame where it is asked for all that it knows, the commonest first; empty for
        one that knows any name.
    """

    below: dict[str, float]
    seen: dict[str, int]


def missed_names(source: Pipeline, trace: Trace) -> MissedNames:
    """What stands below the detector's minimum score of the names that a trace misses, and what else is there.

    The detector runs again on the frame, once for each missing name and once for everything.

    Raises
    ------
    InputError
        The detector cannot be asked again.
    """
    detector, below = source.needed_detector(), {}
    if isinstance(detector, Segmented):
        # Counting needs no masks.
        detector = detector.detector
    for name in trace.missing if not detector.exact else ():
        scores = source.unfiltered_detector().detect(trace.frame, [name]).scores
        if len(scores):
            below[name] = float(scores.max())
    try:
        found = None if detector.vocabulary is None else detector.detect(trace.frame, None)
    except InputError:
        # Not every detector of a vocabulary can be asked for all of it.
        found = None
    labels = [] if found is None else [found.label(i) for i in range(len(found))]
    return MissedNames(below, dict(Counter(labels).most_common()))
