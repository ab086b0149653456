"""Writes views in the very format of Semantic Abstraction from rendered rooms, for the tests of its reader."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np

from pipeline.geometry import Camera, intrinsics
from pipeline.synthetic import Room, camera_at, make_room
from pipeline.synthetic.render import sense_view

Written = Literal["literal", "proper", "opengl", "inverse", "metres", "points-down", "nonsense"]
SCALE = 0.6
DISTANCE = 2.5
"""The writer puts the scene's origin this far before the camera, in metres, and the camera 1.2 units up."""

TRUE_POSE = np.array([[0.0, 0, 1, -DISTANCE], [-1, 0, 0, 0], [0, -1, 0, 2.0], [0, 0, 0, 1]])
"""T_world_camera in metres, with a level camera: x away from it, y to its left, z up."""

EMPTY = 1
FIRST_OBJECT = 3
"""Ids in the file: a class that is never seen, empty space, out of bounds, then the room's instances."""


@dataclass(frozen=True)
class ViewTruth:
    """What was written.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
    depth : (H, W) float32
        Metres.
    seg : (H, W) int32
    labels : dict of int to str
        Of the seen objects.
    world : dict of int to (N, 3) float64
        The written points of each seen object in metres, in the frame of `TRUE_POSE`.
    """

    rgb: np.ndarray
    depth: np.ndarray
    seg: np.ndarray
    labels: dict[int, str]
    world: dict[int, np.ndarray]


def scene_pose(how: Written) -> np.ndarray:
    """cam_pose as it may be written: camera to scene, 0.6 units a metre."""
    S = np.diag([SCALE, SCALE, SCALE, 1.0])
    proper = S @ TRUE_POSE
    if how in ("literal", "points-down"):
        # The generator's own chain of transforms comes out as z = 0.8 + 0.6 y with y downwards.
        literal = proper.copy()
        literal[2] = [0, SCALE, 0, 0.8]
        return literal
    if how == "opengl":
        return proper @ np.diag([1.0, -1, -1, 1])
    if how == "inverse":
        return np.linalg.inv(proper)
    if how == "metres":
        return TRUE_POSE.copy()
    if how == "proper":
        return proper
    return S @ np.array([[0, 1.0, 0, 0.3], [1, 0, 0, 0.7], [0, 0, 1, -0.4], [0, 0, 0, 1]])


@lru_cache(maxsize=4)
def rendered(seed: int, size: int) -> tuple[Room, Camera, np.ndarray, np.ndarray]:
    """A room, a level camera with the dataset's 80 degrees, exact-enough depth and the instances."""
    room = make_room(seed)
    focus = room.focuses[0]
    place = focus.target[:2] - 2.6 * np.array([np.cos(focus.heading), np.sin(focus.heading)])
    place = np.clip(place, 0.3, [room.width - 0.3, room.depth - 0.3])
    gap = focus.target[:2] - place
    posed = camera_at(np.array([*place, 1.576]), math.atan2(gap[1], gap[0]), 0.0, 0.0, size, size)
    f = size / 2 / math.tan(math.radians(40))
    camera = Camera(intrinsics(f, f, size / 2, size / 2), size, size, posed.T_world_camera)
    depth, instances = sense_view(room, camera, np.random.default_rng(seed))
    return room, camera, depth, instances


def surface_points(room: Room, index: int, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) points on an instance's triangles, world metres."""
    instance = room.instances[index]
    triangles = np.concatenate([part.vertices[part.faces] for part in instance.model.parts])
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    a, b, c = np.moveaxis(triangles[rng.choice(len(triangles), count, p=area / area.sum())], 1, 0)
    s, t = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return (a * (1 - s) + b * (s * (1 - t)) + c * (s * t)) @ instance.R.T + instance.position


def write_view(
    path: Path,
    *,
    seed: int = 0,
    size: int = 160,
    points: int = 20_000,
    how: Written = "literal",
    descriptions: list[tuple[str, int, str, str]] | None = None,
    randomized: bool = False,
    items: int = 1,
    in_references: bool = False,
) -> ViewTruth:
    """One file. `descriptions` are (target, its id, relation, reference); with `in_references` by region references."""
    room, camera, depth, instances = rendered(seed, size)
    rng = np.random.default_rng(seed)
    rgb = rng.integers(0, 256, (size, size, 3)).astype(np.uint8)
    view = RenderedView(room, camera, rgb, depth, instances, tuple(i.model.label for i in room.instances))
    other = 255 - rgb if randomized else None
    return write_rendered(path, view, rng, points, how, descriptions, other, items, in_references)


@dataclass(frozen=True, eq=False)
class RenderedView:
    """What one file shows: rgb (H, W, 3) uint8, depth (H, W) float32 metres, the room's instances (H, W), -1 for none,
    and the class name of each instance. The camera is level."""

    room: Room
    camera: Camera
    rgb: np.ndarray
    depth: np.ndarray
    instances: np.ndarray
    names: tuple[str, ...]


