"""Context mesh: posed frames around a frame, fused.

Fusion is Open3D's truncated signed distance volume (extra `open3d`). What the frame itself shows is left out of the
mesh: there its own cloud stands.
"""

from __future__ import annotations

import importlib
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import Dataset, load_picture, readable_frames
from pipeline.geometry.camera import project
from pipeline.geometry.cleaning import depth_edges, flying_pixels
from pipeline.geometry.frame import Frame
from pipeline.system.errors import FrameUnusable, MissingExtra, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent
from pipeline.system.whole_files import write_whole

MOST_FRAMES = 12
"""Neighbouring frames at most, nearest in the sequence first."""
VOXEL_M, FAR_M = 0.025, 6.0
"""Edge of a voxel; depths beyond are left out."""
HIDDEN_M = 0.08
"""Mesh in front of what the frame itself shows, or less than this behind it, is left out."""
SMALLEST_PART = 400
"""Parts of the mesh with fewer faces are left out."""


@dataclass(frozen=True)
class ContextMesh:
    """A coloured mesh in the camera frame of the central frame."""

    vertices: np.ndarray  # (V, 3) float32: Metres, camera frame
    faces: np.ndarray  # (F, 3) int32
    colors: np.ndarray  # (V, 3) uint8
    frames: int  # How many frames were fused


def neighbours(dataset: Dataset, frame_id: str, count: int = MOST_FRAMES) -> tuple[str, ...]:
    """The frames of the same sequence nearest to a frame in the dataset's order, itself left out."""
    sequence = frame_id.rpartition("/")[0]
    ids = [i for i in dataset.frame_ids if i.rpartition("/")[0] == sequence]
    at = ids.index(frame_id)
    return tuple(sorted((i for i in ids if i != frame_id), key=lambda i: abs(ids.index(i) - at))[:count])


def fuse_context(dataset: Dataset, frame: Frame) -> ContextMesh:
    """Fuse the posed frames around a frame, which has a pose.

    Raises
    ------
    FrameUnusable
        Where the frame or all frames around it have no pose.
    MissingExtra
        Where Open3D is not installed.
    """
    frame.camera.check_metric()
    no_pose = f"frame {frame.id} has no pose, so that no other frame can be placed around it"
    pose = needed(frame.camera.T_world_camera, no_pose, error=FrameUnusable)
    others = readable_frames(partial(load_picture, dataset), neighbours(dataset, frame.id))
    posed = [other for other in others if other.camera.T_world_camera is not None]
    require(posed, f"no other frame of the sequence of frame {frame.id} has a pose", error=FrameUnusable)
    key = str(dataset.root), frame.id, frame.content_hash, pose.tobytes()
    return _KEPT.get(key, lambda: _without_the_seen(_fused(posed, np.linalg.inv(pose)), frame))


_KEPT: Recent[tuple[object, ...], ContextMesh] = Recent(8)
"""Meshes that the page goes back to."""


def _fused(frames: list[Frame], T_camera_world: np.ndarray) -> ContextMesh:
    try:
        o3d: Any = importlib.import_module("open3d")
    except (ImportError, OSError) as error:  # OSError: the wheel is there, the system's GL libraries are not.
        raise MissingExtra("fusing the frames around this one", "open3d") from error

    float32 = o3d.core.float32
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"),
        attr_dtypes=(float32, float32, float32),
        attr_channels=((1), (1), (3)),
        voxel_size=VOXEL_M,
        block_resolution=16,
        block_count=5000,
        device=o3d.core.Device("CPU:0"),
    )
    for frame in frames:
        assert frame.camera.T_world_camera is not None
        uncertain = flying_pixels(frame.depth) | depth_edges(frame.depth)
        depth = o3d.t.geometry.Image(o3d.core.Tensor(np.where(uncertain, np.float32(0), frame.depth)))
        color = o3d.t.geometry.Image(o3d.core.Tensor(frame.rgb.astype(np.float32) / 255))
        K = o3d.core.Tensor(frame.camera.K)
        extrinsic = o3d.core.Tensor(np.linalg.inv(frame.camera.T_world_camera))
        blocks = grid.compute_unique_block_coordinates(depth, K, extrinsic, 1.0, FAR_M)
        grid.integrate(blocks, depth, color, K, K, extrinsic, 1.0, FAR_M)
    # One look at a place is enough; by default three are asked for.
    mesh = grid.extract_triangle_mesh(weight_threshold=0.5)
    if mesh.is_empty():
        return ContextMesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8), 0)
    vertices = mesh.vertex.positions.numpy() @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    colors = np.round(np.clip(mesh.vertex.colors.numpy(), 0, 1) * 255).astype(np.uint8)
    faces = mesh.triangle.indices.numpy().astype(np.int32)
    return ContextMesh(vertices.astype(np.float32), faces, colors, len(frames))


def _without_the_seen(mesh: ContextMesh, frame: Frame) -> ContextMesh:
    """Mesh without the surface visible in the frame's own depth."""
    if not len(mesh.vertices):
        return mesh
    pixel = np.nan_to_num(project(mesh.vertices, frame.camera), nan=-1.0)
    u, v = (np.clip(np.round(pixel[:, k]), -1, limit) for k, limit in ((0, frame.width), (1, frame.height)))
    inside = (u >= 0) & (v >= 0) & (u < frame.width) & (v < frame.height)
    depth = np.zeros(len(mesh.vertices), np.float32)
    depth[inside] = frame.depth[v[inside].astype(int), u[inside].astype(int)]
    # What lies in front of the frame's own surface, seen from its camera, is noise or hides it.
    seen = (depth > 0) & (mesh.vertices[:, 2] < depth + HIDDEN_M)
    faces = mesh.faces[~seen[mesh.faces].any(axis=1)]
    faces = faces[_part_sizes(faces, len(mesh.vertices)) >= SMALLEST_PART]
    used, compact = np.unique(faces, return_inverse=True)
    return replace(
        mesh,
        vertices=mesh.vertices[used],
        faces=compact.reshape(-1, 3).astype(np.int32),
        colors=mesh.colors[used],
    )


def _part_sizes(faces: np.ndarray, vertices: int) -> np.ndarray:
    """(F,) int: how many faces hang together with each face."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(vertices, vertices))
    part = connected_components(graph, directed=False)[1][faces[:, 0]]
    return np.bincount(part, minlength=1)[part]


def export_mesh(mesh: ContextMesh, path: Path) -> None:
    """Write the mesh as PLY, OBJ or GLB by the file's ending.

    Raises
    ------
    InputError
        For another ending, or a folder that cannot be written.
    """
    import trimesh

    require(
        path.suffix.lower() in (".ply", ".obj", ".glb"),
        "a mesh cannot be written as this",
        got=path.suffix,
        expected=".ply, .obj or .glb",
        path=path,
    )
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False)
    data = solid.export(file_type=path.suffix.lower()[1:])
    write_whole(path, data.encode() if isinstance(data, str) else bytes(data), "the mesh", make_folder=False)
