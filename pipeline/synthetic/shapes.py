"""Solids the parts are made of: rounded boxes, rods, turned profiles, balls, rings, leaves, cloth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import TypeVar

import numpy as np

from pipeline.synthetic.model import Material, ModelPart

Vec = Sequence[float]
Value = TypeVar("Value")
SIDES = (-1, 1)


@lru_cache(maxsize=8)
def _shell_grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Surface points of an n*n*n lattice ((V, 3) indices) and its outward triangles ((F, 3))."""
    index: dict[tuple[int, int, int], int] = {}
    faces: list[tuple[int, int, int]] = []
    for axis in range(3):
        for side in (0, n - 1):
            for a in range(n - 1):
                for b in range(n - 1):
                    quad = []
                    for da, db in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        p = [0, 0, 0]
                        p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3] = side, a + da, b + db
                        quad.append(index.setdefault((p[0], p[1], p[2]), len(index)))
                    if side == 0:
                        quad.reverse()
                    faces += [(quad[0], quad[1], quad[2]), (quad[0], quad[2], quad[3])]
    return np.array(list(index), dtype=np.int64), np.array(faces, dtype=np.int32)


def block(size: Vec, at: Vec, material: Material, radius: float = 0.006, steps: int = 1) -> ModelPart:
    """A box of `size` with rounded edges; centre in plan at `at[:2]`, BOTTOM at `at[2]`. Round edges catch the light,
    which is what tells furniture from crates; a large radius with more steps makes a cushion."""
    half = np.asarray(size, dtype=np.float64) / 2
    radius = float(min(radius, 0.98 * half.min()))
    grid, faces = _shell_grid(2 * (steps + 1))
    offsets = radius * np.linspace(0, 1, steps + 1)
    points = np.empty((len(grid), 3))
    for axis in range(3):
        coordinates = np.concatenate([-half[axis] + offsets, half[axis] - offsets[::-1]])
        points[:, axis] = coordinates[grid[:, axis]]
    inner = np.clip(points, -(half - radius), half - radius)
    out = points - inner
    points = inner + radius * out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)
    return ModelPart(points + np.array([at[0], at[1], at[2] + half[2]]), faces, material)


def pillow(size: Vec, at: Vec, material: Material) -> ModelPart:
    """A stuffed cushion, thin at the seam. Placed like `block`."""
    grid, faces = _shell_grid(15)
    v = grid / 7.0 - 1.0
    x, y = v[:, 0].copy(), v[:, 1].copy()
    plump = ((1 - np.abs(x) ** 2.6) * (1 - np.abs(y) ** 2.6)).clip(0, 1) ** 0.55
    v[:, 2] *= 0.06 + 0.94 * plump
    v[:, 0] = x * (1 - 0.07 * (1 - y**2))
    v[:, 1] = y * (1 - 0.07 * (1 - x**2))
    v = v * np.asarray(size) / 2
    return ModelPart(v + np.array([at[0], at[1], at[2] + size[2] / 2]), faces, material)


@lru_cache(maxsize=64)
def _turned_faces(rows: int, sections: int) -> np.ndarray:
    """(F, 3) triangles between each ring of `sections` points and the next of `rows` rings."""
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(sections), indexing="ij")
    after = (column + 1) % sections
    a, b = row * sections + column, row * sections + after
    c, d = (row + 1) * sections + after, (row + 1) * sections + column
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product (..., 3), faster than `np.cross` for few vectors."""
    (ax, ay, az), (bx, by, bz) = (np.moveaxis(v, -1, 0) if v.ndim > 1 else v for v in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def lathe(profile: Sequence[tuple[float, float]], at: Vec, material: Material, sections: int = 28) -> ModelPart:
    """A body of revolution about the z axis at `at`; `profile` lists (radius, height), metres."""
    rz = np.asarray(profile, dtype=np.float64)
    angles = np.linspace(0, 2 * np.pi, sections, endpoint=False)
    points = np.empty((len(rz), sections, 3))
    points[..., 0] = rz[:, :1] * np.cos(angles)
    points[..., 1] = rz[:, :1] * np.sin(angles)
    points[..., 2] = rz[:, 1:]
    faces = _turned_faces(len(rz), sections)
    flat = points.reshape(-1, 3)
    first, second, third = flat[faces.T]
    area = np.linalg.norm(_cross(second - first, third - first), axis=1)
    return ModelPart(flat + np.asarray(at, dtype=np.float64), faces[area > 1e-12].astype(np.int32), material)


def cylinder(radius: float, height: float, at: Vec, material: Material, sections: int = 28) -> ModelPart:
    """An upright cylinder with a softened rim and the bottom centre at `at`."""
    bevel = min(0.006, 0.3 * radius, 0.3 * height)
    profile = [
        (0.0, 0.0),
        (radius - bevel, 0.0),
        (radius, bevel),
        (radius, height - bevel),
        (radius - bevel, height),
        (0.0, height),
    ]
    return lathe(profile, at, material, sections)


def rod(start: Vec, end: Vec, radius: float, material: Material, end_radius: float | None = None) -> ModelPart:
    """A round bar from `start` to `end`, tapering to `end_radius`."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(b - a))
    last = radius if end_radius is None else end_radius
    part = lathe([(0, 0), (radius, 0), (last, length), (0, length)], (0, 0, 0), material, sections=14)
    z = (b - a) / length
    x = _cross(np.array([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0]), z)
    x /= np.linalg.norm(x)
    return ModelPart(part.vertices @ np.stack([x, _cross(z, x), z]) + a, part.faces, material)


