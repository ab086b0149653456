"""Rooms and table tops assembled from trimesh's primitives, with a stereo camera's errors and bad masks: to learn from.

Another make than the furnished and the scattered rooms: neither their models nor their plans, cameras, noise or masks.
A network that has seen rooms of several makes is better on those of yet another. World frame with z up, metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from pipeline.geometry.camera import Camera, intrinsics
from pipeline.geometry.viewer import viewer_axes
from pipeline.synthetic.raycast import EmbreeScene, pixel_rays, pose_of
from pipeline.synthetic.render import camera_at
from pipeline.system.arrow import LazyModule

if TYPE_CHECKING:
    import trimesh
    from trimesh import creation

    Mesh = trimesh.Trimesh
else:
    trimesh, creation, Mesh = LazyModule("trimesh"), LazyModule("trimesh.creation"), Any

Rng = np.random.Generator
Top = tuple[float, float, float]
"""Height of a place to put things on, and half its sides."""

Made = tuple[Mesh, tuple[Top, ...]]
BASELINE_M, NEAREST_M, NEAR_SHARE = 0.075, 0.3, 0.05
"""At most this share of the picture may be nearer than a depth camera measures."""


@dataclass(frozen=True)
class Held:
    """Camera placement: metres above the floor (`close`: from the table's middle), degrees down and of roll."""

    height: tuple[float, float]
    pitch: tuple[float, float]
    roll: float
    close: bool = False


HELD = (
    Held((0.25, 0.8), (-10, 20), 8),
    Held((0.8, 1.7), (-2, 40), 8),
    Held((1.6, 2.4), (10, 65), 12),
    Held((0.45, 1.2), (10, 68), 12, close=True),
)


@dataclass(frozen=True, eq=False)
class AssembledView:
    """A view of such a room."""

    depth: np.ndarray  # (H, W) float32: Metres with the sensor's errors; 0 where nothing came back
    masks: tuple[np.ndarray, ...]  # tuple of (H, W) bool
    labels: tuple[str, ...]  # Class names
    camera: Camera  # It knows what is up
    exact: tuple[tuple[np.ndarray, np.ndarray], ...]
    """tuple of ((3,), (3,)) float64: Least and greatest of the whole things along the viewer's (right, up, forward),
    metres from the camera."""


def _box(w: float, d: float, h: float, x: float = 0, y: float = 0, z: float = 0) -> Mesh:
    mesh = creation.box((w, d, h))
    mesh.apply_translation((x, y, z + h / 2))
    return mesh


def _rod(r: float, h: float, x: float = 0, y: float = 0, z: float = 0) -> Mesh:
    mesh = creation.cylinder(r, h, sections=24)
    mesh.apply_translation((x, y, z + h / 2))
    return mesh


def _joined(*meshes: Mesh) -> Mesh:
    found = trimesh.util.concatenate(list(meshes))
    assert isinstance(found, trimesh.Trimesh)
    return found


def _turned(mesh: Mesh, angle: float, axis: tuple[float, float, float] = (0, 0, 1)) -> Mesh:
    mesh.apply_transform(trimesh.transformations.rotation_matrix(angle, axis))
    return mesh


def _grounded(mesh: Mesh) -> Mesh:
    mesh.apply_translation((0, 0, -mesh.bounds[0][2]))
    return mesh


def _four(w: float, d: float, h: float, leg: float) -> list[Mesh]:
    return [_box(leg, leg, h, x * (w - leg) / 2, y * (d - leg) / 2) for x in (-1, 1) for y in (-1, 1)]


def _table(r: Rng) -> Made:
    w, d, h, t, leg = r.uniform((0.7, 0.5, 0.35, 0.02, 0.03), (2.0, 1.0, 0.8, 0.06, 0.08))
    return _joined(_box(w, d, t, 0, 0, h - t), *_four(w, d, h - t, leg)), ((h, w * 0.45, d * 0.45),)


def _round_table(r: Rng) -> Made:
    R, h = r.uniform((0.3, 0.4), (0.6, 0.78))
    return _joined(_rod(R, 0.03, 0, 0, h - 0.03), _rod(0.04, h - 0.03), _rod(R / 2, 0.03)), ((h, R * 0.65, R * 0.65),)


def _chair(r: Rng) -> Made:
    w, h, top = r.uniform((0.38, 0.4, 0.75), (0.5, 0.5, 1.05))
    parts = [_box(w, w, 0.05, 0, 0, h - 0.05), *_four(w, w, h - 0.05, 0.04), _box(w, 0.04, top - h, 0, w / 2 - 0.02, h)]
    if r.random() < 0.4:
        parts += [_box(0.05, w * 0.8, 0.2, s * w / 2, 0, h) for s in (-1, 1)]
    return _joined(*parts), ((h, w * 0.35, w * 0.3),)


def _sofa(r: Rng) -> Made:
    w, d, h, back, arm = r.uniform((1.2, 0.75, 0.38, 0.7, 0.55), (2.4, 1.0, 0.48, 0.95, 0.68))
    parts = [_box(w, d, h), _box(w, 0.2, back, 0, d / 2 - 0.1)]
    parts += [_box(0.18, d, arm, s * (w / 2 - 0.09)) for s in (-1, 1)]
    if r.random() < 0.4:
        parts.append(_box(0.85, r.uniform(0.6, 1.0), h, w / 2 - 0.42, -d / 2 - 0.4))
    return _joined(*parts), ((h, w * 0.35, d * 0.2),)


def _bed(r: Rng) -> Made:
    w, d, h, head = r.uniform((0.9, 1.9, 0.4, 0.8), (1.8, 2.1, 0.6, 1.2))
    slab, mattress = _box(w, d, h - 0.15, 0, 0, 0.1), _box(w * 0.98, d * 0.97, 0.2, 0, 0, h - 0.15)
    return _joined(slab, mattress, _box(w, 0.06, head, 0, d / 2)), ((h + 0.05, w * 0.4, d * 0.4),)


def _cupboard(r: Rng) -> Made:
    w, d, h = r.uniform((0.5, 0.35, 0.5), (2.0, 0.65, 2.2))
    return _box(w, d, h), ((h, w * 0.45, d * 0.42),)


def _shelf(r: Rng) -> Made:
    w, d, apart = r.uniform((0.6, 0.25, 0.28), (1.2, 0.4, 0.42))
    boards = int(r.integers(2, 6))
    parts = [_box(0.03, d, boards * apart + 0.03, s * w / 2) for s in (-1, 1)]
    parts += [_box(w, d, 0.025, 0, 0, k * apart + 0.01) for k in range(boards + 1)]
    if r.random() < 0.5:
        parts.append(_box(w, 0.01, boards * apart, 0, d / 2))
    return _joined(*parts), tuple((k * apart + 0.035, w * 0.42, d * 0.3) for k in range(boards + 1))


def _stool(r: Rng) -> Made:
    R, h = r.uniform((0.14, 0.4), (0.22, 0.7))
    legs = [_rod(0.015, h - 0.04, 0.8 * R * np.cos(a), 0.8 * R * np.sin(a)) for a in (0, 2.1, 4.2)]
    return _joined(_rod(R, 0.04, 0, 0, h - 0.04), *legs), ((h, R * 0.6, R * 0.6),)


def _bin(r: Rng) -> Made:
    s, h = r.uniform((0.2, 0.25), (0.4, 0.6))
    sides = [_box(0.015, s, h, x * s / 2) for x in (-1, 1)] + [_box(s, 0.015, h, 0, y * s / 2) for y in (-1, 1)]
    return _joined(_box(s, s, 0.015), *sides), ()


def _floor_lamp(r: Rng) -> Made:
    h = r.uniform(1.2, 1.8)
    shade = creation.cone(r.uniform(0.15, 0.25), 0.35, sections=20)
    shade.apply_translation((0, 0, h - 0.2))
    return _joined(_rod(0.14, 0.03), _rod(0.015, h), shade), ()


def _plant(r: Rng) -> Made:
    crown = creation.icosphere(2, r.uniform(0.18, 0.4))
    crown.apply_scale((1, 1, r.uniform(0.8, 1.6)))
    pot = _rod(r.uniform(0.1, 0.2), r.uniform(0.2, 0.4))
    crown.apply_translation((0, 0, pot.bounds[1][2] - 0.02 - crown.bounds[0][2]))
    return _joined(pot, crown), ()


def _beanbag(r: Rng) -> Made:
    bag = creation.icosphere(3, r.uniform(0.3, 0.5))
    bag.apply_scale((1, 1, 0.7))
    return _grounded(bag), ()


def _case(r: Rng) -> Made:
    w, d, h = r.uniform((0.25, 0.25, 0.2), (0.8, 0.8, 0.8))
    return _box(w, d, h), ((h, w * 0.4, d * 0.4),)


LARGE: tuple[tuple[str, Callable[[Rng], Made]], ...] = (
    ("table", _table),
    ("table", _table),
    ("table", _round_table),
    ("chair", _chair),
    ("chair", _chair),
    ("sofa", _sofa),
    ("bed", _bed),
    ("cabinet", _cupboard),
    ("cabinet", _cupboard),
    ("bookshelf", _shelf),
    ("bookshelf", _shelf),
    ("stool", _stool),
    ("trash can", _bin),
    ("floor lamp", _floor_lamp),
    ("potted plant", _plant),
    ("beanbag", _beanbag),
    ("box", _case),
    ("box", _case),
)


def _can(r: Rng) -> Made:
    R, h = r.uniform((0.025, 0.06), (0.06, 0.25))
    return _rod(R, h), ((h, R * 0.4, R * 0.4),)


def _ball(r: Rng) -> Made:
    return _grounded(creation.icosphere(2, r.uniform(0.03, 0.13))), ()


def _cone(r: Rng) -> Made:
    return creation.cone(r.uniform(0.03, 0.1), r.uniform(0.08, 0.3), sections=20), ()


def _capsule(r: Rng) -> Made:
    return _grounded(creation.capsule(height=r.uniform(0.08, 0.25), radius=r.uniform(0.025, 0.05), count=(12, 12))), ()


def _roll(r: Rng) -> Made:
    mesh = creation.cylinder(r.uniform(0.02, 0.08), r.uniform(0.1, 0.4), sections=20)
    return _grounded(_turned(mesh, np.pi / 2, (1, 0, 0))), ()


def _carton(r: Rng) -> Made:
    w, d, h = r.uniform((0.05, 0.03, 0.03), (0.3, 0.25, 0.35))
    return _box(w, d, h), ((h, w * 0.4, d * 0.4),)


def _book(r: Rng) -> Made:
    w, d, h = r.uniform((0.12, 0.18, 0.015), (0.2, 0.28, 0.05))
    return _box(w, d, h), ((h, w * 0.45, d * 0.45),)


def _bowl(r: Rng) -> Made:
    R = r.uniform(0.06, 0.16)
    h = R * r.uniform(0.4, 0.9)
    outline = np.array([(0, 0), (R / 2, 0), (R, h), (R * 0.93, h), (R * 0.45, 0.01), (0, 0.01)])
    return creation.revolve(outline, sections=24), ()


def _mug(r: Rng) -> Made:
    R, h = r.uniform((0.035, 0.07), (0.05, 0.11))
    handle = _turned(creation.torus(0.03, 0.007, major_sections=16, minor_sections=8), np.pi / 2, (1, 0, 0))
    handle.apply_translation((R + 0.01, 0, h / 2))
    return _joined(_rod(R, h), handle), ()


def _screen(r: Rng) -> Made:
    w, h = r.uniform((0.35, 0.25), (0.7, 0.45))
    return _joined(_box(w, 0.03, h, 0, 0, 0.1), _box(w * 0.4, 0.18, 0.015), _box(0.05, 0.03, 0.15)), ()


SMALL: tuple[tuple[str, Callable[[Rng], Made]], ...] = (
    ("can", _can),
    ("can", _can),
    ("ball", _ball),
    ("cone", _cone),
    ("bottle", _capsule),
    ("roll", _roll),
    ("box", _carton),
    ("box", _carton),
    ("box", _carton),
    ("book", _book),
    ("book", _book),
    ("bowl", _bowl),
    ("mug", _mug),
    ("computer monitor", _screen),
)


class _World:
    """Named meshes with disjoint upright boxes, except leaning or contained things."""

    def __init__(self, rng: Rng) -> None:
        self.rng = rng
        self.meshes: list[Mesh] = []
        self.labels: list[str] = []
        self.places: list[tuple[np.ndarray, float, Top, int]] = []

    def put(
        self, label: str, made: Made, at: Sequence[float] | np.ndarray, yaw: float, inside: int = -1
    ) -> Mesh | None:
        mesh, tops = made
        mesh = _turned(mesh.copy(), yaw)
        mesh.apply_translation(at)
        low, high = mesh.bounds
        for k, other in enumerate(self.meshes):
            a, b = other.bounds
            if k != inside and (np.minimum(high, b) - np.maximum(low, a) > 0.004).all():
                return None
        self.meshes.append(mesh)
        self.labels.append(label)
        self.places += [(np.asarray(at, float), yaw, top, len(self.meshes) - 1) for top in tops]
        return mesh

    def fill(self, things: int) -> None:
        """Put small things on the surfaces, some with neighbours."""
        rng = self.rng
        for _ in range(6 * things):
            if things <= 0 or not self.places:
                return
            place, yaw, (height, a, b), base = self.places[int(rng.integers(len(self.places)))]
            u, v = rng.uniform(-a, a), rng.uniform(-b, b)
            at = place + np.array([np.cos(yaw) * u - np.sin(yaw) * v, np.sin(yaw) * u + np.cos(yaw) * v, height])
            label, make = SMALL[int(rng.integers(len(SMALL)))]
            mesh = self.put(label, make(rng), at, rng.uniform(0, 6.28), base)
            if mesh is None:
                continue
            things -= 1
            draw = rng.random()
            if draw < 0.25:
                self.lean(mesh, at[2])
            elif draw < 0.45:
                self.touch(mesh, at[2])

    def touch(self, mesh: Mesh, floor: float) -> None:
        """Put a thing at most a centimetre from another."""
        rng, (low, high) = self.rng, mesh.bounds
        label, make = SMALL[int(rng.integers(len(SMALL)))]
        made = make(rng)
        axis, side = int(rng.integers(2)), float(rng.choice([-1, 1]))
        size = made[0].bounds[1] - made[0].bounds[0]
        at = (low + high) / 2
        at[axis] += side * ((high - low)[axis] + size[axis] + rng.uniform(0, 0.02)) / 2
        self.put(label, made, (at[0], at[1], floor), 0.0)

    def lean(self, mesh: Mesh, floor: float) -> None:
        """Lean a board on a thing's side, over the edge if longer."""
        rng, (low, high) = self.rng, mesh.bounds
        tall = high[2] - low[2]
        long, angle = max(rng.uniform(0.8, 1.5) * tall, 0.05), rng.uniform(0.15, 0.6)
        thick = rng.uniform(0.04, 0.15) * long
        board = _turned(_box(rng.uniform(0.3, 0.7) * long + 0.02, thick, long), -angle, (1, 0, 0))
        quarter = int(rng.integers(4)) * np.pi / 2
        board = _turned(board, quarter)
        towards = np.array([-np.sin(quarter), np.cos(quarter)]).round()
        deep = (board.bounds[1] - board.bounds[0])[:2] @ np.abs(towards)
        over = max(0.0, deep - thick * np.cos(angle) - tall * np.tan(angle))
        away = (high - low)[:2] @ np.abs(towards) / 2 + deep / 2 - over
        centre = board.bounds.mean(axis=0)[:2]
        board.apply_translation((*((low + high)[:2] / 2 - towards * away - centre), floor - board.bounds[0][2]))
        self.meshes.append(board)
        self.labels.append("board")


def _room(rng: Rng) -> tuple[_World, list[Mesh], np.ndarray]:
    world, size = _World(rng), rng.uniform(3.6, 6.5, 2)
    for _ in range(int(rng.integers(6, 14))):
        label, make = LARGE[int(rng.integers(len(LARGE)))]
        made = make(rng)
        for _ in range(12):
            yaw = np.pi / 2 * rng.integers(4) + (rng.uniform(-0.8, 0.8) if rng.random() < 0.33 else 0.0)
            mesh = world.put(label, made, (*rng.uniform(0.5, size - 0.5), 0.0), yaw)
            if mesh is not None:
                if rng.random() < 0.12:
                    world.lean(mesh, 0.0)
                break
    world.fill(int(rng.integers(5, 16)))
    w, d = size
    shell = [_box(w + 0.2, d + 0.2, 0.1, w / 2, d / 2, -0.1)]
    shell += [_box(0.1, d, 2.6, x, d / 2) for x in (-0.05, w + 0.05)]
    shell += [_box(w, 0.1, 2.6, w / 2, y) for y in (-0.05, d + 0.05)]
    return world, shell, size


def _table_top(rng: Rng) -> tuple[_World, list[Mesh], np.ndarray]:
    world, height = _World(rng), rng.uniform(0.7, 0.78)
    a, b = rng.uniform((0.35, 0.3), (0.7, 0.5))
    world.places = [(np.zeros(3), 0.0, (height, a * 0.85, b * 0.85), -1)]
    world.fill(int(rng.integers(6, 14)))
    return world, [_box(2 * a, 2 * b, 0.04, 0, 0, height - 0.04), _box(6, 6, 0.1, 0, 0, -0.1)], np.array([0, 0, height])


def _camera(held: Held, place: np.ndarray, rng: Rng, width: int, height: int) -> Camera:
    roll = np.deg2rad(rng.uniform(-held.roll, held.roll))
    pitch = np.deg2rad(rng.uniform(*held.pitch))
    if held.close:
        heading = rng.uniform(0, 2 * np.pi)
        ahead = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), -np.sin(pitch)])
        eye = place + np.array([*rng.uniform(-0.15, 0.15, 2), 0]) - rng.uniform(*held.height) * ahead
    else:
        eye = np.array([*rng.uniform(0.25, place - 0.25), rng.uniform(*held.height)])
        gap = place * rng.uniform(0.25, 0.75, 2) - eye[:2]
        heading = np.arctan2(gap[1], gap[0])
    found = camera_at(eye, float(heading), float(pitch), float(roll), width, height)
    f = rng.uniform(0.75, 1.1) * width
    return replace(found, K=intrinsics(f, f, (width - 1) / 2, (height - 1) / 2))


