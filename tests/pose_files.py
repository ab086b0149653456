"""Pose matrices as a file of another convention holds them, to be read by the doctor and its tests."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.camera import _AXES, _WAYS, _inverse, _reordered


def as_convention(T: np.ndarray, convention: str) -> np.ndarray:
    """Matrices of a file in a convention, (..., 4, 4), for standard poses; the inverse of `standard_poses`."""
    way, axes, *order = convention.split()
    out = np.array(T, np.float64)
    out[..., :3, :3] = out[..., :3, :3] @ _AXES[axes].T
    if way == _WAYS[1]:
        out = _inverse(out)
    if order:
        out[..., :3, :3] = _reordered(out[..., :3, :3], -1)
    return out
