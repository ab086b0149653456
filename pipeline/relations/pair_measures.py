"""The thresholds of the relation profile, and what it measures of every ordered pair of objects.

States are three-valued: T (+1) a relation holds, F (-1) it does not, U (0) it is too close to call.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

T, U, F = 1, 0, -1
NOT_JUDGED = -128
"""Stands for null in arrays of states: U is a state, and a pair without one was not judged."""


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
