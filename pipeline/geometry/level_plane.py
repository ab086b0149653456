"""The level plane of a frame: a floor or a table-top, distinguished from walls and ceilings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np

from pipeline.geometry.camera import IMAGE_UP, Camera, depth_at, lift_pixels
from pipeline.geometry.surface import (
    PARALLEL_DEG,
    UPRIGHT,
    SurfaceBlocks,
    block_noise,
    depth_noise,
    is_floor,
    may_be_wall,
    plane_tolerance,
    surface_blocks,
    surface_normals,
)
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

SAME_SURFACE_DEG = 15.0
"""Normals of one surface differ by no more than this."""
MIN_SURFACE_PIXELS = 60

STEEPEST_DEG, HIGHEST_DEG, MAX_ROLL_DEG = 77.0, 40.0, 30.0
"""How a camera may be held: looking down and up by at most so much, and rolled by at most so much.
A wall, taken for a floor, would say of a camera that looks down that it is upside down, and of a
level one that it looks straight down."""
EASY_ROLL_DEG, EASY_STEEP_DEG, EASY_HIGH_DEG = 14.0, 68.0, 16.0
"""Up to about so much is common; beyond it, every other explanation is more likely."""

APART_DEG = 15.0
"""Hypotheses closer than this are one."""
_PERPENDICULAR = float(np.sin(np.deg2rad(APART_DEG)))
FULL_SHARE = 0.03
"""A plane of so much of the surface counts half, a larger one more."""
WEIGHT = {"floor": 1.0, "ceiling": 0.5, "walls": 0.5}
"""To a camera that looks down steeply, a wall behind a table looks like a ceiling does to one that looks up."""
LEAST_WALL = 0.05
"""A ceiling counts only where walls are seen with it: alone, it may as well be a wall seen from above."""
WALLS_STEEP_DEG, WALLS_HIGH_DEG = 45.0, 10.0
"""Up is where two walls meet only while the camera looks down by no more than this, and up by no more."""
WALLS_EXPLAIN = 0.9
"""And while no less of what is flat goes with it: else one of the two is rather a board that leans."""
MIN_SCORE = 0.15
MIN_LEAD = 2.0
"""The best hypothesis must be so many times as good as the best that contradicts it."""

ALONE_SCORE = 0.6
"""A plane that may be a wall is assumed to be level where it explains the frame so well."""

FAR_FROM_LEVEL_DEG = 10.0
"""A surface that was called level and is so far off the frame's level planes is worth a note: a wall?"""

NOISES = (1, 3, 5, 8)
"""How noisy a sensor is taken to be, one after the other, until something is decided."""
NOISY = 0.45
"""Blocks of a structured-light camera are less noisy than this, and wider windows tell no more of its frames."""

DIRECTIONS = 96
MAX_HYPOTHESES = 5
MIN_POINTS = 50
LEAST_SHARE = 0.01
STRETCH_M = 0.04


@dataclass(frozen=True)
class UpHypothesis:
    """An up vector suggested by planes of the frame, and its support."""

    up: np.ndarray  # (3,) float64, unit vector, camera frame
    # A plane seen from above (a floor, a table-top), one seen from below, or walls that stand on no floor seen
    kind: Literal["floor", "ceiling", "walls"]
    share: float  # Share of the surface seen that lies in the plane; of walls, what speaks for the less seen direction
    explained: float  # Share of the flat surface that is level or upright under it, in either way
    # False for a plane that may as well be a wall which the camera looks up at, and for what is upright to it: it
    # decides nothing, but contradicts
    certain: bool = True

    @property
    def score(self) -> float:
        """Score, 0..1: share of the frame explained, size of the plane, and how common such a camera pose is."""
        held = float(_ease(self.up[None])[0])
        return WEIGHT[self.kind] * held * self.explained**2 * self.share / (self.share + FULL_SHARE)


def level_plane(depth: np.ndarray, camera: Camera) -> np.ndarray | None:
    """Up vector of the level planes of a frame, (3,) float64, camera frame; None where too few or contradictory."""
    best = decided(up_hypotheses(depth, camera))
    return None if best is None else best.up


def decided(found: Sequence[UpHypothesis]) -> UpHypothesis | None:
    """Best of a frame's hypotheses (best first); None where weak or contradicted by another."""
    if not found or found[0].score < MIN_SCORE or not found[0].certain:
        return None
    best = found[0]
    others = (h.score for h in found[1:] if h.up @ best.up < np.cos(np.deg2rad(APART_DEG)))
    return best if best.score >= MIN_LEAD * max(others, default=0.0) else None


def assumed(found: Sequence[UpHypothesis]) -> np.ndarray:
    """Up vector to assume where nothing is decided, (3,) float64; hypotheses come best first.

    It is image-up, or that of a plane which stands alone, so steep that it may be a wall looked up at: more cameras
    look down on tables and floors than up at walls.
    """
    alone = decided([replace(h, certain=True) for h in found])
    return IMAGE_UP if alone is None or alone.score < ALONE_SCORE else alone.up


