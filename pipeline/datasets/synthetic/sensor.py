"""A structured-light depth camera's errors: noise that grows with distance, holes, flying pixels."""

from __future__ import annotations

import numpy as np

HOLE_SHARE = 0.30
FLYING_SHARE = 0.25
"""Shares of the pixels at depth edges that come back empty, or in between."""

FARTHEST_M = 8.0
EDGE_M = 0.04


def noise_sigma(z: np.ndarray) -> np.ndarray:
    """Standard deviation of the depth noise in metres at depth z (metres).

    1.2 mm * (0.4 + z^2): the quadratic growth of structured-light error
    (Khoshelham and Elberink 2012), as used for the measurements of the method.
    """
    return 0.0012 * (0.4 + np.square(z))


def sense(exact: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What the sensor would report of an exact depth map.

    Parameters
    ----------
    exact : (H, W) float32
        Metres along z; 0 where nothing was hit.
    rng : numpy.random.Generator

    Returns
    -------
    (H, W) float32
        Metres; 0 where nothing came back: at depth edges, beyond the range, at
        grazing angles now and then.
    """
    exact = np.asarray(exact, dtype=np.float32)
    valid = exact > 0
    low = np.where(valid, exact, np.inf)
    high = exact.copy()
    for axis in (0, 1):
        for shift in (-1, 1):
            moved = np.roll(exact, shift, axis)
            edge = [slice(None), slice(None)]
            edge[axis] = slice(0, 1) if shift == 1 else slice(-1, None)
            moved[tuple(edge)] = exact[tuple(edge)]
            low = np.minimum(low, np.where(moved > 0, moved, np.inf))
            high = np.maximum(high, moved)
    low = np.where(np.isfinite(low), low, exact)
    step = np.where(valid, high - low, 0.0)
    at_edge = step > EDGE_M * np.maximum(1.0, exact)
    draw = rng.random(exact.shape, dtype=np.float32)
    mix = rng.random(exact.shape, dtype=np.float32)
    noisy = exact + noise_sigma(exact).astype(np.float32) * rng.standard_normal(exact.shape, dtype=np.float32)
    flying = at_edge & (draw >= HOLE_SHARE) & (draw < HOLE_SHARE + FLYING_SHARE)
    noisy = np.where(flying, low + mix * (high - low), noisy)
    lost = (at_edge & (draw < HOLE_SHARE)) | (exact > FARTHEST_M) | (draw > 0.9985)
    return np.where(valid & ~lost, np.maximum(noisy, 0.05), 0.0).astype(np.float32)
