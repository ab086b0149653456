"""Rendering of a room: robot's viewpoint, colour, sensed and exact depth, instances and exact boxes."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera, intrinsics
from pipeline.synthetic.layout import Focus, Room
from pipeline.synthetic.lighting import render_colour
from pipeline.synthetic.raycast import TracedRoom, build_scene, find_surfaces, pixel_rays, pose_of
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class RenderedFrame:
    """A synthetic RGB-D frame with ground truth.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
    depth : (H, W) float32
        Metres as the sensor reports them; 0 where nothing came back.
    depth_exact : (H, W) float32
        Metres without noise; 0 where the ray left through the window.
    instances : (H, W) int32
        Index into the room's instances; -1 for the shell and the outside.
    boxes : tuple of Box3D
        The exact box of every instance of the room, in the camera frame.
    """

    rgb: np.ndarray
    depth: np.ndarray
    depth_exact: np.ndarray
    instances: np.ndarray
    boxes: tuple[Box3D, ...]
    camera: Camera


def render_view(room: Room, camera: Camera, rng: np.random.Generator) -> RenderedFrame:
    """Render the room from a posed camera; `rng` drives the depth sensor's errors only.

    Raises
    ------
    InputError
        The camera has no pose.
    MissingExtra
        embreex is not installed.
    """
    T_camera_world = np.linalg.inv(pose_of(camera))
    scene = build_scene(room)
    shape = (camera.height, camera.width)
    directions = _all_rays(camera)
    surfaces = find_surfaces(scene, camera, directions)
    exact = surfaces.depth.reshape(shape)
    index = np.where(surfaces.hit, scene.part_instance[surfaces.part], -1).reshape(shape).astype(np.int32)
    return RenderedFrame(
        render_colour(scene, camera, surfaces, directions),
        sense(exact, rng),
        exact,
        index,
        tuple(instance.box.transformed(T_camera_world) for instance in room.instances),
        camera,
    )


def sense_view(room: Room, camera: Camera, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Sensed depth and instances of a view without colour, many times faster than `render_view`.

    Raises
    ------
    InputError
        The camera has no pose.
    MissingExtra
        embreex is not installed.
    """
    exact, instances = exact_view(room, camera)
    return sense(exact, rng), instances


def exact_view(room: Room, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Only the `depth_exact` and the `instances` of `render_view`; raises as `sense_view`."""
    origin = pose_of(camera)[:3, 3].astype(np.float32)
    scene = build_scene(room)
    shape = (camera.height, camera.width)
    hits = scene.tracer.first(origin, _all_rays(camera))
    hit = hits.face >= 0
    exact = np.where(hit, hits.t, np.float32(0)).reshape(shape)
    owner = scene.part_instance[scene.face_part[np.where(hit, hits.face, 0)]]
    return exact.astype(np.float32), np.where(hit, owner, -1).reshape(shape).astype(np.int32)


def _all_rays(camera: Camera) -> np.ndarray:
    """Directions of the rays through all pixels, row by row."""
    v, u = np.meshgrid(np.arange(camera.height), np.arange(camera.width), indexing="ij")
    return pixel_rays(camera, v.ravel(), u.ravel())


HOLE_SHARE = 0.30
FLYING_SHARE = 0.25
"""Shares of the pixels at depth edges that come back empty, or in between."""
FARTHEST_M = 8.0
EDGE_M = 0.04


def noise_sigma(z: np.ndarray) -> np.ndarray:
    """Standard deviation of the depth noise in metres at depth z (metres). 1.2 mm * (0.4 + z^2): the quadratic growth
    of structured-light error (Khoshelham and Elberink 2012), as used for the measurements of the method."""
    return 0.0012 * (0.4 + np.square(z))


def sense(exact: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Simulate a depth sensor on exact depth.

    Parameters
    ----------
    exact : (H, W) float32
        Metres along z; 0 where nothing was hit.

    Returns
    -------
    (H, W) float32
        Metres; 0 where nothing came back: at depth edges, beyond the range, at grazing angles now and then.
    """
    exact = np.asarray(exact, dtype=np.float32)
    valid = exact > 0
    low = np.where(valid, exact, np.inf)
    high = exact.copy()
    for axis in (0, 1):
        for shift in (-1, 1):
            moved = np.roll(exact, shift, axis)
            edge = [slice(None), slice(None)]
            edge[axis] = slice(0, 1) if shift == 1 else slice(-1, None)
            moved[tuple(edge)] = exact[tuple(edge)]
            low = np.minimum(low, np.where(moved > 0, moved, np.inf))
            high = np.maximum(high, moved)
    low = np.where(np.isfinite(low), low, exact)
    step = np.where(valid, high - low, 0.0)
    at_edge = step > EDGE_M * np.maximum(1.0, exact)
    draw = rng.random(exact.shape, dtype=np.float32)
    mix = rng.random(exact.shape, dtype=np.float32)
    noisy = exact + noise_sigma(exact).astype(np.float32) * rng.standard_normal(exact.shape, dtype=np.float32)
    flying = at_edge & (draw >= HOLE_SHARE) & (draw < HOLE_SHARE + FLYING_SHARE)
    noisy = np.where(flying, low + mix * (high - low), noisy)
    lost = (at_edge & (draw < HOLE_SHARE)) | (exact > FARTHEST_M) | (draw > 0.9985)
    return np.where(valid & ~lost, np.maximum(noisy, 0.05), 0.0).astype(np.float32)


FOCAL = 0.72
"""Focal length in picture widths: 69.6 degrees across, as an Intel D435's colour camera."""
NEAREST_M = 0.45
"""Nothing but the far walls may be closer to the lens."""
CANDIDATES = 60
PROBE = (48, 36)


def camera_at(
    place: np.ndarray, heading: float, pitch: float, roll: float, width: int = 640, height: int = 480
) -> Camera:
    """A camera at `place` ((3,), world metres); `pitch` is downwards, angles in radians.

    Examples
    --------
    >>> import numpy as np
    >>> from pipeline.synthetic import camera_at
    >>> camera = camera_at(np.array([2.0, 1.0, 1.4]), heading=0.0, pitch=0.0, roll=0.0)
    >>> camera.up
    array([ 0., -1.,  0.])
    """
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
    """Choose `count` cameras, each the best of many candidates around the room's focuses in turn."""
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


def _score(scene: TracedRoom, candidate: tuple[np.ndarray, float, float, float]) -> float:
    """View score: visible objects of fair size, none close to the lens."""
    camera = camera_at(*candidate, width=PROBE[0], height=PROBE[1])
    v, u = (g.ravel() for g in np.meshgrid(np.arange(PROBE[1]), np.arange(PROBE[0]), indexing="ij"))
    hits = scene.tracer.first(candidate[0], pixel_rays(camera, v, u))
    seen = hits.face >= 0
    if (hits.t < NEAREST_M).any() or np.median(hits.t[seen]) < 1.3:
        return -1e3
    index = scene.part_instance[scene.face_part[hits.face[seen]]]
    counts = np.bincount(index[index >= 0], minlength=len(scene.room.instances))
    # A thing of 0.3 % of the picture counts fully; a single one that fills a third of it costs.
    value = np.minimum(counts / (0.003 * len(v)), 1.0).sum()
    return float(value - 12.0 * max(0.0, counts.max() / len(v) - 0.28) - 6.0 * (hits.t < 0.9).mean() * 4)
