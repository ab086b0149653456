"""The region of a relation around a reference, for drawing: where the centre of a target may stand.

left, right, front and behind are drawn in the level plane through the
reference's middle, exactly: all lines on which the rule's verdict can change
(edges of the dead zone, of the overlap, of the switch from gaps to centres, and
of the cones by gaps and by centres) cut the plane into trapezoids, and the rule
itself judges the middle of each. above, below, on, in and near are solids
through outlines at several heights; any other relation is judged on a grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.diagnosis.whatif.region_solids import SOLIDS, solids
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import HORIZONTAL, PAIRWISE, RELATIONS
from pipeline.relations.contact import Measured
from pipeline.relations.predicates import pair_states
from pipeline.relations.relations import Profile, known_extents, letter, measure_pairs
from pipeline.system.errors import InputError

GRID_CELLS = 80
"""Cells along each side of the region of a relation of which only its rule is known."""
REACH = 1.5
"""Metres beyond the reference to which the region is drawn; it goes on without end."""


@dataclass(frozen=True)
class Patch:
    """One part of a region.

    Attributes
    ----------
    label : str
        "T" or "U".
    triangles : (M, 3, 3) float64
        Corners, camera frame, metres; to be drawn translucent.
    lines : (S, 2, 3) float64
        Segments of its outline, camera frame, metres.
    """

    label: str
    triangles: np.ndarray
    lines: np.ndarray


@dataclass(frozen=True)
class Region:
    """Where a relation holds (T) and where it is doubtful (U), for the centre of a target of one size.

    Attributes
    ----------
    relation : str
    patches : tuple of Patch
    axes : (3, 2, 3) float64
        Segments from the reference's middle along the viewer's right, up and forward, camera frame, metres.
    dead_zone : float
        Half width of the doubtful strip along the relation's axis, metres; 0 where it has none.
    exact : bool
        Every point of the plane that is drawn is judged as the rule judges it. The solids of above, below, on and
        in take extents for points, and their U is what lies inside U and outside T.
    """

    relation: str
    patches: tuple[Patch, ...]
    axes: np.ndarray
    dead_zone: float
    exact: bool


def region_of(
    reference: LiftedObject,
    relation: str,
    size: np.ndarray,
    viewer: ViewerAxes,
    profile: Profile | None = None,
    reach: float = REACH,
) -> Region:
    """The region of "target RELATION reference".

    Parameters
    ----------
    reference : LiftedObject
    relation : str
        One of PAIRWISE.
    size : (3,) float
        The target's extents along (right, up, forward), metres: `hi - lo` of its LiftedObject.
    reach : float
        How far beyond the reference it is drawn, metres.

    Raises
    ------
    InputError
        For another relation, a reference without extents, a size that is none.
    """
    profile = profile or Profile()
    if relation not in PAIRWISE:
        raise InputError("there is no region of this relation", got=repr(relation), expected=", ".join(PAIRWISE))
    size = np.asarray(size, np.float64)
    if size.shape != (3,) or not np.isfinite(size).all() or (size < 0).any():
        raise InputError("the target's size must be three lengths", got=size.tolist())
    if not (np.isfinite(reach) and 0 < reach <= 100):
        raise InputError("the reach of a region is out of range", got=reach, expected="above 0, up to 100 m")
    lo, hi = reference.lo, reference.hi
    if not known_extents(lo[None], hi[None]).all():
        raise InputError("the reference has no place in space, and so there is no region around it")
    middle = (lo + hi) / 2
    if relation in SOLIDS:
        found = solids(lo, hi, size, relation, profile, reach)
    else:
        found = _plane(lo, hi, size, relation, profile, reach)
    axes = middle[None, None] + np.stack([np.zeros((3, 3)), np.eye(3) * 0.5 * min(reach, 1.0)], axis=1)
    depth = max(profile.dead_zone_depth, profile.dead_zone_depth_relative * abs(float(middle[2])))
    axis, _ = RELATIONS[relation].axis or (None, 1)
    return Region(
        relation,
        tuple(Patch(name, tri @ viewer.matrix, lines @ viewer.matrix) for name, tri, lines in found),
        axes @ viewer.matrix,
        0.0 if axis is None else depth if axis == 2 else profile.dead_zone,
        relation in HORIZONTAL,
    )


def plane_states(
    lo: np.ndarray, hi: np.ndarray, size: np.ndarray, places: np.ndarray, relation: str, profile: Profile
) -> np.ndarray:
    """(P,) int8: the rule's verdict on a target of a size with its centre at each place ((P, 3), level axes)."""
    count = len(places)
    both = [
        np.stack([places + sign * size / 2, np.broadcast_to(own, (count, 3))], axis=1)
        for sign, own in ((-1, lo), (1, hi))
    ]
    pairs = measure_pairs(both[0], both[1], profile)
    return pair_states(Measured(pairs, profile), np.ones((count, 2), np.bool_), (relation,))[:, 0, 1, 0]


