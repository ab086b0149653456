"""How far each decision of `viewer-cone-v1` stands from its thresholds, in metres.

Every gate of the rules is written as a slack: at least 0 where the gate is
passed, and as many metres as the measures would have to change for it to turn.
"And" is the least slack, "or" the greatest. The slack of T and the slack of
"T or U" give state and margin together: T by its own slack, F by how much
even U is missed, U by 0.
"""

from __future__ import annotations

import numpy as np

from pipeline.relations.contact import Measured, in_measures, on_measures
from pipeline.relations.pair_measures import PairMeasures, Profile


def horizontal_margins(measured: Measured) -> tuple[np.ndarray, ...]:
    """(N, N) float64 margins of left, right, front and behind, metres; see the module."""
    pairs, profile = measured.pairs, measured.profile
    holds, allows = _horizontal(pairs, profile)
    widest = np.abs(pairs.gap[..., ::2]).max(axis=2)[..., None]
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
    own = np.where(differs, np.sign(own) * np.minimum(np.abs(own), np.maximum(edge, 0)), own)
    return tuple(np.moveaxis(own, -1, 0))


def vertical_margins(measured: Measured) -> tuple[np.ndarray, np.ndarray]:
    """(N, N) float64 margins of above and of below, metres."""
    above = margin_of(*_above(measured.pairs, measured.profile))
    return above, above.T


def margin_of(holds: np.ndarray, allows: np.ndarray) -> np.ndarray:
    """The margin, given the slack of T and that of "T or U"."""
    return np.where(holds >= 0, holds, np.where(allows >= 0, 0.0, allows))


def _horizontal(pairs: PairMeasures, profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Slack of T and of "T or U" of left, right, front, behind.

    Returns
    -------
    (2, N, N, 4) float64 each
        By gaps, and by centres.
    """
    n = len(pairs.center)
    displacement = np.abs(np.stack([pairs.gap[..., ::2], pairs.delta[..., ::2]]))
    distance = np.sqrt(np.square(displacement).sum(axis=-1))[..., None]
    # How far the displacement is off each of the two axes, radians.
    off = np.arctan2(displacement[..., ::-1], displacement)
    extent = pairs.extent[:, ::2]
    shorter = np.minimum(extent[:, None], extent[None, :])
    away = np.abs(pairs.center[:, 2])
    dead = np.full((n, n, 2), profile.dead_zone)
    dead[..., 1] = np.maximum(
        profile.dead_zone_depth, profile.dead_zone_depth_relative * np.maximum(away[:, None], away[None, :])
    )
    side = np.stack([-pairs.delta[..., ::2], pairs.delta[..., ::2]], axis=-1)
    slacks = []
    for cone, excess, zone in (
        (profile.cone, profile.overlap_doubts, dead),
        (profile.doubtful_cone, profile.overlap_excludes, 0.0 * dead),
    ):
        in_cone = distance * np.sin(np.deg2rad(cone) - off)
        apart = (excess - pairs.overlap_share[..., ::2]) * shorter
        gate = np.minimum(in_cone, apart)[..., None]
        slacks.append(np.minimum(gate, side - zone[..., None]).reshape(2, n, n, 4))
    return slacks[0], slacks[1]


def _above(pairs: PairMeasures, profile: Profile) -> tuple[np.ndarray, np.ndarray]:
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


def on_margins(measured: Measured) -> np.ndarray:
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


def in_margins(measured: Measured) -> np.ndarray:
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