def assembled_view(seed: int, width: int = 480, height: int = 360, least_pixels: int = 200) -> AssembledView | None:
    """View of the seed's assembled room, deterministic; None for a camera inside a thing."""
    rng = np.random.default_rng([seed, 41])
    held = HELD[seed % len(HELD)]
    world, shell, place = (_table_top if held.close else _room)(rng)
    camera = _camera(held, place, rng, width, height)
    pose = pose_of(camera)
    meshes = [*shell, *world.meshes]
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = np.concatenate([np.asarray(m.faces) + s for m, s in zip(meshes, starts, strict=False)])
    owner = np.repeat(np.arange(len(meshes)) - len(shell), [len(m.faces) for m in meshes])
    tracer = EmbreeScene(np.concatenate([np.asarray(m.vertices) for m in meshes]), faces)
    v, u = (g.ravel() for g in np.indices((height, width)))
    hits = tracer.first(pose[:3, 3], pixel_rays(camera, v, u))
    if not held.close and (hits.t < NEAREST_M).mean() > NEAR_SHARE:
        return None
    met = hits.face >= 0
    ids = np.where(met, owner[np.maximum(hits.face, 0)], -1).reshape(height, width)
    depth = _sensed(np.where(met, hits.t, 0).reshape(height, width).astype(np.float32), rng, camera.fx)
    assert camera.up is not None
    axes = pose[:3, :3] @ viewer_axes(camera.up).matrix.T
    masks, labels, exact = [], [], []
    for k, mesh in enumerate(world.meshes):
        mask = ids == k
        if mask.sum() >= least_pixels:
            along = (np.asarray(mesh.vertices) - pose[:3, 3]) @ axes
            masks.append(_spoilt(mask, rng, least_pixels))
            labels.append(world.labels[k])
            exact.append((along.min(axis=0), along.max(axis=0)))
    return AssembledView(depth, tuple(masks), tuple(labels), camera, tuple(exact))


