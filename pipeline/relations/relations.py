"""Spatial relations by geometry: the rule profile `viewer-cone-v1`.

States are three-valued: T (+1) the relation holds, F (-1) it does not, U (0)
it is too close to call. All pairs of a scene are judged at once. "A RELATION B"
is entry [a, b]; extents with leading dimensions are a batch of scenes. Every
relation is judged in the viewer's level axes (right, up, forward) of
`pipeline.geometry.viewer`; nothing here knows an object's own front.

The profile: left, right, front (nearer) and behind (farther) are cones of 45
degrees with an undecided band to 67.5 degrees around the axis, on signed gaps
between extents; above and below ask for overlap in plan. on, in and near are
extras of the same profile; `pipeline.relations.scorer` has between, closest and farthest.

Margins say how far each decision stands from its thresholds, in metres. Every gate of the rules is written as a
slack: at least 0 where the gate is passed, and as many metres as the measures would have to change for it to turn.
"And" is the least slack, "or" the greatest. The slack of T and the slack of "T or U" give state and margin together:
T by its own slack, F by how much even U is missed, U by 0.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL, PAIRWISE
from pipeline.relations.pair_measures import (
    AllMeasures,
    F,
    PairMeasures,
    Profile,
    T,
    U,
    in_measures,
    in_states,
    known_extents,
    measure_pairs,
    near_measures,
    on_measures,
    on_states,
)
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

Judge = Callable[[AllMeasures], Sequence[np.ndarray]]
Slacks = Callable[[PairMeasures, Profile], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Predicate:
    """Rule of one relation, or of several judged together."""

    relations: tuple[str, ...]
    states: Judge  # (..., N, N) states, one array for each of the relations: T, U or F at [a, b] for "a RELATION b"
    margins: Judge  # (N, N) float64 metres to the nearest threshold for each: positive for T, negative for F, 0 for U
    reads_points: bool = False  # It looks at more than extents


PREDICATES: dict[str, Predicate] = {}
"""By the name of a relation."""


def register(predicate: Predicate) -> None:
    """Register a predicate for its relations."""
    PREDICATES.update(dict.fromkeys(predicate.relations, predicate))


def predicate(relation: str) -> Callable[[Slacks], Slacks]:
    """Register a function of the measures of all ordered pairs as the rule of a relation.

    The function returns two (..., N, N) arrays: how many metres the measures could change before "a RELATION b" were
    no longer sure, and before it were surely false. Where the first is at least 0 the state is T, where only the
    second is, U, elsewhere F; the margins follow from both.
    """

    def registered(slacks: Slacks) -> Slacks:
        def states(measured: AllMeasures) -> tuple[np.ndarray]:
            holds, allows = slacks(measured.pairs, measured.profile)
            return (three_valued(holds >= 0, allows >= 0),)

        def margins(measured: AllMeasures) -> tuple[np.ndarray]:
            return (margin_of(*slacks(measured.pairs, measured.profile)),)

        register(Predicate((relation,), states, margins))
        return slacks

    return registered


def predicates_of(relations: Iterable[str]) -> list[Predicate]:
    """Predicates judging these relations, each once.

    Raises
    ------
    InputError
        A relation has none.
    """
    relations = tuple(relations)
    missing = [name for name in relations if name not in PREDICATES]
    if missing:
        raise InputError(
            f"the relation {missing[0]!r} has no predicate",
            expected=f"a function under @predicate({missing[0]!r}), as in pipeline/relations/relations.py",
            cause="it is declared in pipeline/language/relation.py alone",
        )
    return list({id(found): found for found in (PREDICATES[name] for name in relations)}.values())


def _stacked(relations: Sequence[str], of: Callable[[Predicate], Sequence[np.ndarray]]) -> np.ndarray:
    found: dict[str, np.ndarray] = {}
    for one in predicates_of(relations):
        found.update(zip(one.relations, of(one), strict=True))
    return np.moveaxis(np.stack([found[name] for name in relations]), 0, -1)


def pair_states(measured: AllMeasures, known: np.ndarray, relations: Sequence[str]) -> np.ndarray:
    """(..., N, N, R) int8 states of the relations in order.

    U where the extents of either are not known (`known` is (..., N) bool), F of an object to itself.
    """
    result = _stacked(relations, lambda p: p.states(measured)).astype(np.int8)
    if not known.all():
        result[~(known[..., :, None] & known[..., None, :])] = U
    own = np.arange(known.shape[-1])
    result[..., own, own, :] = F
    return result


def pair_margins(measured: AllMeasures, states: np.ndarray, relations: Sequence[str]) -> np.ndarray:
    """(N, N, R) float64 margins of the relations, metres, given their states; never beyond the state.

    Rounding at a threshold may part the two by a hair.
    """
    margins = _stacked(relations, lambda p: p.margins(measured))
    return np.where(states == T, np.maximum(margins, 0), np.where(states == F, np.minimum(margins, 0), 0.0))


def margin_of(holds: np.ndarray, allows: np.ndarray) -> np.ndarray:
    """Margin, given the slack of T and the slack of "T or U"."""
    return np.where(holds >= 0, holds, np.where(allows >= 0, 0.0, allows))


PROFILE = "viewer-cone-v1"


Indices = Sequence[int] | np.ndarray
"""Places in a list of objects."""

_LETTER = {T: "T", U: "U", F: "F"}


def letter(state: int) -> str:
    """ "T", "U" or "F"."""
    return _LETTER[int(state)]


def directional_states(lo: np.ndarray, hi: np.ndarray, profile: Profile | None = None) -> np.ndarray:
    """States of the six directional relations of all ordered pairs.

    Parameters
    ----------
    lo, hi : (N, 3) float
        Extents along (right, up, forward), metres, as `lifting.extents` gives them. An object with NaN extents is in
        doubt (U) with every other one.

    Returns
    -------
    (N, N, 6) int8
        In the order of DIRECTIONAL; the diagonal is F.

    >>> import numpy as np
    >>> from pipeline.language.relation_names import DIRECTIONAL
    >>> mug, laptop = [-0.5, 0.0, 1.0], [0.0, 0.0, 1.0]
    >>> states = directional_states(np.array([mug, laptop]), np.array([mug, laptop]) + 0.1)
    >>> dict(zip(DIRECTIONAL, map(letter, states[0, 1])))
    {'left': 'T', 'right': 'F', 'above': 'F', 'below': 'F', 'front': 'F', 'behind': 'F'}
    """
    return pairwise_states(lo, hi, profile=profile, relations=DIRECTIONAL)


def three_valued(holds: np.ndarray, allows: np.ndarray) -> np.ndarray:
    """States, int8: T where something holds, U where it is allowed, elsewhere F."""
    return np.where(holds, np.int8(T), np.where(allows, np.int8(U), np.int8(F)))


def _horizontal_states(measured: AllMeasures) -> tuple[np.ndarray, ...]:
    """(..., N, N) states of left, right, front and behind."""
    profile = measured.profile
    widest_gap = measured.displacements[0].max(axis=0)
    by_gap, by_center = _horizontal(measured)
    states = np.where(widest_gap < profile.gap_switch, by_center, by_gap)
    low, high = profile.gap_switch_band
    switching = (widest_gap >= low) & (widest_gap <= high)
    states[switching & (by_gap != by_center)] = U
    return tuple(states)


def _horizontal(measured: AllMeasures) -> tuple[np.ndarray, np.ndarray]:
    """(4, ..., N, N) states of left, right, front, behind for each reading of the displacement: gaps and centres."""
    pairs, profile = measured.pairs, measured.profile
    angle = np.rad2deg(measured.turns[:, 0])
    lateral = _overlap_gate(_cone(angle, profile), pairs.overlap_share[..., 0], profile)
    depth = _overlap_gate(_cone(90 - angle, profile), pairs.overlap_share[..., 2], profile)
    distance = np.abs(pairs.center[..., 2])
    dead_depth = np.maximum(
        profile.dead_zone_depth,
        profile.dead_zone_depth_relative * np.maximum(distance[..., :, None], distance[..., None, :]),
    )
    right, forward = pairs.delta[..., 0], pairs.delta[..., 2]
    found = np.stack(
        [
            _sign_gate(lateral, -right, profile.dead_zone),
            _sign_gate(lateral, right, profile.dead_zone),
            _sign_gate(depth, -forward, dead_depth),
            _sign_gate(depth, forward, dead_depth),
        ],
        axis=1,
    )
    return found[0], found[1]


def _cone(angle: np.ndarray, profile: Profile) -> np.ndarray:
    return three_valued(angle <= profile.cone, angle <= profile.doubtful_cone)


def _overlap_gate(state: np.ndarray, share: np.ndarray, profile: Profile) -> np.ndarray:
    doubted = np.where(share >= profile.overlap_doubts, np.minimum(state, np.int8(U)), state)
    return np.where(share >= profile.overlap_excludes, np.int8(F), doubted)


def _sign_gate(state: np.ndarray, signed: np.ndarray, dead_zone: np.ndarray | float) -> np.ndarray:
    doubted = np.where(signed < dead_zone, np.minimum(state, np.int8(U)), state)
    return np.where(signed <= 0, np.int8(F), doubted)


def _vertical_states(measured: AllMeasures) -> tuple[np.ndarray, np.ndarray]:
    """(..., N, N) states of above and of below."""
    pairs, profile = measured.pairs, measured.profile
    area = pairs.extent[..., 0] * pairs.extent[..., 2]
    shared = pairs.overlap[..., 0] * pairs.overlap[..., 2]
    plan = shared / np.minimum(area[..., :, None], area[..., None, :])
    clearance = pairs.lo[..., :, None, 1] - pairs.hi[..., None, :, 1]
    height = pairs.extent[..., 1]
    lower = np.minimum(height[..., :, None], height[..., None, :])
    tolerance = np.maximum(profile.sink, profile.sink_relative * lower)
    sideways = np.hypot(pairs.gap[..., 0], pairs.gap[..., 2])
    elevation = np.rad2deg(np.arctan2(np.maximum(clearance, 0), sideways))
    resting, raised = clearance >= -tolerance, clearance > profile.clear_height
    holds = (plan >= profile.plan_overlap) & resting | raised & (elevation >= profile.elevation)
    undecided = (plan >= profile.plan_overlap_doubtful) & resting | raised & (elevation >= profile.elevation_doubtful)
    state = three_valued(holds, undecided)
    above = _sign_gate(state, pairs.delta[..., 1], profile.dead_zone)
    return above, above.swapaxes(-1, -2)


def pairwise_states(
    lo: np.ndarray,
    hi: np.ndarray,
    clouds: Sequence[np.ndarray] | None = None,
    profile: Profile | None = None,
    relations: Collection[str] = PAIRWISE,
) -> np.ndarray:
    """States of all relations judged for every ordered pair.

    Parameters
    ----------
    lo, hi : (N, 3) float
        Extents along (right, up, forward), metres.
    clouds : sequence of (M, 3) float, optional
        Each object's points along (right, up, forward); `on` reads the height of the supporting surface from them and
        `in` counts them. Without points the extents stand in.
    relations : collection of str
        Of those that look at points only these are judged; the directions always are.

    Returns
    -------
    (N, N, R) int8
        In the order of PAIRWISE, as `judged_relations` names them; the diagonal is F.
    """
    profile = profile or Profile()
    lo, hi = np.asarray(lo, np.float64).reshape(-1, 3), np.asarray(hi, np.float64).reshape(-1, 3)
    known = known_extents(lo, hi)
    pairs = measure_pairs(np.where(known[:, None], lo, 0.0), np.where(known[:, None], hi, 0.0), profile)
    return pair_states(AllMeasures(pairs, profile, clouds), known, judged_relations(relations))


def judged_relations(relations: Collection[str]) -> tuple[str, ...]:
    """Relations judged by `pairwise_states` for a request."""
    return tuple(name for name in PAIRWISE if name in DIRECTIONAL or name in relations)


def horizontal_margins(measured: AllMeasures) -> tuple[np.ndarray, ...]:
    """(N, N) float64 margins of left, right, front and behind, metres; see the module."""
    profile = measured.profile
    holds, allows = _horizontal_slacks(measured)
    widest = measured.displacements[0].max(axis=0)
    low, high = profile.gap_switch_band
    below = widest < low
    between = ~below & (widest <= high)
    read = margin_of(holds, allows)
    own, other = np.where(below, read[1], read[0]), np.where(below, read[0], read[1])
    own = np.where(between, margin_of(holds.min(axis=0), allows.max(axis=0)), own)
    # Outside the band the other reading takes over at its edge; where it would
    # decide otherwise, that edge is as near as any threshold.
    edge = np.where(below, low - widest, widest - high)
    differs = ~between & (np.sign(other) != np.sign(own))
    return tuple(np.where(differs, np.sign(own) * np.minimum(np.abs(own), np.maximum(edge, 0)), own))


def vertical_margins(measured: AllMeasures) -> tuple[np.ndarray, np.ndarray]:
    """(N, N) float64 margins of above and of below, metres."""
    above = margin_of(*_above_slacks(measured.pairs, measured.profile))
    return above, above.T


def _horizontal_slacks(measured: AllMeasures) -> tuple[np.ndarray, np.ndarray]:
    """Slack of T and of "T or U" of left, right, front, behind.

    Returns (2, 4, N, N) float64 each: by gaps, and by centres.
    """
    pairs, profile = measured.pairs, measured.profile
    n = len(pairs.center)
    distance = np.sqrt(np.square(measured.displacements).sum(axis=1))[:, None]
    extent = pairs.extent[:, ::2].T
    shorter = np.minimum(extent[:, :, None], extent[:, None, :])
    share = np.moveaxis(pairs.overlap_share[..., ::2], -1, 0)
    away = np.abs(pairs.center[:, 2])
    dead = np.full((2, n, n), profile.dead_zone)
    dead[1] = np.maximum(
        profile.dead_zone_depth, profile.dead_zone_depth_relative * np.maximum(away[:, None], away[None, :])
    )
    delta = np.moveaxis(pairs.delta[..., ::2], -1, 0)
    side = np.stack([-delta, delta], axis=1)
    slacks = []
    for cone, excess, beyond in (
        (profile.cone, profile.overlap_doubts, side - dead[:, None]),
        (profile.doubtful_cone, profile.overlap_excludes, side),
    ):
        in_cone = distance * np.sin(np.deg2rad(cone) - measured.turns)
        gate = np.minimum(in_cone, (excess - share) * shorter)[:, :, None]
        slacks.append(np.minimum(gate, beyond).reshape(2, 4, n, n))
    return slacks[0], slacks[1]


def _above_slacks(pairs: PairMeasures, profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    area = pairs.extent[:, 0] * pairs.extent[:, 2]
    least = np.minimum(area[:, None], area[None, :])
    plan, side = pairs.overlap[..., 0] * pairs.overlap[..., 2] / least, np.sqrt(least)
    clearance = pairs.lo[:, None, 1] - pairs.hi[None, :, 1]
    height = pairs.extent[:, 1]
    tolerance = np.maximum(profile.sink, profile.sink_relative * np.minimum(height[:, None], height[None, :]))
    sideways = np.hypot(pairs.gap[..., 0], pairs.gap[..., 2])
    rise = np.maximum(clearance, 0)
    elevation, reach = np.arctan2(rise, sideways), np.hypot(rise, sideways)
    slacks = []
    for overlap, degrees, dead in (
        (profile.plan_overlap, profile.elevation, profile.dead_zone),
        (profile.plan_overlap_doubtful, profile.elevation_doubtful, 0.0),
    ):
        # Where the footprints are apart, they first have to meet.
        resting = np.minimum((plan - overlap) * side - sideways, clearance + tolerance)
        raised = np.minimum(clearance - profile.clear_height, reach * np.sin(elevation - np.deg2rad(degrees)))
        slacks.append(np.minimum(np.maximum(resting, raised), pairs.delta[..., 1] - dead))
    return slacks[0], slacks[1]


def on_margins(measured: AllMeasures) -> np.ndarray:
    """(N, N) float64 margins of on, metres."""
    pairs, profile = measured.pairs, measured.profile
    side = np.sqrt(pairs.extent[:, 0] * pairs.extent[:, 2])
    covered, ratio, gap = on_measures(measured)
    sideways = np.hypot(pairs.gap[..., 0], pairs.gap[..., 2])
    supported = np.minimum(
        (covered - profile.on_overlap) * side[:, None] - sideways, (profile.on_area_ratio - ratio) * side[None, :]
    )
    touching = np.maximum(profile.on_gap, profile.on_gap_relative * pairs.extent[:, 1])[:, None]
    return margin_of(
        np.minimum(supported, touching - gap),
        np.minimum(supported, np.maximum(touching, profile.on_gap_doubtful) - gap),
    )


def in_margins(measured: AllMeasures) -> np.ndarray:
    """(N, N) float64 margins of in, metres."""
    pairs, profile = measured.pairs, measured.profile
    share, below_rim = in_measures(measured)
    length = np.cbrt(pairs.extent.prod(axis=1))[:, None]
    sunk = (below_rim - profile.in_below_rim) * pairs.extent[:, None, 1]
    outside = np.maximum(np.linalg.norm(pairs.gap, axis=2) - profile.in_inflation, 0)
    return margin_of(
        np.minimum((share - profile.in_share) * length - outside, sunk),
        np.minimum((share - profile.in_share_doubtful) * length - outside, sunk),
    )


register(Predicate(("left", "right", "front", "behind"), _horizontal_states, horizontal_margins))
register(Predicate(("above", "below"), _vertical_states, vertical_margins))
register(Predicate(("on",), lambda m: (on_states(m),), lambda m: (on_margins(m),), reads_points=True))
register(Predicate(("in",), lambda m: (in_states(m),), lambda m: (in_margins(m),), reads_points=True))


@predicate("near")
def near_slacks(pairs: PairMeasures, profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Slack of the distance between extents, in mean diagonals."""
    gap, mean = near_measures(pairs)
    return profile.near_diagonals * mean - gap, profile.near_diagonals_doubtful * mean - gap
