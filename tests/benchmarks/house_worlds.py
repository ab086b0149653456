"""Furnished rooms and table tops of a maker of their own, for measuring: three kinds of sensors, exact or rough masks.

No network learns from them or is calibrated on them. The rooms: house_rooms.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from benchmarks.house_models import Rng
from benchmarks.house_rooms import furnished, table_top
from benchmarks.house_space import House, Placed
from other_makers import MIN_PIXELS, Regime, Seen, seen_objects
from scipy.special import ndtri

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera, intrinsics
from pipeline.geometry.viewer import viewer_axes
from pipeline.synthetic.raycast import EmbreeScene, pixel_rays, pose_of

ROOMS, CAMERAS = 60, 150
"""Rooms tried for a world, and cameras tried in a room."""
SHELL, PANE, NOTHING = -1, -2, -3
FEWEST, MOST = 5, 20
"""Objects of MIN_PIXELS in a view."""
COARSE = 5
"""A camera is judged by every so manyth pixel both ways."""


@dataclass(frozen=True, eq=False)
class _View:
    """What rays of a camera see: `ids` index what is placed, or are SHELL, PANE or NOTHING; (H, W) all but points."""

    depth: np.ndarray
    ids: np.ndarray
    slant: np.ndarray
    """Cosine between ray and surface."""
    points: np.ndarray
    """(H, W, 3), in the world."""


class _Scene:
    """A room's triangles, ready to be looked at."""

    def __init__(self, house: House) -> None:
        self.house = house
        self.vertices = [np.asarray(found.mesh.vertices) for found in house.placed]
        self.middles = np.array([points.mean(axis=0) for points in self.vertices])
        owners = [*range(len(house.placed)), *[SHELL] * len(house.shell), *[PANE] * len(house.panes)]
        meshes = [*(found.thing.mesh for found in house.placed), *house.shell, *house.panes]
        points = [*self.vertices, *(np.asarray(mesh.vertices) for mesh in (*house.shell, *house.panes))]
        starts = np.cumsum([0, *map(len, points)])
        faces = np.concatenate([np.asarray(mesh.faces) + k for mesh, k in zip(meshes, starts, strict=False)])
        corners = np.concatenate(points)[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
        self.owner = np.repeat(owners, [len(mesh.faces) for mesh in meshes])
        self.tracer = EmbreeScene(np.concatenate(points), faces)

    def seen(self, camera: Camera, step: int = 1) -> _View:
        v, u = np.mgrid[step // 2 : camera.height : step, step // 2 : camera.width : step]
        eye, rays = pose_of(camera)[:3, 3], pixel_rays(camera, v.ravel(), u.ravel())
        hits = self.tracer.first(eye, rays)
        met, face = hits.face >= 0, np.maximum(hits.face, 0)
        depth = np.where(met, hits.t, 0)
        slant = np.abs((self.normals[face] * rays).sum(axis=1)) / np.linalg.norm(rays, axis=1)
        ids = np.where(met, self.owner[face], NOTHING)
        points = eye + rays * depth[:, None]
        depth, ids, slant = (found.reshape(v.shape) for found in (depth, ids, slant))
        return _View(depth, ids, slant, points.reshape(*v.shape, 3))

    def hidden(self, view: _View, eye: np.ndarray) -> np.ndarray:
        """(H, W) bool: whether something is between there and what is seen."""
        ways = view.points.reshape(-1, 3) - eye
        return (self.tracer.first(eye, ways).t < 1 - 0.012).reshape(view.ids.shape)


# Cameras


def _pose(rng: Rng, regime: Regime, heading: float) -> np.ndarray:
    """Of a camera at the origin that looks there."""
    pitch, roll = np.deg2rad(rng.uniform(*regime.pitch)), np.deg2rad(rng.uniform(-regime.roll, regime.roll))
    ahead = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), -np.sin(pitch)])
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    x = np.cos(roll) * right + np.sin(roll) * np.cross(ahead, right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(ahead, x), ahead], axis=1)
    return pose


