"""Where a robot would look from: cameras at its height that see many objects."""

from __future__ import annotations

import numpy as np

from pipeline.datasets.synthetic.layout import Focus, Room
from pipeline.datasets.synthetic.raycast import Scene, build_scene, pixel_rays
from pipeline.geometry.camera import Camera, intrinsics

FOCAL = 0.72
"""Focal length in picture widths: 69.6 degrees across, as an Intel D435's colour camera."""

NEAREST_M = 0.45
"""Nothing but the far walls may be closer to the lens."""

CANDIDATES = 60
PROBE = (48, 36)


def camera_at(
    place: np.ndarray, heading: float, pitch: float, roll: float, width: int = 640, height: int = 480
) -> Camera:
    """A camera at `place` ((3,), world metres); `pitch` is downwards, angles in radians."""
    forward = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), -np.sin(pitch)])
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    down = np.cross(forward, right)
    x = np.cos(roll) * right + np.sin(roll) * down
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(forward, x), forward], axis=1)
    T[:3, 3] = place
    f = FOCAL * width
    up = T[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    return Camera(intrinsics(f, f, (width - 1) / 2, (height - 1) / 2), width, height, T, up, "declared")


def choose_views(room: Room, count: int, rng: np.random.Generator, width: int = 640, height: int = 480) -> list[Camera]:
    """`count` cameras, each the best of many tried around one of the room's focuses in turn."""
    scene = build_scene(room)
    cameras: list[Camera] = []
    for k in range(count):
        focus = room.focuses[k % len(room.focuses)]
        tried = [_candidate(room, focus, rng) for _ in range(CANDIDATES)]
        scores = [_score(scene, candidate) for candidate in tried]
        place, heading, pitch, roll = tried[int(np.argmax(scores))]
        cameras.append(camera_at(place, heading, pitch, roll, width, height))
    return cameras


def _candidate(room: Room, focus: Focus, rng: np.random.Generator) -> tuple[np.ndarray, float, float, float]:
    heading = focus.heading + rng.uniform(-focus.spread, focus.spread)
    distance = rng.uniform(focus.near, focus.far)
    place = focus.target[:2] - distance * np.array([np.cos(heading), np.sin(heading)])
    place = np.clip(place, 0.30, [room.width - 0.30, room.depth - 0.30])
    eye = np.array([place[0], place[1], rng.uniform(1.15, 1.5)])
    gap = focus.target - eye
    pitch = np.arctan2(-gap[2], float(np.hypot(gap[0], gap[1])))
    heading = np.arctan2(gap[1], gap[0]) + np.deg2rad(rng.uniform(-4, 4))
    pitch = float(np.clip(pitch + np.deg2rad(rng.uniform(-5, 3)), np.deg2rad(10), np.deg2rad(30)))
    return eye, float(heading), pitch, float(np.deg2rad(rng.uniform(-2, 2)))


def _score(scene: Scene, candidate: tuple[np.ndarray, float, float, float]) -> float:
    """How much there is to see: objects of a fair size, none in the lens's way."""
    camera = camera_at(*candidate, width=PROBE[0], height=PROBE[1])
    v, u = (g.ravel() for g in np.meshgrid(np.arange(PROBE[1]), np.arange(PROBE[0]), indexing="ij"))
    hits = scene.trace(candidate[0], pixel_rays(camera, v, u))
    seen = hits.face >= 0
    if (hits.t < NEAREST_M).any() or np.median(hits.t[seen]) < 1.3:
        return -1e3
    index = scene.part_instance[scene.face_part[hits.face[seen]]]
    counts = np.bincount(index[index >= 0], minlength=len(scene.room.instances))
    # A thing of 0.3 % of the picture counts fully; a single one that fills a third of it costs.
    value = np.minimum(counts / (0.003 * len(v)), 1.0).sum()
    return float(value - 12.0 * max(0.0, counts.max() / len(v) - 0.28) - 6.0 * (hits.t < 0.9).mean() * 4)
