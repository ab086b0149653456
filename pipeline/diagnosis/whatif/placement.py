"""Where a target falls in a relation's region: the measures of the rule, and in one sentence why it is T, U or F."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import HORIZONTAL, PAIRWISE
from pipeline.relations.contact import Measured, in_measures, near_measures, on_measures
from pipeline.relations.predicates import pair_margins, pair_states
from pipeline.relations.relations import PairMeasures, Profile, known_extents, letter, measure_pairs
from pipeline.relations.scorer import stacked_extents
from pipeline.system.errors import InputError

Measures = dict[str, float]


@dataclass(frozen=True)
class Placement:
    """One pair under one relation's rule.

    Attributes
    ----------
    relation : str
    state : int
        1 T, 0 U, -1 F: the rule's own.
    why : str
        One sentence.
    measures : dict of str to float
        What the rule looked at; names end in `_m` (metres), `_deg` (degrees), else they are shares.
    """

    relation: str
    state: int
    why: str
    measures: Measures

    @property
    def letter(self) -> str:
        """"T", "U" or "F"."""
        return letter(self.state)


def place_in_region(
    target: LiftedObject,
    reference: LiftedObject,
    relation: str,
    viewer: ViewerAxes,
    profile: Profile | None = None,
) -> Placement:
    """Judge "target RELATION reference" by the profile, and say why.

    Raises
    ------
    InputError
        For a relation that is not of two objects.
    """
    if relation not in PAIRWISE:
        raise InputError("there is no region of this relation", got=repr(relation), expected=", ".join(PAIRWISE))
    profile = profile or Profile()
    lo, hi = stacked_extents([target, reference])
    if not known_extents(lo, hi).all():
        return Placement(relation, 0, "One of the two has no place in space: U", {})
    axes = viewer.matrix.T.astype(np.float32)
    measured = Measured(measure_pairs(lo, hi, profile), profile, [o.points @ axes for o in (target, reference)])
    states = pair_states(measured, np.ones(2, np.bool_), (relation,))
    state = int(states[0, 1, 0])
    if relation in HORIZONTAL:
        measures, reason = _horizontal(measured.pairs, relation, profile)
    elif relation in ("above", "below"):
        measures, reason = _vertical(measured.pairs, relation, profile)
    elif relation in _REASONS:
        measures, reason = _REASONS[relation](measured)
    else:
        measures, reason = _by_margin(float(pair_margins(measured, states, (relation,))[0, 1, 0]))
    return Placement(relation, state, f"{reason(state)}: {letter(state)}", measures)


_Reason = Callable[[int], str]


def _horizontal(pairs: PairMeasures, relation: str, profile: Profile) -> tuple[Measures, _Reason]:
    axis, side = HORIZONTAL[relation]
    gap, delta = pairs.gap[0, 1], pairs.delta[0, 1]
    widest = float(np.abs(gap[[0, 2]]).max())
    by_gap, by_center = _off_axis(gap, axis), _off_axis(delta, axis)
    alpha = by_center if widest < profile.gap_switch else by_gap
    offset, rho = float(side * delta[axis]), float(pairs.overlap_share[0, 1, axis])
    farther = float(np.abs(pairs.center[:, 2]).max())
    deep = max(profile.dead_zone_depth, profile.dead_zone_depth_relative * farther)
    dead = profile.dead_zone if axis == 0 else deep
    measures = {
        "alpha_deg": alpha,
        "alpha_by_gaps_deg": by_gap,
        "alpha_by_centres_deg": by_center,
        "gap_right_m": float(gap[0]),
        "gap_forward_m": float(gap[2]),
        "offset_m": offset,
        "dead_zone_m": dead,
        "rho": rho,
        "cone_deg": profile.cone,
        "doubtful_cone_deg": profile.doubtful_cone,
    }
    along = "right" if axis == 0 else "forward"
    read = "centres" if widest < profile.gap_switch else "gaps"

    def reason(state: int) -> str:
        if offset <= 0:
            return f"It lies on the other side, by {-offset:.2f} m"
        if rho >= profile.overlap_excludes:
            return f"The two overlap by {rho:.0%} along {along}, {profile.overlap_excludes:.0%} or more"
        if state < 0:
            return f"{alpha:.0f}° off the axis by {read}, beyond {profile.doubtful_cone:g}°"
        if state > 0:
            return f"{alpha:.0f}° off the axis by {read}, within {profile.cone:g}°"
        if offset < dead:
            return f"Only {offset:.2f} m to that side, within the dead zone of {dead:.2f} m"
        if rho >= profile.overlap_doubts:
            return f"The two overlap by {rho:.0%} along {along}, {profile.overlap_doubts:.0%} or more"
        if alpha > profile.cone and alpha <= profile.doubtful_cone:
            return f"{alpha:.0f}° off the axis by {read}, between {profile.cone:g}° and {profile.doubtful_cone:g}°"
        return f"At a gap of {widest:.2f} m gaps ({by_gap:.0f}°) and centres ({by_center:.0f}°) disagree"

    return measures, reason


def _off_axis(displacement: np.ndarray, axis: int) -> float:
    """Degrees between a displacement in plan and an axis, by the rule's own formula."""
    angle = float(np.rad2deg(np.arctan2(abs(displacement[2]), abs(displacement[0]))))
    return angle if axis == 0 else 90 - angle


