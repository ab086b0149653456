"""One pair of an answer under the relation that was asked: where in its region the target falls, and what that is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.placement import Placement, place_in_region
from pipeline.diagnosis.whatif.region import Region, region_of
from pipeline.geometry.lifting import LiftedObject
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import Profile
from pipeline.system.errors import InputError

REACH = 1.0
"""Metres around the reference that a region is drawn for."""


@dataclass(frozen=True)
class AskedPair:
    """What a region is of: "target RELATION reference", in the order in which it is judged."""

    trace: Trace
    ends: tuple[int, int]  # Target and reference, indices in the trace's objects
    profile: Profile  # The rule's thresholds, edited or not

    @property
    def _lifted(self) -> tuple[LiftedObject, LiftedObject]:
        a, b = self.ends
        return self.trace.objects[a].lifted, self.trace.objects[b].lifted

    @property
    def region(self) -> Region | None:
        """Where the relation holds; None where the reference has no place in space."""
        target, reference = self._lifted
        try:
            size = target.hi - target.lo
            return region_of(reference, self.trace.relation, size, self.trace.viewer, self.profile, REACH)
        except InputError:
            return None

    @property
    def placement(self) -> Placement:
        """Where the target falls in it, by the rule, and why."""
        return place_in_region(*self._lifted, self.trace.relation, self.trace.viewer, self.profile)

    @property
    def middle(self) -> np.ndarray:
        """(3,) the middle of the target's extents, camera frame, metres; not finite where it has no place in space."""
        target, _ = self._lifted
        return self.trace.viewer.matrix.T @ (target.lo + target.hi) / 2

    @property
    def region_key(self) -> tuple[object, ...]:
        """What the region depends on, to a tenth of a millimetre: a target that is only moved keeps it."""
        target, reference = self._lifted
        ends = (tuple(np.round(v, 4).tolist()) for v in (reference.lo, reference.hi, target.hi - target.lo))
        return self.trace.relation, *ends, self.trace.viewer.matrix.tobytes(), self.profile


def asked_pair(trace: Trace, pair: ScoredPair | None, edits: Edits) -> AskedPair | None:
    """A ranked pair under the asked relation; None where the relation is not of two objects."""
    if pair is None or pair.reference is None or trace.relation not in PAIRWISE:
        return None
    ends = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    return AskedPair(trace, ends, replace(Profile(), **edits.profile))