def scene_clouds(view: RenderedView, rng: np.random.Generator, points: int) -> list[np.ndarray]:
    """(`points`, 3) of the whole surface of every instance, in scene units."""
    assert view.camera.T_world_camera is not None
    T = TRUE_POSE @ np.linalg.inv(view.camera.T_world_camera)
    room = view.room
    clouds = (surface_points(room, k, rng, points) for k in range(len(room.instances)))
    return [(cloud @ T[:3, :3].T + T[:3, 3]) * SCALE for cloud in clouds]


def write_rendered(
    path: Path,
    view: RenderedView,
    rng: np.random.Generator,
    points: int = 20_000,
    how: Written = "literal",
    descriptions: list[tuple[str, int, str, str]] | None = None,
    randomized: np.ndarray | None = None,
    items: int = 1,
    in_references: bool = False,
) -> ViewTruth:
    """One file of a rendered view; `randomized` is the picture (H, W, 3) with other materials."""
    seg = np.where(view.instances >= 0, view.instances + FIRST_OBJECT, -1).astype(np.int32)
    classes = ["ceiling", "empty", "out of bounds", *view.names]
    labels = {int(i): classes[i] for i in np.unique(seg[seg >= 0])}
    share = points // (2 * len(view.names))
    clouds = scene_clouds(view, rng, share)
    owner = np.repeat(np.arange(len(clouds)) + FIRST_OBJECT, share)
    scene = np.concatenate(clouds)
    inside = ((scene >= [-1, -1, -0.1]) & (scene <= [1, 1, 1.9])).all(axis=1)
    scene, owner = scene[inside], owner[inside]
    empty = rng.uniform([-1, -1, -0.1], [1, 1, 1.9], (points - len(scene), 3))
    order = rng.permutation(points)
    xyz = np.concatenate([scene, empty])[order].astype(np.float32)
    owner = np.concatenate([owner, np.full(len(empty), EMPTY)])[order].astype(np.int32)
    world = {i: xyz[owner == i].astype(np.float64) / SCALE for i in labels}
    if how == "points-down":
        xyz[:, 2] = 2 - xyz[:, 2]
    path.parent.mkdir(parents=True, exist_ok=True)
    root: dict[str, np.ndarray] = {
        "rgb": view.rgb,
        "depth": view.depth,
        "seg": seg,
        "full_xyz_pts": xyz,
        "full_objid_pts": owner,
        "tsdf_value_pts": np.zeros(512, np.float32),
        "tsdf_xyz_pts": np.zeros((512, 3), np.float32),
    }
    with h5py.File(path, "w") as file:
        group = file.create_group("data")
        for name, value in root.items():
            stored = np.stack([value if k == 0 else value[::-1] for k in range(items)])
            made = file.create_dataset(
                name,
                data=stored,
                chunks=(1, *value.shape),
                maxshape=(None, *value.shape),
                compression="gzip",
                compression_opts=1,
            )
            _list(group, name, [made.regionref[k, ...] for k in range(items)], h5py.regionref_dtype)
        file.create_dataset("saliencies", data=np.zeros((2, 8, 8), np.float32))
        group["cam_intr"], group["cam_pose"] = view.camera.K, scene_pose(how)
        group["scene_bounds"] = np.array([[-1, -1, -0.1], [1, 1, 1.9]])
        group["domain_randomized_rgb"] = np.zeros((1, 1)) if randomized is None else randomized[None]
        group["objid_to_class"] = np.array([f"{name}[{k}]" for k, name in enumerate(classes)]).astype("S")
        group["visible_scene_obj_labels"] = np.array(sorted(set(labels.values()))).astype("S")
        if descriptions is not None:
            _describe(file, group.create_group("descriptions"), descriptions, in_references)
    return ViewTruth(view.rgb, view.depth, seg, labels, world)


def _describe(file: Any, group: Any, rows: list[tuple[str, int, str, str]], in_references: bool) -> None:
    columns: dict[str, np.ndarray] = {
        "target_obj_name": np.array([row[0] for row in rows], object),
        "target_obj_id": np.array([row[1] for row in rows], np.int64),
        "target_obj_material": np.array(["Wood"] * len(rows), object),
        "reference_obj_name": np.array([row[3] for row in rows], object),
        "reference_obj_material": np.array([""] * len(rows), object),
        "spatial_relation_name": np.array([row[2] for row in rows], object),
    }
    for name, values in columns.items():
        data = values.tolist()
        kind = h5py.string_dtype() if values.dtype == object else np.dtype(np.int64)
        if not in_references:
            group.create_dataset(name, data=data, dtype=kind)
            continue
        stored = [text.encode() for text in data] if values.dtype == object else data
        held = file.create_dataset(f"description_{name}", data=np.array(stored))
        _list(group, name, [held.regionref[k : k + 1] for k in range(len(data))], h5py.regionref_dtype)


def _list(group: Any, name: str, references: list[Any], dtype: Any) -> None:
    made = group.create_dataset(name, (len(references),), dtype=dtype)
    for k, reference in enumerate(references):
        made[k] = reference
