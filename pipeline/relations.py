"""Spatial relations by geometry: the rule profile `viewer-cone-v1`.

States are three-valued: T (+1) the relation holds, F (-1) it does not, U (0)
it is too close to call. All pairs of a scene are judged at once. "A RELATION B"
is entry [a, b]; extents with leading dimensions are a batch of scenes. Every
relation is judged in the viewer's level axes (right, up, forward) of
`pipeline.viewer`; nothing here knows an object's own front.

The profile: left, right, front (nearer) and behind (farther) are cones of 45
degrees with a doubtful band to 67.5 degrees around the axis, on signed gaps
between extents; above and below ask for overlap in plan. on, in and near are
extras of the same profile; `pipeline.arrangement` has between, closest and farthest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

T, U, F = 1, 0, -1
PROFILE = "viewer-cone-v1"

DIRECTIONAL = ("left", "right", "above", "below", "front", "behind")
PAIRWISE = (*DIRECTIONAL, "on", "in", "near")
"""Relations with a state for every ordered pair, in the order in which they are always shown."""

VOCABULARIES: dict[str, tuple[str, ...]] = {
    "avd": DIRECTIONAL,
    "semantic-abstraction": ("behind", "left", "right", "front", "on", "in"),
    "all": PAIRWISE,
}
INVERSE = {"left": "right", "right": "left", "above": "below", "below": "above", "front": "behind", "behind": "front"}
PHRASE = {
    "left": "left of",
    "right": "right of",
    "above": "above",
    "below": "below",
    "front": "in front of",
    "behind": "behind",
    "on": "on",
    "in": "in",
    "near": "near",
    "between": "between",
    "closest": "closest to",
    "farthest": "farthest from",
}

Indices = Sequence[int] | np.ndarray
"""Places in a list of objects."""

_LETTER = {T: "T", U: "U", F: "F"}


def letter(state: int) -> str:
    """"T", "U" or "F"."""
    return _LETTER[int(state)]


@dataclass(frozen=True)
class Profile:
    """The thresholds of `viewer-cone-v1`; lengths in metres, angles in degrees."""

    cone: float = 45.0
    doubtful_cone: float = 67.5
    gap_switch: float = 0.03
    gap_switch_band: tuple[float, float] = (0.02, 0.04)
    overlap_excludes: float = 0.8
    overlap_doubts: float = 0.5
    dead_zone: float = 0.05
    dead_zone_depth: float = 0.10
    dead_zone_depth_relative: float = 0.02
    plan_overlap: float = 0.2
    plan_overlap_doubtful: float = 0.05
    sink: float = 0.05
    sink_relative: float = 0.25
    clear_height: float = 0.06
    elevation: float = 45.0
    elevation_doubtful: float = 22.5
    min_extent: float = 0.001
    on_overlap: float = 0.3
    on_area_ratio: float = 1.5
    on_footprint_margin: float = 0.10
    on_gap: float = 0.05
    on_gap_relative: float = 0.15
    on_gap_doubtful: float = 0.15
    in_inflation: float = 0.02
    in_share: float = 0.7
    in_share_doubtful: float = 0.4
    in_below_rim: float = 0.25
    near_diagonals: float = 0.5
    near_diagonals_doubtful: float = 1.0


@dataclass(frozen=True)
class PairMeasures:
    """Measures of all ordered pairs [a, b]; the last dimension is (right, up, forward).

    Attributes
    ----------
    lo, hi, center, extent : (N, 3) float64
        Of each object, metres; extents are at least a millimetre.
    delta : (N, N, 3) float64
        Centre of a less that of b, metres.
    gap : (N, N, 3) float64
        Signed distance between the extents, metres: positive where a lies
        after b along the axis, negative where before, 0 where they overlap.
    overlap, overlap_share : (N, N, 3) float64
        Length of the overlap in metres, and as a share of the shorter extent.
    """

    lo: np.ndarray
    hi: np.ndarray
    center: np.ndarray
    extent: np.ndarray
    delta: np.ndarray
    gap: np.ndarray
    overlap: np.ndarray
    overlap_share: np.ndarray


def known_extents(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """(..., N) bool: objects whose extents ((..., N, 3)) are finite."""
    return np.logical_and.reduce(np.isfinite(np.concatenate([lo, hi], axis=-1)), axis=-1)


def measure_pairs(lo: np.ndarray, hi: np.ndarray, profile: Profile | None = None) -> PairMeasures:
    """What the rules measure, and what the network is given: lo and hi are (N, 3), or (..., N, 3), metres."""
    profile = profile or Profile()
    center, extent = (lo + hi) / 2, np.maximum(hi - lo, profile.min_extent)
    lo_a, hi_a, lo_b, hi_b = lo[..., :, None, :], hi[..., :, None, :], lo[..., None, :, :], hi[..., None, :, :]
    ahead, back = lo_a - hi_b, lo_b - hi_a
    overlap = np.maximum(np.minimum(hi_a, hi_b) - np.maximum(lo_a, lo_b), 0)
    return PairMeasures(
        lo,
        hi,
        center,
        extent,
        delta=center[..., :, None, :] - center[..., None, :, :],
        gap=np.where(ahead > 0, ahead, np.where(back > 0, -back, 0.0)),
        overlap=overlap,
        overlap_share=overlap / np.minimum(extent[..., :, None, :], extent[..., None, :, :]),
    )


def directional_states(lo: np.ndarray, hi: np.ndarray, profile: Profile | None = None) -> np.ndarray:
    """The six directional relations of all ordered pairs.

    Parameters
    ----------
    lo, hi : (N, 3) float
        Extents along (right, up, forward), metres, as `lifting.extents` gives
        them. An object with NaN extents is in doubt (U) with every other one.

    Returns
    -------
    (N, N, 6) int8
        In the order of DIRECTIONAL; the diagonal is F.
    """
    profile = profile or Profile()
    lo, hi = np.asarray(lo, np.float64).reshape(-1, 3), np.asarray(hi, np.float64).reshape(-1, 3)
    known = known_extents(lo, hi)
    pairs = measure_pairs(np.where(known[:, None], lo, 0.0), np.where(known[:, None], hi, 0.0), profile)
    return measured_directions(pairs, known, profile)


def measured_directions(pairs: PairMeasures, known: np.ndarray, profile: Profile) -> np.ndarray:
    """`directional_states` where the pairs, or a batch of scenes, are measured already; `known` is (..., N) bool."""
    widest_gap = np.abs(pairs.gap[..., [0, 2]]).max(axis=-1)
    by_gap = _horizontal(pairs, pairs.gap, profile)
    by_center = _horizontal(pairs, pairs.delta, profile)
    states = np.where((widest_gap < profile.gap_switch)[..., None], by_center, by_gap)
    low, high = profile.gap_switch_band
    switching = (widest_gap >= low) & (widest_gap <= high)
    states[switching[..., None] & (by_gap != by_center)] = U

    above = _above(pairs, profile)
    left, right, front, behind = np.moveaxis(states, -1, 0)
    below = above.swapaxes(-1, -2)
    return _decided(np.stack([left, right, above, below, front, behind], axis=-1), known)


def _decided(states: np.ndarray, known: np.ndarray) -> np.ndarray:
    """int8 states: U where either extents are not known, F of an object to itself."""
    result = states.astype(np.int8)
    result[~(known[..., :, None] & known[..., None, :])] = U
    result[..., np.eye(known.shape[-1], dtype=bool), :] = F
    return result


def _horizontal(pairs: PairMeasures, displacement: np.ndarray, profile: Profile) -> np.ndarray:
    """(..., N, N, 4) states of left, right, front, behind for one reading of the displacement."""
    angle = np.rad2deg(np.arctan2(np.abs(displacement[..., 2]), np.abs(displacement[..., 0])))
    lateral = _overlap_gate(_cone(angle, profile), pairs.overlap_share[..., 0], profile)
    depth = _overlap_gate(_cone(90 - angle, profile), pairs.overlap_share[..., 2], profile)
    distance = np.abs(pairs.center[..., 2])
    dead_depth = np.maximum(
        profile.dead_zone_depth,
        profile.dead_zone_depth_relative * np.maximum(distance[..., :, None], distance[..., None, :]),
    )
    right, forward = pairs.delta[..., 0], pairs.delta[..., 2]
    return np.stack(
        [
            _sign_gate(lateral, -right, profile.dead_zone),
            _sign_gate(lateral, right, profile.dead_zone),
            _sign_gate(depth, -forward, dead_depth),
            _sign_gate(depth, forward, dead_depth),
        ],
        axis=-1,
    )


def _cone(angle: np.ndarray, profile: Profile) -> np.ndarray:
    return np.where(angle <= profile.cone, T, np.where(angle <= profile.doubtful_cone, U, F))


def _overlap_gate(state: np.ndarray, share: np.ndarray, profile: Profile) -> np.ndarray:
    doubted = np.where(share >= profile.overlap_doubts, np.minimum(state, U), state)
    return np.where(share >= profile.overlap_excludes, F, doubted)


def _sign_gate(state: np.ndarray, signed: np.ndarray, dead_zone: np.ndarray | float) -> np.ndarray:
    return np.where(signed <= 0, F, np.where(signed < dead_zone, np.minimum(state, U), state))


def _above(pairs: PairMeasures, profile: Profile) -> np.ndarray:
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
    doubtful = (plan >= profile.plan_overlap_doubtful) & resting | raised & (elevation >= profile.elevation_doubtful)
    state = np.where(holds, T, np.where(doubtful, U, F))
    return _sign_gate(state, pairs.delta[..., 1], profile.dead_zone)


def pairwise_states(
    lo: np.ndarray, hi: np.ndarray, clouds: Sequence[np.ndarray] | None = None, profile: Profile | None = None
) -> np.ndarray:
    """All relations that have a state for every ordered pair.

    Parameters
    ----------
    lo, hi : (N, 3) float
        Extents along (right, up, forward), metres.
    clouds : sequence of (M, 3) float, optional
        Each object's points along (right, up, forward); `on` reads the height
        of the supporting surface from them and `in` counts them. Without
        points the extents stand in.

    Returns
    -------
    (N, N, 9) int8
        In the order of PAIRWISE; the diagonal is F.
    """
    profile = profile or Profile()
    lo, hi = np.asarray(lo, np.float64).reshape(-1, 3), np.asarray(hi, np.float64).reshape(-1, 3)
    known = known_extents(lo, hi)
    clean_lo, clean_hi = np.where(known[:, None], lo, 0.0), np.where(known[:, None], hi, 0.0)
    pairs = measure_pairs(clean_lo, clean_hi, profile)
    surface = supporting_surfaces(clean_lo, clean_hi, clouds, profile)
    return measured_states(pairs, known, surface, enclosed_shares(pairs, clouds, profile), profile)


def measured_states(
    pairs: PairMeasures, known: np.ndarray, surface: np.ndarray, share: np.ndarray, profile: Profile
) -> np.ndarray:
    """`pairwise_states` where everything is measured already, of one scene or of a batch.

    Parameters
    ----------
    known : (..., N) bool
    surface, share : (..., N, N) float64
        From `supporting_surfaces` and `enclosed_shares`.

    Returns
    -------
    (..., N, N, 9) int8
    """
    found = [_on(pairs, surface, profile), _in(pairs, share, profile), _near(pairs, profile)]
    directions = measured_directions(pairs, known, profile)
    return np.concatenate([directions, _decided(np.stack(found, axis=-1), known)], axis=-1)


def on_measures(
    pairs: PairMeasures, clouds: Sequence[np.ndarray] | None, profile: Profile
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What decides "a on b".

    Returns
    -------
    covered : (N, N) float64
        Share of a's footprint that lies over b's.
    area_ratio : (N, N) float64
        Footprint of a over that of b.
    gap : (N, N) float64
        Metres between a's bottom and the surface of b under it.
    """
    return _on_surfaces(pairs, supporting_surfaces(pairs.lo, pairs.hi, clouds, profile))


