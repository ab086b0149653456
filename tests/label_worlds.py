"""Labels of worlds of boxes seen by points on their near faces: thousands of pairs in a second, without rays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from box_worlds import random_boxes
from label_sets import frame_row, object_row, pair_row, write_labels

from pipeline.geometry import Box3D, ViewerAxes, extents_of, pca_box, viewer_axes
from pipeline.labels import Labels
from pipeline.language import PAIRWISE
from pipeline.relations import pairwise_states

WIDTH, HEIGHT, FOCAL = 640, 480, 560.0
CLASSES = ("mug", "lamp", "office chair", "trash_can", "laptop", "sofa", "plant")
POINTS = 120


def label_worlds(
    folder: Path,
    scenes: int = 6,
    views: int = 4,
    *,
    seed: int = 0,
    camera_height: tuple[float, float] = (1.2, 1.6),
    pitch: tuple[float, float] = (10.0, 20.0),
    roll: float = 2.0,
) -> Labels:
    """Labels by the rule on what is seen; each view is a world of its own, degrees and metres as given."""
    rows: dict[str, list[Any]] = {"frames": [], "objects": [], "relations": []}
    for scene in range(scenes):
        for view in range(views):
            rng = np.random.default_rng([seed, scene, view])
            _add_view(rows, rng, f"s{scene}", f"s{scene}/{view:03d}", camera_height, pitch, roll)
    return write_labels(folder, rows)


def _add_view(
    rows: dict[str, list[Any]],
    rng: np.random.Generator,
    scene: str,
    name: str,
    camera_height: tuple[float, float],
    pitch: tuple[float, float],
    roll: float,
) -> None:
    tilt, lean = np.deg2rad(rng.uniform(*pitch)), np.deg2rad(rng.uniform(-roll, roll))
    up = np.array([np.sin(lean), -np.cos(lean) * np.cos(tilt), -np.cos(lean) * np.sin(tilt)])
    viewer = viewer_axes(up)
    pose = np.eye(4)
    pose[:3, 3] = rng.uniform(-3, 3, 3)
    frame = frame_row(
        len(rows["frames"]),
        name,
        scene=scene,
        up=up.tolist(),
        width=WIDTH,
        height=HEIGHT,
        T_world_camera=pose.ravel().tolist(),
    )
    lo, hi, clouds, objects = [], [], [], []
    for box in random_boxes(rng, rng.uniform(*camera_height)):
        level = _near_faces(box, rng)
        cloud = level @ viewer.R_level_camera
        bbox = _projected(cloud)
        if bbox is None:
            continue
        along = cloud @ viewer.matrix.T
        low, high = extents_of(along)
        lo.append(low)
        hi.append(high)
        clouds.append(along)
        objects.append(_object(frame, len(objects), str(rng.choice(CLASSES)), cloud, bbox, low, high, box, viewer))
    states = pairwise_states(np.array(lo), np.array(hi), clouds)
    rows["frames"].append({**frame, "objects": len(objects)})
    rows["objects"] += objects
    rows["relations"] += [
        pair_row(frame, a, b, dict(zip(PAIRWISE, states[a, b].tolist(), strict=True)))
        for a in range(len(objects))
        for b in range(len(objects))
        if a != b
    ]


def _near_faces(box: Box3D, rng: np.random.Generator) -> np.ndarray:
    """(POINTS, 3) noisy points on the faces that look at the origin; level frame (right, down, forward)."""
    inside = rng.uniform(-0.5, 0.5, (POINTS, 3))
    facing = -np.sign(box.R.T @ box.center)
    axis = rng.integers(0, 3, POINTS)
    inside[np.arange(POINTS), axis] = 0.5 * facing[axis]
    return (inside * box.size) @ box.R.T + box.center + rng.normal(0, 0.004, (POINTS, 3))


def _projected(cloud: np.ndarray) -> list[float] | None:
    """The 2D box of points in front of the camera; None where most of it is outside the image."""
    if (cloud[:, 2] < 0.3).any():
        return None
    pixels = FOCAL * cloud[:, :2] / cloud[:, 2:] + (WIDTH / 2, HEIGHT / 2)
    x0, y0 = np.clip(pixels.min(axis=0), 0, (WIDTH, HEIGHT))
    x1, y1 = np.clip(pixels.max(axis=0), 0, (WIDTH, HEIGHT))
    return None if min(x1 - x0, y1 - y0) < 8 else [float(x0), float(y0), float(x1), float(y1)]


def _object(
    frame: dict[str, Any],
    number: int,
    label: str,
    cloud: np.ndarray,
    bbox: list[float],
    lo: np.ndarray,
    hi: np.ndarray,
    box: Box3D,
    viewer: ViewerAxes,
) -> dict[str, Any]:
    pca = pca_box(cloud)[0]
    shown = Box3D(viewer.R_level_camera.T @ box.center, viewer.R_level_camera.T @ box.R, box.size)
    return object_row(
        frame,
        number,
        label,
        shown,
        bbox=bbox,
        lo=lo.tolist(),
        hi=hi.tolist(),
        pca_center=pca.center.tolist(),
        pca_R=pca.R.ravel().tolist(),
        pca_size=pca.size.tolist(),
    )