def _vertical(pairs: PairMeasures, relation: str, profile: Profile) -> tuple[Measures, _Reason]:
    upper, lower = (0, 1) if relation == "above" else (1, 0)
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
    end = "The target's" if relation == "above" else "The reference's"

    def reason(state: int) -> str:
        resting, raised = clearance >= -sink, clearance > profile.clear_height
        if offset <= 0:
            return f"Its centre lies on the other side, by {-offset:.2f} m"
        if not resting:
            return f"{end} bottom is {-clearance:.2f} m below the other's top, more than {sink:.2f} m"
        holds = plan >= profile.plan_overlap or (raised and elevation >= profile.elevation)
        if state == 0 and holds:
            return f"Only {offset:.2f} m between the centres, within the dead zone of {profile.dead_zone:.2f} m"
        if plan >= (profile.plan_overlap if state > 0 else profile.plan_overlap_doubtful):
            more = "at least" if state > 0 else "less than"
            return f"In plan the two overlap by {plan:.0%}, {more} {profile.plan_overlap:.0%}"
        if raised:
            return f"In plan the two overlap by {plan:.0%}, and the line between them rises by {elevation:.0f}°"
        return f"In plan the two overlap by only {plan:.0%}"

    return measures, reason


def _on(measured: Measured) -> tuple[Measures, _Reason]:
    profile = measured.profile
    covered, ratio, gap = (float(m[0, 1]) for m in on_measures(measured))
    touching = max(profile.on_gap, profile.on_gap_relative * float(measured.pairs.extent[0, 1]))
    measures = {"covered": covered, "area_ratio": ratio, "gap_m": gap, "touching_m": touching}

    def reason(state: int) -> str:
        if covered < profile.on_overlap:
            return f"{covered:.0%} of its footprint lies over the reference, less than {profile.on_overlap:.0%}"
        if ratio >= profile.on_area_ratio:
            return f"Its footprint is {ratio:.1f} times the reference's, too large to stand on it"
        if state > 0:
            return f"{gap:.2f} m between its bottom and the surface below, within {touching:.2f} m"
        if state == 0:
            return f"{gap:.2f} m between its bottom and the surface below, up to {profile.on_gap_doubtful:.2f} m"
        if gap <= max(touching, profile.on_gap_doubtful):
            return "Each could be on the other, and its middle is not the higher one"
        return f"{gap:.2f} m between its bottom and the surface below, more than {profile.on_gap_doubtful:.2f} m"

    return measures, reason


def _in(measured: Measured) -> tuple[Measures, _Reason]:
    profile = measured.profile
    share, below_rim = (float(m[0, 1]) for m in in_measures(measured))

    def reason(state: int) -> str:
        if below_rim < profile.in_below_rim:
            return f"It reaches {below_rim:.0%} of its height below the rim, less than {profile.in_below_rim:.0%}"
        bound = {1: f"at least {profile.in_share:.0%}", 0: f"less than {profile.in_share:.0%}"}
        return f"{share:.0%} of it lies inside, {bound.get(state, f'less than {profile.in_share_doubtful:.0%}')}"

    return {"share": share, "below_rim": below_rim}, reason


def _near(measured: Measured) -> tuple[Measures, _Reason]:
    profile = measured.profile
    gap, mean = (float(m[0, 1]) for m in near_measures(measured.pairs))
    close, doubtful = profile.near_diagonals * mean, profile.near_diagonals_doubtful * mean

    def reason(state: int) -> str:
        bound = {1: f"within {close:.2f} m", 0: f"between {close:.2f} m and {doubtful:.2f} m"}
        return f"{gap:.2f} m between the two, {bound.get(state, f'more than {doubtful:.2f} m')}"

    return {"gap_m": gap, "mean_diagonal_m": mean, "near_m": close, "doubtful_m": doubtful}, reason


def _by_margin(margin: float) -> tuple[Measures, _Reason]:
    """For a relation of which only its rule is known."""

    def reason(state: int) -> str:
        sure = {1: f"It holds by {margin:.2f} m", -1: f"It fails by {-margin:.2f} m"}
        return sure.get(state, "It is too close to call")

    return {"margin_m": margin}, reason


_REASONS = {"on": _on, "in": _in, "near": _near}
