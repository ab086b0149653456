"""Thresholds of the relation profile, and measures of every ordered pair of objects.

on, in and near ask for contact, by extents and by points. "a RELATION b" is entry [a, b]; leading dimensions are a
batch of scenes. Extents and points are along the viewer's (right, up, forward), metres.

States are three-valued: T (+1) a relation holds, F (-1) it does not, U (0) it is too close to call.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from pipeline.system.frozen import dataclass

T, U, F = 1, 0, -1
NOT_JUDGED = -128
"""Stands for null in arrays of states: U is a state, and a pair without one was not judged."""


@dataclass(frozen=True)
class Profile:
    """Thresholds of `viewer-cone-v1`; lengths in metres, angles in degrees."""

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
    """Measures of all ordered pairs [a, b]; the last dimension is (right, up, forward)."""

    # lo, hi, center, extent: (N, 3) float64: of each object, metres; extents are at least a millimetre
    lo: np.ndarray
    hi: np.ndarray
    center: np.ndarray
    extent: np.ndarray
    delta: np.ndarray  # (N, N, 3) float64: centre of a less that of b, metres
    # (N, N, 3) float64: signed distance between the extents, metres: positive where a lies after b along the axis,
    # negative where before, 0 where they overlap
    gap: np.ndarray
    # overlap, overlap_share: (N, N, 3) float64: length of the overlap in metres, and as a share of the shorter extent
    overlap: np.ndarray
    overlap_share: np.ndarray


def known_extents(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """(..., N) bool: objects with finite extents ((..., N, 3))."""
    return np.logical_and.reduce(np.isfinite(np.concatenate([lo, hi], axis=-1)), axis=-1)


def measure_pairs(lo: np.ndarray, hi: np.ndarray, profile: Profile | None = None) -> PairMeasures:
    """Measures of all ordered pairs for rules and network: lo and hi are (N, 3), or (..., N, 3), metres.

    >>> import numpy as np
    >>> lo = np.array([[-0.5, 0.0, 1.0], [0.0, 0.0, 1.0]])
    >>> measure_pairs(lo, lo + 0.1).gap[0, 1].round(3).tolist()
    [-0.4, 0.0, 0.0]
    """
    profile = profile or Profile()
    center, extent = (lo + hi) / 2, np.maximum(hi - lo, profile.min_extent)
    own = [np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in (lo, hi, center, extent)]
    between = measures_between([part[..., :, None] for part in own], [part[..., None, :] for part in own])
    return PairMeasures(lo, hi, center, extent, *(np.moveaxis(part, 0, -1) for part in between))


def measures_between(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """`delta`, `gap`, `overlap` and `overlap_share` of PairMeasures, (3, ...), of `lo`, `hi`, `center` and `extent` of
    either, (3, ...) each: an axis after the other, as numbers side by side are worked through several times as fast.
    """
    (lo_a, hi_a, center_a, extent_a), (lo_b, hi_b, center_b, extent_b) = a, b
    ahead, back = lo_a - hi_b, lo_b - hi_a
    overlap = np.maximum(np.minimum(hi_a, hi_b) - np.maximum(lo_a, lo_b), 0)
    gap = np.where(ahead > 0, ahead, np.where(back > 0, -back, 0.0))
    return center_a - center_b, gap, overlap, overlap / np.minimum(extent_a, extent_b)


_BEYOND_EXTENTS = 0.1
"""Of 20 points or more, never so large a share lies beyond the extents to one side: 1st and 99th percentiles."""


@dataclass(frozen=True)
class AllMeasures:
    """All measures of every ordered pair, those of points only on demand."""

    pairs: PairMeasures
    profile: Profile
    # sequence of (M, 3) float: each object's points along (right, up, forward); without them extents stand in
    clouds: Sequence[np.ndarray] | None = None
    # ((..., N, N), (..., N, N)) float64: `surface` and `share` where they are known: of a batch of scenes always
    given: tuple[np.ndarray, np.ndarray] | None = None

    @cached_property
    def displacements(self) -> np.ndarray:
        """(2, 2, ..., N, N) float64: how far apart, metres: by gaps and by centres; to the right and forward."""
        return np.abs(np.stack([np.moveaxis(part[..., ::2], -1, 0) for part in (self.pairs.gap, self.pairs.delta)]))

    @cached_property
    def turns(self) -> np.ndarray:
        """(2, 2, ..., N, N) float64: how far the displacements are off each of the two axes, radians."""
        return np.arctan2(self.displacements[:, ::-1], self.displacements)

    @cached_property
    def surface(self) -> np.ndarray:
        """(..., N, N) float64: height of b's surface under a, metres."""
        if self.given is not None:
            return self.given[0]
        return supporting_surfaces(self.pairs.lo, self.pairs.hi, self.clouds, self.profile)

    @cached_property
    def share(self) -> np.ndarray:
        """(..., N, N) float64: share of a within b's inflated extents."""
        return enclosed_shares(self.pairs, self.clouds, self.profile) if self.given is None else self.given[1]


