"""Rooms of analytic solids for calibration: closed-form ray hits, and another sensor's errors.

Nothing of the furnished or scattered rooms is used: neither meshes nor ray caster nor cameras nor noise nor masks.
A network's probabilities are fitted here, because on rooms of its own training it is surer than anywhere else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from pipeline.geometry.camera import Camera
from pipeline.synthetic.raycast import pose_of
from pipeline.synthetic.render import camera_at

Rng = np.random.Generator

_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


@dataclass(frozen=True, eq=False)
class Solid:
    """A unit solid under an affine map, world frame with z up, metres. box: the cube of side 1; cylinder: radius 1
    about z, height 1; ball: radius 1. All around the origin."""

    kind: Literal["box", "cylinder", "ball"]
    A: np.ndarray  # (3, 3) float64
    t: np.ndarray  # (3,) float64

    def reach(self, axes: np.ndarray) -> np.ndarray:
        """(K,) half extents along unit directions ((K, 3)): the support function about `t`."""
        along = axes @ self.A
        if self.kind == "box":
            return np.abs(along).sum(axis=1) / 2
        if self.kind == "ball":
            return np.sqrt(np.square(along).sum(axis=1))
        return np.hypot(along[:, 0], along[:, 1]) + np.abs(along[:, 2]) / 2

    def window(self, camera: Camera) -> tuple[slice, slice]:
        """Rows and columns of the image bounding the solid."""
        T = pose_of(camera)
        half = {"box": (0.5, 0.5, 0.5), "cylinder": (1, 1, 0.5), "ball": (1, 1, 1)}[self.kind]
        corners = (_CORNERS * half @ self.A.T + self.t - T[:3, 3]) @ T[:3, :3]
        if corners[:, 2].max() <= 0:
            return slice(0, 0), slice(0, 0)
        if corners[:, 2].min() < 0.05:
            return slice(0, camera.height), slice(0, camera.width)
        x = camera.fx * corners[:, 0] / corners[:, 2] + camera.cx
        y = camera.fy * corners[:, 1] / corners[:, 2] + camera.cy
        low = np.clip(np.floor([y.min(), x.min()]), 0, (camera.height, camera.width)).astype(int)
        high = np.clip(np.ceil([y.max(), x.max()]) + 1, 0, (camera.height, camera.width)).astype(int)
        return slice(low[0], high[0]), slice(low[1], high[1])

    def met(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Ray parameters (N,) of entry into the solid, inf for misses."""
        inverse = np.linalg.inv(self.A)
        start, along = inverse @ (origin - self.t), directions @ inverse.T
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.kind == "box":
                enter, leave = _slabs(start, along)
            elif self.kind == "ball":
                enter, leave = _round(start, along)
            else:
                sides, ends = _round(start[:2], along[:, :2]), _slabs(start[2:], along[:, 2:])
                enter, leave = np.maximum(sides[0], ends[0]), np.minimum(sides[1], ends[1])
        return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def _slabs(start: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sides = np.stack([(s - start) / along for s in (-0.5, 0.5)])
    return sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)