_Line = tuple[float, float]
_Level = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _plane(
    lo: np.ndarray, hi: np.ndarray, size: np.ndarray, relation: str, profile: Profile, reach: float
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Trapezoids in the plane through the reference's middle, merged along the second coordinate.

    The coordinates are (s, t): s along the relation's axis towards its side, t across, both from the middle. Of a
    relation without an axis s is along right, and the trapezoids are cells of a grid.
    """
    axis, side = HORIZONTAL.get(relation, (0, 1))
    across = 2 - axis
    middle = (lo + hi) / 2
    far = ((size + (hi - lo)) / 2)[[axis, across]] + reach
    if relation in HORIZONTAL:
        s, c, m = _exact_cuts(lo, hi, size, axis, side, far, profile)
    else:
        s, c = (np.linspace(-end, end, GRID_CELLS + 1) for end in far)
        m = np.zeros(len(c))
    s0, s1 = s[:-1], s[1:]
    t0, t1 = (np.clip(c[None] + m[None] * x[:, None], -far[1], far[1]) for x in (s0, s1))
    order = np.argsort(t0 + t1, axis=1, kind="stable")
    t0, t1 = (np.take_along_axis(t, order, axis=1) for t in (t0, t1))
    low0, high0, low1, high1 = t0[:, :-1], t0[:, 1:], t1[:, :-1], t1[:, 1:]
    strip = np.broadcast_to(np.arange(len(s0))[:, None], low0.shape)
    solid = (high0 - low0) + (high1 - low1) > 1e-9
    corners = np.stack([low0[solid], high0[solid], low1[solid], high1[solid]], axis=1)
    strip = strip[solid]
    places = np.broadcast_to(middle, (len(strip), 3)).copy()
    places[:, axis] += side * (s0[strip] + s1[strip]) / 2
    places[:, across] += corners.mean(axis=1)
    state = plane_states(lo, hi, size, places, relation, profile)
    return _merged(strip, corners, state, s0, s1, axis, side, middle)


def _exact_cuts(
    lo: np.ndarray, hi: np.ndarray, size: np.ndarray, axis: int, side: int, far: np.ndarray, profile: Profile
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All lines on which the verdict can change: sorted s, and c and m of the lines t = c + m s."""
    across = 2 - axis
    extent = np.maximum(hi - lo, profile.min_extent)
    half = (size + (hi - lo)) / 2
    shorter = np.minimum(np.maximum(size, profile.min_extent), extent)
    depth = float(((lo + hi) / 2)[2])
    upright = _uprights(axis, side, float(half[axis]), float(shorter[axis]), depth, profile)
    band = [profile.gap_switch, *profile.gap_switch_band, 0.0]
    # A line t = c + m s, and its mirror image.
    sloped: list[_Line] = [(float(half[across]) + g, 0.0) for g in band]
    for angle in (profile.cone, profile.doubtful_cone):
        if angle < 90:
            slope = float(np.tan(np.deg2rad(angle)))
            sloped += [(0.0, slope), (float(half[across] - slope * half[axis]), slope)]
    lines = np.array(sorted({*sloped, *((-c, -m) for c, m in sloped), (far[1], 0.0), (-far[1], 0.0)}))
    cuts = [*upright, 0.0, far[0]]
    c, m = lines[:, 0], lines[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        meet = -(c[:, None] - c[None]) / (m[:, None] - m[None])
    cuts += meet[np.isfinite(meet)].tolist()
    return np.unique(np.round([x for x in cuts if 0 <= x <= far[0]], 9)), c, m


def _uprights(
    axis: int, side: int, half: float, shorter: float, depth: float, profile: Profile
) -> list[float]:
    """Where along the relation's axis the verdict may change at once for every place across it."""
    found = [half + g for g in (0.0, profile.gap_switch, *profile.gap_switch_band)]
    found += [half - share * shorter for share in (profile.overlap_doubts, profile.overlap_excludes)]
    if axis == 0:
        return [*found, profile.dead_zone]
    # The dead zone along forward is max(fixed, relative * the farther centre's distance).
    r = profile.dead_zone_depth_relative
    found += [profile.dead_zone_depth, r * abs(depth)]
    for sign in (1, -1):
        # s = r |depth + side s|
        bottom = 1 - sign * r * side
        if abs(bottom) > 1e-9:
            found.append(sign * r * depth / bottom)
    return found


def _merged(
    strip: np.ndarray,
    corners: np.ndarray,
    state: np.ndarray,
    s0: np.ndarray,
    s1: np.ndarray,
    axis: int,
    side: int,
    middle: np.ndarray,
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Triangles and outlines of T and of U; neighbours of one verdict in a strip become one."""
    first = np.r_[True, (strip[1:] != strip[:-1]) | (state[1:] != state[:-1])]
    start = np.flatnonzero(first)
    last = np.r_[start[1:], len(strip)] - 1
    which, at = state[start], strip[start]
    edges = np.stack([corners[start, 0], corners[last, 1], corners[start, 2], corners[last, 3]], axis=1)

    def level(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        points = np.broadcast_to(middle, (*s.shape, 3)).copy()
        points[..., axis] += side * s
        points[..., 2 - axis] += t
        return points

    found = []
    for value in (1, 0):
        mine = which == value
        a, b = s0[at[mine]], s1[at[mine]]
        p, q, r, w = (level(x, edges[mine, k]) for k, x in enumerate((a, a, b, b)))
        triangles = np.concatenate([np.stack([p, q, r], axis=1), np.stack([q, w, r], axis=1)])
        rims = np.concatenate([np.stack([p, r], axis=1), np.stack([q, w], axis=1)])
        walls = _walls(a, b, edges[mine], level)
        if len(triangles):
            found.append((letter(value), triangles, np.concatenate([rims, walls])))
    return found


def _walls(a: np.ndarray, b: np.ndarray, edges: np.ndarray, level: _Level) -> np.ndarray:
    """Outline between strips: where exactly one of two neighbouring strips has the verdict."""
    found = []
    for s in np.unique(np.concatenate([a, b])):
        ends = np.concatenate([edges[a == s, :2], edges[b == s, 2:]])
        cuts = np.unique(np.round(ends, 9))
        low, high = cuts[:-1], cuts[1:]
        mid = (low + high) / 2
        covered = ((ends[:, 0] < mid[:, None]) & (mid[:, None] < ends[:, 1])).sum(axis=1) == 1
        x = np.full(int(covered.sum()), s)
        found.append(np.stack([level(x, low[covered]), level(x, high[covered])], axis=1))
    return np.concatenate(found) if found else np.zeros((0, 2, 3))
