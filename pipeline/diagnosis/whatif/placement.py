"""Placement of an edited object: its box in numbers, its pixels, and its place in a relation's region."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.whatif.edits import Edits, Three
from pipeline.diagnosis.whatif.region import Region, region_of
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.masks import decode_run_length
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import FrameCases
from pipeline.language.relation_names import HORIZONTAL, PAIRWISE
from pipeline.relations.pair_measures import AllMeasures, in_measures, near_measures, on_measures
from pipeline.relations.predicates import pair_margins, pair_states
from pipeline.relations.relations import Profile, known_extents, letter, measure_pairs
from pipeline.relations.scorer import stacked_extents
from pipeline.system.errors import InputError, require

Measures = dict[str, float]


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
    require(
        relation in PAIRWISE, "there is no region of this relation", got=repr(relation), expected=", ".join(PAIRWISE)
    )
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


SMALLEST_SIDE = 0.01
"""Metres; a flatter box could not be taken hold of again."""


def pulled(box: Box3D, axis: int, side: float, by: float) -> Box3D:
    """Pull a face (`side` 1 or -1 of its own `axis`) of a box outwards by metres; the opposite stays."""
    grown = max(box.size[axis] + by, SMALLEST_SIDE) - box.size[axis]
    outwards = box.R[:, axis] * side
    return Box3D(box.center + outwards * grown / 2, box.R, box.size + grown * (np.arange(3) == axis))


@dataclass(frozen=True)
class BoxNumbers:
    """Box in the viewer's level axes."""

    center: Three  # Along (right, forward, up), metres
    size: Three  # Along the box's own axes, for an upright box (width, height, depth), metres
    yaw: float  # Of the box's first axis in plan, degrees from right towards forward, in (-180, 180]


def box_numbers(box: Box3D, viewer: ViewerAxes) -> BoxNumbers:
    """Numbers of a box (camera frame)."""
    x, y, z = (_axes(viewer) @ box.center).tolist()
    width, height, depth = box.size.tolist()
    return BoxNumbers((x, y, z), (width, height, depth), float(np.rad2deg(_yaw(box, viewer))))


def with_numbers(
    box: Box3D,
    viewer: ViewerAxes,
    *,
    center: Three | None = None,
    size: Three | None = None,
    yaw: float | None = None,
) -> Box3D:
    """Change some numbers of a box; None keeps a number."""
    axes = _axes(viewer)
    moved = box.center if center is None else axes.T @ np.array(center, np.float64)
    sides = box.size if size is None else np.maximum(np.array(size, np.float64), SMALLEST_SIDE)
    R = box.R
    if yaw is not None:
        angle = np.deg2rad(yaw) - _yaw(box, viewer)
        cos, sin = np.cos(angle), np.sin(angle)
        R = axes.T @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ axes @ R
    return Box3D(moved, R, sides)


def _axes(viewer: ViewerAxes) -> np.ndarray:
    """(3, 3): rotation of the camera frame into (right, forward, up)."""
    return np.stack([viewer.right, viewer.forward, viewer.up])


def _yaw(box: Box3D, viewer: ViewerAxes) -> float:
    x, y, _ = _axes(viewer) @ box.R[:, 0]
    return float(np.arctan2(y, x))


MOST_PIXELS = 200
"""A mask is grown or shrunk by no more at once."""
SAME = 0.1
"""The labelled object that overlaps most is meant where its 2D box overlaps by as much (IoU): badly placed boxes are
what another mask is for."""


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Grow a mask by a disc, or shrink it for a negative radius.

    `mask`: (H, W) bool; `pixels`: -200..200.
    """
    require(
        abs(pixels) <= MOST_PIXELS,
        "a mask grows by so many pixels at most",
        got=pixels,
        expected=f"at most {MOST_PIXELS}",
    )
    if pixels == 0:
        return mask
    step = np.arange(-abs(pixels), abs(pixels) + 1)
    disc = (step[:, None] ** 2 + step[None] ** 2 <= pixels**2).astype(np.uint8)
    change, beyond = (cv2.dilate, 0) if pixels > 0 else (cv2.erode, 1)
    # What lies beyond the picture's edge neither adds to a mask nor takes from it.
    changed = change(mask.view(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=beyond)
    return changed.astype(np.bool_)


def rectangle(height: int, width: int, corners: tuple[float, float, float, float]) -> np.ndarray:
    """(H, W) bool: pixels between two corners, x0, y0, x1, y1 as fractions of width and height in any order."""
    x0, y0, x1, y1 = corners
    require(np.isfinite([x0, y0, x1, y1]).all(), "the corners of a rectangle must be finite", got=corners)
    xs, ys = sorted((x0, x1)), sorted((y0, y1))
    left, right = (int(np.clip(round(x * width), 0, width)) for x in xs)
    top, bottom = (int(np.clip(round(y * height), 0, height)) for y in ys)
    mask = np.zeros((height, width), np.bool_)
    mask[top:bottom, left:right] = True
    require(mask.any(), "the rectangle holds no pixel", got=corners)
    return mask


def labelled_mask(truth: FrameCases, bbox: np.ndarray, height: int, width: int) -> np.ndarray | None:
    """(H, W) bool: labelled pixels of the object of a 2D box; None without any."""
    if not len(truth.boxes):
        return None
    overlap = iou_2d(bbox, truth.boxes)[0]
    k = int(overlap.argmax())
    code = truth.masks[k]
    if overlap[k] < SAME or code is None:
        return None
    return decode_run_length((height, width), code, f"labelled object {truth.numbers[k]} of frame {truth.frame}")


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
