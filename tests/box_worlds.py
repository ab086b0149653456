"""Rooms of another maker: boxes of random size on a floor, on tables and in the air, seen by noisy rays.

Nothing of it is shared with `pipeline.synthetic`: neither the geometry, nor the
cameras, nor the sensor's errors.
"""

from __future__ import annotations

import cv2
import numpy as np
from other_makers import MIN_PIXELS, USUAL, Extents, Regime, seen_objects
from scenes import Plane, camera_of, cast, up_of, upright

from pipeline.geometry import Box3D, Camera, LiftedObject, ViewerAxes, viewer_axes


def random_boxes(rng: np.random.Generator, floor: float) -> list[Box3D]:
    """Furniture on the floor, things on top of it, a few that hang; level frame (right, down, forward), metres."""
    boxes: list[Box3D] = []
    for _ in range(200):
        if len(boxes) >= 8:
            break
        size = rng.uniform((0.25, 0.2, 0.25), (1.0, 0.9, 0.8))
        at = (rng.uniform(-1.8, 1.8), floor - size[1] / 2, rng.uniform(1.3, 4.5))
        _add(boxes, upright(at, size, rng.uniform(0, 180)))
    for base in list(boxes):
        for _ in range(int(rng.integers(0, 3))):
            size = rng.uniform((0.06, 0.05, 0.06), (0.3, 0.35, 0.3))
            side = base.R @ (rng.uniform(-0.4, 0.4, 3) * base.size * (1, 0, 1))
            top = base.center[1] - base.size[1] / 2 - size[1] / 2
            at = (base.center[0] + side[0], top, base.center[2] + side[2])
            _add(boxes, upright(at, size, rng.uniform(0, 180)))
    for _ in range(2):
        size = rng.uniform((0.2, 0.15, 0.1), (0.6, 0.5, 0.3))
        at = (rng.uniform(-1.5, 1.5), floor - rng.uniform(1.3, 1.9), rng.uniform(2.5, 4.5))
        _add(boxes, upright(at, size, rng.uniform(0, 180)))
    return boxes


def _add(boxes: list[Box3D], box: Box3D) -> None:
    """Keep a box that does not reach into another one (by the discs around them in plan)."""
    for other in boxes:
        apart = np.hypot(*(box.center - other.center)[[0, 2]])
        reach = (np.hypot(*box.size[[0, 2]]) + np.hypot(*other.size[[0, 2]])) / 2
        stacked = abs(box.center[1] - other.center[1]) >= (box.size[1] + other.size[1]) / 2 - 1e-6
        if apart < reach and not stacked:
            return
    boxes.append(box)


def box_world(
    seed: int, width: int = 320, height: int = 240, regime: Regime | None = None
) -> tuple[list[LiftedObject], list[Extents], ViewerAxes, np.ndarray, Camera]:
    """What is seen of one world, and the exact extents of the same objects along (right, up, forward).

    The last two are the noisy depth and the camera, with its up vector.
    """
    rng = np.random.default_rng([seed, 99])
    given = regime or USUAL
    floor = rng.uniform(*given.height)
    viewer = viewer_axes(up_of(rng.uniform(*given.pitch), rng.uniform(-given.roll, given.roll)))
    camera = camera_of(width, height, rng.uniform(0.75, 1.05) * width).with_up(viewer.up, "declared")
    planes = [Plane((0, 1, 0), floor), Plane((0, 0, 1), 5.5)]
    seen = cast(camera, random_boxes(rng, floor), planes, viewer)
    depth = _noisy(seen.depth, rng)
    masks, exact = [], []
    for k, box in enumerate(seen.boxes):
        mask = seen.ids == k
        if mask.sum() < MIN_PIXELS:
            continue
        if rng.random() < 0.5:
            mask = cv2.dilate(mask.view(np.uint8), np.ones((3, 3), np.uint8)).view(np.bool_)
        corners = box.corners @ viewer.matrix.T
        masks.append(mask)
        exact.append((corners.min(axis=0), corners.max(axis=0)))
    found = seen_objects(depth, camera, masks, exact)
    return found.objects, found.exact, found.viewer, depth, camera


def _noisy(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise by a constant error of disparity, steps of disparity, and 2 % of the pixels lost."""
    disparity = 40.0 / np.maximum(depth, 0.1) + rng.normal(0, 0.03, depth.shape)
    noisy = 40.0 / np.maximum(np.round(disparity * 16) / 16, 0.5)
    lost = (depth <= 0) | (rng.random(depth.shape) < 0.02)
    return np.where(lost, 0, noisy).astype(np.float32)
