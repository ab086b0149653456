"""Objects of a Semantic Abstraction view (pixels, points), and the camera pose.

`cam_pose` is checked against the file's own points. The scene frame has x away from the camera, y to its left and z for
height, and 0.6 units a metre. The program that wrote the files mirrors z in `cam_pose`, and whether the depth is
mirrored with it cannot be told from the program alone. So the depth is put into the scene under every convention that
may be meant, and the one that puts it onto the points of the same objects is taken.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from pipeline.datasets.cameras import inverse, nearest_rotation
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Annotation
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

LEAST_POINTS = 20
"""An object with fewer points in the scene has no exact box."""
SAMPLES_AN_OBJECT = 60
"""Depth pixels of each object that the pose is judged by."""


@dataclass(frozen=True)
class ObjectPoints:
    """Points (M, 3) of annotated objects, with ascending object indices (M,) below `count`."""

    xyz: np.ndarray
    owner: np.ndarray
    count: int


def object_ids(seg: np.ndarray) -> np.ndarray:
    """Object ids of a segmentation, ascending."""
    real = seg[seg >= 0]
    # Counting is many times as fast as sorting, where the numbers are small.
    return np.flatnonzero(np.bincount(real)) if real.size and real.max() < real.size else np.unique(real)


def points_of(xyz: np.ndarray, objects: np.ndarray, ids: list[int]) -> ObjectPoints:
    """Points (M, 3) of the objects `ids` (ascending), sorted by object."""
    owner = _owners(objects, ids)
    chosen = np.flatnonzero(owner >= 0)
    order = chosen[np.argsort(owner[chosen], kind="stable")]
    xyz = xyz[order]
    finite = np.isfinite(xyz).all(axis=1)
    return ObjectPoints(xyz[finite], owner[order][finite].astype(np.int64), len(ids))


def _owners(values: np.ndarray, ids: list[int]) -> np.ndarray:
    """The index in `ids` (ascending) of each of many object ids; -1 for others."""
    # Small integers are what numpy sorts fastest.
    table = np.full((ids[-1] if ids else 0) + 2, -1, np.int16 if len(ids) < 2**15 else np.int32)
    table[ids] = np.arange(len(ids))
    return table[np.where((values >= 0) & (values < len(table) - 1), values, len(table) - 1)]


def depth_samples(seg: np.ndarray, depth: np.ndarray, ids: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and owners of at most `SAMPLES_AN_OBJECT` pixels with depth per object, evenly spread. So many of
    each, since a wall or a floor looks much the same upside down."""
    owner = _owners(seg, ids)
    owner = np.where(depth > 0, owner, -1).ravel()
    pixels = np.flatnonzero(owner >= 0)
    pixels = pixels[np.argsort(owner[pixels], kind="stable")]
    sorted_owner = owner[pixels].astype(np.int64)
    counts = np.bincount(sorted_owner, minlength=len(ids))
    rank = np.arange(len(pixels)) - (np.cumsum(counts) - counts)[sorted_owner]
    step = np.maximum(-(-counts // SAMPLES_AN_OBJECT), 1)[sorted_owner]
    pixels, sorted_owner = pixels[rank % step == 0], sorted_owner[rank % step == 0]
    v, u = np.divmod(pixels, seg.shape[1])
    return v, u, sorted_owner


def annotated_objects(
    seg: np.ndarray, labels: dict[int, str], pose: ScenePose | None, points: ObjectPoints | None
) -> tuple[Annotation, ...]:
    """Annotations for every object of `labels` (ascending ids present in `seg`), with boxes where known."""
    from scipy.ndimage import find_objects

    boxes = _boxes(pose, points, len(labels))
    # Slices are found of labels from 1; a label that has no pixel cannot be, they come from the pixels.
    slices = find_objects(_owners(seg, list(labels)).astype(np.int32) + 1, max_label=len(labels))
    found: list[Annotation] = []
    for (number, label), (rows, columns), box in zip(labels.items(), slices, boxes, strict=True):
        mask = np.zeros(seg.shape, np.bool_)
        mask[rows, columns] = seg[rows, columns] == number
        bbox = np.array([columns.start, rows.start, columns.stop, rows.stop])
        found.append(Annotation(number, label, bbox, mask, box, instance=number))
    return tuple(found)


def _boxes(pose: ScenePose | None, points: ObjectPoints | None, count: int) -> list[Box3D | None]:
    """The objects' boxes in the camera frame: extents of their points along the scene's axes."""
    if pose is None or points is None or not len(points.xyz):
        return [None] * count
    T = inverse(pose.T_world_camera)
    world = pose.to_world(points.xyz)
    sizes = np.bincount(points.owner, minlength=count)
    # Objects without a point have no run, and would break reduceat.
    runs = np.flatnonzero(sizes)
    starts = np.searchsorted(points.owner, runs)
    low, high = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    low[runs] = np.minimum.reduceat(world, starts)
    high[runs] = np.maximum.reduceat(world, starts)
    good = (sizes >= LEAST_POINTS) & (high > low).all(axis=1)
    return [
        Box3D((low[k] + high[k]) / 2, np.eye(3), high[k] - low[k]).transformed(T) if good[k] else None
        for k in range(count)
    ]


SCENE_UNITS_PER_METRE = 0.6
SCENE_BOUNDS = np.array([[-1.0, -1.0, -0.1], [1.0, 1.0, 1.9]])
MIRROR_TOP = 2.0
"""The writer's mirror takes a height z to 2 - z."""
CELLS = 40
"""Cells along the longest side of the scene: 5 cm in scene units, 8 cm in metres."""
LEAST_SHARE = 0.5
"""Share of the depth that must come to lie within a cell of its own object, for a convention to fit."""
LEAST_INSIDE = 30
"""So many depth samples must fall into the scene's bounds, to judge by."""
CLEARLY_DOWN = 0.5


@dataclass(frozen=True)
class ScenePose:
    """The camera in the scene, and the scene in metres."""

    T_world_camera: np.ndarray
    """(4, 4) float64: A rigid motion, metres. The world is the scene frame in metres, mirrored where `mirrored`."""
    up: np.ndarray  # (3,) float64: Against gravity in the camera frame
    units_per_metre: float  # Of the scene
    mirrored: bool  # Whether the file's points have to be mirrored in z, since as they are no rotation leads to them
    convention: str  # What had to be assumed; "" for the file's own cam_pose
    share: float  # Share of the depth samples that it puts onto their own objects

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """The file's points ((N, 3)) in the world, (N, 3) float64 metres."""
        sign = np.array([1.0, 1.0, -1.0 if self.mirrored else 1.0])
        return np.asarray(points, np.float64) * (sign / self.units_per_metre)


def fit_pose(
    cam_pose: np.ndarray,
    samples: np.ndarray,
    sample_owner: np.ndarray,
    points: np.ndarray,
    point_owner: np.ndarray,
    bounds: np.ndarray = SCENE_BOUNDS,
) -> ScenePose:
    """Fit the pose convention aligning depth and points.

    `cam_pose` (4, 4) float: As the file has it; `samples` (N, 3) float: Camera-frame points of the depth image,
    metres; `sample_owner` (N,) int: The object of each, counted from 0 without gaps; `points` (M, 3) float: The
    file's points of those objects, scene units; `point_owner` (M,) int: The object of each; `bounds` (2, 3) float:
    The scene's lowest and highest corner.
    """
    owners = int(max(sample_owner.max(initial=-1), point_owner.max(initial=-1))) + 1
    taken = _taken(points, point_owner, owners, bounds)
    best, best_hits, best_inside, best_name = None, -1, 0, ""
    for name, A in _conventions(np.asarray(cam_pose, np.float64)):
        at, inside, _ = _cells(samples @ A[:3, :3].T + A[:3, 3], bounds)
        hits = int(taken[(sample_owner[inside], *at[inside].T)].sum())
        if hits > best_hits:
            best, best_hits, best_inside, best_name = A, hits, int(inside.sum()), name
    share = best_hits / max(best_inside, 1)
    if best is None or best_inside < LEAST_INSIDE or share < LEAST_SHARE:
        raise InputError(f"depth and points do not fit under any convention, at best {share:.0%} of them")
    scale = float(np.cbrt(abs(np.linalg.det(best[:3, :3]))))
    mirrored = bool(np.linalg.det(best[:3, :3]) < 0)
    M = best[:3] / scale
    if mirrored:
        M[2] *= -1
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = nearest_rotation(M[:, :3]), M[:, 3]
    # The camera is level in this dataset: where z clearly points along the camera's down, it counts depth below.
    up = T[2, :3] * (-1.0 if T[2, 1] > CLEARLY_DOWN else 1.0)
    return ScenePose(T, up, scale, mirrored, best_name, share)


def _conventions(cam_pose: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Conventions for cam_pose: (assumption, camera-to-scene (4, 4)), the literal reading first."""
    require(
        np.isfinite(cam_pose).all() and np.abs(cam_pose[3] - (0, 0, 0, 1)).max() <= 1e-6, "cam_pose is no rigid motion"
    )
    linear = cam_pose[:3, :3]
    scale = float(np.cbrt(abs(np.linalg.det(linear))))
    require(
        scale >= 1e-6 and np.abs(linear @ linear.T / scale**2 - np.eye(3)).max() <= 1e-2,
        "cam_pose is not a rotation with one scale",
    )
    directions = [("", cam_pose), ("taken as scene-to-camera", np.linalg.inv(cam_pose))]
    scales = [("", np.eye(4))]
    if abs(scale - 1) < 0.05:
        scales.append((f"scaled by {SCENE_UNITS_PER_METRE:g}", np.diag([SCENE_UNITS_PER_METRE] * 3 + [1.0])))
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    lifted = mirror.copy()
    lifted[2, 3] = MIRROR_TOP
    heights = [("", np.eye(4)), ("with its height mirrored", lifted), ("with its height negated", mirror)]
    cameras = [
        ("", np.eye(4)),
        ("with the image's y upward", np.diag([1.0, -1.0, 1.0, 1.0])),
        ("in OpenGL's camera axes", np.diag([1.0, -1.0, -1.0, 1.0])),
    ]
    found: list[tuple[str, np.ndarray]] = []
    for (a, P), (b, S), (c, H), (d, C) in product(directions, scales, heights, cameras):
        words = ", ".join(word for word in (a, b, c, d) if word)
        # A scale about the origin of the scene, or about the camera where its position is in scene units already.
        found.append((words, H @ S @ P @ C))
        if b:
            found.append((f"{words} about the camera", H @ P @ S @ C))
    return sorted(found, key=lambda entry: bool(entry[0]) + entry[0].count(","))


def _cells(points: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Cells (N, 3) int64 of points, (N,) bool of points inside, and the shape of the scene with a rim of one cell."""
    size = bounds[1] - bounds[0]
    edge = float(size.max()) / CELLS
    shape = np.ceil(size / edge - 1e-6).astype(int) + 2
    with np.errstate(invalid="ignore", over="ignore"):
        cell = np.floor((points - (bounds[0] - edge)) / edge)
    inside: np.ndarray = np.all((cell >= 0) & (cell < shape), axis=1)
    return np.where(inside[:, np.newaxis], cell, 0).astype(np.int64), inside, tuple(shape.tolist())


def _taken(points: np.ndarray, owner: np.ndarray, owners: int, bounds: np.ndarray) -> np.ndarray:
    """Occupied cells of each object, (owners, X, Y, Z) bool, dilated by a cell."""
    at, inside, shape = _cells(points, bounds)
    grid = np.zeros((owners, *shape), bool)
    grid[(owner[inside], *at[inside].T)] = True
    for axis in (1, 2, 3):
        taken = np.moveaxis(grid, axis, 0)
        before = taken.copy()
        taken[1:] |= before[:-1]
        taken[:-1] |= before[1:]
    return grid