def ball(radius: float, at: Vec, material: Material, squash: Vec = (1, 1, 1)) -> ModelPart:
    """A sphere, or an ellipsoid with radii `radius * squash`, centred at `at`: an inflated cube lattice."""
    grid, faces = _shell_grid(11)
    # The tangent evens out the triangles between the middle and the corners of each side.
    points = np.tan((grid / 5.0 - 1.0) * np.pi / 4)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return ModelPart(radius * points * np.asarray(squash) + np.asarray(at), faces, material)


def ring(major: float, minor: float, at: Vec, material: Material, sections: int = 28, around: int = 10) -> ModelPart:
    """A torus lying level, centred at `at`."""
    turn = np.linspace(0, 2 * np.pi, sections, endpoint=False)[None, :]
    bend = np.linspace(0, 2 * np.pi, around, endpoint=False)[:, None]
    reach = major + minor * np.cos(bend)
    points = np.stack(np.broadcast_arrays(reach * np.cos(turn), reach * np.sin(turn), minor * np.sin(bend)), -1)
    row, column = np.meshgrid(np.arange(around), np.arange(sections), indexing="ij")
    below, above = row * sections, (row + 1) % around * sections
    after = (column + 1) % sections
    a, b, c, d = (x.ravel() for x in (below + column, below + after, above + after, above + column))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return ModelPart(points.reshape(-1, 3) + np.asarray(at, dtype=np.float64), faces.astype(np.int32), material)


def sheet(points: np.ndarray, material: Material) -> ModelPart:
    """A surface through a grid of points ((M, N, 3), metres), seen from both sides."""
    m, n = points.shape[:2]
    row, column = np.meshgrid(np.arange(m - 1), np.arange(n - 1), indexing="ij")
    a = (row * n + column).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 1], -1), np.stack([a, a + n + 1, a + n], -1)])
    return ModelPart(points.reshape(-1, 3).astype(np.float64), faces.astype(np.int32), material)


def leaf(
    base: Vec, azimuth: float, length: float, width: float, rise: float, droop: float, material: Material
) -> ModelPart:
    """A bent leaf growing from `base`, starting at slope `rise` radians and bending by `droop`."""
    s = np.linspace(0, 1, 9)
    slope = rise - droop * s
    reach = np.concatenate([[0], np.cumsum(np.cos(slope[:-1]))]) * length / 8
    lift = np.concatenate([[0], np.cumsum(np.sin(slope[:-1]))]) * length / 8
    half = width / 2 * np.sin(np.pi * np.clip(s * 0.97 + 0.03, 0, 1)) ** 0.8
    across = np.linspace(-1, 1, 5)
    fold = 0.25 * np.abs(across)
    out, side = np.array([np.cos(azimuth), np.sin(azimuth), 0]), np.array([-np.sin(azimuth), np.cos(azimuth), 0])
    points = (
        np.asarray(base, dtype=np.float64)
        + reach[:, None, None] * out
        + lift[:, None, None] * np.array([0.0, 0.0, 1.0])
        + (half[:, None] * across)[..., None] * side
        + (half[:, None] * fold)[..., None] * np.array([0.0, 0.0, 1.0])
    )
    return sheet(points, material)


def each(values: Iterable[Value], make: Callable[[Value], Iterable[ModelPart]]) -> list[ModelPart]:
    """Parts made for each value in turn, such as the left side (-1) and the right side (1)."""
    return [part for value in values for part in make(value)]


def joined(parts: Sequence[ModelPart]) -> ModelPart:
    """Pieces of a single material as a single part."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return ModelPart(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]).astype(np.int32),
        parts[0].material,
    )
