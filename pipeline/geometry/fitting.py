"""Oriented boxes from points: upright, and the paper's PCA box with its canonical form."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes

LOW_PERCENT, HIGH_PERCENT = 1.0, 99.0
CONTRAST = 0.2
"""Contrast of `plan_yaws` above which an outline claims a direction."""
LEAST_DEPTH = 0.5
"""Least depth of a thing with sides, as a share of its width: behind what is seen the box goes on to it."""
THIN_DEPTH = 0.05
"""The same for classes such as pictures and curtains."""
NOISE_ENDS = np.array([1.5, 0.0, 1.5])
"""Standard deviations of the depth by which the outermost points lie outside, along the box's axes: at the top and the
bottom are few points.
"""
MOST_SLANT = 3.0
"""Largest factor by which the rim of a surface seen at a slant is lengthened."""
PART_GAP, PLAN_SLACK = 0.03, 0.01
"""Metres beyond a box's end from which dropped points tell of a part, and beyond its plan within which they do."""
NEAREST = 0.01
"""Distances to a side below this count alike, metres."""
YAW_POINTS = 160
AS_GOOD = 0.99
BLOCK = 4
"""So many outlines are looked at together."""
YAWS = np.deg2rad(np.arange(0, 90, 4.5))
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
    return extents_along(np.ascontiguousarray(coordinates.T))


def extents_along(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`extents_of` of (D, N) coordinates, an axis after the other."""
    n = columns.shape[1]
    ranks = np.array([LOW_PERCENT, HIGH_PERCENT]) / 100 * (n - 1)
    below = np.floor(ranks).astype(int)
    above = np.minimum(below + 1, n - 1)
    share = ranks - below
    # Counted from their own end: what lies between need not be there.
    below[1], above[1] = below[1] - n, above[1] - n
    ordered = np.sort(columns, axis=1) if n < MANY else [_sorted_ends(c, above[0], below[1]) for c in columns]
    low = np.array([column[below] for column in ordered], np.float64)
    value = low + (np.array([column[above] for column in ordered]) - low) * share
    return value[:, 0], value[:, 1]


MANY, EVERY, BEYOND = 1500, 8, 0.025
"""From so many values on, every so many tell about where such a share of them ends."""


def _sorted_ends(values: np.ndarray, low: int, high: int) -> np.ndarray:
    """Values of (N,) in order, without most of those between the places `low` from the start and `high` from the end.

    A whole sort is what numpy does fastest of all that gives several ranks; of the two ends it takes a third of that.
    """
    some = np.sort(values[::EVERY])
    beyond = int(BEYOND * len(some)) + 2
    first, last = values <= some[beyond], values >= some[-1 - beyond]
    told = np.count_nonzero(first) > low and np.count_nonzero(last) >= -high
    return np.sort(values[first | last] if told else values)


def mean_of(points: np.ndarray) -> np.ndarray:
    """Mean of (N, 3) points, N > 0, as (3,) float64: numpy's own sum down the rows, several times as fast."""
    return np.add.reduceat(points.astype(np.float64), [0], axis=0)[0] / len(points)


def median(values: np.ndarray) -> np.ndarray:
    """Median of (..., N) values along the last axis, N > 0, as numpy's, which is slower and loads masked arrays."""
    half = values.shape[-1] // 2
    ordered = np.partition(values, half)
    other = ordered[..., half] if values.shape[-1] % 2 else ordered[..., :half].max(axis=-1)
    return (ordered[..., half] + other) / 2


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
    box = _box_in(level.T, np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]))
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
    """Fit the upright box to (N, 3) points of one object, see `upright_boxes`; beside it stands the yaw confidence."""
    return upright_boxes([points], viewer, margins=[margin], noises=[noise], thin=[thin])[0]


