"""The objects of a Semantic Abstraction view: their pixels, their points, and what follows from both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.datasets.cameras import inverse
from pipeline.datasets.semantic_abstraction_pose import ScenePose
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Annotation

LEAST_POINTS = 20
"""An object with fewer points in the scene has no exact box."""
SAMPLES_AN_OBJECT = 60
"""Depth pixels of each object that the pose is judged by."""


@dataclass(frozen=True)
class ObjectPoints:
    """Points (M, 3) of the annotated objects and the place (M,) of each one's object, ascending, below `count`."""

    xyz: np.ndarray
    owner: np.ndarray
    count: int


def object_ids(seg: np.ndarray) -> np.ndarray:
    """The ids that a segmentation holds, ascending."""
    real = seg[seg >= 0]
    # Counting is many times as fast as sorting, where the numbers are small.
    return np.flatnonzero(np.bincount(real)) if real.size and real.max() < real.size else np.unique(real)


def points_of(xyz: np.ndarray, objects: np.ndarray, ids: list[int]) -> ObjectPoints:
    """Those of the points (M, 3), each with its object's id (M,), that belong to `ids`, ascending; sorted by object."""
    owner = _owners(objects, ids)
    chosen = np.flatnonzero(owner >= 0)
    order = chosen[np.argsort(owner[chosen], kind="stable")]
    xyz = xyz[order]
    finite = np.isfinite(xyz).all(axis=1)
    return ObjectPoints(xyz[finite], owner[order][finite].astype(np.int64), len(ids))


def _owners(values: np.ndarray, ids: list[int]) -> np.ndarray:
    """The place in `ids` (ascending) of each of many object ids; -1 for others."""
    # Small integers are what numpy sorts fastest.
    table = np.full((ids[-1] if ids else 0) + 2, -1, np.int16 if len(ids) < 2**15 else np.int32)
    table[ids] = np.arange(len(ids))
    return table[np.where((values >= 0) & (values < len(table) - 1), values, len(table) - 1)]


def depth_samples(seg: np.ndarray, depth: np.ndarray, ids: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and owners of at most `SAMPLES_AN_OBJECT` pixels with depth of each object, evenly over it.

    So many of each, since a wall or a floor looks much the same upside down.
    """
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
    """Every object of `labels` (id to class, ascending ids, each with a pixel in `seg`), its box where it has one."""
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