def up_hypotheses(depth: np.ndarray, camera: Camera) -> tuple[UpHypothesis, ...]:
    """Up vectors suggested by the planes of a depth map, (H, W) float32, metres; the best first.

    Candidate directions are normals of the surface itself, so that every hypothesis is a real patch of the
    scene and no random numbers are needed. A plane counts only on the side it is seen from: a floor from
    above, a ceiling from below.
    """
    found: list[tuple[UpHypothesis, ...]] = []
    for noise in NOISES if block_noise(depth) > NOISY else NOISES[:1]:
        found.append(_of_surface(surface_blocks(depth, camera, noise)))
        if decided(found[-1]) is not None:
            return found[-1]
    return max(found, key=lambda of: of[0].score if of else 0.0)


def _of_surface(surface: SurfaceBlocks) -> tuple[UpHypothesis, ...]:
    if len(surface.points) < MIN_POINTS or surface.flat.sum() < MIN_POINTS:
        return ()
    found = [*_of_one_side(surface, "floor"), *_of_one_side(surface, "ceiling")]
    same = np.cos(np.deg2rad(APART_DEG))
    # A level plane is fitted to more than the directions of walls are.
    found += [h for h in _of_walls(surface) if not any(h.up @ level.up > same for level in found)]
    found.sort(key=lambda h: -h.score)
    if found and not found[0].certain:
        # Where a wall may be meant, what is upright to a floor may as well be the ceiling, or the walls, beside it.
        found = [replace(h, certain=h.certain and abs(h.up @ found[0].up) > _PERPENDICULAR) for h in found]
    return tuple(found)


def _of_one_side(surface: SurfaceBlocks, kind: Literal["floor", "ceiling"]) -> list[UpHypothesis]:
    sign = np.float32(1.0 if kind == "floor" else -1.0)
    voters = surface.voters * sign
    candidates = voters[_ease(voters) > 0]
    if len(candidates) < 10:
        return []
    candidates = candidates[np.linspace(0, len(candidates) - 1, min(DIRECTIONS, len(candidates))).astype(int)]
    cosines = candidates @ voters.T
    alike, same = (np.float32(np.cos(np.deg2rad(a))) for a in (PARALLEL_DEG, APART_DEG))
    support = np.count_nonzero(cosines > alike, axis=1)
    found: list[UpHypothesis] = []
    for _ in range(MAX_HYPOTHESES):
        best = int(support.argmax())
        if support[best] < LEAST_SHARE / 2 * len(voters):
            break
        direction = voters[cosines[best] > alike].mean(axis=0)
        fitted = _fitted(surface, direction / np.linalg.norm(direction), sign)
        support[candidates @ candidates[best] > same] = 0
        if fitted is None or _ease(fitted[0][None])[0] == 0 or any(fitted[0] @ h.up > same for h in found):
            continue
        up, offset, share = fitted
        if kind == "ceiling" and np.mean(np.abs(voters @ up.astype(np.float32)) < UPRIGHT) < LEAST_WALL:
            continue
        certain = kind == "ceiling" or not may_be_wall(up) or is_floor(surface, up, offset)
        found.append(UpHypothesis(up, kind, share, _explained(voters, up), certain))
    return found


def _of_walls(surface: SurfaceBlocks) -> list[UpHypothesis]:
    """Hypothesis of the direction common to all walls, where nothing level is seen and walls face at least two ways."""
    normals = surface.voters.astype(np.float64)
    up, spread = _least_seen(normals)
    for _ in range(2):
        upright = normals[np.abs(normals @ up) < UPRIGHT]
        if len(upright) < MIN_POINTS:
            return []
        up, spread = _least_seen(upright)
    explained = _explained(normals, up)
    if not -WALLS_HIGH_DEG < _pitch_deg(up) < WALLS_STEEP_DEG or _ease(up[None])[0] == 0 or explained < WALLS_EXPLAIN:
        return []
    share = spread / len(normals) * float(surface.flat.mean())
    return [UpHypothesis(up, "walls", share, explained)] if share > LEAST_SHARE else []


