"""Region of a relation around a reference, for drawing: allowed centres of a target.

left, right, front and behind are drawn in the level plane through the
reference's middle, exactly: all lines on which the rule's verdict can change
(edges of the dead zone, of the overlap, of the switch from gaps to centres, and
of the cones by gaps and by centres) cut the plane into trapezoids, and the rule
itself judges the middle of each. above, below, on, in and near are solids
through outlines at several heights; any other relation is judged on a grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import HORIZONTAL, PAIRWISE, RELATIONS
from pipeline.relations.pair_measures import AllMeasures
from pipeline.relations.predicates import pair_states
from pipeline.relations.relations import Profile, known_extents, letter, measure_pairs
from pipeline.system.errors import require

_Level = Callable[[np.ndarray, np.ndarray], np.ndarray]
_CORNER_STEPS = 8
SOLIDS = ("above", "below", "on", "in", "near")
"""The relations whose regions are solids."""
Solid = tuple[str, np.ndarray, np.ndarray]
"""Label, triangles (M, 3, 3), segments (S, 2, 3)."""

GRID_CELLS = 80
"""Cells along each side of the region of a relation of which only its rule is known."""
REACH = 1.5
"""Metres beyond the reference to which the region is drawn; it goes on without end."""


@dataclass(frozen=True)
class RegionPart:
    """Part of a region."""

    label: str  # "T" or "U"
    triangles: np.ndarray  # (M, 3, 3) float64: corners, camera frame, metres; to be drawn translucent
    lines: np.ndarray  # (S, 2, 3) float64: segments of its outline, camera frame, metres


@dataclass(frozen=True)
class Region:
    """Region of a relation: T where held, U where undecided, for the centre of a target of a given size."""

    relation: str
    patches: tuple[RegionPart, ...]
    # (3, 2, 3) float64: segments from the reference's middle along the viewer's right, up and forward, camera frame,
    # metres
    axes: np.ndarray
    dead_zone: float  # Half width of the undecided strip along the relation's axis, metres; 0 where it has none
    # Every point of the plane that is drawn is judged as the rule judges it. The solids of above, below, on and in take
    # extents for points, and their U is what lies inside U and outside T.
    exact: bool


def region_of(
    reference: LiftedObject,
    relation: str,
    size: np.ndarray,
    viewer: ViewerAxes,
    profile: Profile | None = None,
    reach: float = REACH,
) -> Region:
    """Region of "target RELATION reference".

    `relation`: one of PAIRWISE; `size`: (3,) float: the target's extents along (right, up, forward), metres: `hi - lo`
    of its LiftedObject; `reach`: how far beyond the reference it is drawn, metres.
    """
    profile = profile or Profile()
    require(
        relation in PAIRWISE, "there is no region of this relation", got=repr(relation), expected=", ".join(PAIRWISE)
    )
    size = np.asarray(size, np.float64)
    require(
        size.shape == (3,) and np.isfinite(size).all() and not (size < 0).any(),
        "the target's size must be three lengths",
        got=size.tolist(),
    )
    require(
        (np.isfinite(reach) and 0 < reach <= 100),
        "the reach of a region is out of range",
        got=reach,
        expected="above 0, up to 100 m",
    )
    lo, hi = reference.lo, reference.hi
    require(
        known_extents(lo[None], hi[None]).all(),
        "the reference has no place in space, and so there is no region around it",
    )
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
        tuple(RegionPart(name, tri @ viewer.matrix, lines @ viewer.matrix) for name, tri, lines in found),
        axes @ viewer.matrix,
        0.0 if axis is None else depth if axis == 2 else profile.dead_zone,
        relation in HORIZONTAL,
    )


def plane_states(
    lo: np.ndarray, hi: np.ndarray, size: np.ndarray, indices: np.ndarray, relation: str, profile: Profile
) -> np.ndarray:
    """(P,) int8: rule's verdict on a target of a size, centred at each place ((P, 3), level axes)."""
    count = len(indices)
    both = [
        np.stack([indices + sign * size / 2, np.broadcast_to(own, (count, 3))], axis=1)
        for sign, own in ((-1, lo), (1, hi))
    ]
    pairs = measure_pairs(both[0], both[1], profile)
    return pair_states(AllMeasures(pairs, profile), np.ones((count, 2), np.bool_), (relation,))[:, 0, 1, 0]


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
    indices = np.broadcast_to(middle, (len(strip), 3)).copy()
    indices[:, axis] += side * (s0[strip] + s1[strip]) / 2
    indices[:, across] += corners.mean(axis=1)
    state = plane_states(lo, hi, size, indices, relation, profile)
    return _merged(strip, corners, state, s0, s1, axis, side, middle)