def _round(start: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = np.square(along).sum(axis=1), along @ start, start @ start - 1
    root = np.sqrt(b * b - a * c)
    return (-b - root) / a, (-b + root) / a


Thing = tuple[Solid, ...]


def solid(
    kind: Literal["box", "cylinder", "ball"],
    size: tuple[float, float, float],
    foot: np.ndarray,
    yaw: float,
    at: tuple[float, float, float] = (0, 0, 0),
    lean: float = 0.0,
) -> Solid:
    """A solid of a size along own axes, with the lowest point `at` in the frame of a thing on `foot`. `lean` tilts it
    backwards (towards +y of the thing), radians."""
    half = np.array(size) if kind == "box" else np.array(size) / (2, 2, 1 if kind == "cylinder" else 2)
    c, s, cl, sl = np.cos(yaw), np.sin(yaw), np.cos(lean), np.sin(lean)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    tilt = np.array([[1.0, 0, 0], [0, cl, sl], [0, -sl, cl]])
    A = turn @ tilt @ np.diag(half)
    found = Solid(kind, A, np.zeros(3))
    up = found.reach(np.array([[0, 0, 1.0]]))[0]
    return Solid(kind, A, np.asarray(foot, float) + turn @ np.array(at) + (0, 0, up))


def _table(rng: Rng, foot: np.ndarray, yaw: float) -> tuple[Thing, float]:
    w, d, h, leg = rng.uniform(0.6, 1.8), rng.uniform(0.5, 0.9), rng.uniform(0.4, 0.8), rng.uniform(0.03, 0.08)
    legs = [
        solid("box", (leg, leg, h - 0.04), foot, yaw, (x * (w - leg) / 2, y * (d - leg) / 2, 0))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    return (solid("box", (w, d, 0.04), foot, yaw, (0, 0, h - 0.04)), *legs), h


def _seat(rng: Rng, foot: np.ndarray, yaw: float) -> tuple[Thing, float]:
    w, d, h, back = rng.uniform(0.4, 2.2), rng.uniform(0.4, 0.95), rng.uniform(0.38, 0.5), rng.uniform(0.25, 0.6)
    parts = [solid("box", (w, d, h), foot, yaw), solid("box", (w, 0.15, back), foot, yaw, (0, d / 2 - 0.07, h))]
    if w > 1:
        parts += [solid("box", (0.16, d, 0.2), foot, yaw, (x * (w / 2 - 0.08), 0, h)) for x in (-1, 1)]
    return tuple(parts), h


def _shelf(rng: Rng, foot: np.ndarray, yaw: float) -> tuple[Thing, float]:
    w, d, boards, apart = rng.uniform(0.5, 1.2), rng.uniform(0.25, 0.45), int(rng.integers(2, 6)), rng.uniform(0.3, 0.4)
    sides = [solid("box", (0.03, d, boards * apart), foot, yaw, (x * w / 2, 0, 0)) for x in (-1, 1)]
    flat = [solid("box", (w, d, 0.025), foot, yaw, (0, 0, k * apart)) for k in range(boards + 1)]
    return (*sides, *flat), float(apart * rng.integers(0, boards + 1)) + 0.025


def _lump(rng: Rng, foot: np.ndarray, yaw: float, least: float, most: float) -> tuple[Thing, float]:
    w, d, h = np.exp(rng.uniform(np.log(least), np.log(most), 3))
    kind: Literal["box", "cylinder", "ball"] = ("box", "box", "cylinder", "ball")[int(rng.integers(4))]
    return (solid(kind, (w, w if kind == "cylinder" else d, h), foot, yaw),), h


@dataclass(frozen=True, eq=False)
class SolidView:
    """A view of a room of solids."""

    depth: np.ndarray  # (H, W) float32: Metres with the sensor's errors; 0 where nothing came back
    masks: tuple[np.ndarray, ...]  # tuple of (H, W) bool
    camera: Camera
    things: tuple[Thing, ...]  # That belong to the masks

    def exact(self, axes: np.ndarray) -> np.ndarray:
        """(N, 2, 3) lo and hi of the whole things along axes ((3, 3), rows, camera frame), from the camera, metres."""
        T = pose_of(self.camera)
        world = axes @ T[:3, :3].T
        found = []
        for thing in self.things:
            centres = np.array([world @ (s.t - T[:3, 3]) for s in thing])
            reach = np.array([s.reach(world) for s in thing])
            found.append([(centres - reach).min(axis=0), (centres + reach).max(axis=0)])
        return np.array(found).reshape(-1, 2, 3)


def solid_view(seed: int, number: int, width: int = 320, height: int = 240, least_pixels: int = 200) -> SolidView:
    """View `number` of the seed, each of a separate room; equal arguments give equal views."""
    rng = np.random.default_rng([seed, 37, number])
    close = rng.random() < 0.35
    things = _table_top(rng) if close else _room(rng)
    camera = _camera(rng, things, close, width, height)
    T = pose_of(camera)
    v, u = np.mgrid[:height, :width]
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    rays = local @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = -T[2, 3] / rays[..., 2]
    depth, owner = np.where(floor > 0, floor, np.inf), np.full(floor.shape, -1)
    for k, thing in enumerate(things):
        for part in thing:
            here = part.window(camera)
            met = part.met(T[:3, 3], rays[here].reshape(-1, 3)).reshape(depth[here].shape)
            nearer = met < depth[here]
            depth[here][nearer], owner[here][nearer] = met[nearer], k
    depth = np.where(np.isfinite(depth), depth, 0)
    seen = [k for k in range(len(things)) if (owner == k).sum() >= least_pixels]
    masks = tuple(_outlined(owner == k, rng) for k in seen)
    return SolidView(_sensed(depth, camera, rng), masks, camera, tuple(things[k] for k in seen))


def _apart(thing: Thing, others: list[Thing], share: float = 0.02) -> bool:
    """Test whether upright boxes share less than `share` metres along some axis with every other."""
    low, high = _bounds(thing)
    return all(
        (np.minimum(high, b) - np.maximum(low, a)).min() < share for a, b in (_bounds(other) for other in others)
    )


def _bounds(thing: Thing) -> tuple[np.ndarray, np.ndarray]:
    reach = [s.reach(np.eye(3)) for s in thing]
    parts = list(zip(thing, reach, strict=True))
    return np.min([s.t - r for s, r in parts], axis=0), np.max([s.t + r for s, r in parts], axis=0)


def _room(rng: Rng) -> list[Thing]:
    things: list[Thing] = []
    size = rng.uniform(2.5, 6.0, 2)
    for _ in range(int(rng.integers(14, 36))):
        foot, yaw = np.array([*rng.uniform(0, size), 0.0]), rng.choice([0, 90, rng.uniform(0, 180)]) * np.pi / 180
        make = (_table, _seat, _shelf)[int(rng.integers(3))]
        thing, top = make(rng, foot, yaw) if rng.random() < 0.6 else _lump(rng, foot, yaw, 0.15, 1.6)
        if _apart(thing, things):
            things.append(thing)
            for _ in range(int(rng.integers(0, 3))):
                _on_top(rng, things, foot + rng.uniform(-0.3, 0.3, 3) * (1, 1, 0) + (0, 0, top), len(things) - 1)
    return things


def _table_top(rng: Rng) -> list[Thing]:
    table, top = _table(rng, np.zeros(3), 0.0)
    things: list[Thing] = [table]
    for _ in range(int(rng.integers(12, 30))):
        _on_top(rng, things, np.array([*rng.uniform(-0.3, 0.3, 2), top]), 0)
    return things


def _on_top(rng: Rng, things: list[Thing], foot: np.ndarray, base: int) -> None:
    """Put a thing on another, perhaps with a third on top or leaning."""
    yaw = rng.uniform(0, np.pi)
    thing, h = _lump(rng, foot, yaw, 0.03, 0.3)
    others = [t for k, t in enumerate(things) if k != base]
    if not _apart(thing, others):
        return
    things.append(thing)
    draw = rng.random()
    low, high = _bounds(thing)
    if draw < 0.25:
        upper, _ = _lump(rng, np.array([*foot[:2], high[2]]), yaw, 0.03, 0.2)
        things.append(upper)
    elif draw < 0.5:
        # A board at the front of the thing, its top back over the thing's edge where it is the longer.
        lean, long = rng.uniform(0.15, 0.6), h * rng.uniform(0.7, 1.5)
        thick = rng.uniform(0.06, 0.3) * long
        wide = rng.uniform(0.3, 1.0) * long + 0.02
        deep = thick * np.cos(lean) + long * np.sin(lean)
        sunk = max(0.0, deep - thick * np.cos(lean) - h * np.tan(lean))
        at = np.array([foot[0], low[1] - deep / 2 + sunk, foot[2]])
        board = (solid("box", (wide, thick, long), at, 0.0, lean=lean),)
        if _apart(board, others):
            things.append(board)


def _camera(rng: Rng, things: list[Thing], close: bool, width: int, height: int) -> Camera:
    target = things[int(rng.integers(len(things)))][0].t
    heading = rng.uniform(0, 2 * np.pi)
    roll = np.deg2rad(rng.normal(0, 5))
    pitch = np.deg2rad(rng.uniform(10, 65))
    back = rng.uniform(0.5, 1.2)
    if not close:
        eye_height = rng.choice([rng.uniform(0.3, 0.8), rng.uniform(0.8, 1.7), rng.uniform(1.6, 2.4)])
        back = rng.uniform(1.0, 4.0)
        pitch = np.arctan2(eye_height - target[2], back) + np.deg2rad(rng.uniform(-8, 8))
        eye = np.array([*(target[:2] - back * np.array([np.cos(heading), np.sin(heading)])), eye_height])
    else:
        ahead = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), -np.sin(pitch)])
        eye = target - back * ahead
    camera = camera_at(eye, float(heading), float(pitch), float(roll), width, height)
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= rng.uniform(0.95, 1.5)
    return replace(camera, K=K)