def upright_boxes(
    clouds: Sequence[np.ndarray],
    viewer: ViewerAxes,
    *,
    margins: Sequence[float],
    noises: Sequence[float],
    thin: Sequence[bool],
) -> list[tuple[Box3D, float]]:
    """Fit the upright box to what is seen of each object: its sides lie along the outline in plan (`plan_yaws`).

    Where the outline claims no direction, the box faces the viewer and is as deep as it is wide: such things are mostly
    round, but for thin ones. The axes are near (right, down, forward), so that `size` reads (width, height, depth).
    Beside each box stands the yaw confidence, 0..1: above .5 where a direction is claimed.

    Parameters
    ----------
    clouds : sequence of (N, 3) float
        N > 0; camera frame, metres.
    margins : sequence of float
        The rim that erosion took from each mask, metres across the viewing ray: given back along the sides that are
        seen, to those that are not.
    noises : sequence of float
        Standard deviations of the depth, metres: the outermost points lie NOISE_ENDS of it outside.
    thin : sequence of bool
        Things of the class may be thin (`language.is_thin`), and are not round: THIN_DEPTH and not LEAST_DEPTH holds.
    """
    if not clouds:
        return []
    R_level_camera = viewer.R_level_camera
    counts, flat = np.array([len(points) for points in clouds]), np.array(thin, np.bool_)
    # One array for all: shorter clouds end in copies of their first point. Sums are taken by cloud: a box is the same,
    # bit by bit, whatever is fitted beside it.
    level, center = np.empty((3, len(clouds), counts.max())), np.empty((len(clouds), 3))
    for k, points in enumerate(clouds):
        n, own = len(points), level[:, k]
        own[:, :n] = found = R_level_camera @ np.asarray(points.T, np.float64)
        own[:, n:] = found[:, :1]
        center[k] = np.add.reduce(found, axis=1) / n
    x, y, z = level
    k = np.arange(len(clouds))
    even = np.linspace(0, counts - 1, YAW_POINTS, axis=1).astype(np.intp)
    yaw, contrast = plan_yaws(np.stack([x[k[:, None], even], z[k[:, None], even]], axis=1))
    claimed = flat | (contrast > CONTRAST)
    yaw = np.where(claimed, yaw, np.arctan2(center[:, 2], center[:, 0]) - np.pi / 2)
    # A quarter turn only exchanges width and depth: with less than half of one the axes are near right and forward.
    yaw = (yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4
    cos, sin, zero = np.cos(yaw), np.sin(yaw), np.zeros(len(clouds))
    R = np.array([[cos, zero, -sin], [zero, zero + 1, zero], [sin, zero, cos]]).transpose(2, 0, 1)
    axes = cos[:, None] * x + sin[:, None] * z, y, cos[:, None] * z - sin[:, None] * x
    near, far = (np.stack([end.reduce(axis, axis=1) for axis in axes], axis=1) for end in (np.minimum, np.maximum))
    ray = (center[:, None] @ R)[:, 0]
    length = np.maximum(np.linalg.norm(ray, axis=1), 1e-9)[:, None]
    noisy = np.minimum(NOISE_ENDS * np.array(noises)[:, None] * np.abs(ray) / length, (far - near) / 4)
    # Distances of the sides that are seen, of two opposite ones at most one.
    seen = np.maximum(np.maximum(near, -far), 0)
    # On a surface that is seen at a slant the same rim of the picture is longer.
    slant = np.maximum(seen[:, [1, 0, 0]], seen[:, [2, 2, 1]])
    rim = np.array(margins)[:, None] * np.minimum(length / np.maximum(slant, 1e-9), MOST_SLANT) * (slant > 0)
    lo, hi = near + noisy - rim * (near <= 0), far - noisy + rim * (far >= 0)
    deep = np.where(np.abs(ray[:, 0]) > np.abs(ray[:, 2]), 0, 2)
    least = np.where(claimed, np.where(flat, THIN_DEPTH, LEAST_DEPTH), 1.0)
    behind = np.maximum(least * (hi - lo)[k, 2 - deep] - (hi - lo)[k, deep], 0)
    ahead = ray[k, deep] > 0
    hi[k, deep] += behind * ahead
    lo[k, deep] -= behind * ~ahead
    R = R_level_camera.T @ R
    middle = (R @ ((lo + hi) / 2)[..., None])[..., 0]
    confidence = (contrast / (contrast + CONTRAST)).tolist()
    return [(Box3D(*box), sure) for *box, sure in zip(middle, R, hi - lo, confidence, strict=True)]


def with_thin_parts(box: Box3D, dropped: np.ndarray, least: float) -> Box3D:
    """Extend an upright box up or down to parts that cleaning dropped whole: legs of tables are thinner than rims.

    `dropped`: (N, 3) points of the mask that cleaning dropped, camera frame, metres. A part is told by `least` of them
    within the box's plan and more than PART_GAP beyond its end; of these the outermost twentieth does not count.
    """
    local, half = (dropped - box.center) @ box.R, box.size / 2
    heights = local[np.abs(local[:, 1]) > half[1] + PART_GAP]
    heights = heights[(np.abs(heights[:, ::2]) <= half[::2] + PLAN_SLACK).all(axis=1), 1]
    if not len(heights):
        return box
    ends = [half[1], half[1]]
    for k, outwards in enumerate((-heights, heights)):
        part = np.sort(outwards[outwards > half[1] + PART_GAP])
        if len(part) >= max(least, 1):
            ends[k] = part[len(part) - 1 - len(part) // 20]
    up, down = ends
    if up + down == box.size[1]:
        return box
    size = np.array([box.size[0], up + down, box.size[2]])
    return Box3D(box.center + box.R[:, 1] * (down - up) / 2, box.R, size)


def plan_yaws(plans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the directions of the sides of M outlines in plan, (M, 2, N) metres: angles, 0..pi/2, and contrasts, (M,).

    By the closeness criterion for L-shaped views (Zhang, Xu, Dong and Dolan 2017): points lie near the two sides that
    are seen. The contrast is how far the best angle stands above the median one; of round things about 0.
    """
    plans = plans.astype(np.float32)
    coarse = _closeness(plans, YAWS)
    angles = YAWS[coarse.argmax(axis=1)][:, None] + _FINER
    fine = _closeness(plans, angles)
    best = fine.max(axis=1)
    # The middle of those as good: of a flat front several are.
    good = fine >= AS_GOOD * best[:, None]
    yaw = (angles * good).sum(axis=1) / good.sum(axis=1)
    return yaw % (np.pi / 2), best / median(coarse) - 1


def _closeness(plans: np.ndarray, yaws: np.ndarray) -> np.ndarray:
    """(M, A) float32: of A angles (the same, or (M, A)) in the order given."""
    if len(plans) > BLOCK:
        # What a processor holds beside it: longer arrays take twice the time.
        yaws = np.broadcast_to(yaws, (len(plans), yaws.shape[-1]))
        parts = range(0, len(plans), BLOCK)
        return np.concatenate([_closeness(plans[k : k + BLOCK], yaws[k : k + BLOCK]) for k in parts])
    cos, sin = np.cos(yaws).astype(np.float32), np.sin(yaws).astype(np.float32)
    axes = np.concatenate([np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)], axis=-2)
    along = (axes @ plans).reshape(len(plans), 2, yaws.shape[-1], -1)
    low, high = along.min(axis=3, keepdims=True), along.max(axis=3, keepdims=True)
    near = along - low
    side = np.minimum(near, np.subtract(high, along, out=along), out=near).min(axis=1)
    return np.reciprocal(np.maximum(side, NEAREST, out=side), out=side).sum(axis=2)


def pca_box(points: np.ndarray, viewer: ViewerAxes | None = None) -> tuple[Box3D, float]:
    """Fit the paper's box to (N, 3) points, camera frame, metres: axes by PCA in falling order, sizes by percentiles.

    With a viewer, the axes are renamed to be nearest to the level camera frame. Beside the box stands the confidence,
    1 - l2/l1 of the variances.
    """
    return pca_boxes([points], viewer)[0]


def pca_boxes(clouds: Sequence[np.ndarray], viewer: ViewerAxes | None = None) -> list[tuple[Box3D, float]]:
    """Fit the boxes of `pca_box` to many clouds; each is the same, bit by bit, whatever is fitted beside it."""
    if not clouds:
        return []
    spread, columns = np.empty((len(clouds), 3, 3)), []
    for own, points in zip(spread, clouds, strict=True):
        columns.append(np.ascontiguousarray(points.T, np.float64))
        centred = columns[-1] - mean_of(points)[:, None]
        own[:] = centred @ centred.T / len(points)
    variance, axes = np.linalg.eigh(spread)
    R = axes[:, :, ::-1].copy()
    R[np.linalg.det(R) < 0, :, 2] *= -1
    boxes = [_box_in(own, R) for own, R in zip(columns, R, strict=True)]
    if viewer is not None:
        R_level_camera = viewer.R_level_camera
        levels = (canonicalised(Box3D(R_level_camera @ b.center, R_level_camera @ b.R, b.size)) for b in boxes)
        boxes = [Box3D(R_level_camera.T @ b.center, R_level_camera.T @ b.R, b.size) for b in levels]
    sure = (1.0 - max(second, 0.0) / first if first > 1e-12 else 0.0 for _, second, first in variance.tolist())
    return list(zip(boxes, sure, strict=True))


def canonicalised(box: Box3D) -> Box3D:
    """Rename a box's axes to be nearest to the axes of its frame; the solid stays the same.

    Of the 24 proper signed permutations M the one with the largest
    trace(R M^T) is taken, the lexicographically first where several tie; then
    R <- R M^T and size <- |M| size.
    """
    agreement = np.einsum("ij,mij->m", box.R, AXIS_RELABELLINGS)
    M = AXIS_RELABELLINGS[int(np.flatnonzero(agreement >= agreement.max() - 1e-9)[0])]
    return Box3D(box.center, box.R @ M.T, np.abs(M) @ box.size)


def _box_in(columns: np.ndarray, R: np.ndarray) -> Box3D:
    """Box along the columns of R of points, (3, N)."""
    lo, hi = extents_along(R.T @ columns)
    return Box3D(R @ ((lo + hi) / 2), R, hi - lo)