def on_measures(measured: AllMeasures) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measures deciding "a on b".

    Returns `covered` (N, N) float64: share of a's footprint that lies over b's; `area_ratio` (N, N) float64: footprint
    of a over that of b; `gap` (N, N) float64: metres between a's bottom and the surface of b under it.
    """
    return _on_surfaces(measured.pairs, measured.surface)


def _on_surfaces(pairs: PairMeasures, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    area = pairs.extent[..., 0] * pairs.extent[..., 2]
    covered = pairs.overlap[..., 0] * pairs.overlap[..., 2] / area[..., :, None]
    return covered, area[..., :, None] / area[..., None, :], np.abs(pairs.lo[..., :, None, 1] - surface)


def on_states(measured: AllMeasures) -> np.ndarray:
    """(..., N, N) states of "a on b"."""
    pairs, profile = measured.pairs, measured.profile
    covered, area_ratio, gap = on_measures(measured)
    supported = (covered >= profile.on_overlap) & (area_ratio < profile.on_area_ratio)
    touching = np.maximum(profile.on_gap, profile.on_gap_relative * pairs.extent[..., 1])[..., :, None]
    state = np.where(supported & (gap <= touching), T, np.where(supported & (gap <= profile.on_gap_doubtful), U, F))
    # Of two flat things at one height only the one whose middle is higher can be on the other.
    mutual = (state >= U) & (state.swapaxes(-1, -2) >= U)
    return np.where(mutual & (pairs.delta[..., 1] <= 0), F, state)


def supporting_surfaces(
    lo: np.ndarray, hi: np.ndarray, clouds: Sequence[np.ndarray] | None, profile: Profile
) -> np.ndarray:
    """(N, N) float64: height of b's surface under a, metres; extents lo and hi are (N, 3)."""
    found = np.empty((len(lo), len(lo)))
    for b in range(len(lo)):
        found[:, b] = surface_heights(lo, hi, None if clouds is None else clouds[b], hi[b, 1], profile)
    return found


