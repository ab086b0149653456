"""Synthetic objects: solids, parts, models, and colour schemes of rooms."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np

from pipeline.system.frozen import dataclass

WOODS = {"oak": "#c59a6b", "walnut": "#7d5638", "birch": "#dcbf94", "teak": "#a66f42", "ash": "#cdb492"}


@dataclass(frozen=True)
class Palette:
    """A colour scheme."""

    wall: str
    feature: str  # sRGB of the walls and of the one wall that differs
    floor: str  # Texture of the floor: planks, herringbone or tiles
    floor_tint: str
    wood: str  # A key of WOODS
    painted: str  # Painted furniture
    seat: str  # The large upholstered piece
    accents: tuple[str, ...]  # Cushions, mugs, pictures, books
    rug: tuple[str, str, str]  # tuple of (str, str, str): Ground, figure, accent
    metal: str = "#2f3136"


PALETTES = (
    Palette(
        "#efe6d8",
        "#8ea394",
        "planks",
        "#c49a6c",
        "oak",
        "#f3efe6",
        "#c9b79c",
        ("#c8643c", "#e0a94a", "#5f7f73", "#2f4b57", "#e7d3bd"),
        ("#e9dfcd", "#8c5b43", "#c8843c"),
    ),
    Palette(
        "#f1ebe1",
        "#3f6470",
        "herringbone",
        "#b98a5c",
        "walnut",
        "#2f4b57",
        "#3d6f78",
        ("#d9903d", "#e7c27d", "#b5532f", "#84a59d", "#f2e3cf"),
        ("#ece0cb", "#2f5a66", "#d1803a"),
    ),
    Palette(
        "#f3e7dc",
        "#d8a48f",
        "planks",
        "#d6b48a",
        "birch",
        "#f6f0e8",
        "#a9b5a2",
        ("#bb6b58", "#d9ae94", "#7d8f78", "#e3c58c", "#4f5d57"),
        ("#f0e6da", "#bb7c68", "#8fa08a"),
    ),
    Palette(
        "#ece9e1",
        "#c99f5f",
        "tiles",
        "#d8cdbd",
        "teak",
        "#53685f",
        "#b8673f",
        ("#39605a", "#e3b458", "#a8452d", "#87a6a2", "#efe1c6"),
        ("#e6d8be", "#a8452d", "#39605a"),
    ),
    Palette(
        "#e8e6df",
        "#6d7f93",
        "planks",
        "#a97c53",
        "ash",
        "#e9e4da",
        "#68788a",
        ("#d4815b", "#edc88f", "#3e5568", "#9bb0a5", "#8a4b3c"),
        ("#dfdcd2", "#54687c", "#d08c5a"),
    ),
)


def pick(rng: np.random.Generator, options: tuple[str, ...]) -> str:
    """Random choice of `options`."""
    return options[int(rng.integers(len(options)))]


def wood(palette: Palette, rng: np.random.Generator, span: float = 0.7) -> Material:
    """The room's wood, a shade lighter or darker from piece to piece."""
    return Material(shade(rgb(WOODS[palette.wood]), rng, 0.06), ("wood",), span, gloss=0.12)


def paint(code: str, gloss: float = 0.12) -> Material:
    """Smooth painted or plastic surface."""
    return Material(rgb(code), None, gloss=gloss)


def cloth(code: str, span: float = 0.22) -> Material:
    """Woven upholstery."""
    return Material(rgb(code), ("fabric",), span)


def metal(palette: Palette) -> Material:
    """Dark powder-coated metal."""
    return Material(rgb(palette.metal), None, gloss=0.35)


def shade(color: tuple[float, float, float], rng: np.random.Generator, deviation: float) -> tuple[float, float, float]:
    """The colour scaled at random, staying below white."""
    factor = float(np.clip(1 + deviation * rng.standard_normal(), 0.75, 1.2))
    r, g, b = (min(0.95, c * factor) for c in color)
    return (r, g, b)


TextureKey = tuple[object, ...]
"""Names a texture of `textures.pyramid`: its kind, then that kind's arguments."""


