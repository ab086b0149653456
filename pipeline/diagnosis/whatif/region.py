"""Region of a relation around its reference, and the place of a pair in it: both by the rule, with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import HORIZONTAL, PAIRWISE
from pipeline.relations.pair_measures import AllMeasures, enclosed_share, in_measures, near_measures, on_measures
from pipeline.relations.relations import Profile, T, known_extents, letter, measure_pairs, pair_margins, pair_states
from pipeline.relations.scorer import stacked_extents
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

Measures = dict[str, float]
CELLS, LEVELS = 120, 201
"""Cells of a region along each side, and levels among which its height is chosen."""
REACH = 1.0
"""Metres around the reference that a region is drawn for; it goes on without end."""


@dataclass(frozen=True)
class RegionPart:
    """Level part of a region, for drawing; camera frame, metres."""

    label: str  # "T" or "U"
    triangles: np.ndarray  # (M, 3, 3) float64: corners
    lines: np.ndarray  # (S, 2, 3) float64: segments of the outline


def region_of(
    reference: LiftedObject,
    relation: str,
    size: np.ndarray,
    viewer: ViewerAxes,
    profile: Profile | None = None,
    reach: float = REACH,
) -> tuple[RegionPart, ...]:
    """Region of "target RELATION reference": centres of a target for which the rule says T, and U.

    A level square of cells, each judged by the rule at its middle: at the height nearest to the reference's middle at
    which a target right over it (or under it) stands in the relation; at the middle itself where none does.

    `relation`: one of PAIRWISE; `size`: (3,) float: the target's extents along (right, up, forward), metres: `hi - lo`
    of its LiftedObject; `reach`: how far beyond the reference it is drawn, metres.
    """
    profile = profile or Profile()
    lo, hi, size = reference.lo, reference.hi, np.asarray(size, np.float64)
    _check_pairwise(relation)
    known = known_extents(lo[None], hi[None]).all() and size.shape == (3,) and np.isfinite(size).all()
    require(known, "the reference or the target has no place in space, and so there is no region", got=size.tolist())
    middle, far = (lo + hi) / 2, (size + hi - lo) / 2 + reach
    levels = middle + np.linspace(-far[1], far[1], LEVELS)[:, None] * [0, 1, 0]
    held = levels[states_at(levels, lo, hi, relation, size, profile) == T]
    height = held[np.abs(held - middle).sum(axis=1).argmin(), 1] if len(held) else middle[1]
    right, forward = (np.linspace(middle[k] - far[k], middle[k] + far[k], CELLS + 1) for k in (0, 2))
    corners = np.stack(np.broadcast_arrays(right, height, forward[:, None]), axis=-1)
    places = (corners[:-1, :-1] + corners[1:, 1:]).reshape(-1, 3) / 2
    state = states_at(places, lo, hi, relation, size, profile).reshape(CELLS, CELLS)
    found = []
    for value in (1, 0):
        cells = np.pad(state == value, 1)
        if cells.any():
            triangles, lines = _drawn(cells, corners @ viewer.matrix)
            found.append(RegionPart(letter(value), triangles, lines))
    return tuple(found)


def states_at(
    places: np.ndarray, lo: np.ndarray, hi: np.ndarray, relation: str, size: np.ndarray, profile: Profile
) -> np.ndarray:
    """States (P,) int8 of "target RELATION reference" by the rule, for a target of a size centred at each place.

    `places`: (P, 3); `lo`, `hi`, `size`: (3,) float64: extents of the reference, and those of the target; all along
    (right, up, forward), metres. Extents stand in for points.
    """
    ends = zip((places - size / 2, places + size / 2), (lo, hi), strict=True)
    both = [np.stack([edge, np.broadcast_to(own, edge.shape)], axis=1) for edge, own in ends]
    surface = np.broadcast_to(both[1][:, None, :, 1], (len(places), 2, 2))
    share = np.zeros(surface.shape)
    share[:, 0, 1] = enclosed_share(-size / 2, size / 2, None, lo - places, hi - places, profile)
    measured = AllMeasures(measure_pairs(both[0], both[1], profile), profile, given=(surface, share))
    return pair_states(measured, np.ones((len(places), 2), np.bool_), (relation,))[:, 0, 1, 0]


def _drawn(cells: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (M, 3, 3) and outline (S, 2, 3) of cells (R + 2, C + 2) bool with an empty border, by their corners."""
    beside, below = (cells[1:-1, 1:] != cells[1:-1, :-1]), (cells[1:, 1:-1] != cells[:-1, 1:-1])
    # Neighbours in a row are one rectangle: its ends come by turns.
    i, j = np.nonzero(beside)
    row, column = i.reshape(-1, 2), j.reshape(-1, 2)
    a, b, c, d = (corners[row[:, 0] + down, column[:, end]] for down, end in ((0, 0), (0, 1), (1, 1), (1, 0)))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    k, m = np.nonzero(below)
    upright = np.stack([corners[i, j], corners[i + 1, j]], axis=1)
    level = np.stack([corners[k, m], corners[k, m + 1]], axis=1)
    return triangles, np.concatenate([upright, level])


