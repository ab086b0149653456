"""Oriented boxes from points: upright, and the paper's PCA box with its canonical form."""

from __future__ import annotations

import math
from itertools import permutations, product

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes

LOW_PERCENT, HIGH_PERCENT = 1.0, 99.0
CONTRAST = 0.2
"""Contrast of `plan_yaw` above which an outline claims a direction."""
LEAST_DEPTH = 0.5
"""Least depth of a thing with sides, as a share of its width: behind what is seen the box goes on to it."""
THIN_DEPTH = 0.05
"""The same for classes such as pictures and curtains."""
NOISE_ENDS = (1.5, 0.0, 1.5)
"""Standard deviations of the depth by which the outermost points lie outside, along the box's axes: at the top and the
bottom are few points.
"""
MOST_SLANT = 3.0
"""Largest factor by which the rim of a surface seen at a slant is lengthened."""
NEAREST = 0.01
"""Distances to a side below this count alike, metres."""
YAW_POINTS = 160
AS_GOOD = 0.99
YAWS = np.deg2rad(np.arange(0, 90, 4.5))
_COARSE = np.cos(YAWS), np.sin(YAWS)
_FINER = np.deg2rad(np.arange(-2, 2.5, 0.5))


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

    Linear interpolation between order statistics, as numpy's default.
    """
    n = len(coordinates)
    ranks = np.array([LOW_PERCENT, HIGH_PERCENT]) / 100 * (n - 1)
    below = np.floor(ranks).astype(int)
    above = np.minimum(below + 1, n - 1)
    # A whole sort: numpy vectorises it, and a partial one for several ranks it does not, which takes four times longer.
    columns = np.sort(np.ascontiguousarray(coordinates.T), axis=1)
    low = columns[:, below].astype(np.float64)
    value = low + (columns[:, above] - low) * (ranks - below)
    return value[:, 0], value[:, 1]


def median(values: np.ndarray) -> float:
    """Median of (N,) values, N > 0, as numpy's, at a third of its cost for few values."""
    ordered = np.sort(values)
    return float((ordered[(len(values) - 1) // 2] + ordered[len(values) // 2]) / 2)


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


def upright_box(
    points: np.ndarray,
    viewer: ViewerAxes,
    *,
    margin: float = 0.0,
    noise: float = 0.0,
    thin: bool = False,
) -> tuple[Box3D, float]:
    """Fit the upright box to what is seen of an object: its sides lie along the outline in plan (`plan_yaw`).

    Where the outline claims no direction, the box faces the viewer and is as deep as it is wide: such things are mostly
    round, but for thin ones. The axes are near (right, down, forward), so that `size` reads (width, height, depth).
    Beside the box stands the yaw confidence, 0..1: above .5 where a direction is claimed.

    Parameters
    ----------
    points : (N, 3) float
        Camera frame, metres.
    margin : float
        The rim that erosion took from the mask, metres across the viewing ray: given back along the sides that are
        seen, to those that are not.
    noise : float
        Standard deviation of the depth, metres: the outermost points lie NOISE_ENDS of it outside.
    thin : bool
        Things of the class may be thin (`language.is_thin`), and are not round: THIN_DEPTH and not LEAST_DEPTH holds.
    """
    R_level_camera = viewer.R_level_camera
    level = R_level_camera @ points.T.astype(np.float64)
    yaw, contrast = plan_yaw(level[::2])
    claimed = thin or contrast > CONTRAST
    center = level.mean(axis=1)
    if not claimed:
        yaw = math.atan2(center[2], center[0]) - math.pi / 2
    # A quarter turn only exchanges width and depth: with less than half of one the axes are near right and forward.
    yaw = (yaw + math.pi / 4) % (math.pi / 2) - math.pi / 4
    cos, sin = math.cos(yaw), math.sin(yaw)
    R = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    along = R.T @ level
    lo, hi, ray = along.min(axis=1).tolist(), along.max(axis=1).tolist(), (center @ R).tolist()
    length = max(math.hypot(*ray), 1e-9)
    # Distances of the sides that are seen, of two opposite ones at most one.
    seen = [max(near, -far, 0.0) for near, far in zip(lo, hi, strict=True)]
    for axis, (near, far) in enumerate(zip(lo, hi, strict=True)):
        noisy = min(NOISE_ENDS[axis] * noise * abs(ray[axis]) / length, (far - near) / 4)
        # On a surface seen at a slant the same rim of the picture is longer.
        slant = max(seen[:axis] + seen[axis + 1 :])
        rim = margin * min(length / slant, MOST_SLANT) if slant else 0.0
        lo[axis] = near + noisy - rim * (near <= 0)
        hi[axis] = far - noisy + rim * (far >= 0)
    deep, wide = (0, 2) if abs(ray[0]) > abs(ray[2]) else (2, 0)
    least = 1.0 if not claimed else THIN_DEPTH if thin else LEAST_DEPTH
    behind = max(least * (hi[wide] - lo[wide]) - (hi[deep] - lo[deep]), 0.0)
    if ray[deep] > 0:
        hi[deep] += behind
    else:
        lo[deep] -= behind
    ends, R = np.array([lo, hi]), R_level_camera.T @ R
    return Box3D(R @ (ends[0] + ends[1]) / 2, R, ends[1] - ends[0]), contrast / (contrast + CONTRAST)


def plan_yaw(plan: np.ndarray) -> tuple[float, float]:
    """Find the direction of the sides of an outline in plan, (2, N) metres: angle in 0..pi/2, and its contrast.

    By the closeness criterion for L-shaped views (Zhang, Xu, Dong and Dolan 2017): points lie near the two sides that
    are seen. The contrast is how far the best angle stands above the median one; of round things about 0.
    """
    points = plan[:, :: -(-plan.shape[1] // YAW_POINTS)].astype(np.float32)
    coarse = _closeness(points, *_COARSE)
    best = YAWS[coarse.argmax()] + _FINER
    fine = _closeness(points, np.cos(best), np.sin(best))
    # The middle of those as good: of a flat front several are.
    yaw = float(best[fine >= AS_GOOD * fine.max()].mean())
    return yaw % (math.pi / 2), float(fine.max()) / median(coarse) - 1


def _closeness(points: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    axes = np.concatenate([np.array([cos, sin], np.float32).T, np.array([-sin, cos], np.float32).T])
    along = (axes @ points).reshape(2, len(cos), -1)
    low, high = along.min(axis=2, keepdims=True), along.max(axis=2, keepdims=True)
    side = np.minimum(along - low, high - along).min(axis=0)
    return np.reciprocal(np.maximum(side, NEAREST, out=side), out=side).sum(axis=1)


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
