"""Dashed lines for pictures that can draw only whole ones."""

from __future__ import annotations

import numpy as np


def dashed(segments: np.ndarray, period: float, share: float = 0.55) -> np.ndarray:
    """Line segments cut into dashes.

    Parameters
    ----------
    segments : (N, 2, D) float
        Start and end of each.
    period : float
        Length of a dash with its gap, about: each segment holds a whole number of dashes, and ends with one.
    share : float
        Of the dash in it, 0..1.

    Returns
    -------
    (M, 2, D) float32
        In the order of the segments.
    """
    segments = np.asarray(segments, np.float64)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    count = np.maximum(np.ceil(length / period), 1).astype(int)
    which = np.repeat(np.arange(len(segments)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    # With the last gap left out, so that every corner is drawn.
    whole = count[which] - (1 - share)
    ends = np.stack([number / whole, np.minimum((number + share) / whole, 1.0)], axis=1)
    start, step = segments[which, 0], segments[which, 1] - segments[which, 0]
    return (start[:, None] + ends[..., None] * step[:, None]).astype(np.float32)
