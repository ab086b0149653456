"""How far each decision of `viewer-cone-v1` stands from its thresholds, in metres.

Every gate of the rules is written as a slack: at least 0 where the gate is
passed, and as many metres as the measures would have to change for it to turn.
"And" is the least slack, "or" the greatest. The slack of T and the slack of
"T or U" give state and margin together: T by its own slack, F by how much
even U is missed, U by 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.relations import (
    PairMeasures,
    Profile,
    in_measures,
    near_measures,
    on_measures,
)


def directional_margins(pairs: PairMeasures, profile: Profile) -> np.ndarray:
    """(N, N, 6) float64 margins in the order of DIRECTIONAL, metres; see the module."""
    by_gap = _horizontal(pairs, pairs.gap, profile)
    by_center = _horizontal(pairs, pairs.delta, profile)
    widest = np.abs(pairs.gap[..., [0, 2]]).max(axis=2)[..., None]
    low, high = profile.gap_switch_band
    holds = np.where(widest < low, by_center[0], by_gap[0])
    allows = np.where(widest < low, by_center[1], by_gap[1])
    between = (widest >= low) & (widest <= high)
    holds = np.where(between, np.minimum(by_gap[0], by_center[0]), holds)
    allows = np.where(between, np.maximum(by_gap[1], by_center[1]), allows)
    own = margin_of(holds, allows)
    # Outside the band the other reading takes over at its edge; where it would
    # decide otherwise, that edge is as near as any threshold.
    other = np.where(widest < low, margin_of(*by_gap), margin_of(*by_center))
    edge = np.where(widest < low, low - widest, widest - high)
    differs = ~between & (np.sign(other) != np.sign(own))
    own = np.where(differs, np.sign(own) * np.minimum(np.abs(own), np.maximum(edge, 0)), own)
    left, right, front, behind = np.moveaxis(own, 2, 0)
    above = margin_of(*_above(pairs, profile))
    return np.stack([left, right, above, above.T, front, behind], axis=2)


def margin_of(holds: np.ndarray, allows: np.ndarray) -> np.ndarray:
    """The margin, given the slack of T and that of "T or U"."""
    return np.where(holds >= 0, holds, np.where(allows >= 0, 0.0, allows))


def _horizontal(pairs: PairMeasures, displacement: np.ndarray, profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Slack of T and of "T or U" for left, right, front, behind ((N, N, 4) each) under one reading."""
    sideways, away = np.abs(displacement[..., 0]), np.abs(displacement[..., 2])
    distance, angle = np.hypot(sideways, away), np.arctan2(away, sideways)
    shorter = np.minimum(pairs.extent[:, None], pairs.extent[None, :])
    dead_depth = np.maximum(
        profile.dead_zone_depth,
        profile.dead_zone_depth_relative
        * np.maximum(np.abs(pairs.center[:, None, 2]), np.abs(pairs.center[None, :, 2])),
    )
    dead_zone = {0: profile.dead_zone, 2: dead_depth}
    slacks = []
    for cone, excess, dead in (
        (profile.cone, profile.overlap_doubts, 1.0),
        (profile.doubtful_cone, profile.overlap_excludes, 0.0),
    ):
        found = []
        for axis, off in ((0, angle), (2, np.pi / 2 - angle)):
            in_cone = distance * np.sin(np.deg2rad(cone) - off)
            apart = (excess - pairs.overlap_share[..., axis]) * shorter[..., axis]
            for sign in (-1, 1):
                side = sign * pairs.delta[..., axis] - dead * dead_zone[axis]
                found.append(np.minimum(np.minimum(in_cone, apart), side))
        slacks.append(np.stack(found, axis=2))
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
        resting = np.minimum((plan - overlap) * side, clearance + tolerance)
        raised = np.minimum(clearance - profile.clear_height, reach * np.sin(elevation - np.deg2rad(degrees)))
        slacks.append(np.minimum(np.maximum(resting, raised), pairs.delta[..., 1] - dead))
    return slacks[0], slacks[1]


def contact_margins(pairs: PairMeasures, clouds: Sequence[np.ndarray] | None, profile: Profile) -> np.ndarray:
    """(N, N, 3) float64 margins of on, in and near, metres."""
    area = pairs.extent[:, 0] * pairs.extent[:, 2]
    side = np.sqrt(area)
    covered, ratio, gap = on_measures(pairs, clouds, profile)
    supported = np.minimum(
        (covered - profile.on_overlap) * side[:, None], (profile.on_area_ratio - ratio) * side[None, :]
    )
    touching = np.maximum(profile.on_gap, profile.on_gap_relative * pairs.extent[:, 1])[:, None]
    on = margin_of(
        np.minimum(supported, touching - gap),
        np.minimum(supported, np.maximum(touching, profile.on_gap_doubtful) - gap),
    )
    share, below_rim = in_measures(pairs, clouds, profile)
    length = np.cbrt(pairs.extent.prod(axis=1))[:, None]
    sunk = (below_rim - profile.in_below_rim) * pairs.extent[:, None, 1]
    inside = margin_of(
        np.minimum((share - profile.in_share) * length, sunk),
        np.minimum((share - profile.in_share_doubtful) * length, sunk),
    )
    apart, mean = near_measures(pairs)
    near = margin_of(profile.near_diagonals * mean - apart, profile.near_diagonals_doubtful * mean - apart)
    return np.stack([on, inside, near], axis=2)