def _check_pairwise(relation: str) -> None:
    require(
        relation in PAIRWISE, "there is no region of this relation", got=repr(relation), expected=", ".join(PAIRWISE)
    )


@dataclass(frozen=True)
class Placement:
    """Pair under a relation's rule."""

    relation: str
    state: int  # 1 T, 0 U, -1 F: the rule's own
    why: str  # One sentence
    measures: Measures  # What the rule looked at; names end in `_m` (metres), `_deg` (degrees), else they are shares


def place_in_region(
    target: LiftedObject,
    reference: LiftedObject,
    relation: str,
    viewer: ViewerAxes,
    profile: Profile | None = None,
) -> Placement:
    """Judge "target RELATION reference" by the profile, with the reason."""
    _check_pairwise(relation)
    profile = profile or Profile()
    lo, hi = stacked_extents([target, reference])
    if not known_extents(lo, hi).all():
        return Placement(relation, 0, "One of the two has no place in space: U", {})
    axes = viewer.matrix.T.astype(np.float32)
    measured = AllMeasures(measure_pairs(lo, hi, profile), profile, [o.points @ axes for o in (target, reference)])
    state = int(pair_states(measured, np.ones(2, np.bool_), (relation,))[0, 1, 0])
    why = _horizontal if relation in HORIZONTAL else _REASONS.get(relation, _by_margin)
    measures, reason = why(measured, relation, state)
    return Placement(relation, state, f"{reason}: {letter(state)}", measures)


def _first(*reasons: tuple[bool, str]) -> str:
    """First applicable reason."""
    return next(text for given, text in reasons if given)


def _horizontal(measured: AllMeasures, relation: str, state: int) -> tuple[Measures, str]:
    pairs, profile = measured.pairs, measured.profile
    axis, side = HORIZONTAL[relation]
    gap, delta = pairs.gap[0, 1], pairs.delta[0, 1]
    widest = float(np.abs(gap[[0, 2]]).max())
    by_gap, by_center = _off_axis(gap, axis), _off_axis(delta, axis)
    alpha, read = (by_center, "centres") if widest < profile.gap_switch else (by_gap, "gaps")
    offset, rho = float(side * delta[axis]), float(pairs.overlap_share[0, 1, axis])
    farther = float(np.abs(pairs.center[:, 2]).max())
    deep = max(profile.dead_zone_depth, profile.dead_zone_depth_relative * farther)
    dead, along = (profile.dead_zone, "right") if axis == 0 else (deep, "forward")
    cone, undecided = profile.cone, profile.doubtful_cone
    measures = {
        "alpha_deg": alpha,
        "alpha_by_gaps_deg": by_gap,
        "alpha_by_centres_deg": by_center,
        "gap_right_m": float(gap[0]),
        "gap_forward_m": float(gap[2]),
        "offset_m": offset,
        "dead_zone_m": dead,
        "rho": rho,
        "cone_deg": cone,
        "doubtful_cone_deg": undecided,
    }
    off, overlap = f"{alpha:.0f}° off the axis by {read}", f"The two overlap by {rho:.0%} along {along}"
    return measures, _first(
        (offset <= 0, f"It lies on the other side, by {-offset:.2f} m"),
        (rho >= profile.overlap_excludes, f"{overlap}, {profile.overlap_excludes:.0%} or more"),
        (state < 0, f"{off}, beyond {undecided:g}°"),
        (state > 0, f"{off}, within {cone:g}°"),
        (offset < dead, f"Only {offset:.2f} m to that side, within the dead zone of {dead:.2f} m"),
        (rho >= profile.overlap_doubts, f"{overlap}, {profile.overlap_doubts:.0%} or more"),
        (cone < alpha <= undecided, f"{off}, between {cone:g}° and {undecided:g}°"),
        (True, f"At a gap of {widest:.2f} m gaps ({by_gap:.0f}°) and centres ({by_center:.0f}°) disagree"),
    )


def _off_axis(displacement: np.ndarray, axis: int) -> float:
    """Degrees between a displacement in plan and an axis, by the rule's own formula."""
    angle = float(np.rad2deg(np.arctan2(abs(displacement[2]), abs(displacement[0]))))
    return angle if axis == 0 else 90 - angle