def _on_surfaces(pairs: PairMeasures, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    area = pairs.extent[..., 0] * pairs.extent[..., 2]
    covered = pairs.overlap[..., 0] * pairs.overlap[..., 2] / area[..., :, None]
    return covered, area[..., :, None] / area[..., None, :], np.abs(pairs.lo[..., :, None, 1] - surface)


def _on(pairs: PairMeasures, surface: np.ndarray, profile: Profile) -> np.ndarray:
    covered, area_ratio, gap = _on_surfaces(pairs, surface)
    supported = (covered >= profile.on_overlap) & (area_ratio < profile.on_area_ratio)
    touching = np.maximum(profile.on_gap, profile.on_gap_relative * pairs.extent[..., 1])[..., :, None]
    state = np.where(
        supported & (gap <= touching), T, np.where(supported & (gap <= profile.on_gap_doubtful), U, F)
    )
    # Of two flat things at one height only the one whose middle is higher can be on the other.
    mutual = (state >= U) & (state.swapaxes(-1, -2) >= U)
    return np.where(mutual & (pairs.delta[..., 1] <= 0), F, state)


def supporting_surfaces(
    lo: np.ndarray, hi: np.ndarray, clouds: Sequence[np.ndarray] | None, profile: Profile
) -> np.ndarray:
    """(N, N) float64: the height of b's surface under a, metres; extents lo and hi are (N, 3)."""
    found = np.empty((len(lo), len(lo)))
    for b in range(len(lo)):
        found[:, b] = surface_heights(lo, hi, None if clouds is None else clouds[b], hi[b, 1], profile)
    return found


def surface_heights(
    lo: np.ndarray, hi: np.ndarray, cloud: np.ndarray | None, top: float, profile: Profile
) -> np.ndarray:
    """(N,) height of one object under and around footprints: the 95th percentile of its points there.

    Parameters
    ----------
    lo, hi : (N, 3) float
        Extents of what may stand on it, metres.
    cloud : (M, 3) float or None
        Its points along (right, up, forward).
    top : float
        Its upper extent, for footprints under which it has no point.
    """
    heights = np.full(len(lo), top)
    if cloud is None or not len(cloud):
        return heights
    cloud = cloud[:: max(1, len(cloud) // 1500)]
    plan = cloud[:, [0, 2]]
    margin = profile.on_footprint_margin
    low, high = lo[:, [0, 2]] - margin, hi[:, [0, 2]] + margin
    under = np.logical_and.reduce((plan[None] >= low[:, None]) & (plan[None] <= high[:, None]), axis=2)
    order = np.argsort(cloud[:, 1])
    rank = np.cumsum(under[:, order], axis=1)
    number = rank[:, -1]
    at = (rank >= np.ceil(0.95 * number)[:, None]).argmax(axis=1)
    return np.where(number > 0, cloud[order, 1][at], heights)


def in_measures(
    pairs: PairMeasures, clouds: Sequence[np.ndarray] | None, profile: Profile
) -> tuple[np.ndarray, np.ndarray]:
    """What decides "a in b".

    Returns
    -------
    share : (N, N) float64
        Share of a's points, or of its extents where it has none, in b's inflated extents.
    below_rim : (N, N) float64
        How far a's bottom lies below b's top, in heights of a.
    """
    return enclosed_shares(pairs, clouds, profile), _below_rim(pairs)


def _below_rim(pairs: PairMeasures) -> np.ndarray:
    return (pairs.hi[..., None, :, 1] - pairs.lo[..., :, None, 1]) / pairs.extent[..., :, None, 1]


def enclosed_shares(pairs: PairMeasures, clouds: Sequence[np.ndarray] | None, profile: Profile) -> np.ndarray:
    """(N, N) float64: the share of a that lies in b's inflated extents."""
    share = np.zeros(pairs.delta.shape[:2])
    for a in range(len(pairs.lo)):
        cloud = None if clouds is None else clouds[a]
        share[a] = enclosed_share(pairs.lo[a], pairs.hi[a], cloud, pairs.lo, pairs.hi, profile)
    return share


def enclosed_share(
    lo_a: np.ndarray, hi_a: np.ndarray, cloud: np.ndarray | None, lo: np.ndarray, hi: np.ndarray, profile: Profile
) -> np.ndarray:
    """(N,) share of one object's points, or of its extents ((3,)) where it has none, in others' ((N, 3)) inflated."""
    low, high = lo - profile.in_inflation, hi + profile.in_inflation
    if cloud is not None and len(cloud):
        cloud = cloud[:: max(1, len(cloud) // 500)]
        return ((cloud[None] >= low[:, None]) & (cloud[None] <= high[:, None])).all(axis=2).mean(axis=1)
    shared = np.minimum(hi_a, high) - np.maximum(lo_a, low)
    return (np.clip(shared, 0, None) / np.maximum(hi_a - lo_a, profile.min_extent)).clip(0, 1).prod(axis=1)


def _in(pairs: PairMeasures, share: np.ndarray, profile: Profile) -> np.ndarray:
    sunk = _below_rim(pairs) >= profile.in_below_rim
    return np.where(
        sunk & (share >= profile.in_share), T, np.where(sunk & (share >= profile.in_share_doubtful), U, F)
    )


def near_measures(pairs: PairMeasures) -> tuple[np.ndarray, np.ndarray]:
    """What decides "a near b": metres between them, and the mean of their diagonals; both (N, N) float64."""
    diagonal = np.linalg.norm(pairs.extent, axis=-1)
    return np.linalg.norm(pairs.gap, axis=-1), (diagonal[..., :, None] + diagonal[..., None, :]) / 2


def _near(pairs: PairMeasures, profile: Profile) -> np.ndarray:
    gap, mean = near_measures(pairs)
    doubtful = np.where(gap <= profile.near_diagonals_doubtful * mean, U, F)
    return np.where(gap <= profile.near_diagonals * mean, T, doubtful)