def _camera(scene: _Scene, upon: list[Placed], regime: Regime, rng: Rng, width: int, height: int) -> Camera | None:
    """One that stands free and sees enough, not all of it one thing; None where none is found."""
    placed, size = scene.house.placed, scene.house.size
    focus = [placed.index(found) for found in upon]
    for _ in range(CAMERAS):
        if regime.close:
            pose = _pose(rng, regime, rng.uniform(0, 2 * np.pi))
            towards = scene.middles[focus[int(rng.integers(len(focus)))]]
            eye = towards - rng.uniform(*regime.height) * pose[:3, 2] + rng.normal(0, 0.05, 3)
        else:
            eye = rng.uniform((0.25, 0.25, regime.height[0]), (*(size[:2] - 0.25), regime.height[1]))
            gap = scene.middles[int(rng.integers(len(placed)))] - eye
            pose = _pose(rng, regime, np.arctan2(gap[1], gap[0]) + rng.normal(0, 0.25))
        pose[:3, 3] = eye
        f = width / 2 / np.tan(np.deg2rad(rng.uniform(50, 74)) / 2)
        cx, cy = rng.normal(((width - 1) / 2, (height - 1) / 2), 4 / 480 * width)
        K = intrinsics(f, f * rng.uniform(0.995, 1.005), cx, cy)
        camera = Camera(K, width, height, pose, pose[:3, :3].T @ np.array([0, 0, 1.0]), "declared")
        if _free(scene.house, eye, 0.2 if regime.close else 0.3) and _worthwhile(scene.seen(camera, COARSE), focus):
            return camera
    return None


def _free(house: House, eye: np.ndarray, least: float) -> bool:
    """In the room, and so far from anything."""
    if (eye[:2] < 0.25).any() or (eye[:2] > house.size[:2] - 0.25).any() or not 0.25 < eye[2] < house.size[2] - 0.08:
        return False
    x, y, hx, hy, yaw, z0, z1 = house.boxes.T
    u, v = eye[0] - x, eye[1] - y
    off = np.abs(np.cos(yaw) * u + np.sin(yaw) * v) - hx, np.abs(np.cos(yaw) * v - np.sin(yaw) * u) - hy
    return bool((np.linalg.norm(np.maximum([*off, np.maximum(z0 - eye[2], eye[2] - z1)], 0), axis=0) >= least).all())


def _worthwhile(view: _View, focus: list[int]) -> bool:
    """Neither too near nor too far from what it is about (`focus`, or the room), several things, none all over it."""
    if (view.ids == NOTHING).any():
        return False
    if focus:
        about = np.isin(view.ids, focus)
        if about.mean() < 0.06 or not 0.45 < np.median(view.depth[about]) < 1.25 or np.quantile(view.depth, 0.02) < 0.3:
            return False
    elif np.quantile(view.depth, 0.03) < 0.45 or np.median(view.depth) < 1:
        return False
    pixels = np.bincount(view.ids[view.ids >= 0], minlength=1)
    return pixels.max() <= 0.55 * view.ids.size and (pixels >= 10).sum() >= 4 and (pixels >= 7).sum() <= 22


# Depth


def _noise(rng: Rng, shape: tuple[int, ...], scale: float) -> np.ndarray:
    """Smooth normal noise of unit variance."""
    found = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), scale)
    return found / found.std()