def _vertical(measured: AllMeasures, relation: str, state: int) -> tuple[Measures, str]:
    pairs, profile = measured.pairs, measured.profile
    upper, lower, end = (0, 1, "The target's") if relation == "above" else (1, 0, "The reference's")
    area = pairs.extent[:, 0] * pairs.extent[:, 2]
    plan = float(pairs.overlap[0, 1, 0] * pairs.overlap[0, 1, 2] / area.min())
    clearance = float(pairs.lo[upper, 1] - pairs.hi[lower, 1])
    sink = max(profile.sink, profile.sink_relative * float(pairs.extent[:, 1].min()))
    sideways = float(np.hypot(pairs.gap[0, 1, 0], pairs.gap[0, 1, 2]))
    elevation = float(np.rad2deg(np.arctan2(max(clearance, 0), sideways)))
    offset = float(pairs.delta[upper, lower, 1])
    measures = {
        "plan_overlap": plan,
        "clearance_m": clearance,
        "sink_m": sink,
        "sideways_m": sideways,
        "elevation_deg": elevation,
        "offset_m": offset,
        "dead_zone_m": profile.dead_zone,
    }
    raised = clearance > profile.clear_height
    holds = plan >= profile.plan_overlap or (raised and elevation >= profile.elevation)
    least, more = (profile.plan_overlap, "at least") if state > 0 else (profile.plan_overlap_doubtful, "less than")
    overlap = f"In plan the two overlap by {plan:.0%}"
    return measures, _first(
        (offset <= 0, f"Its centre lies on the other side, by {-offset:.2f} m"),
        (clearance < -sink, f"{end} bottom is {-clearance:.2f} m below the other's top, more than {sink:.2f} m"),
        (
            state == 0 and holds,
            f"Only {offset:.2f} m between the centres, within the dead zone of {profile.dead_zone:.2f} m",
        ),
        (plan >= least, f"{overlap}, {more} {profile.plan_overlap:.0%}"),
        (raised, f"{overlap}, and the line between them rises by {elevation:.0f}°"),
        (True, f"In plan the two overlap by only {plan:.0%}"),
    )


def _on(measured: AllMeasures, _relation: str, state: int) -> tuple[Measures, str]:
    profile = measured.profile
    covered, ratio, gap = (float(m[0, 1]) for m in on_measures(measured))
    touching = max(profile.on_gap, profile.on_gap_relative * float(measured.pairs.extent[0, 1]))
    measures = {"covered": covered, "area_ratio": ratio, "gap_m": gap, "touching_m": touching}
    above, undecided = f"{gap:.2f} m between its bottom and the surface below", profile.on_gap_doubtful
    return measures, _first(
        (
            covered < profile.on_overlap,
            f"{covered:.0%} of its footprint lies over the reference, less than {profile.on_overlap:.0%}",
        ),
        (
            ratio >= profile.on_area_ratio,
            f"Its footprint is {ratio:.1f} times the reference's, too large to stand on it",
        ),
        (state > 0, f"{above}, within {touching:.2f} m"),
        (state == 0, f"{above}, up to {undecided:.2f} m"),
        (gap <= max(touching, undecided), "Each could be on the other, and its middle is not the higher one"),
        (True, f"{above}, more than {undecided:.2f} m"),
    )


def _in(measured: AllMeasures, _relation: str, state: int) -> tuple[Measures, str]:
    profile = measured.profile
    share, below_rim = (float(m[0, 1]) for m in in_measures(measured))
    return {"share": share, "below_rim": below_rim}, _first(
        (
            below_rim < profile.in_below_rim,
            f"It reaches {below_rim:.0%} of its height below the rim, less than {profile.in_below_rim:.0%}",
        ),
        (state > 0, f"{share:.0%} of it lies inside, at least {profile.in_share:.0%}"),
        (state == 0, f"{share:.0%} of it lies inside, less than {profile.in_share:.0%}"),
        (True, f"{share:.0%} of it lies inside, less than {profile.in_share_doubtful:.0%}"),
    )


def _near(measured: AllMeasures, _relation: str, state: int) -> tuple[Measures, str]:
    profile = measured.profile
    gap, mean = (float(m[0, 1]) for m in near_measures(measured.pairs))
    close, undecided = profile.near_diagonals * mean, profile.near_diagonals_doubtful * mean
    between = f"{gap:.2f} m between the two"
    return {"gap_m": gap, "mean_diagonal_m": mean, "near_m": close, "doubtful_m": undecided}, _first(
        (state > 0, f"{between}, within {close:.2f} m"),
        (state == 0, f"{between}, between {close:.2f} m and {undecided:.2f} m"),
        (True, f"{between}, more than {undecided:.2f} m"),
    )


def _by_margin(measured: AllMeasures, relation: str, state: int) -> tuple[Measures, str]:
    """Reason for a relation known by its rule alone."""
    states = pair_states(measured, np.ones(2, np.bool_), (relation,))
    margin = float(pair_margins(measured, states, (relation,))[0, 1, 0])
    sure = {1: f"It holds by {margin:.2f} m", -1: f"It fails by {-margin:.2f} m"}
    return {"margin_m": margin}, sure.get(state, "It is too close to call")


_REASONS = {"above": _vertical, "below": _vertical, "on": _on, "in": _in, "near": _near}


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
    def region(self) -> tuple[RegionPart, ...]:
        """Region of the relation; empty without 3D extents."""
        target, reference = self._lifted
        try:
            return region_of(reference, self.trace.relation, target.hi - target.lo, self.trace.viewer, self.profile)
        except InputError:
            return ()

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
