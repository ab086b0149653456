"""A room as a triangle mesh in Embree, and ray hits: position, normal, colour."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from pipeline.geometry.camera import Camera
from pipeline.synthetic import textures
from pipeline.synthetic.layout import Room
from pipeline.synthetic.model import Material, ObjectModel
from pipeline.system.errors import extra_module, needed
from pipeline.system.frozen import dataclass

SMOOTH_COS = float(np.cos(np.deg2rad(50)))
"""Faces that meet at less than this angle are shaded as one round surface."""


@dataclass(frozen=True)
class Hits:
    """First hits of N rays."""

    t: np.ndarray  # (N,) float32: Ray parameter, in lengths of the direction; inf where nothing was hit
    face: np.ndarray  # (N,) int32: Index into the scene's triangles, -1 where nothing was hit
    u: np.ndarray
    v: np.ndarray  # (N,) float32: Barycentric weights of the triangle's second and third corner


@dataclass(frozen=True, eq=False)
class TracedRoom:
    """The room ready to be traced. P parts, F triangles."""

    room: Room
    vertices: np.ndarray  # (V, 3) float64: World
    faces: np.ndarray  # (F, 3) int
    face_part: np.ndarray  # (F,) int32
    part_instance: np.ndarray  # (P,) int32: -1 for the shell
    part_R: np.ndarray
    part_t: np.ndarray  # (P, 3, 3), (P, 3) float32: World-from-model pose of the part's instance
    part_low: np.ndarray
    part_high: np.ndarray  # (P, 3) float32: Bounds in the model's frame
    materials: tuple[Material, ...]
    tracer: EmbreeScene

    @cached_property
    def normals(self) -> tuple[np.ndarray, np.ndarray]:
        """(F, 3, 3) float32 world normal at each corner, smoothed over round surfaces, and (F, 3) float32 of each face.
        Only colour needs them, and they cost as much as the rest of a scene."""
        return _normals(self.vertices, self.faces)


class EmbreeScene:
    """An Embree scene of a triangle mesh."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        meshes, scenes = (
            extra_module(f"embreex.{name}", "rendering synthetic scenes", "render")
            for name in ("mesh_construction", "rtcore_scene")
        )
        self._scene: Any = scenes.EmbreeScene()
        self._mesh: Any = meshes.TriangleMesh(
            self._scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(faces, dtype=np.int32),
        )

    def first(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """First hits of rays, both (N, 3) in the world."""
        origins, directions = _rays(origins, directions)
        found = self._scene.run(origins, directions, output=1)
        face = found["primID"].astype(np.int32)
        t = np.where(face >= 0, found["tfar"], np.float32(np.inf)).astype(np.float32)
        return Hits(t, face, found["u"], found["v"])

    def blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(N,) bool: whether anything lies along the ray, however far."""
        origins, directions = _rays(origins, directions)
        return self._scene.run(origins, directions, query="OCCLUDED") == 0


def _rays(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    directions = np.ascontiguousarray(directions, dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(origins, directions.shape), dtype=np.float32), directions


@lru_cache(maxsize=4)
def build_scene(room: Room) -> TracedRoom:
    """The room's triangles in world coordinates with everything shading needs; kept for the last rooms."""
    placed = [(-1, part, np.eye(3), np.zeros(3)) for part in room.shell]
    placed += [
        (k, part, instance.R, instance.position)
        for k, instance in enumerate(room.instances)
        for part in instance.model.parts
    ]
    owners, parts, turns, shifts = zip(*placed, strict=True)
    world = [part.vertices @ R.T + position for _, part, R, position in placed]
    starts = np.cumsum([0, *(len(points) for points in world[:-1])])
    mesh = np.concatenate(world), np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)])
    return TracedRoom(
        room,
        *mesh,
        np.repeat(np.arange(len(parts), dtype=np.int32), [len(part.faces) for part in parts]),
        np.array(owners, dtype=np.int32),
        np.array(turns, dtype=np.float32),
        np.array(shifts, dtype=np.float32),
        np.array([part.low for part in parts], dtype=np.float32),
        np.array([part.high for part in parts], dtype=np.float32),
        tuple(part.material for part in parts),
        EmbreeScene(*mesh),
    )