def _least_seen(normals: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit vector least pointed to by normals, (N, 3), up the image, and the sum of squares of the next axis."""
    spread, axes = np.linalg.eigh(normals.T @ normals)
    return axes[:, 0] * (-1.0 if axes[1, 0] > 0 else 1.0), float(spread[1])


def _explained(normals: np.ndarray, up: np.ndarray) -> float:
    """Share of the normals, (N, 3), parallel or perpendicular to an up vector."""
    along = np.abs(normals @ up.astype(normals.dtype))
    return float(((along > np.cos(np.deg2rad(PARALLEL_DEG))) | (along < UPRIGHT)).mean())


def _ease(up: np.ndarray) -> np.ndarray:
    """Commonness, 0..1, of holding a camera with each up vector, (N, 3); 0 is never."""
    pitch, roll = _pitch_deg(up), np.abs(np.rad2deg(np.arctan2(up[..., 0], -up[..., 1])))
    beyond = np.maximum(pitch - EASY_STEEP_DEG, 0) + np.maximum(-pitch - EASY_HIGH_DEG, 0)
    held = np.exp(-0.5 * (np.maximum(roll - EASY_ROLL_DEG, 0) / 8) ** 2 - beyond / 12)
    return np.where((pitch < STEEPEST_DEG) & (pitch > -HIGHEST_DEG) & (roll < MAX_ROLL_DEG), held, 0.0)


def _pitch_deg(up: np.ndarray) -> np.ndarray:
    """Downward pitch of a camera with an up vector, (..., 3), degrees."""
    return np.rad2deg(np.arcsin(np.clip(-up[..., 2], -1, 1)))


def _fitted(surface: SurfaceBlocks, direction: np.ndarray, sign: np.float32) -> tuple[np.ndarray, float, float] | None:
    """Largest plane of about a normal: unit normal, offset along the normal, share of the points; None if too small."""
    points = surface.points
    tolerance = plane_tolerance(points)
    cosine = surface.normals @ direction * sign
    near = surface.flat & (cosine > np.cos(np.deg2rad(PARALLEL_DEG)))
    heights = np.sort(points[near] @ direction)
    stretch = np.searchsorted(heights, heights + STRETCH_M) - np.arange(len(heights))
    densest = int(stretch.argmax())
    normal = direction.astype(np.float64)
    offset = float(np.median(heights[densest : densest + stretch[densest]]))
    near = surface.flat & (cosine > np.cos(np.deg2rad(3 * PARALLEL_DEG)))
    cloud, tolerance = points[near].astype(np.float64), tolerance[near]
    for slack in (2, 1, 1):
        inside = np.abs(cloud @ normal - offset) < slack * tolerance
        if np.count_nonzero(inside) < max(LEAST_SHARE * len(points), 20):
            return None
        centre, normal = _plane_of(cloud[inside], 1.0 / tolerance[inside])
        normal = normal if normal @ direction > 0 else -normal
        offset = float(centre @ normal)
    if sign * offset > 0:
        return None  # Not on the side it would be seen from.
    return normal, offset, float(inside.sum() / len(points))


def _plane_of(cloud: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and unit normal of points; far ones are noisier by z squared and unweighted would tilt the plane."""
    centre = np.average(cloud, axis=0, weights=weight)
    spread = (cloud - centre) * weight[:, None]
    return centre, np.linalg.svd(spread.T @ spread)[0][:, 2]


def level_normal_at(depth: np.ndarray, camera: Camera, u: int, v: int) -> np.ndarray:
    """Up vector, (3,), camera frame, from a pixel (column u, row v) of a level surface, chosen by a person.

    The plane around the pixel is grown to the connected region that lies in it, and fitted to that. It points to the
    side from which the surface is seen: that of one who looks down on it.

    Raises
    ------
    InputError
        The pixel is outside the picture, has no depth, or lies on no plane.
    """
    depth_at(depth, u, v, "a pixel of a level surface")
    no_plane = InputError("there is no plane at the pixel", got=f"{u},{v}", expected="a pixel of a level surface")
    normals, known = surface_normals(depth, camera)
    if not known[v, u]:
        raise no_plane
    rows, columns = np.indices(depth.shape)
    points = lift_pixels(depth.ravel(), camera, rows.ravel(), columns.ravel()).reshape(*depth.shape, 3)
    tolerance = 3 * depth_noise(depth)
    normal = normals[v, u].astype(np.float64)
    offset = float(points[v, u] @ normal)
    for _ in range(4):
        near = known & (np.abs(points @ normal - offset) < tolerance)
        near &= normals @ normal > np.cos(np.deg2rad(SAME_SURFACE_DEG))
        near[v, u] = True
        _, regions = cv2.connectedComponents(near.view(np.uint8), connectivity=4)
        region = regions == regions[v, u]
        if region.sum() < MIN_SURFACE_PIXELS:
            raise no_plane
        cloud = points[region].astype(np.float64)
        centre, normal = _plane_of(cloud, 1.0 / tolerance[region].astype(np.float64))
        normal = normal if normal @ centre < 0 else -normal
        offset = float(centre @ normal)
    return normal


def far_from_level(depth: np.ndarray, camera: Camera, up: np.ndarray) -> float | None:
    """Angle, degrees, of an up vector to the level planes of a frame; None where they do not contradict."""
    own = level_plane(depth, camera)
    angle = 0.0 if own is None else float(np.rad2deg(np.arccos(np.clip(own @ up / np.linalg.norm(up), -1, 1))))
    return angle if angle > FAR_FROM_LEVEL_DEG else None
