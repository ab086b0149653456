"""What a synthetic object is made of: materials, parts, and the model that joins them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

TextureKey = tuple[object, ...]
"""Names a texture of `textures.pyramid`: its kind, then that kind's arguments."""


def rgb(hex_code: str) -> tuple[float, float, float]:
    """Linear reflectance (0..1 each) of an sRGB colour written like "#a1b2c3".

    The transfer function is that of IEC 61966-2-1.
    """
    s = [int(hex_code[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    r, g, b = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in s)
    return (r, g, b)


@dataclass(frozen=True)
class Material:
    """How a part looks.

    Attributes
    ----------
    color : (3,) float
        Linear reflectance; multiplies the texture.
    texture : TextureKey or None
    span : float
        Metres that one repeat of the texture covers; 0 stretches one copy over the part.
    gloss : float
        Strength of the mirror-like highlight, 0..1.
    emission : float
        Light given off, as a multiple of the colour.
    """

    color: tuple[float, float, float]
    texture: TextureKey | None = None
    span: float = 0.5
    gloss: float = 0.0
    emission: float = 0.0


@dataclass(frozen=True, eq=False)
class Part:
    """One piece of one material.

    Attributes
    ----------
    vertices : (V, 3) float64
        Metres, in the model's frame.
    faces : (F, 3) int32
    material : Material
    """

    vertices: np.ndarray
    faces: np.ndarray
    material: Material

    @cached_property
    def low(self) -> np.ndarray:
        return self.vertices.min(axis=0)

    @cached_property
    def high(self) -> np.ndarray:
        return self.vertices.max(axis=0)

    def moved(self, offset: Iterable[float]) -> Part:
        """The same part shifted by `offset` ((3,), metres)."""
        return replace(self, vertices=self.vertices + np.asarray(tuple(offset), dtype=np.float64))

    def turned(self, angle: float, axis: int = 2, about: Iterable[float] = (0.0, 0.0, 0.0)) -> Part:
        """The same part turned by `angle` radians about a coordinate axis through `about`."""
        origin = np.asarray(tuple(about), dtype=np.float64)
        return replace(self, vertices=(self.vertices - origin) @ axis_rotation(angle, axis).T + origin)


@dataclass(frozen=True)
class Surface:
    """A level rectangle things may rest on, in the model's frame, metres.

    `room` is the free height above it.
    """

    z: float
    x0: float
    x1: float
    y0: float
    y1: float
    room: float = 3.0


@dataclass(frozen=True, eq=False)
class Model:
    """An object: z up, its front towards -y, standing on z = 0, centred on the z axis.

    Attributes
    ----------
    label : str
        Class name.
    parts : tuple of Part
    surfaces : tuple of Surface
        Where other things may be put on it, the main one first.
    """

    label: str
    parts: tuple[Part, ...]
    surfaces: tuple[Surface, ...] = ()

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


def assemble(label: str, parts: Iterable[Part], surfaces: Iterable[Surface] = ()) -> Model:
    """A model from parts in any frame with z up: recentred over the origin and set on z = 0."""
    parts = tuple(parts)
    low = np.min([part.low for part in parts], axis=0)
    high = np.max([part.high for part in parts], axis=0)
    dx, dy, dz = -(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]
    return Model(
        label,
        tuple(part.moved((dx, dy, dz)) for part in parts),
        tuple(Surface(s.z + dz, s.x0 + dx, s.x1 + dx, s.y0 + dy, s.y1 + dy, s.room) for s in surfaces),
    )


def axis_rotation(angle: float, axis: int) -> np.ndarray:
    """(3, 3) right-handed rotation by `angle` radians about coordinate axis 0, 1 or 2."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R
