"""Agreement of camera poses by the surfaces that two views see, and refinement of one pose against other views.

Agreement is matched / (matched + seen through): hidden points say nothing, points that a view looks through contradict
the poses. Refinement is point-to-plane ICP with projective association (Chen and Medioni 1992; Blais and Levine 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

from pipeline.geometry.surface import surface_normals
from pipeline.scenes.views import View, Visibility
from pipeline.system.frozen import dataclass

POINTS = 6_000
"""So many points of a view are compared."""
LEAST_SHARED = 0.05
"""Views that share a smaller part of their points are not compared."""
STEPS, FARTHEST_M = 30, 0.10
"""Steps of refinement, and the distance beyond which two points are no match at first; it shrinks to a quarter."""
LEAST_MATCHED = 200
"""With fewer matched points nothing is refined."""
SETTLED = 1e-5
"""Metres and radians below which a step ends the refinement."""


@dataclass(frozen=True)
class PoseAgreement:
    """Comparison of two views' surfaces under their poses."""

    one: str
    other: str
    matched: int  # Points of either view that lie on the other's surface
    through: int  # Points that the other view looks through
    shared: float  # Matched or looked through, of all compared points, 0..1

    @property
    def agree(self) -> float | None:
        """Share of the deciding points that match, 0..1; None for views that share too little."""
        if self.shared < LEAST_SHARED:
            return None
        return self.matched / (self.matched + self.through)


@dataclass(frozen=True, eq=False)
class Refinement:
    """A view's pose before and after refinement; nothing is changed by it."""

    frame_id: str
    T_world_camera: np.ndarray  # (4, 4) float64, refined
    moved_m: float  # Distance between the camera centres
    turned_deg: float
    matched: int  # Points of the last step
    residual_before_m: float  # Median distance of matched points to the other views' planes
    residual_m: float


def sampled(view: View, most: int = POINTS) -> np.ndarray:
    """World points of a view, evenly spread over its sharp pixels, (N, 3) float32, metres."""
    points = view.points
    return points[:: max(1, len(points) // most)]


def agreement(one: View, other: View, tolerance: float = 1.0) -> PoseAgreement:
    """Compare two views under their poses.

    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.scenes.poses import agreement
    >>> from pipeline.scenes.views import views_of
    >>> one, other = views_of(open_dataset(demo_path()), ("000001/000000", "000001/000001"))
    >>> round(agreement(one, other).agree, 2)
    0.95
    """
    matched = through = compared = 0
    for seeing, seen in ((one, other), (other, one)):
        points = sampled(seen)
        found = seeing.at(*seeing.project(points), tolerance)
        matched += int(np.count_nonzero(found == Visibility.SEEN))
        through += int(np.count_nonzero(found == Visibility.THROUGH))
        compared += len(points)
    return PoseAgreement(one.frame_id, other.frame_id, matched, through, (matched + through) / max(1, compared))


def agreements(views: Sequence[View], tolerance: float = 1.0) -> tuple[PoseAgreement, ...]:
    """Compare each pair of views."""
    return tuple(agreement(one, other, tolerance) for one, other in combinations(views, 2))


def refine(view: View, others: Sequence[View]) -> Refinement | None:
    """Refine a view's pose against the surfaces of other views; None where too little is shared.

    Each step matches the view's points with the points that the other views measured at the same pixels, and moves the
    view by the least squares of the distances to those points' planes.
    """
    points = sampled(view, POINTS)
    surfaces = [(other, *surface_normals(other.depth, other.camera)) for other in others]
    T, first, found, matched = np.eye(4), None, np.inf, 0
    for step in range(STEPS):
        reach = FARTHEST_M * max(0.25, 1 - step / 10)
        moved = points @ T[:3, :3].T + T[:3, 3]
        rows, distances = [], []
        for other, normals, known in surfaces:
            p, n, d = _matches(moved, other, normals, known, reach)
            rows.append(np.hstack([np.cross(p, n), n]))
            distances.append(d)
        A, d = np.concatenate(rows), np.concatenate(distances)
        matched = len(d)
        if matched < LEAST_MATCHED:
            return None
        found = float(np.median(np.abs(d)))
        first = found if first is None else first
        # Huber's weights: what moved between the views pulls less.
        scale = max(1.5 * found, 1e-4)
        w = np.minimum(1.0, scale / np.maximum(np.abs(d), 1e-9))
        # Where all surfaces are parallel nothing holds the view along them: the damping does.
        damping = 1e-3 * np.trace(A.T @ (w[:, None] * A)) / 6 * np.eye(6)
        x = np.linalg.solve(A.T @ (w[:, None] * A) + damping, -A.T @ (w * d))
        change = np.eye(4)
        change[:3, :3], change[:3, 3] = cv2.Rodrigues(x[:3])[0], x[3:]
        T = change @ T
        if np.abs(x).max() < SETTLED:
            break
    pose = T @ view.T_world_camera
    apart = np.linalg.inv(view.T_world_camera) @ pose
    turned = np.rad2deg(np.arccos(np.clip((np.trace(apart[:3, :3]) - 1) / 2, -1, 1)))
    return Refinement(
        view.frame_id, pose, float(np.linalg.norm(apart[:3, 3])), float(turned), matched, first or 0.0, found
    )


def _matches(
    points: np.ndarray, other: View, normals: np.ndarray, known: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matched world points, (N, 3), normals of the surfaces that they meet, (N, 3), world, and signed distances, (N,)."""
    v, u, z = other.project(points)
    meets = (v >= 0) & other.sharp[v, u] & known[v, u]
    meets[meets] = np.abs(z[meets] - other.depth[v[meets], u[meets]]) < reach
    v, u, p = v[meets], u[meets], points[meets].astype(np.float64)
    n = normals[v, u].astype(np.float64) @ other.T_world_camera[:3, :3].T
    return p, n, np.einsum("ij,ij->i", p - other.world(v, u), n)


ALL_PAIRS, NEAR = 24, 4
"""Up to so many views each is compared with each; of more, each with so many before it and as many spread over the
rest."""
DEVIATIONS, LEAST_BELOW = 4.0, 0.05
"""A view whose best agreement lies so many median absolute deviations, and at least so much, below the recording's
median does not fit."""


def compared(count: int) -> tuple[tuple[int, int], ...]:
    """Pairs of views to compare, by index, the smaller first."""
    if count <= ALL_PAIRS:
        return tuple(combinations(range(count), 2))
    spread = np.linspace(0, count - 1, NEAR).astype(int).tolist()
    found = {(min(i, j), max(i, j)) for j in range(count) for i in (*range(max(0, j - NEAR), j), *spread) if i != j}
    return tuple(sorted(found))


def fits(found: Sequence[PoseAgreement]) -> dict[str, float]:
    """Best agreement of each view with another, by frame: of a view that fits one other the pose is no lie.

    Views that share too little with all others are missing.
    """
    best: dict[str, float] = {}
    for pair in found:
        if pair.agree is not None:
            for frame_id in (pair.one, pair.other):
                best[frame_id] = max(best.get(frame_id, 0.0), pair.agree)
    return best


def misfits(best: Sequence[float] | np.ndarray) -> float:
    """Agreement below which a view does not fit, by what is usual in the recording: sensors and scenes differ."""
    values = np.asarray(best, float)
    if not len(values):
        return 0.0
    middle = float(np.median(values))
    return middle - max(DEVIATIONS * float(np.median(np.abs(values - middle))), LEAST_BELOW)
