"""Planes of depth maps, each on its own: bent under a wrong kind of depth, not square under a wrong focal length.

Along a plane 1/z is an affine function of the pixel, whatever the focal length; of a distance to the camera it is the
ray's length over the distance, of inverse depth what is stored.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.datasets.meant import ray_lengths
from pipeline.datasets.settings import MEANT
from pipeline.geometry.frame import Frame
from pipeline.system.frozen import dataclass

KINDS: tuple[str, ...] = MEANT["depth_is"]
SAMPLED = 110
"""Columns of a depth map that are looked at, about."""
FLAT = 0.005
"""A depth counts half for a plane where it is so far off it, as a share."""
TRIPLES, CLIMBS = 80, 6
LEAST_SEEN = 0.4
"""Share of a window's pixels with a depth, below which it is left out."""
LEAST_FLAT = 0.35
"""A window says something where under some kind so much of it is one plane."""


@dataclass(frozen=True)
class Sampled:
    """A depth map at every few pixels."""

    u: np.ndarray  # (H, W) float64, columns
    v: np.ndarray  # (H, W) float64, rows
    inverse: dict[str, np.ndarray]  # By kind (H, W) float64 what is affine along planes; NaN where missing

    @classmethod
    def of(cls, frame: Frame) -> Sampled:
        every = max(1, round(frame.width / SAMPLED))
        v, u = np.mgrid[every // 2 : frame.height : every, every // 2 : frame.width : every].astype(float)
        stored = frame.depth[every // 2 :: every, every // 2 :: every].astype(float)
        stored = np.where(stored > 0, stored, np.nan)
        length = ray_lengths(frame.camera.K, frame.depth.shape)[every // 2 :: every, every // 2 :: every]
        return cls(u, v, {"z": 1 / stored, "distance": length / stored, "inverse": stored})


def windows(size: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    """Halves of a picture of (height, width), overlapping by half, row by row."""
    for row in range(3):
        for column in range(3):
            yield tuple(slice(k * n // 4, (k + 2) * n // 4) for k, n in zip((row, column), size, strict=True))  # type: ignore[misc]


def flatness(frame: Frame, kinds: Sequence[str] = KINDS) -> np.ndarray:
    """Share (W, K) of each window that is one plane under each kind of depth; NaN where a window says nothing."""
    seen = Sampled.of(frame)
    found = np.full((9, len(kinds)), np.nan)
    for k, window in enumerate(windows(seen.u.shape)):
        known = np.isfinite(seen.inverse["z"][window])
        if known.mean() < LEAST_SEEN:
            continue
        uv1 = np.stack([seen.u[window][known], seen.v[window][known], np.ones(known.sum())], axis=1)
        row = [plane_of(uv1, seen.inverse[kind][window][known])[1].mean() for kind in kinds]
        found[k] = row if max(row) >= LEAST_FLAT else np.nan
    return found


def plane_of(uv1: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest plane of pixels.

    Parameters
    ----------
    uv1 : (N, 3) float64
        Columns, rows and 1.
    inverse : (N,) float64
        What is affine along a plane.

    Returns
    -------
    plane : (3,) float64
        Its coefficients.
    near : (N,) float64
        How nearly each pixel lies in it, 0..1.
    """
    middle = uv1.mean(axis=0) * [1, 1, 0]
    scale = max(float(np.ptp(uv1[:, :2], axis=0).max()), 1.0)
    at = (uv1 - middle) / [scale, scale, 1]
    rng = np.random.default_rng(0)
    some = rng.integers(0, len(at), (TRIPLES, 3))
    corners = at[some]
    good = np.abs(np.linalg.det(corners)) > 0.01
    if not good.any():
        return np.zeros(3), np.zeros(len(at))
    tried = np.linalg.solve(corners[good], inverse[some[good]][..., None])[..., 0]
    few = slice(None, None, max(1, len(at) // 400))
    off = (at[few] @ tried.T / inverse[few, None] - 1) / (2 * FLAT)
    best = tried[int((1 / (1 + off * off)).sum(axis=0).argmax())]
    for climb in range(CLIMBS):
        off = (at @ best / inverse - 1) / (FLAT * (2 if climb < 2 else 1))
        weight = 1 / (1 + off * off) / inverse
        # Cauchy's weights, of relative residuals.
        best = np.linalg.lstsq(at * weight[:, None], inverse * weight, rcond=None)[0]
    off = (at @ best / inverse - 1) / FLAT
    plane = best / [scale, scale, 1]
    plane[2] -= plane[:2] @ middle[:2]
    return plane, 1 / (1 + off * off)


MOST_PLANES, LEAST_PLANE = 6, 0.04
"""So many planes of a frame are looked for, each at least so much of its depth."""
IN_PLANE = 0.3
"""What lies in a plane so nearly belongs to it."""
PARALLEL = float(np.cos(np.radians(10)))
"""Planes whose normals differ by less count as one."""
SQUARE_DEG = 2.5
"""Walls and floors are square to each other within about so much."""


def planes_of(frame: Frame) -> list[np.ndarray]:
    """Largest planes of a frame, (3,) float64 each: 1/z = a u + b v + c, at pixel u, v, metres."""
    seen = Sampled.of(frame)
    left = np.isfinite(seen.inverse["z"])
    uv1 = np.stack([seen.u[left], seen.v[left], np.ones(left.sum())], axis=1)
    inverse = seen.inverse["z"][left]
    found, total = [], len(inverse)
    for _ in range(MOST_PLANES):
        if len(inverse) < LEAST_PLANE * total:
            break
        plane, near = plane_of(uv1, inverse)
        inside = near > IN_PLANE
        if inside.sum() < LEAST_PLANE * total:
            break
        if all(abs(_direction(plane, frame) @ _direction(other, frame)) < PARALLEL for other in found):
            found.append(plane)
        uv1, inverse = uv1[~inside], inverse[~inside]
    return found


def _direction(plane: np.ndarray, frame: Frame) -> np.ndarray:
    """Normal (3,) of a plane."""
    a, b, c = plane
    camera = frame.camera
    normal = np.array([a * camera.fx, b * camera.fy, a * camera.cx + b * camera.cy + c])
    return normal / max(float(np.linalg.norm(normal)), 1e-12)


def square_focals(frame: Frame) -> np.ndarray:
    """By what the focal length must be multiplied to make pairs of planes square.

    Returns
    -------
    (N, 3) float64
        Of each pair that tells: logarithm of the factor, its standard deviation, and the angle as read, degrees.
    """
    found = []
    normals = [_direction(plane, frame) for plane in planes_of(frame)]
    for k, one in enumerate(normals):
        for other in normals[:k]:
            across, along = float(one[:2] @ other[:2]), float(one[2] * other[2])
            angle = np.degrees(np.arccos(across + along))
            if across * along >= 0:
                continue
            square = -along / across
            scaled = [n * [np.sqrt(square), np.sqrt(square), 1] for n in (one, other)]
            slope = 2 * abs(across) * square / np.prod([np.linalg.norm(n) for n in scaled])
            found.append((0.5 * np.log(square), np.radians(SQUARE_DEG) / slope, angle))
    return np.array(found).reshape(-1, 3)