def _sensed(depth: np.ndarray, rng: Rng, focal: float) -> np.ndarray:
    """Stereo sensor: disparity in eighths of a pixel with jitter, holes and flying pixels at edges, lost blobs."""
    height, width = depth.shape
    jitter = np.rint(rng.normal(0, 0.5, (2, height, width))).astype(int)
    v, u = np.mgrid[:height, :width]
    depth = depth[np.clip(v + jitter[0], 0, height - 1), np.clip(u + jitter[1], 0, width - 1)]
    product = focal * BASELINE_M
    disparity = product / np.maximum(depth, 0.1) + rng.normal(0, rng.uniform(0.05, 0.15), depth.shape)
    noisy = product / np.maximum(np.round(disparity * 8) / 8, 0.3)
    kernel = np.ones((3, 3), np.uint8)
    near = cv2.erode(np.where(depth > 0, depth, 99).astype(np.float32), kernel)
    far = cv2.dilate(depth.astype(np.float32), kernel)
    edge, draw = (far - near > 0.05) & (depth > 0), rng.random(depth.shape)
    flying = edge & (draw > 0.35) & (draw < 0.35 + rng.uniform(0.1, 0.35))
    noisy = np.where(flying, near + rng.random(depth.shape) * (far - near), noisy)
    lost = (edge & (draw < 0.35)) | (depth <= 0) | (depth > 8) | (rng.random(depth.shape) < 0.01)
    noisy = np.where(lost, 0, noisy).astype(np.float32)
    for _ in range(int(rng.integers(0, 6))):
        at, size = (int(rng.integers(width)), int(rng.integers(height))), rng.integers(2, 12, 2).tolist()
        cv2.ellipse(noisy, at, size, 0, 0, 360, 0, -1)
    return noisy


def _spoilt(mask: np.ndarray, rng: Rng, least_pixels: int) -> np.ndarray:
    """Mask eroded or dilated by up to 4 pixels, every second shifted by up to 2."""
    pixels = int(rng.integers(-4, 5))
    if pixels:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(pixels) + 1,) * 2)
        changed = (cv2.dilate if pixels > 0 else cv2.erode)(mask.view(np.uint8), kernel).view(np.bool_)
        mask = changed if changed.sum() >= least_pixels // 2 else mask
    if rng.random() < 0.5:
        (x, y), (height, width) = rng.integers(-2, 3, 2), mask.shape
        v, u = np.clip(np.arange(height) - y, 0, height - 1), np.clip(np.arange(width) - x, 0, width - 1)
        mask = mask[v][:, u]
    return mask
