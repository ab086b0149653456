"""Agreement of camera poses by the surfaces that two views see, and refinement of one pose against other views.

Agreement is matched / (matched + seen through): hidden points say nothing, points that a view looks through contradict
the poses. Refinement is point-to-plane ICP with projective association (Chen and Medioni 1992; Blais and Levine 1995).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.geometry.surface import depth_noise
from pipeline.scenes.views import PosedView
from pipeline.system.frozen import dataclass

POINTS = 6_000
"""So many points of a view are compared."""
LEAST_SHARED = 0.05
"""Views that share a smaller part of their points are not compared."""
NOISES = 1.5
"""A point is on a surface, or before it, by so many standard deviations of both depths: of 1.5, 2 and 3 the one that
tells poses that are 1 cm off best, on rendered rooms."""
STEPS, FARTHEST_M = 30, 0.10
"""Steps of refinement, and the distance beyond which two points are no match at first; it shrinks to a quarter."""
LEAST_MATCHED = 200
"""With fewer matched points nothing is refined."""
SETTLED = 1e-5
"""Metres and radians below which a step ends the refinement."""
DAMPING = 1e-4
"""Part of the least squares that holds a view where nothing else does: along surfaces that are all parallel."""
ALL_PAIRS, NEAR = 24, 4
"""A view is compared with all views before it, or so many; of more with so many just before it and as many others that
look alike."""
DEVIATIONS, LEAST_BELOW, MORE_THROUGH, LEAST_AGREE = 4.0, 0.03, 0.5, 0.5
"""A view does not fit whose best agreement lies so many median absolute deviations below the recording's median, and at
least so much, and has so many more points looked through than is usual; or where fewer than the last match."""
LEAST_PAIRS = 4
"""Of a view that shares enough with so many others its typical agreement is judged, too: a wrong pose fits one of many
by chance."""


@dataclass(frozen=True)
class PoseAgreement:
    """Comparison of two views' surfaces under their poses."""

    one: str
    other: str
    matched: int  # Points of either view that lie on the other's surface
    through: int  # Points that the other view looks through
    shared: float  # Matched or looked through, of all compared points, 0..1
    residual_m: float  # Median distance, along the rays, of the points within 10 cm of the other's surface

    @property
    def agree(self) -> float | None:
        """Share of the deciding points that match, 0..1; None for views that share too little."""
        return self.matched / (self.matched + self.through) if self.shared >= LEAST_SHARED else None


@dataclass(frozen=True)
class Refinement:
    """A view's pose after refinement, and what it does; nothing is changed by it."""

    frame_id: str
    pose: tuple[tuple[float, ...], ...]  # T_world_camera (4, 4), refined
    moved_m: float  # Distance between the camera centres
    turned_deg: float
    residual_before_m: float  # Median distance of matched points to the other views' planes
    residual_m: float
    agree_before: float  # Best agreement with the other views, 0..1
    agree: float
    used: bool = False  # As the map's pose, because that was asked for

    @property
    def better(self) -> bool:
        """Tell whether the views agree better with it, by more than chance, and the pose stays near."""
        return self.agree > self.agree_before + LEAST_BELOW / 3 and self.moved_m <= FARTHEST_M