def rgb(hex_code: str) -> tuple[float, float, float]:
    """Linear reflectance (0..1 each) of an sRGB colour written like "#a1b2c3". The transfer function is that of IEC
    61966-2-1."""
    s = [int(hex_code[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    r, g, b = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in s)
    return (r, g, b)


@dataclass(frozen=True)
class Material:
    """Appearance of a part."""

    color: tuple[float, float, float]  # (3,) float: Linear reflectance; multiplies the texture
    texture: TextureKey | None = None
    span: float = 0.5  # Metres that one repeat of the texture covers; 0 stretches one copy over the part
    gloss: float = 0.0  # Strength of the mirror-like highlight, 0..1
    emission: float = 0.0  # Light given off, as a multiple of the colour


@dataclass(frozen=True, eq=False)
class ModelPart:
    """A piece of a single material."""

    vertices: np.ndarray  # (V, 3) float64: Metres, in the model's frame
    faces: np.ndarray  # (F, 3) int32
    material: Material

    @cached_property
    def low(self) -> np.ndarray:
        return self.vertices.min(axis=0)

    @cached_property
    def high(self) -> np.ndarray:
        return self.vertices.max(axis=0)

    def moved(self, offset: Iterable[float]) -> ModelPart:
        """Part shifted by `offset` ((3,), metres)."""
        return replace(self, vertices=self.vertices + np.asarray(tuple(offset), dtype=np.float64))

    def turned(self, angle: float, axis: int = 2, about: Iterable[float] = (0.0, 0.0, 0.0)) -> ModelPart:
        """Part turned by `angle` radians about a coordinate axis through `about`."""
        origin = np.asarray(tuple(about), dtype=np.float64)
        return replace(self, vertices=(self.vertices - origin) @ axis_rotation(angle, axis).T + origin)


@dataclass(frozen=True)
class RestSurface:
    """A level rectangle things may rest on, in the model's frame, metres. `room` is the free height above it."""

    z: float
    x0: float
    x1: float
    y0: float
    y1: float
    room: float = 3.0


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """An object: z up, front towards -y, standing on z = 0, centred on the z axis."""

    label: str  # Class name
    parts: tuple[ModelPart, ...]
    surfaces: tuple[RestSurface, ...] = ()  # Where other things may be put on it, the main one first

    @cached_property
    def low(self) -> np.ndarray:
        """(3,) lower corner of the exact box in the model's frame, metres."""
        return np.min([part.low for part in self.parts], axis=0)

    @cached_property
    def high(self) -> np.ndarray:
        """(3,) upper corner of the exact box in the model's frame, metres."""
        return np.max([part.high for part in self.parts], axis=0)

    @property
    def size(self) -> np.ndarray:
        return self.high - self.low

    @cached_property
    def key(self) -> str:
        """Equal for equal class and geometry, whatever the colours."""
        digest = hashlib.blake2b(self.label.encode(), digest_size=12)
        for part in self.parts:
            digest.update(np.round(part.vertices * 1e5).astype(np.int64).tobytes())
            digest.update(part.faces.astype(np.int32).tobytes())
        return digest.hexdigest()


def assemble(label: str, parts: Iterable[ModelPart], surfaces: Iterable[RestSurface] = ()) -> ObjectModel:
    """A model from parts in any frame with z up: recentred over the origin and set on z = 0."""
    parts = tuple(parts)
    low = np.min([part.low for part in parts], axis=0)
    high = np.max([part.high for part in parts], axis=0)
    dx, dy, dz = -(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]
    return ObjectModel(
        label,
        tuple(part.moved((dx, dy, dz)) for part in parts),
        tuple(RestSurface(s.z + dz, s.x0 + dx, s.x1 + dx, s.y0 + dy, s.y1 + dy, s.room) for s in surfaces),
    )


def axis_rotation(angle: float, axis: int) -> np.ndarray:
    """(3, 3) right-handed rotation by `angle` radians about coordinate axis 0, 1 or 2."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


BRASS = Material(rgb("#c8a155"), None, gloss=0.7)
STEEL = Material(rgb("#b9bcc0"), None, gloss=0.7)
WHITE = Material(rgb("#f4f1ea"), None, gloss=0.25)
BLACK = Material(rgb("#1d1e21"), None, gloss=0.35)
PAPER = Material(rgb("#f1eadb"), ("plaster",), 0.05)


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
