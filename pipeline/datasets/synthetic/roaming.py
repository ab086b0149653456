"""Cameras of every kind: held low, held high and tilted, rolled, close to a table; things are cut by the border."""

from __future__ import annotations

import numpy as np

from pipeline.datasets.synthetic.layout import Room
from pipeline.datasets.synthetic.raycast import build_scene, pixel_rays
from pipeline.datasets.synthetic.scattered import TABLE_TOP
from pipeline.datasets.synthetic.views import PROBE, camera_at
from pipeline.geometry.camera import Camera, intrinsics

HEIGHTS_M = {"low": (0.25, 0.8), "usual": (0.8, 1.7), "high": (1.6, 2.4)}
PITCHES_DEG = {"low": (-12.0, 25.0), "usual": (-5.0, 45.0), "high": (5.0, 65.0)}
ROLLS_DEG = 12.0
CLOSE_M = (0.45, 1.3)
"""Distance from the table's things, where a table is looked at."""

FOCALS = (0.65, 1.15)
"""Focal length in picture widths."""

NEAREST_M, NEAR_SHARE = 0.3, 0.03
"""At most this share of the picture may be nearer than a depth camera measures."""

LEAST_SEEN = 3
TRIES = 40


def roaming_cameras(room: Room, count: int, rng: np.random.Generator, width: int, height: int) -> list[Camera]:
    """`count` cameras in the room, each towards a thing drawn at random; fewer where too little can be seen."""
    scene = build_scene(room)
    v, u = (g.ravel() for g in np.meshgrid(np.arange(PROBE[1]), np.arange(PROBE[0]), indexing="ij"))
    cameras: list[Camera] = []
    for _ in range(count * TRIES):
        if len(cameras) == count:
            break
        place, heading, pitch, roll, focal = _candidate(room, rng)
        probe = _zoomed(camera_at(place, heading, pitch, roll, *PROBE), focal)
        hits = scene.trace(place, pixel_rays(probe, v, u))
        owner = np.where(hits.face >= 0, scene.part_instance[scene.face_part[np.maximum(hits.face, 0)]], -1)
        seen = np.bincount(owner[owner >= 0], minlength=1)
        if (hits.t < NEAREST_M).mean() <= NEAR_SHARE and (seen >= 4).sum() >= LEAST_SEEN:
            cameras.append(_zoomed(camera_at(place, heading, pitch, roll, width, height), focal))
    return cameras


def _candidate(room: Room, rng: np.random.Generator) -> tuple[np.ndarray, float, float, float, float]:
    target = room.instances[int(rng.integers(len(room.instances)))].box.center + rng.normal(0, 0.15, 3)
    roll, focal = float(np.deg2rad(rng.uniform(-ROLLS_DEG, ROLLS_DEG))), float(rng.uniform(*FOCALS))
    if room.kind == TABLE_TOP:
        pitch, heading = np.deg2rad(rng.uniform(10, 70)), rng.uniform(0, 2 * np.pi)
        ahead = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), -np.sin(pitch)])
        return target - rng.uniform(*CLOSE_M) * ahead, float(heading), float(pitch), roll, focal
    kind = ("low", "usual", "high")[int(rng.integers(3))]
    place = rng.uniform(0.15, [room.width - 0.15, room.depth - 0.15])
    eye = np.array([*place, rng.uniform(*HEIGHTS_M[kind])])
    gap = target - eye
    down = np.arctan2(-gap[2], np.hypot(gap[0], gap[1])) + np.deg2rad(rng.uniform(-10, 10))
    pitch = float(np.clip(down, *np.deg2rad(PITCHES_DEG[kind])))
    return eye, float(np.arctan2(gap[1], gap[0])), pitch, roll, focal


def _zoomed(camera: Camera, focal: float) -> Camera:
    """The camera with another focal length, in picture widths."""
    f, w, h = focal * camera.width, camera.width, camera.height
    K = intrinsics(f, f, (w - 1) / 2, (h - 1) / 2)
    return Camera(K, w, h, camera.T_world_camera, camera.up, camera.up_source)