def _sensed(scene: _Scene, view: _View, camera: Camera, rng: Rng) -> np.ndarray:
    """Depth as of structured light, of a stereo pair or of time of flight; 0 where nothing is measured."""
    kind = str(rng.choice(("light", "stereo", "flight"), p=(0.45, 0.35, 0.2)))
    shape, kernel, depth = view.ids.shape, np.ones((3, 3), np.uint8), view.depth.astype(np.float32)
    near, far, base = cv2.erode(depth, kernel), cv2.dilate(depth, kernel), rng.uniform(0.05, 0.09)
    edge = far - near > np.maximum(0.03, 0.03 * depth)
    if kind == "flight":
        ripple = 0.002 * depth * _noise(rng, shape, 30) + 0.006 * rng.uniform(0.3, 1) * _noise(rng, shape, 18)
        found = depth + ripple + (0.002 + 0.0012 * depth**2) * rng.standard_normal(shape)
        lost = np.zeros(shape, np.bool_)
    else:
        lost = _shadow(scene, view, camera, base * rng.choice((-1, 1)))
        if kind == "light":
            found = _light(depth, camera.fx * base, camera.width, rng)
        else:
            lost &= _noise(rng, shape, 2) > -0.3
            found = _stereo(depth, camera.fx * base, rng)
    flying = edge & (rng.random(shape) < {"light": 0.06, "stereo": 0.3, "flight": 0.5}[kind])
    found = np.where(flying, near + rng.random(shape) * (far - near), found)
    torn = _noise(rng, shape, 1.2) > {"light": -0.4, "stereo": 0.4, "flight": 0.6}[kind]
    lost |= edge & torn & ~flying
    lost |= (view.slant < rng.uniform(0.06, 0.16)) & (_noise(rng, shape, 2) > -0.5)
    lost |= _absorbed(scene.house, view, rng)
    lost |= _noise(rng, shape, 5) > rng.uniform(2.4, 3.2)
    lost |= (depth < rng.uniform(0.2, 0.35)) | (depth > rng.uniform(7, 8.5)) | (found < 0.05) | (found > 9)
    if kind != "flight":
        lost[:, : int(rng.integers(0, 9))] = True
    return np.where(lost, 0, found).astype(np.float32)


def _shadow(scene: _Scene, view: _View, camera: Camera, aside: float) -> np.ndarray:
    """What an eye or a projector beside the camera does not see."""
    pose = pose_of(camera)
    return scene.hidden(view, pose[:3, 3] + aside * pose[:3, 0])


def _light(depth: np.ndarray, product: float, width: int, rng: Rng) -> np.ndarray:
    """Disparity in eighths of a pixel of a picture of 640."""
    scale, shape = 640 / width, depth.shape
    disparity = scale * product / np.maximum(depth, 0.05)
    disparity += rng.uniform(0.06, 0.16) * _noise(rng, shape, 1.2) + 0.05 * _noise(rng, shape, 30)
    return scale * product / np.maximum(np.round(8 * disparity) / 8, 1e-3)


def _stereo(depth: np.ndarray, product: float, rng: Rng) -> np.ndarray:
    """What is in front grows; noise of some 20 to 40 mm RMS at 2.5 m."""
    shape, loud = depth.shape, rng.uniform(0.5, 1)
    grown = cv2.erode(depth, np.ones((2 * int(rng.integers(1, 3)) + 1,) * 2, np.uint8))
    depth = np.where((_noise(rng, shape, 3) > 0.1) & (depth - grown > 0.03 * depth), grown, depth)
    disparity = product / np.maximum(depth, 0.05)
    noise = rng.uniform(0.08, 0.22) * _noise(rng, shape, rng.uniform(1.5, 3.5))
    disparity += loud * (noise + 0.04 * _noise(rng, shape, 25) + 0.04 * rng.standard_normal(shape))
    steps = rng.choice((8, 16, 32))
    return product / np.maximum(np.round(steps * disparity) / steps, 1e-3)


def _absorbed(house: House, view: _View, rng: Rng) -> np.ndarray:
    """Blobs of what is dark or gives no echo, and most of panes."""
    shares = np.array([*(found.thing.absorbs for found in house.placed), 0.0])
    share = np.where(view.ids >= 0, shares[view.ids], 0) * rng.uniform(0.2, 1.2)
    share = np.where(view.ids == PANE, 0.85, share)
    return _noise(rng, share.shape, 4) < ndtri(share)


# Masks


