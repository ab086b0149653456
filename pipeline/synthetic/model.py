"""Synthetic objects: parts, models, and colour schemes of rooms."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

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
