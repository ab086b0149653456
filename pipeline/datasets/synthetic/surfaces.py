"""What camera rays see: where, which way it faces, and of what colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.datasets.synthetic import textures
from pipeline.datasets.synthetic.raycast import Hits, Scene
from pipeline.geometry.camera import Camera

OFFSET_M = 2e-3
"""Rays leave this far from the surface they start on, so as not to meet it."""


@dataclass(frozen=True)
class Looks:
    """The materials of a scene as arrays, one row a part."""

    color: np.ndarray
    mean: np.ndarray
    texture: np.ndarray
    keys: tuple[tuple[object, ...], ...]
    span: np.ndarray
    gloss: np.ndarray
    emission: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True)
class Surfaces:
    """What N rays see: float32, world; `normal` is smoothed, `flat` the triangle's own, both towards the viewer."""

    hit: np.ndarray
    part: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    depth: np.ndarray

    def part_of(self, k: slice) -> Surfaces:
        """What some of the rays see."""
        return Surfaces(self.hit[k], self.part[k], self.position[k], self.normal[k], self.flat[k], self.depth[k])


@lru_cache(maxsize=4)
def looks(scene: Scene) -> Looks:
    """The scene's materials, with the mean colour of each texture for bounced light."""
    keys: dict[tuple[object, ...], int] = {}
    texture, mean = [], []
    for material in scene.materials:
        color = np.array(material.color)
        if material.texture is None:
            texture.append(-1)
            mean.append(color)
        else:
            texture.append(keys.setdefault(material.texture, len(keys)))
            mean.append(color * textures.pyramid(material.texture)[-1].mean(axis=(0, 1)))
    rng = np.random.default_rng(scene.room.seed)
    return Looks(
        np.array([m.color for m in scene.materials], dtype=np.float32),
        np.array(mean, dtype=np.float32),
        np.array(texture, dtype=np.int32),
        tuple(keys),
        np.array([m.span for m in scene.materials], dtype=np.float32),
        np.array([m.gloss for m in scene.materials], dtype=np.float32),
        np.array([m.emission for m in scene.materials], dtype=np.float32),
        rng.random((len(scene.materials), 2)).astype(np.float32),
    )


def find_surfaces(scene: Scene, camera: Camera, directions: np.ndarray) -> Surfaces:
    """What the rays from the camera's centre ((N, 3) directions) see first."""
    assert camera.T_world_camera is not None
    origin = camera.T_world_camera[:3, 3].astype(np.float32)
    return resolve(scene, scene.trace(origin, directions), origin, directions)


def resolve(scene: Scene, hits: Hits, origin: np.ndarray, directions: np.ndarray, round_off: bool = True) -> Surfaces:
    """The surfaces at hits; without `round_off` their normals are the triangles' own."""
    hit = hits.face >= 0
    face = np.where(hit, hits.face, 0)
    # Sheets are seen from both sides: the normal looks back at the viewer.
    flat = scene.normals[1].take(face, axis=0)
    away = np.where(np.einsum("ij,ij->i", flat, directions) > 0, np.float32(-1), np.float32(1))[:, None]
    flat *= away
    normal = flat
    if round_off:
        corner = scene.normals[0].reshape(-1, 9).take(face, axis=0)
        u, v = hits.u[:, None], hits.v[:, None]
        normal = (1 - u - v) * corner[:, :3] + u * corner[:, 3:6] + v * corner[:, 6:]
        normal *= away / np.maximum(np.sqrt(np.einsum("ij,ij->i", normal, normal)), 1e-9)[:, None]
    t = np.where(hit, hits.t, 0).astype(np.float32)
    return Surfaces(hit, scene.face_part.take(face), origin + t[:, None] * directions, normal, flat, t)


def reflectance(scene: Scene, look: Looks, s: Surfaces, pixel: float) -> np.ndarray:
    """Linear reflectance of each sample, textures projected along the nearest axis of the model's frame."""
    part = s.part
    out = look.color[part]
    kind = np.where(s.hit, look.texture[part], -1)
    textured = np.flatnonzero(kind >= 0)
    if len(textured) == 0:
        return out
    p = part[textured]
    local = _into_model(scene, p, s.position[textured] - scene.part_t[p])
    normal = np.abs(_into_model(scene, p, s.normal[textured]))
    # Ties are on bevelled edges, which go with the top.
    upright = 1.2 * normal[:, 2] >= np.maximum(normal[:, 0], normal[:, 1])
    across = ~upright & (normal[:, 0] >= normal[:, 1])
    low, size = scene.part_low.take(p, axis=0), (scene.part_high - scene.part_low).take(p, axis=0)
    (u, u_low, u_size), (v, v_low, v_size) = (
        [np.where(side, a[:, 1], a[:, other]) for a in (local, low, np.maximum(size, np.float32(1e-4)))]
        for side, other in ((across, 0), (upright, 2))
    )
    span = look.span[p]
    fitted = span == 0
    # Grain runs along the longer side of each face.
    turn = ~fitted & (v_size > u_size)
    u, v = np.where(turn, v, u), np.where(turn, u, v)
    scale = np.where(fitted, u_size, span)
    # Fitted pictures must not wrap their far edge into the near one.
    u = np.where(fitted, np.clip((u - u_low) / u_size, 0.002, 0.998), u / scale + look.offset[p, 0])
    v = np.where(fitted, np.clip(1 - (v - v_low) / v_size, 0.002, 0.998), v / scale + look.offset[p, 1])
    uv = np.stack([u, v], axis=1)
    footprint = s.depth[textured] * pixel / scale
    kind = kind[textured]
    for k in np.unique(kind):
        chosen = np.flatnonzero(kind == k)
        out[textured[chosen]] *= textures.sample(look.keys[k], uv[chosen], footprint[chosen])
    return np.minimum(out, 0.95)


def _into_model(scene: Scene, part: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """World vectors ((N, 3)) in the axes of their parts' models, which only ever turn about z."""
    cosine, sine = scene.part_R[part, 0, 0], scene.part_R[part, 1, 0]
    x, y, z = vectors.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)