def _rough(mask: np.ndarray, kind: int, rng: Rng) -> np.ndarray:
    """Off by some pixels: grown or shrunk by a wavy border, then (1) shifted or (2) a coarse polygon."""
    inside, outside = (cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, 3) for side in (mask, ~mask))
    across = np.sqrt(mask.sum())
    most = min(3.0, across / 12)
    wave = np.clip(0.5 * _noise(rng, mask.shape, rng.uniform(3, 8)), -1, 1)
    found = inside - outside + most * (rng.normal(0, 0.4) + wave) > 0
    if kind == 1:
        found = np.roll(found, rng.integers(-1, 2, 2), (0, 1))
    if kind == 2:
        outlines, _ = cv2.findContours(found.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        polygons = [cv2.approxPolyDP(line, min(2.5, across / 14), True) for line in outlines]
        filled = cv2.fillPoly(np.zeros(mask.shape, np.uint8), polygons, 1)
        found = (filled > 0) & (outside <= 4)
    return found if found.sum() >= MIN_PIXELS // 2 else mask


@dataclass(frozen=True, eq=False)
class SensedView:
    """A view of one world as a sensor gives it."""

    camera: Camera
    depth: np.ndarray
    """(H, W) float32, metres."""
    masks: list[np.ndarray]
    rough: bool
    """Whether the masks are off by some pixels."""
    things: list[Placed]
    vertices: list[np.ndarray]
    """(N, 3) each: of the things, in the world."""

    @property
    def names(self) -> list[str]:
        return [found.thing.kind for found in self.things]

    def boxes(self) -> list[Box3D]:
        """Exact boxes, along the sides of the things' models, in the camera frame."""
        R_camera_world, eye = pose_of(self.camera)[:3, :3].T, pose_of(self.camera)[:3, 3]
        found = []
        for placed in self.things:
            lo, hi = placed.thing.mesh.bounds
            cos, sin = np.cos(placed.yaw), np.sin(placed.yaw)
            # Columns: the model's x, down, and y, a right-handed frame.
            R = R_camera_world @ np.array([[cos, 0, -sin], [sin, 0, cos], [0, -1, 0]])
            center = R_camera_world @ (placed.world(*((lo + hi) / 2)) - eye)
            found.append(Box3D(center, R, (hi - lo)[[0, 2, 1]]))
        return found


def house_world(seed: int, regime: Regime, width: int = 480, height: int = 360) -> Seen | None:
    """What is seen of one world; None where no camera sees enough of any room."""
    view = sensed_view(seed, regime, width, height)
    if view is None:
        return None
    pose = pose_of(view.camera)
    assert view.camera.up is not None
    turn = pose[:3, :3] @ viewer_axes(view.camera.up).matrix.T
    along = [(points - pose[:3, 3]) @ turn for points in view.vertices]
    extents = [(points.min(axis=0), points.max(axis=0)) for points in along]
    return seen_objects(view.depth, view.camera, view.masks, extents, view.names)


def sensed_view(seed: int, regime: Regime, width: int = 480, height: int = 360) -> SensedView | None:
    """A sensor's view of one world; None where no camera sees enough of any room. Half of them have exact masks."""
    rng = np.random.default_rng([seed, 4077, round(100 * regime.height[1])])
    for _ in range(ROOMS):
        house, upon = table_top(rng) if regime.close else (furnished(rng), [])
        if len(house.placed) < 7 or (regime.close and len(upon) < 3):
            continue
        scene = _Scene(house)
        camera = _camera(scene, upon, regime, rng, width, height)
        if camera is None:
            continue
        view = scene.seen(camera)
        pixels = np.bincount(view.ids[view.ids >= 0], minlength=1)
        kept = rng.permutation(np.flatnonzero(pixels >= MIN_PIXELS))
        if FEWEST <= len(kept) <= MOST:
            depth = _sensed(scene, view, camera, rng)
            masks, kind, rough = [view.ids == k for k in kept], int(rng.integers(3)), bool(rng.random() < 0.5)
            if rough:
                masks = [_rough(mask, kind, rng) for mask in masks]
            things = [house.placed[k] for k in kept]
            return SensedView(camera, depth, masks, rough, things, [scene.vertices[k] for k in kept])
    return None
