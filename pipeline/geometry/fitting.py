"""Oriented boxes from points: upright, and the paper's PCA box with its canonical form."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes

LOW_PERCENT, HIGH_PERCENT = 1.0, 99.0
CONTRAST = 0.2
"""Contrast of `plan_yaw` above which an outline claims a direction."""
LEAST_DEPTH = 0.5
"""Least depth of a thing with sides, as a share of its width: half is seen of few."""
YAWS = np.deg2rad(np.arange(0, 90, 3.0))
YAW_POINTS = 160
NEAREST = 0.01
"""Distances to a side below this count alike, metres."""


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


def upright_box(points: np.ndarray, viewer: ViewerAxes, margin: float = 0.0) -> tuple[Box3D, float]:
    """Fit the upright box to (N, 3) points of what is seen of an object, camera frame, metres.

    Its sides lie along the outline in plan (`plan_yaw`), or face the viewer where that claims no direction. `margin` is
    the rim, metres, that erosion took from the mask: it is given back across the viewing ray. Behind what is seen the
    box goes on until its depth is at least LEAST_DEPTH of its width, all of it where no direction is claimed: such
    things are mostly round. The axes are near (right, down, forward), so that `size` reads (width, height, depth).
    Beside the box stands the yaw confidence, 0..1, above .5 where a direction is claimed.
    """
    R_level_camera = viewer.R_level_camera
    level = points.astype(np.float64) @ R_level_camera.T
    yaw, contrast = plan_yaw(level[:, [0, 2]])
    claimed = contrast > CONTRAST
    center = level.mean(axis=0)
    if not claimed:
        yaw = np.arctan2(center[2], center[0]) - np.pi / 2
    cos, sin = np.cos(yaw), np.sin(yaw)
    R = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    along = level @ R
    lo, hi = along.min(axis=0), along.max(axis=0)
    ray = center @ R
    across = np.sqrt(np.maximum(1 - (ray / max(np.linalg.norm(ray), 1e-9)) ** 2, 0))
    lo, hi = lo - margin * across, hi + margin * across
    size = hi - lo
    deep, wide = (0, 2) if abs(ray[0]) > abs(ray[2]) else (2, 0)
    hidden = max((LEAST_DEPTH if claimed else 1.0) * size[wide] - size[deep], 0.0)
    if ray[deep] > 0:
        hi[deep] += hidden
    else:
        lo[deep] -= hidden
    center = R_level_camera.T @ (R @ ((lo + hi) / 2))
    R, size = _canonical(R, hi - lo)
    return Box3D(center, R_level_camera.T @ R, size), contrast / (contrast + CONTRAST)


def plan_yaw(plan: np.ndarray) -> tuple[float, float]:
    """Find the direction of the sides of an outline in plan, (N, 2) metres: angle in 0..pi/2, and its contrast.

    The closeness criterion for L-shaped views (Zhang, Xu, Dong and Dolan 2017): points lie near the two sides that are
    seen. The contrast is how far the best angle stands above the median one; of round things about 0.
    """
    points = plan[:: max(1, len(plan) // YAW_POINTS)]
    coarse = _closeness(points, YAWS)
    best = YAWS[int(coarse.argmax())] + np.deg2rad(np.arange(-2, 2.5, 0.5))
    fine = _closeness(points, best)
    median = float(np.median(coarse))
    return float(best[int(fine.argmax())] % (np.pi / 2)), float(fine.max() - median) / median


def _closeness(points: np.ndarray, yaws: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(yaws), np.sin(yaws)
    along = (np.array([[cos, sin], [-sin, cos]]).transpose(0, 2, 1) @ points.T).astype(np.float32)
    side = np.minimum(along - along.min(axis=2, keepdims=True), along.max(axis=2, keepdims=True) - along)
    return (1 / np.maximum(side.min(axis=0), np.float32(NEAREST))).sum(axis=1)


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
    return Box3D(box.center, *_canonical(box.R, box.size))


def _canonical(R: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    agreement = np.einsum("ij,mij->m", R, AXIS_RELABELLINGS)
    M = AXIS_RELABELLINGS[int(np.flatnonzero(agreement >= agreement.max() - 1e-9)[0])]
    return R @ M.T, np.abs(M) @ size


def _box_in(points: np.ndarray, R: np.ndarray) -> Box3D:
    lo, hi = extents_of(points @ R)
    return Box3D(R @ ((lo + hi) / 2), R, hi - lo)