def _sensed(depth: np.ndarray, camera: Camera, rng: Rng) -> np.ndarray:
    """Stereo depth: disparity errors shared by neighbours, steps, smeared edges, lost patches."""
    product = camera.fx * 2 * rng.uniform(0.05, 0.1)
    shared = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 2.0) * rng.uniform(0.1, 0.6)
    disparity = product / np.maximum(depth, 0.1) + shared + rng.normal(0, 0.05, depth.shape)
    step = float(rng.choice([8.0, 16.0, 32.0]))
    noisy = product / np.maximum(np.round(disparity * step) / step, 0.5)
    smeared = np.where(rng.random(depth.shape) < 0.5, cv2.blur(noisy, (3, 3)), noisy)
    jump = cv2.morphologyEx(depth.astype(np.float32), cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0.05
    noisy = np.where(jump, smeared, noisy)
    patches = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 3.0)
    lost = (patches > 3.0 * patches.std()) | (jump & (rng.random(depth.shape) < 0.3)) | (depth <= 0) | (depth > 9)
    return np.where(lost, 0, noisy).astype(np.float32)


def _outlined(mask: np.ndarray, rng: Rng) -> np.ndarray:
    """Mask redrawn by the outline, with corners off by one to three pixels."""
    contours, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    grown, jitter = rng.normal(0, 1.2), rng.uniform(0.2, 1.0)
    outlines = [cv2.approxPolyDP(contour, rng.uniform(0.3, 1.5), True) for contour in contours]
    drawn = np.zeros(mask.shape, np.uint8)
    cv2.fillPoly(drawn, [np.rint(o + rng.normal(0, jitter, o.shape)).astype(np.int32) for o in outlines], 1)
    pixels = round(abs(grown))
    if pixels:
        kernel = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
        changed = cv2.dilate(drawn, kernel) if grown > 0 else cv2.erode(drawn, kernel)
        drawn = changed if changed.sum() >= mask.sum() / 2 else drawn
    return drawn.view(np.bool_) if drawn.any() else mask
