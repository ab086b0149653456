"""Solids of the regions of above, below, on, in and near, as outlines at several heights joined by walls.

Places are those of the target's centre, along (right, up, forward), metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pipeline.relations.relations import Profile

_CORNER_STEPS = 8
SOLIDS = ("above", "below", "on", "in", "near")
"""The relations whose regions are solids."""
Solid = tuple[str, np.ndarray, np.ndarray]
"""Label, triangles (M, 3, 3), segments (S, 2, 3)."""


def solids(
    lo: np.ndarray, hi: np.ndarray, size: np.ndarray, relation: str, profile: Profile, reach: float
) -> list[Solid]:
    """T and U of a relation around extents lo and hi ((3,)) for a target of a size ((3,))."""
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
    """A slab over the upper face; where the reference has points the rule takes their height instead."""
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
    """The box of places at which no axis alone leaves more of the target outside than is allowed."""
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


def _near(
    middle: np.ndarray, half: np.ndarray, extent: np.ndarray, size: np.ndarray, profile: Profile
) -> list[Solid]:
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
    """(K, 2) outline of the places at which the two overlap in plan by a share of the smaller footprint.

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
    return np.concatenate(
        [quarter[::-1] * [1, 1], quarter * [-1, 1], quarter[::-1] * [-1, -1], quarter * [1, -1]]
    )[::-1]


def _loft(middle: np.ndarray, rings: Sequence[np.ndarray], heights: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles and segments of a solid with one outline ((K, 2), all of one K) at each height, closed at both ends."""
    levels = []
    for ring, height in zip(rings, heights, strict=True):
        points = np.empty((len(ring), 3))
        points[:, [0, 2]], points[:, 1] = middle[[0, 2]] + ring, middle[1] + height
        levels.append(points)
    triangles, lines = [], []
    for points in levels:
        lines.append(np.stack([points, np.roll(points, -1, axis=0)], axis=1))
    for low, high in pairwise(levels):
        next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        triangles += [np.stack([low, next_low, high], axis=1), np.stack([next_low, next_high, high], axis=1)]
        lines.append(np.stack([low, high], axis=1)[:: max(1, len(low) // 4)])
    for points in (levels[0], levels[-1]):
        center = np.broadcast_to(points.mean(axis=0), points.shape)
        triangles.append(np.stack([center, points, np.roll(points, -1, axis=0)], axis=1))
    return np.concatenate(triangles), np.concatenate(lines)
