"""Oriented boxes from points: upright, and the paper's PCA box with its canonical form."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes

LOW_PERCENT, HIGH_PERCENT = 1.0, 99.0


def _proper_signed_permutations() -> np.ndarray:
    found = []
    for order in permutations(range(3)):
        for signs in product((-1.0, 1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), order] = signs
            if np.linalg.det(M) > 0:
                found.append(M)
    return np.array(sorted(found, key=lambda M: M.ravel().tolist()))


AXIS_RELABELLINGS = _proper_signed_permutations()
"""(24, 3, 3): all proper ways to rename the axes of a box, in lexicographic order."""


def extents_of(coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1st and 99th percentile of each column of (N, D) coordinates, as two (D,) float64.

    Linear interpolation between order statistics, as numpy's default; a partial
    sort of the few needed ranks is several times faster than a full one.
    """
    n = len(coordinates)
    ranks = np.array([LOW_PERCENT, HIGH_PERCENT]) / 100 * (n - 1)
    below = np.floor(ranks).astype(int)
    above = np.minimum(below + 1, n - 1)
    # Always a copy: the partial sort is in place, and one column is contiguous as it is.
    columns = np.array(coordinates.T, order="C")
    columns.partition(np.unique(np.concatenate([below, above])), axis=1)
    low = columns[:, below].astype(np.float64)
    value = low + (columns[:, above] - low) * (ranks - below)
    return value[:, 0], value[:, 1]


def gravity_box(points: np.ndarray, viewer: ViewerAxes) -> tuple[Box3D, float]:
    """Fit the upright box to (N, 3) points, camera frame, metres: yaw by PCA in plan, sizes by percentiles.

    The axes are near (right, down, forward), so that `size` reads (width, height, depth). Beside the box stands the
    yaw confidence, 1 - l2/l1 of the plan's variances.
    """
    R_level_camera = viewer.R_level_camera
    level = points.astype(np.float64) @ R_level_camera.T
    plan = level[:, [0, 2]]
    centred = plan - plan.mean(axis=0)
    variance, axes = np.linalg.eigh(centred.T @ centred / max(len(plan), 1))
    cos, sin = axes[:, 1]
    box = _box_in(level, np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]))
    confidence = 1.0 - float(max(variance[0], 0.0) / variance[1]) if variance[1] > 1e-12 else 0.0
    box = canonicalised(box)
    return Box3D(R_level_camera.T @ box.center, R_level_camera.T @ box.R, box.size), confidence


def pca_box(points: np.ndarray, viewer: ViewerAxes | None = None) -> tuple[Box3D, float]:
    """Fit the paper's box to (N, 3) points, camera frame, metres: axes by PCA in falling order, sizes by percentiles.

    With a viewer, the axes are renamed to be nearest to the level camera frame. Beside the box stands the confidence,
    1 - l2/l1 of the variances.
    """
    cloud = points.astype(np.float64)
    centred = cloud - cloud.mean(axis=0)
    variance, axes = np.linalg.eigh(centred.T @ centred / len(cloud))
    R = axes[:, ::-1].copy()
    if np.linalg.det(R) < 0:
        R[:, 2] = -R[:, 2]
    box = _box_in(cloud, R)
    if viewer is not None:
        R_level_camera = viewer.R_level_camera
        level = canonicalised(Box3D(R_level_camera @ box.center, R_level_camera @ box.R, box.size))
        box = Box3D(R_level_camera.T @ level.center, R_level_camera.T @ level.R, level.size)
    confidence = 1.0 - float(max(variance[1], 0.0) / variance[2]) if variance[2] > 1e-12 else 0.0
    return box, confidence


def canonicalised(box: Box3D) -> Box3D:
    """Rename a box's axes to be nearest to the axes of its frame; the solid stays the same.

    Of the 24 proper signed permutations M the one with the largest
    trace(R M^T) is taken, the lexicographically first where several tie; then
    R <- R M^T and size <- |M| size.
    """
    agreement = np.einsum("ij,mij->m", box.R, AXIS_RELABELLINGS)
    M = AXIS_RELABELLINGS[int(np.flatnonzero(agreement >= agreement.max() - 1e-9)[0])]
    return Box3D(box.center, box.R @ M.T, np.abs(M) @ box.size)


def _box_in(points: np.ndarray, R: np.ndarray) -> Box3D:
    lo, hi = extents_of(points @ R)
    return Box3D(R @ ((lo + hi) / 2), R, hi - lo)
