"""Pair of an answer under the asked relation: the target's place in the region, and its verdict."""

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
    """Pair of a region: "target RELATION reference", in the judged order."""

    trace: Trace
    ends: tuple[int, int]  # Target and reference, indices in the trace's objects
    profile: Profile  # The rule's thresholds, edited or not

    @property
    def _lifted(self) -> tuple[LiftedObject, LiftedObject]:
        a, b = self.ends
        return self.trace.objects[a].lifted, self.trace.objects[b].lifted

    @property
    def region(self) -> Region | None:
        """Region of the relation; None for a reference without 3D extents."""
        target, reference = self._lifted
        try:
            size = target.hi - target.lo
            return region_of(reference, self.trace.relation, size, self.trace.viewer, self.profile, REACH)
        except InputError:
            return None

    @property
    def placement(self) -> Placement:
        """Place of the target in the region, by the rule, with the reason."""
        return place_in_region(*self._lifted, self.trace.relation, self.trace.viewer, self.profile)

    @property
    def middle(self) -> np.ndarray:
        """(3,) middle of the target's extents, camera frame, metres; not finite without 3D extents."""
        target, _ = self._lifted
        return self.trace.viewer.matrix.T @ (target.lo + target.hi) / 2

    @property
    def region_key(self) -> tuple[object, ...]:
        """Cache key of the region, to a tenth of a millimetre: unchanged for a moved target."""
        target, reference = self._lifted
        ends = (tuple(np.round(v, 4).tolist()) for v in (reference.lo, reference.hi, target.hi - target.lo))
        return self.trace.relation, *ends, self.trace.viewer.matrix.tobytes(), self.profile


def asked_pair(trace: Trace, pair: ScoredPair | None, edits: Edits) -> AskedPair | None:
    """Ranked pair under the asked relation; None for a relation of more or fewer than two objects."""
    if pair is None or pair.reference is None or trace.relation not in PAIRWISE:
        return None
    ends = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    return AskedPair(trace, ends, replace(Profile(), **edits.profile))
