"""Recordings that are rendered for `doctor`: a table-top seen from above beside a robot's arms, a shelf that a robot
scans, and a walk through a room; structured light of a depth camera of its own, and the same aligned to colour.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.geometry import Camera, Frame, Registration, intrinsics, registered
from pipeline.synthetic import Room, camera_at, exact_view, make_room, render_view
from pipeline.synthetic.layout import FLOOR, Layout
from pipeline.synthetic.model import (
    PALETTES,
    STEEL,
    WHITE,
    ObjectModel,
    Palette,
    RestSurface,
    assemble,
    ball,
    block,
    paint,
    rod,
)
from pipeline.synthetic.objects import book, bottle, bowl, mug, standing_book, vase
from pipeline.synthetic.raycast import build_scene, pixel_rays, pose_of
from pipeline.synthetic.rooms import furnish_bookshelf, stocked_bookshelf

Rng = np.random.Generator
THINGS = (mug, bottle, bowl, book, standing_book, vase)
ARM = "robot arm"


@dataclass(frozen=True)
class Rendered:
    """One frame: aligned to colour, and the same with the depth camera's own depth in place of it, not aligned.

    Attributes
    ----------
    frame : Frame
    raw : (H, W) float32
        Metres, of the depth camera.
    warp : Registration
        What aligns it, of a depth camera whose intrinsics are `depth_K`.
    depth_K : (3, 3) float64
    """

    frame: Frame
    raw: np.ndarray
    warp: Registration
    depth_K: np.ndarray

    @property
    def unaligned(self) -> Frame:
        """The depth camera's depth read as if it were the colour camera's."""
        return replace(self.frame, depth=self.raw)


def table_top(seed: int, count: int = 5, width: int = 640, poses: bool = False) -> list[Rendered]:
    """From above, each picture of things put anew; two arms reach in at the border, whose depth is bad."""
    rng = np.random.default_rng([seed, 11])
    palette = PALETTES[seed % len(PALETTES)]
    rig, aim = _rig(rng), rng.uniform(-0.05, 0.05, 2)
    high, tilt, turn = rng.uniform(0.68, 0.85), rng.uniform(80, 88), rng.uniform(0, 2 * np.pi)
    found = []
    for k in range(count):
        layout = Layout(4.0, 4.0, 2.5, rng)
        table = layout.add(_table(palette, rng), np.array([2.0, 2.0, 0.0]), 0.0, FLOOR)
        camera = _looking(np.array([2.0 + aim[0], 2.0 + aim[1], 0.72]), high, turn, tilt, 0.0, width)
        _put_arms(layout, camera, rng)
        for _ in range(int(rng.integers(3, 9))):
            lying = THINGS[int(rng.integers(len(THINGS)))](palette, rng)
            layout.put(lying, table, tuple(rng.uniform(-0.45, 0.45, 2)), rng.uniform(0, 6.3), wander=0.3)
        found.append(_seen(f"{k:06d}", _room(layout, palette, rng), camera, rig, rng, bad=ARM))
    return found if poses else [replace(one, frame=_without_pose(one.frame)) for one in found]


def shelf_scan(seed: int, count: int = 7, width: int = 480) -> list[Rendered]:
    """A stocked shelf, seen from half a metre by an arm that moves aside, up, nearer, and turns."""
    rng = np.random.default_rng([seed, 13])
    palette, rig = PALETTES[seed % len(PALETTES)], _rig(rng)
    layout = Layout(4.0, 4.0, 2.5, rng)
    shelf = layout.against(stocked_bookshelf(palette, rng), "back", 2.0)
    furnish_bookshelf(layout, palette, shelf)
    room = _room(layout, palette, rng)
    middle = layout.instances[0].box.center * [1, 1, 0] + [0, 0, rng.uniform(0.6, 1.2)]
    found = []
    for k in range(count):
        at = middle + rng.uniform((-0.15, 0, -0.12), (0.15, 0, 0.12))
        heading = np.pi / 2 + rng.uniform(-0.3, 0.3)
        camera = _looking(at, rng.uniform(0.5, 0.75), heading, rng.uniform(-12, 15), rng.uniform(-6, 6), width)
        found.append(_seen(f"{k:06d}", room, camera, rig, rng))
    return found


def walk(seed: int, count: int = 26, width: int = 256) -> list[Rendered]:
    """A camera that is carried through a room, faster and slower, neighbours a few centimetres apart."""
    rng = np.random.default_rng([seed, 17])
    room, rig = make_room(seed), _rig(rng)
    focus = room.focuses[int(rng.integers(len(room.focuses)))]
    t = np.cumsum(0.4 + np.abs(np.convolve(rng.normal(0, 1.0, count + 6), np.ones(4) / 4, "same"))[:count])
    waves = [rng.uniform(0.1, 0.35, 3) * w for w in rng.normal(0, 1, (5, 1))]
    sways = [np.sum([np.sin(f * t / (j + 1) + rng.uniform(0, 6.3)) for j, f in enumerate(w)], axis=0) for w in waves]
    heading = focus.heading + 0.16 * sways[0]
    away = np.clip(0.5 * (focus.near + focus.far) + 0.12 * sways[1], 1.2, None)
    pitch, roll = np.deg2rad(20) + 0.06 * sways[2], 0.03 * sways[3]
    found = []
    for k in range(count):
        eye = focus.target[:2] - away[k] * np.array([np.cos(heading[k]), np.sin(heading[k])])
        eye = np.clip(eye, 0.3, [room.width - 0.3, room.depth - 0.3])
        place = np.array([*eye, 1.35 + 0.06 * sways[4][k]])
        camera = camera_at(place, heading[k], pitch[k], roll[k], width, width * 3 // 4)
        found.append(_seen(f"{k:06d}", room, camera, rig, rng))
    return found


def room_views(seed: int, count: int = 5, width: int = 400) -> list[Rendered]:
    """A furnished room from places far apart that look at the same."""
    rng = np.random.default_rng([seed, 19])
    room, rig = make_room(seed), _rig(rng)
    focus = room.focuses[int(rng.integers(len(room.focuses)))]
    found = []
    for k in range(count):
        heading = focus.heading + rng.uniform(-focus.spread, focus.spread)
        eye = focus.target[:2] - rng.uniform(focus.near, focus.far) * np.array([np.cos(heading), np.sin(heading)])
        eye = np.clip(eye, 0.3, [room.width - 0.3, room.depth - 0.3])
        heading, pitch = heading + rng.normal(0, 0.12), np.deg2rad(rng.uniform(12, 28))
        place = np.array([*eye, rng.uniform(1.15, 1.5)])
        camera = camera_at(place, heading, pitch, rng.normal(0, 0.04), width, width * 3 // 4)
        found.append(_seen(f"{k:06d}", room, camera, rig, rng))
    return found


SCENES: dict[str, Callable[[int], list[Rendered]]] = {
    "table-top": table_top,
    "shelf": shelf_scan,
    "walk": walk,
    "room": room_views,
}


# What is in them


def _table(palette: Palette, rng: Rng) -> ObjectModel:
    """A plain board, often larger than the picture, so that only what lies on it and the arms have outlines."""
    w, d = rng.uniform(0.9, 1.9), rng.uniform(0.7, 1.4)
    color = paint(palette.accents[int(rng.integers(len(palette.accents)))])
    legs = [block((0.05, 0.05, 0.68), (x, y, 0), STEEL, 0.002) for x in (-0.3, 0.3) for y in (-0.2, 0.2)]
    top = RestSurface(0.72, -w / 2, w / 2, -d / 2, d / 2)
    return assemble("table", [block((w, d, 0.04), (0, 0, 0.68), color, 0.003), *legs], [top])


def _put_arms(layout: Layout, camera: Camera, rng: Rng) -> None:
    """Two arms of white links and steel joints, over the lower corners of the picture."""
    T = pose_of(camera)
    for side in (-1, 1):
        far, near = (side * rng.uniform(0.4, 0.55), 0.6, 1), (side * rng.uniform(0.2, 0.35), 0.4, 1)
        start, end = (tuple(T[:3, 3] + z * T[:3, :3] @ np.array(p)) for p, z in ((far, 0.5), (near, 0.58)))
        parts = [rod(start, end, 0.055, WHITE), ball(0.06, end, STEEL)]
        corners = np.concatenate([part.vertices for part in parts])
        middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
        layout.add(assemble(ARM, parts), np.array([*middle[:2], corners[:, 2].min()]), 0.0, FLOOR)


def _room(layout: Layout, palette: Palette, rng: Rng) -> Room:
    """The things in a shell of their own."""
    shell = make_room(int(rng.integers(1000)))
    return replace(
        shell,
        instances=tuple(layout.instances),
        focuses=(),
        width=layout.width,
        depth=layout.depth,
        shell=tuple(part for part in shell.shell),
    )


def _looking(at: np.ndarray, away: float, heading: float, pitch_deg: float, roll_deg: float, width: int) -> Camera:
    """A camera that has this point in the middle, from so far."""
    pitch = np.deg2rad(pitch_deg)
    ahead = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), -np.sin(pitch)])
    return camera_at(at - away * ahead, heading, pitch, np.deg2rad(roll_deg), width, width * 3 // 4)


def _without_pose(frame: Frame) -> Frame:
    return replace(frame, camera=Camera(frame.camera.K, frame.camera.width, frame.camera.height))


# How it is sensed


@dataclass(frozen=True)
class Rig:
    """A depth camera and its projector beside a colour camera: offsets in metres, focal length by the colour's."""

    t: np.ndarray
    focal: float
    center: np.ndarray
    base: float