def sampled(view: PosedView) -> np.ndarray:
    """World points of a view, evenly spread over its sharp pixels, (N, 3) float32, metres."""
    v, u = view.pixels
    step = max(1, len(v) // POINTS)
    return view.world(v[::step], u[::step])


def agreement(one: PosedView, other: PosedView) -> PoseAgreement:
    """Compare two views under their poses.

    >>> from pipeline.datasets import demo_path, open_dataset
    >>> from pipeline.scenes.poses import agreement
    >>> from pipeline.scenes.views import views_of
    >>> one, other = views_of(open_dataset(demo_path()), ("000001/000000", "000001/000001"))
    >>> round(agreement(one, other).agree, 2)
    0.94
    """
    matched = through = compared = 0
    near: list[np.ndarray] = []
    for seeing, seen in ((one, other), (other, one)):
        points = sampled(seen)
        v, u, z = seeing.project(points)
        meets = (v >= 0) & seeing.sharp[v, u]
        measured, z = seeing.depth[v[meets], u[meets]], z[meets]
        apart = z - measured
        slack = NOISES * np.hypot(depth_noise(measured), depth_noise(z))
        matched += int(np.count_nonzero(np.abs(apart) <= slack))
        through += int(np.count_nonzero(apart < -slack))
        near.append(np.abs(apart)[np.abs(apart) < FARTHEST_M])
        compared += len(points)
    distances = np.concatenate(near)
    residual = float(np.median(distances)) if len(distances) else 0.0
    shared = (matched + through) / max(1, compared)
    return PoseAgreement(one.frame_id, other.frame_id, matched, through, shared, residual)


def best_agreement(view: PosedView, others: Sequence[PosedView]) -> float:
    """Best agreement of a view with others, 0..1; 0 where it shares too little with all."""
    return max((agreement(other, view).agree or 0.0 for other in others), default=0.0)


def refine(view: PosedView, others: Sequence[PosedView]) -> Refinement | None:
    """Refine a view's pose against the surfaces of other views; None where too little is shared.

    Each step matches the view's points with the points that the other views measured at the same pixels, and moves the
    view by the least squares of the distances to those points' planes.
    """
    points, T = sampled(view), np.eye(4)
    # About the points' middle a radian moves them about as far as a metre does.
    middle = points.mean(axis=0, dtype=np.float64) if len(points) else np.zeros(3)
    first, found = None, np.inf
    for step in range(STEPS):
        reach = FARTHEST_M * max(0.25, 1 - step / 10)
        rows = [_matches(points @ T[:3, :3].T + T[:3, 3], other, reach, middle) for other in others]
        A, d = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        if len(d) < LEAST_MATCHED:
            return None
        found = float(np.median(np.abs(d)))
        first = found if first is None else first
        # Huber's weights: what moved between the views pulls less.
        w = np.minimum(1.0, max(1.5 * found, 1e-4) / np.maximum(np.abs(d), 1e-9))
        H = A.T @ (w[:, None] * A)
        x = np.linalg.solve(H + DAMPING * np.trace(H) / 6 * np.eye(6), -A.T @ (w * d))
        change = np.eye(4)
        change[:3, :3] = cv2.Rodrigues(x[:3])[0]
        change[:3, 3] = x[3:] + middle - change[:3, :3] @ middle
        T = change @ T
        if np.abs(x).max() < SETTLED:
            break
    pose = T @ view.T_world_camera
    apart = np.linalg.inv(view.T_world_camera) @ pose
    turned = np.rad2deg(np.linalg.norm(cv2.Rodrigues(apart[:3, :3])[0]))
    before, after = best_agreement(view, others), best_agreement(view.moved(pose), others)
    rows = tuple(map(tuple, pose.tolist()))
    moved = float(np.linalg.norm(apart[:3, 3]))
    return Refinement(view.frame_id, rows, moved, float(turned), first or 0.0, found, before, after)


def _matches(points: np.ndarray, other: PosedView, reach: float, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the least squares, (N, 6), of world points that meet a view's surface, and distances to it, (N,)."""
    normals, known = other.normals
    v, u, z = other.project(points)
    meets = (v >= 0) & other.sharp[v, u] & known[v, u]
    meets[meets] = np.abs(z[meets] - other.depth[v[meets], u[meets]]) < reach
    v, u, p = v[meets], u[meets], points[meets].astype(np.float64)
    n = normals[v, u].astype(np.float64) @ other.T_world_camera[:3, :3].T
    return np.hstack([np.cross(p - middle, n), n]), np.einsum("ij,ij->i", p - other.world(v, u), n)


def partners(poses: Sequence[np.ndarray], place: int) -> tuple[int, ...]:
    """Places of the earlier views that a view is compared with, in order; what comes later changes nothing.

    `poses`: T_world_camera (4, 4) of the views, metres.
    """
    if place <= ALL_PAIRS:
        return tuple(range(place))
    just = range(place - NEAR, place)
    spread = range(0, place - NEAR, max(1, place // ALL_PAIRS))
    T = np.stack([poses[i] for i in (*spread, place)])
    # A metre apart is as unlike as 60 degrees turned.
    unlike = np.linalg.norm(T[:-1, :3, 3] - T[-1, :3, 3], axis=1) + 2 * (1 - T[:-1, :3, 2] @ T[-1, :3, 2])
    return tuple(sorted({*just, *(spread[k] for k in np.argsort(unlike, kind="stable")[:NEAR])}))


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


def typical_fits(found: Sequence[PoseAgreement]) -> dict[str, float]:
    """Median agreement of each view with others, by frame, weighted by what they share; not of views with few pairs."""
    pairs: dict[str, list[tuple[float, float]]] = {}
    for pair in found:
        if pair.agree is not None:
            for frame_id in (pair.one, pair.other):
                pairs.setdefault(frame_id, []).append((pair.agree, pair.shared))
    out = {}
    for frame_id, own in pairs.items():
        if len(own) >= LEAST_PAIRS:
            agree, shared = np.array(sorted(own)).T
            weight = np.cumsum(shared)
            out[frame_id] = float(agree[np.searchsorted(weight, weight[-1] / 2)])
    return out


def misfits(values: Sequence[float] | np.ndarray, least: float = LEAST_AGREE) -> float:
    """Agreement below which a view does not fit, by what is usual in the recording: sensors and scenes differ."""
    values = np.asarray(values, float)
    if not len(values):
        return 0.0
    middle = float(np.median(values))
    spread = float(np.median(np.abs(values - middle)))
    below = max(DEVIATIONS * spread, LEAST_BELOW, MORE_THROUGH * (1 - middle))
    return max(middle - below, least)