def _normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner normals ((F, 3, 3)) and face normals ((F, 3)), float32. A corner's normal is the area-weighted mean over
    the faces around its vertex that are within the smoothing angle of its own face."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    weighted = np.cross(b - a, c - a)
    flat = weighted / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-15)
    corner_vertex = faces.ravel()
    order = np.argsort(corner_vertex, kind="stable")
    counts = np.bincount(corner_vertex, minlength=len(vertices))
    first = np.cumsum(counts) - counts
    around = counts[corner_vertex]
    mine = np.repeat(np.arange(len(corner_vertex)), around)
    offset = np.arange(len(mine)) - np.repeat(np.cumsum(around) - around, around)
    other = order[first[corner_vertex[mine]] + offset] // 3
    near = np.einsum("ij,ij->i", flat[mine // 3], flat[other]) > SMOOTH_COS
    total = np.zeros((len(corner_vertex), 3))
    for axis in range(3):
        total[:, axis] = np.bincount(mine, np.where(near, weighted[other, axis], 0.0), len(corner_vertex))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    own = np.repeat(flat, 3, axis=0)
    smooth = np.where(length > 1e-15, total / np.maximum(length, 1e-15), own)
    return smooth.reshape(-1, 3, 3).astype(np.float32), flat.astype(np.float32)


def pose_of(camera: Camera) -> np.ndarray:
    """Camera-to-world pose (4, 4) for rendering; InputError without a pose."""
    return needed(camera.T_world_camera, "a camera must have a pose to be rendered from", got="T_world_camera=None")


def pixel_rays(camera: Camera, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(N, 3) float32 world directions of (sub)pixels; their length makes the ray parameter the depth z."""
    T_world_camera = pose_of(camera)
    local = np.empty((len(u), 3), dtype=np.float32)
    local[:, 0] = (u - camera.cx) / camera.fx
    local[:, 1] = (v - camera.cy) / camera.fy
    local[:, 2] = 1
    return local @ T_world_camera[:3, :3].T.astype(np.float32)


@lru_cache(maxsize=256)
def _model_tracer(model: ObjectModel) -> EmbreeScene:
    starts = np.cumsum([0, *(len(part.vertices) for part in model.parts[:-1])])
    return EmbreeScene(
        np.concatenate([part.vertices for part in model.parts]),
        np.concatenate([part.faces + start for part, start in zip(model.parts, starts, strict=True)]),
    )


def silhouette(room: Room, index: int, camera: Camera, most: int = 60_000) -> tuple[int, np.ndarray, np.ndarray]:
    """Unoccluded silhouette of an instance. As in the BOP toolkit, it also counts what would fall outside the picture,
    here up to one picture size beyond each edge. `v, u` (N,) int: The rows and columns of those that hit."""
    instance = room.instances[index]
    pose = pose_of(camera)
    corners = (instance.box.corners - pose[:3, 3]) @ pose[:3, :3]
    w, h = camera.width, camera.height
    u0, v0, u1, v1 = -w, -h, 2 * w, 2 * h
    if (corners[:, 2] > 0.05).all():
        x = camera.fx * corners[:, 0] / corners[:, 2] + camera.cx
        y = camera.fy * corners[:, 1] / corners[:, 2] + camera.cy
        u0, u1 = max(u0, int(np.floor(x.min()))), min(u1, int(np.ceil(x.max())) + 1)
        v0, v1 = max(v0, int(np.floor(y.min()))), min(v1, int(np.ceil(y.max())) + 1)
    step = max(1, int(np.ceil(np.sqrt(max(u1 - u0, 1) * max(v1 - v0, 1) / most))))
    # The grid passes through pixel (0, 0), so that it meets the picture's own pixels.
    us, vs = np.arange(-(-u0 // step) * step, u1, step), np.arange(-(-v0 // step) * step, v1, step)
    v, u = (g.ravel() for g in np.meshgrid(vs, us, indexing="ij"))
    if len(u) == 0:
        return step, v, u
    directions = pixel_rays(camera, v, u) @ instance.R.astype(np.float32)
    origin = (pose[:3, 3] - instance.position) @ instance.R
    hit = _model_tracer(instance.model).blocked(origin, directions)
    return step, v[hit], u[hit]


OFFSET_M = 2e-3
"""Rays leave this far from the surface they start on, so as not to meet it."""


@dataclass(frozen=True)
class Looks:
    """Materials of a scene as arrays, a row per part."""

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
    """Ray hits (N), float32, world; `normal` is smoothed, `flat` the triangle's, both towards the viewer."""

    hit: np.ndarray
    part: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    depth: np.ndarray

    def part_of(self, k: slice) -> Surfaces:
        """Hits of some of the rays."""
        return Surfaces(self.hit[k], self.part[k], self.position[k], self.normal[k], self.flat[k], self.depth[k])


@lru_cache(maxsize=4)
def looks(scene: TracedRoom) -> Looks:
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


def find_surfaces(scene: TracedRoom, camera: Camera, directions: np.ndarray) -> Surfaces:
    """First hits of rays ((N, 3) directions) from the camera's centre."""
    origin = pose_of(camera)[:3, 3].astype(np.float32)
    return resolve(scene, scene.tracer.first(origin, directions), origin, directions)


def resolve(
    scene: TracedRoom, hits: Hits, origin: np.ndarray, directions: np.ndarray, round_off: bool = True
) -> Surfaces:
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


def reflectance(scene: TracedRoom, look: Looks, s: Surfaces, pixel: float) -> np.ndarray:
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


def _into_model(scene: TracedRoom, part: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """World vectors ((N, 3)) in model axes; models only turn about z."""
    cosine, sine = scene.part_R[part, 0, 0], scene.part_R[part, 1, 0]
    x, y, z = vectors.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)