def _rig(rng: Rng) -> Rig:
    t = np.array([rng.choice((-1, 1)) * rng.uniform(0.02, 0.045), rng.normal(0, 0.004), rng.normal(0, 0.002)])
    return Rig(t, rng.uniform(0.86, 1.12), rng.normal(0, 4, 2), rng.choice((-1, 1)) * rng.uniform(0.05, 0.08))


def _seen(name: str, room: Room, camera: Camera, rig: Rig, rng: Rng, bad: str = "") -> Rendered:
    """Colour of one camera, depth of the other."""
    rgb = render_view(room, camera, rng).rgb
    pose = pose_of(camera).copy()
    # A point of the depth camera's frame plus t is the same in the colour camera's.
    pose[:3, 3] += pose[:3, :3] @ rig.t
    scale = camera.width / 640
    cx, cy = np.array([camera.cx, camera.cy]) + scale * rig.center
    K = intrinsics(camera.fx * rig.focal, camera.fy * rig.focal, cx, cy)
    depth_camera = replace(camera, K=K, T_world_camera=pose, up=None, up_source=None)
    raw = _sensed(room, depth_camera, rig.base, rng, bad)
    warp = Registration(camera.fx, camera.fy, camera.cx, camera.cy, *(float(n) for n in rig.t))
    aligned, _ = registered(raw, depth_camera, warp)
    return Rendered(Frame(name, rgb, aligned, camera), raw, warp, K)