def _exact_cuts(
    lo: np.ndarray, hi: np.ndarray, size: np.ndarray, axis: int, side: int, far: np.ndarray, profile: Profile
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines of possible change of the verdict: sorted s, and c and m of the lines t = c + m s."""
    across = 2 - axis
    extent = np.maximum(hi - lo, profile.min_extent)
    half = (size + (hi - lo)) / 2
    shorter = np.minimum(np.maximum(size, profile.min_extent), extent)
    depth = float(((lo + hi) / 2)[2])
    upright = _uprights(axis, side, float(half[axis]), float(shorter[axis]), depth, profile)
    band = [profile.gap_switch, *profile.gap_switch_band, 0.0]
    # A line t = c + m s, and its mirror image.
    sloped: list[tuple[float, float]] = [(float(half[across]) + g, 0.0) for g in band]
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


def _uprights(axis: int, side: int, half: float, shorter: float, depth: float, profile: Profile) -> list[float]:
    """Places along the relation's axis of a possible change for every place across it."""
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
    """Triangles and outlines of T and of U; neighbours of equal verdict in a strip are merged."""
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
    """Outline between strips: exactly one of two neighbouring strips has the verdict."""
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


def solids(
    lo: np.ndarray, hi: np.ndarray, size: np.ndarray, relation: str, profile: Profile, reach: float
) -> list[Solid]:
    """Solids of T and U of a relation around extents lo and hi ((3,)) for a target of a size ((3,))."""
    middle, half = (lo + hi) / 2, (size + (hi - lo)) / 2
    if relation in ("above", "below"):
        return _vertical(middle, half, hi - lo, size, relation, profile, reach)
    if relation == "on":
        return _on(middle, half, hi, lo, size, profile)
    if relation == "in":
        return _in(middle, hi, lo, size, profile)
    return _near(middle, half, hi - lo, size, profile)


def _vertical(
    middle: np.ndarray,
    half: np.ndarray,
    extent: np.ndarray,
    size: np.ndarray,
    relation: str,
    profile: Profile,
    reach: float,
) -> list[Solid]:
    """A prism over the plan overlap, and a frustum that widens with the height."""
    sign = 1.0 if relation == "above" else -1.0
    extent, own = np.maximum(extent, profile.min_extent), np.maximum(size, profile.min_extent)
    sink = max(profile.sink, profile.sink_relative * min(extent[1], own[1]))
    found = []
    for label, plan, elevation in (
        ("T", profile.plan_overlap, profile.elevation),
        ("U", profile.plan_overlap_doubtful, profile.elevation_doubtful),
    ):
        bottom = max(half[1] - sink, profile.dead_zone if label == "T" else 0.0)
        outline = _overlapping(half, extent, own, plan)
        parts = [_loft(middle, [outline, outline], [sign * bottom, sign * (half[1] + reach)])] if len(outline) else []
        if 0 < elevation < 90:
            spread = 1 / np.tan(np.deg2rad(elevation))
            low = max(half[1] + profile.clear_height, bottom)
            rings = [_rounded(half, (h - half[1]) * spread) for h in (low, half[1] + reach)]
            parts.append(_loft(middle, rings, [sign * low, sign * (half[1] + reach)]))
        if parts:
            found.append((label, *(np.concatenate([p[k] for p in parts]) for k in (0, 1))))
    return found


def _on(
    middle: np.ndarray, half: np.ndarray, hi: np.ndarray, lo: np.ndarray, size: np.ndarray, profile: Profile
) -> list[Solid]:
    """Slab over the upper face; for a reference with points the rule takes their height instead."""
    extent, own = np.maximum(hi - lo, profile.min_extent), np.maximum(size, profile.min_extent)
    if own[0] * own[2] / (extent[0] * extent[2]) >= profile.on_area_ratio:
        return []
    touching = max(profile.on_gap, profile.on_gap_relative * own[1])
    # Covered is a share of the target's own footprint, and not of the smaller one.
    footprint, other = own[0] * own[2], extent[0] * extent[2]
    outline = _overlapping(half, extent, own, profile.on_overlap * footprint / min(footprint, other))
    if not len(outline):
        return []
    return [
        (label, *_loft(middle, [outline, outline], [half[1] - gap, half[1] + gap]))
        for label, gap in (("T", touching), ("U", max(touching, profile.on_gap_doubtful)))
    ]


def _in(middle: np.ndarray, hi: np.ndarray, lo: np.ndarray, size: np.ndarray, profile: Profile) -> list[Solid]:
    """Box of places with no axis alone leaving more of the target outside than allowed."""
    own = np.maximum(size, profile.min_extent)
    room = hi - lo + 2 * profile.in_inflation
    found = []
    for label, share in (("T", profile.in_share), ("U", profile.in_share_doubtful)):
        if (room < share * own).any():
            continue
        # The shared length on an axis is at least share * own up to this distance of the centres.
        limit = (room + own) / 2 - share * own
        top = min(limit[1], (hi[1] - lo[1]) / 2 + own[1] / 2 - profile.in_below_rim * own[1])
        if top > -limit[1]:
            outline = _rectangle(limit)
            found.append((label, *_loft(middle, [outline, outline], [-limit[1], top])))
    return found


def _near(middle: np.ndarray, half: np.ndarray, extent: np.ndarray, size: np.ndarray, profile: Profile) -> list[Solid]:
    """The box of touching places, grown by a sphere."""
    sizes = [np.maximum(s, profile.min_extent) for s in (extent, size)]
    mean = sum(float(np.linalg.norm(s)) for s in sizes) / 2
    found = []
    for label, share in (("T", profile.near_diagonals), ("U", profile.near_diagonals_doubtful)):
        radius = share * mean
        angle = np.deg2rad([-90, -60, -30, 0, 0, 30, 60, 90])
        rise = np.where(np.arange(8) < 4, -half[1], half[1]) + radius * np.sin(angle)
        rings = [_rounded(half, radius * float(np.cos(a))) for a in angle]
        found.append((label, *_loft(middle, rings, rise.tolist())))
    return found


def _rectangle(half: np.ndarray) -> np.ndarray:
    """(4, 2) outline in (right, forward)."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half[[0, 2]]


def _rounded(half: np.ndarray, radius: float) -> np.ndarray:
    """(K, 2) outline of a rectangle grown by a disc."""
    turn = np.linspace(0, np.pi / 2, _CORNER_STEPS)
    outline = []
    for quarter, (x, z) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = turn + quarter * np.pi / 2
        corner = np.array([x * half[0], z * half[2]])
        outline.append(corner + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(outline)


def _overlapping(half: np.ndarray, extent: np.ndarray, own: np.ndarray, share: float) -> np.ndarray:
    """(K, 2) outline of the places with a plan overlap of a share of the smaller footprint.

    The overlap is the product of two lengths, and so a quarter of the outline is a hyperbola between the places
    where one length is as large as it gets.
    """
    most = np.minimum(extent, own)[[0, 2]]
    reach = half[[0, 2]]
    need = share * min(extent[0] * extent[2], own[0] * own[2])
    if need > most.prod() or need <= 0:
        return np.zeros((0, 2)) if need > 0 else _rectangle(half)
    along = np.geomspace(need / most[1], most[0], _CORNER_STEPS)
    quarter = np.stack([reach[0] - along, reach[1] - need / along], axis=1)
    return np.concatenate([quarter[::-1] * [1, 1], quarter * [-1, 1], quarter[::-1] * [-1, -1], quarter * [1, -1]])[
        ::-1
    ]


def _loft(middle: np.ndarray, rings: Sequence[np.ndarray], heights: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles and segments of a solid with an outline ((K, 2), of equal K) at each height, closed at both ends."""
    levels = []
    for ring, height in zip(rings, heights, strict=True):
        points = np.empty((len(ring), 3))
        points[:, [0, 2]], points[:, 1] = middle[[0, 2]] + ring, middle[1] + height
        levels.append(points)
    triangles, lines = [], [np.stack([points, np.roll(points, -1, axis=0)], axis=1) for points in levels]
    for low, high in pairwise(levels):
        next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        triangles += [np.stack([low, next_low, high], axis=1), np.stack([next_low, next_high, high], axis=1)]
        lines.append(np.stack([low, high], axis=1)[:: max(1, len(low) // 4)])
    for points in (levels[0], levels[-1]):
        center = np.broadcast_to(points.mean(axis=0), points.shape)
        triangles.append(np.stack([center, points, np.roll(points, -1, axis=0)], axis=1))
    return np.concatenate(triangles), np.concatenate(lines)
