"""A room as one triangle mesh in Embree, and what rays find in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from pipeline.datasets.synthetic.layout import Room
from pipeline.datasets.synthetic.model import Material, Model
from pipeline.geometry.camera import Camera
from pipeline.system.errors import MissingExtra

SMOOTH_COS = float(np.cos(np.deg2rad(50)))
"""Faces that meet at less than this angle are shaded as one round surface."""


@dataclass(frozen=True)
class Hits:
    """First hits of N rays.

    Attributes
    ----------
    t : (N,) float32
        Ray parameter, in lengths of the direction; inf where nothing was hit.
    face : (N,) int32
        Index into the scene's triangles, -1 where nothing was hit.
    u, v : (N,) float32
        Barycentric weights of the triangle's second and third corner.
    """

    t: np.ndarray
    face: np.ndarray
    u: np.ndarray
    v: np.ndarray


@dataclass(frozen=True, eq=False)
class Scene:
    """The room ready to be traced. P parts, F triangles.

    Attributes
    ----------
    vertices : (V, 3) float64
        World.
    faces : (F, 3) int
    face_part : (F,) int32
    part_instance : (P,) int32
        -1 for the shell.
    part_R, part_t : (P, 3, 3), (P, 3) float32
        World-from-model pose of the part's instance.
    part_low, part_high : (P, 3) float32
        Bounds in the model's frame.
    materials : tuple of Material, one a part
    """

    room: Room
    vertices: np.ndarray
    faces: np.ndarray
    face_part: np.ndarray
    part_instance: np.ndarray
    part_R: np.ndarray
    part_t: np.ndarray
    part_low: np.ndarray
    part_high: np.ndarray
    materials: tuple[Material, ...]
    tracer: Tracer

    @cached_property
    def normals(self) -> tuple[np.ndarray, np.ndarray]:
        """(F, 3, 3) float32 world normal at each corner, smoothed over round surfaces, and (F, 3) float32 of each face.

        Only colour needs them, and they cost as much as the rest of a scene.
        """
        return _normals(self.vertices, self.faces)

    def trace(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """First hits of rays, both (N, 3) in the world."""
        return self.tracer.first(origins, directions)

    def blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(N,) bool: whether anything lies along the ray, however far."""
        return self.tracer.blocked(origins, directions)


class Tracer:
    """An Embree scene of one triangle mesh.

    Raises
    ------
    MissingExtra
        embreex is not installed.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingExtra("rendering synthetic scenes", "render") from error
        self._scene: Any = EmbreeScene()
        self._mesh: Any = TriangleMesh(
            self._scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(faces, dtype=np.int32),
        )

    def first(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        origins, directions = _rays(origins, directions)
        found = self._scene.run(origins, directions, output=1)
        face = found["primID"].astype(np.int32)
        t = np.where(face >= 0, found["tfar"], np.float32(np.inf)).astype(np.float32)
        return Hits(t, face, found["u"], found["v"])

    def blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        origins, directions = _rays(origins, directions)
        return self._scene.run(origins, directions, query="OCCLUDED") == 0


def _rays(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    directions = np.ascontiguousarray(directions, dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(origins, directions.shape), dtype=np.float32), directions


@lru_cache(maxsize=4)
def build_scene(room: Room) -> Scene:
    """The room's triangles in world coordinates with everything shading needs; kept for the last rooms."""
    vertices, faces, face_part = [], [], []
    owner, turns, shifts, lows, highs, materials = [], [], [], [], [], []
    placed = [(-1, part, np.eye(3), np.zeros(3)) for part in room.shell]
    placed += [
        (k, part, instance.R, instance.position)
        for k, instance in enumerate(room.instances)
        for part in instance.model.parts
    ]
    start = 0
    for number, (index, part, R, position) in enumerate(placed):
        world = part.vertices @ R.T + position
        vertices.append(world)
        faces.append(part.faces + start)
        face_part.append(np.full(len(part.faces), number, dtype=np.int32))
        owner.append(index)
        turns.append(R)
        shifts.append(position)
        lows.append(part.low)
        highs.append(part.high)
        materials.append(part.material)
        start += len(world)
    mesh = np.concatenate(vertices), np.concatenate(faces)
    return Scene(
        room,
        *mesh,
        np.concatenate(face_part),
        np.array(owner, dtype=np.int32),
        np.array(turns, dtype=np.float32),
        np.array(shifts, dtype=np.float32),
        np.array(lows, dtype=np.float32),
        np.array(highs, dtype=np.float32),
        tuple(materials),
        Tracer(*mesh),
    )


def _normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner normals ((F, 3, 3)) and face normals ((F, 3)), float32.

    A corner's normal is the area-weighted mean over the faces around its
    vertex that are within the smoothing angle of its own face.
    """
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


def pixel_rays(camera: Camera, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(N, 3) float32 world directions of (sub)pixels; their length makes the ray parameter the depth z."""
    if camera.T_world_camera is None:
        raise ValueError("a camera must have a pose to be rendered from")
    local = np.empty((len(u), 3), dtype=np.float32)
    local[:, 0] = (u - camera.cx) / camera.fx
    local[:, 1] = (v - camera.cy) / camera.fy
    local[:, 2] = 1
    return local @ camera.T_world_camera[:3, :3].T.astype(np.float32)


@lru_cache(maxsize=256)
def _model_tracer(model: Model) -> Tracer:
    starts = np.cumsum([0, *(len(part.vertices) for part in model.parts[:-1])])
    return Tracer(
        np.concatenate([part.vertices for part in model.parts]),
        np.concatenate([part.faces + start for part, start in zip(model.parts, starts, strict=True)]),
    )


def silhouette(room: Room, index: int, camera: Camera, most: int = 60_000) -> tuple[int, np.ndarray, np.ndarray]:
    """The unoccluded silhouette of one instance.

    As in the BOP toolkit, it also counts what would fall outside the picture,
    here up to one picture size beyond each edge.

    Returns
    -------
    step : int
        Rays were cast at every `step`-th pixel both ways: 1 unless more than
        `most` would have been needed.
    v, u : (N,) int
        The rows and columns of those that hit.
    """
    instance = room.instances[index]
    pose = camera.T_world_camera
    if pose is None:
        raise ValueError("a camera must have a pose to be rendered from")
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