def _sensed(room: Room, camera: Camera, base: float, rng: Rng, bad: str) -> np.ndarray:
    """Depth of structured light: shadows, steps of disparity, torn outlines; of what is `bad`, outlines that swell."""
    exact, instances = exact_view(room, camera)
    shape, T = exact.shape, pose_of(camera)
    rows, columns = (c.ravel() for c in np.mgrid[0 : shape[0], 0 : shape[1]])
    rays = pixel_rays(camera, rows, columns)
    points = T[:3, 3] + rays * exact.reshape(-1, 1)
    projector = (T[:3, 3] + base * T[:3, 0]).astype(np.float32)
    shadow = (build_scene(room).tracer.first(projector, points - projector).t < 0.985).reshape(shape)
    product = camera.fx * abs(base) * 640 / camera.width
    disparity = product / np.maximum(exact, 0.05) + 0.12 * _noise(rng, shape, 1.2) + 0.05 * _noise(rng, shape, 30)
    found = product / np.maximum(np.round(8 * disparity) / 8, 1e-3)
    kernel = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(exact, kernel) - cv2.erode(exact, kernel) > np.maximum(0.015, 0.03 * exact)
    edge = cv2.dilate(edge.astype(np.uint8), kernel) > 0
    lost = shadow | (edge & (_noise(rng, shape, 1.5) > 0)) | (_noise(rng, shape, 5) > 2.8) | (exact <= 0) | (exact > 7)
    names = [instance.model.label for instance in room.instances]
    odd = np.isin(instances, [k for k, name in enumerate(names) if bad and name == bad])
    if odd.any():
        away = cv2.distanceTransform((~odd).astype(np.uint8), cv2.DIST_L2, 3) * 640 / shape[1]
        swollen = ~odd & (away < 9 + 5 * _noise(rng, shape, 12))
        nearest = cv2.erode(np.where(odd, exact, np.float32(9)), np.ones((31, 31), np.uint8))
        found, lost = np.where(swollen, nearest, found), lost & ~swollen
    return np.where(lost | (found > 8.9), 0, found).astype(np.float32)


def _noise(rng: Rng, shape: Sequence[int], scale: float) -> np.ndarray:
    """Smooth normal noise of unit variance."""
    found = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), scale)
    return found / found.std()