def surface_heights(
    lo: np.ndarray, hi: np.ndarray, cloud: np.ndarray | None, top: float, profile: Profile
) -> np.ndarray:
    """(N,) heights of one object under and around footprints: the 95th percentile of the points there.

    `lo`, `hi`: (N, 3) float: extents of what may stand on it, metres; `cloud`: (M, 3) float: its points along (right,
    up, forward); `top`: its upper extent, for footprints under which it has no point.
    """
    heights = np.full(len(lo), top)
    if cloud is None or not len(cloud):
        return heights
    cloud = cloud[:: max(1, len(cloud) // 1500)]
    plan = cloud[:, [0, 2]]
    margin = profile.on_footprint_margin
    low, high = lo[:, [0, 2]] - margin, hi[:, [0, 2]] + margin
    # Most footprints are nowhere near: only the others need be compared with each point.
    near = np.flatnonzero((low <= plan.max(axis=0)).all(axis=1) & (high >= plan.min(axis=0)).all(axis=1))
    if not len(near):
        return heights
    low, high = low[near, None], high[near, None]
    under = np.logical_and.reduce((plan[None] >= low) & (plan[None] <= high), axis=2)
    order = np.argsort(cloud[:, 1])
    rank = np.cumsum(under[:, order], axis=1)
    number = rank[:, -1]
    at = (rank >= np.ceil(0.95 * number)[:, None]).argmax(axis=1)
    heights[near] = np.where(number > 0, cloud[order, 1][at], heights[near])
    return heights


def in_measures(measured: AllMeasures) -> tuple[np.ndarray, np.ndarray]:
    """Measures deciding "a in b".

    Returns `share` (N, N) float64: share of a's points, or of its extents where it has none, in b's inflated extents;
    `below_rim` (N, N) float64: how far a's bottom lies below b's top, in heights of a.
    """
    return measured.share, _below_rim(measured.pairs)


def _below_rim(pairs: PairMeasures) -> np.ndarray:
    return (pairs.hi[..., None, :, 1] - pairs.lo[..., :, None, 1]) / pairs.extent[..., :, None, 1]


def points_decide(pairs: PairMeasures, profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Pairs ((..., N, N) bool) decided by points for `on` and for `in`: elsewhere extents alone say F."""
    covered, area_ratio, _ = _on_surfaces(pairs, np.zeros(pairs.delta.shape[:-1]))
    surface = (covered >= profile.on_overlap) & (area_ratio < profile.on_area_ratio)
    share = _below_rim(pairs) >= profile.in_below_rim
    if profile.in_share_doubtful > _BEYOND_EXTENTS:
        share &= (np.abs(pairs.gap) <= profile.in_inflation).all(axis=-1)
    return surface, share


def enclosed_shares(pairs: PairMeasures, clouds: Sequence[np.ndarray] | None, profile: Profile) -> np.ndarray:
    """(N, N) float64: share of a within b's inflated extents."""
    share = np.zeros(pairs.delta.shape[:2])
    for a in range(len(pairs.lo)):
        cloud = None if clouds is None else clouds[a]
        share[a] = enclosed_share(pairs.lo[a], pairs.hi[a], cloud, pairs.lo, pairs.hi, profile)
    return share


def enclosed_share(
    lo_a: np.ndarray, hi_a: np.ndarray, cloud: np.ndarray | None, lo: np.ndarray, hi: np.ndarray, profile: Profile
) -> np.ndarray:
    """(N,) share of one object's points, else of its extents ((3,)), within others' ((N, 3)) inflated extents."""
    low, high = lo - profile.in_inflation, hi + profile.in_inflation
    if cloud is not None and len(cloud):
        cloud = cloud[:: max(1, len(cloud) // 500)]
        # Most boxes hold none of the points.
        near = np.flatnonzero((low <= cloud.max(axis=0)).all(axis=1) & (high >= cloud.min(axis=0)).all(axis=1))
        inside = (cloud[None] >= low[near, None]) & (cloud[None] <= high[near, None])
        share = np.zeros(len(low))
        share[near] = inside.all(axis=2).mean(axis=1)
        return share
    shared = np.minimum(hi_a, high) - np.maximum(lo_a, low)
    return (np.clip(shared, 0, None) / np.maximum(hi_a - lo_a, profile.min_extent)).clip(0, 1).prod(axis=1)


def in_states(measured: AllMeasures) -> np.ndarray:
    """(..., N, N) states of "a in b"."""
    profile, (share, below_rim) = measured.profile, in_measures(measured)
    sunk = below_rim >= profile.in_below_rim
    return np.where(sunk & (share >= profile.in_share), T, np.where(sunk & (share >= profile.in_share_doubtful), U, F))


def near_measures(pairs: PairMeasures) -> tuple[np.ndarray, np.ndarray]:
    """Measures deciding "a near b": distance in metres, and the mean of both diagonals; (N, N) float64 each."""
    diagonal = np.linalg.norm(pairs.extent, axis=-1)
    return np.linalg.norm(pairs.gap, axis=-1), (diagonal[..., :, None] + diagonal[..., None, :]) / 2
