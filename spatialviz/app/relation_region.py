"""The asked relation of the chosen pair: its region in space, and where its target falls in it. The core computes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnosis.whatif.placement import Placement, place_in_region
from pipeline.diagnosis.whatif.region import Region, region_of
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import Profile
from pipeline.system.errors import InputError
from spatialviz.app.state import State

REACH = 1.0
"""Metres around the reference that are drawn."""


@dataclass(frozen=True)
class AskedPair:
    """What a region is of: "target RELATION reference", in the order in which it is judged.

    Attributes
    ----------
    relation : str
    target, reference : LiftedObject
    places : (int, int)
        In `shown.objects`.
    viewer : ViewerAxes
    profile : Profile
    """

    relation: str
    target: LiftedObject
    reference: LiftedObject
    places: tuple[int, int]
    viewer: ViewerAxes
    profile: Profile

    @property
    def region(self) -> Region | None:
        """Where the relation holds; None where the reference has no place in space."""
        try:
            size = self.target.hi - self.target.lo
            return region_of(self.reference, self.relation, size, self.viewer, self.profile, REACH)
        except InputError:
            return None

    @property
    def placement(self) -> Placement:
        """Where the target falls in it, and why."""
        return place_in_region(self.target, self.reference, self.relation, self.viewer, self.profile)

    @property
    def marks(self) -> tuple[object, ...]:
        """What the region depends on, to a tenth of a millimetre: a target that is only moved keeps it."""
        lengths = (self.reference.lo, self.reference.hi, self.target.hi - self.target.lo)
        ends = (tuple(np.round(v, 4).tolist()) for v in lengths)
        return self.relation, *ends, self.viewer.matrix.tobytes(), self.profile


def asked_pair(state: State) -> AskedPair | None:
    """The chosen pair under the asked relation; None where the relation is not of two objects."""
    trace, pair = state.trace, state.chosen
    if trace is None or pair is None or pair.reference is None or trace.relation not in PAIRWISE:
        return None
    a, b = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    return AskedPair(
        trace.relation,
        trace.objects[a].lifted,
        trace.objects[b].lifted,
        (state.shown.place[a], state.shown.place[b]),
        trace.viewer,
        replace(Profile(), **state.edits.profile),
    )
