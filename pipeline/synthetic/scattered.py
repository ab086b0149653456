"""Rooms and table tops without a plan: anything anywhere, of odd sizes, stacked, touching, leaning on each other.

A network that learns from furnished rooms alone learns how rooms are furnished. Here the same models, stretched, and
plain solids stand wherever they fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.geometry.camera import Camera, intrinsics
from pipeline.synthetic import decor as c
from pipeline.synthetic import furniture as f
from pipeline.synthetic import objects as o
from pipeline.synthetic.layout import Layout, Room, overlaps, part_boxes
from pipeline.synthetic.model import (
    PALETTES,
    Material,
    ModelPart,
    ObjectModel,
    Palette,
    RestSurface,
    assemble,
    ball,
    block,
    cylinder,
    lathe,
    rgb,
)
from pipeline.synthetic.raycast import build_scene, pixel_rays
from pipeline.synthetic.render import PROBE, camera_at

Rng = np.random.Generator
Make = Callable[[Palette, Rng], ObjectModel]

LARGE: tuple[Make, ...] = (
    f.dining_table,
    f.desk,
    f.coffee_table,
    f.sofa,
    f.armchair,
    f.bed,
    f.wardrobe,
    f.bookshelf,
    f.cabinet,
    f.nightstand,
    f.chair,
    f.chair,
    f.office_chair,
    f.stool,
    c.floor_lamp,
    c.plant,
    c.trash_can,
    c.box,
)
SMALL: tuple[Make, ...] = (
    o.laptop,
    o.tv,
    o.mug,
    o.bottle,
    o.bowl,
    o.plate,
    o.vase,
    o.book,
    o.standing_book,
    o.mouse,
    c.lamp,
    c.desk_lamp,
    c.plant,
    c.basket,
    c.box,
    c.backpack,
    c.alarm_clock,
    c.teapot,
    c.candle,
    c.teddy_bear,
    c.toy_ball,
)
SOLID_SHARE = 0.5
"""So many of the small things, and a fifth of the large ones, are plain solids."""

PLAIN = Material(rgb("#b9b2a6"))
TABLE_TOP, SCATTERED = "table top", "scattered room"
LEAN_SHARE, BESIDE_SHARE, STACK_SHARE = 0.25, 0.25, 0.3


def make_scattered(seed: int) -> Room:
    """The scattered room of this seed; two in five are table tops. Equal seeds give equal rooms."""
    rng = np.random.default_rng([seed, 31])
    palette = PALETTES[int(rng.integers(len(PALETTES)))]
    table_top = rng.random() < 0.4
    width, depth = rng.uniform(3.2, 6.5, 2) if not table_top else (3.0, 3.0)
    room = Layout(float(width), float(depth), 2.65, rng)
    if table_top:
        _furnish_table(room, palette)
    else:
        _furnish_floor(room, palette)
    sun = np.array([0.0, 0.0, 1.0])
    kind = TABLE_TOP if table_top else SCATTERED
    shell = _plain_shell(room.width, room.depth, room.height)
    return Room(seed, kind, room.width, room.depth, room.height, shell, tuple(room.instances), (), sun, (0, 0, 0, 0))


def _furnish_table(room: Layout, p: Palette) -> None:
    rng = room.rng
    make = (f.dining_table, f.desk, f.coffee_table, f.cabinet)[int(rng.integers(4))]
    table = room.stand(_stretched(make(p, rng), rng, 0.8, 1.2), room.width / 2, room.depth / 2, rng.uniform(0, 6.28))
    # Things in reach of one camera, not all over the table.
    spot = rng.uniform(-0.6, 0.6, 2)
    for _ in range(int(rng.integers(6, 20))):
        u, v = np.clip(spot + rng.normal(0, 0.35, 2), -1, 1)
        put = room.put(_small(p, rng), table, (float(u), float(v)), rng.uniform(0, 6.28), 0, 0.1)
        _company(room, p, put)


def _furnish_floor(room: Layout, p: Palette) -> None:
    rng = room.rng
    bases: list[int] = []
    for _ in range(int(rng.integers(8, 20))):
        make = LARGE[int(rng.integers(len(LARGE)))]
        model = _solid(rng, 0.2, 1.2) if rng.random() < 0.2 else _stretched(make(p, rng), rng, 0.75, 1.3)
        quarter = np.pi / 2 * float(rng.integers(4))
        turn = quarter + (rng.uniform(-0.8, 0.8) if rng.random() < 0.4 else 0.0)
        place = rng.uniform(0.3, [room.width - 0.3, room.depth - 0.3])
        stood = room.stand_near(model, float(place[0]), float(place[1]), turn, 0.6, 12)
        if stood is not None:
            bases.append(stood)
            if rng.random() < LEAN_SHARE / 2:
                _lean(room, stood)
    shelves = [k for k in bases if room.instances[k].model.surfaces]
    for _ in range(int(rng.integers(6, 26)) if shelves else 0):
        base = shelves[int(rng.integers(len(shelves)))]
        surface = int(rng.integers(len(room.instances[base].model.surfaces)))
        put = room.put(_small(p, rng), base, None, rng.uniform(0, 6.28), surface)
        _company(room, p, put)
    for _ in range(int(rng.integers(0, 4))):
        place = rng.uniform(0.3, [room.width - 0.3, room.depth - 0.3])
        room.stand_near(_small(p, rng), float(place[0]), float(place[1]), rng.uniform(0, 6.28), 0.5, 8)


def _company(room: Layout, p: Palette, of: int | None) -> None:
    """Sometimes put a thing on, next to or leaning on another."""
    rng = room.rng
    if of is None:
        return
    draw = rng.random()
    if draw < LEAN_SHARE:
        _lean(room, of)
    elif draw < LEAN_SHARE + BESIDE_SHARE:
        _beside(room, of, _small(p, rng))
    elif draw < LEAN_SHARE + BESIDE_SHARE + STACK_SHARE:
        below = room.instances[of].model
        # What stands on a thing covers a third of its top or more, and may stick out a little.
        share = rng.uniform(0.5, 1.1, 2)
        room.stack(_block(rng, (*(share * below.size[:2]), rng.uniform(0.015, 0.2))), of, rng.uniform(-0.5, 0.5))


def _side(room: Layout, of: int) -> tuple[np.ndarray, float, np.ndarray]:
    """A side of a thing: direction (3,), turn of things in front, half extents (across, outwards)."""
    base, quarter = room.instances[of], int(room.rng.integers(4))
    half = base.model.size[:2] / 2
    turn = base.yaw + quarter * np.pi / 2
    outwards = np.array([np.sin(turn), -np.cos(turn), 0.0])
    return outwards, turn, half if quarter % 2 == 0 else half[::-1]


def _beside(room: Layout, of: int, model: ObjectModel) -> None:
    """Put a model next to a thing, at most a centimetre away."""
    rng = room.rng
    outwards, turn, half = _side(room, of)
    across = np.array([-outwards[1], outwards[0], 0.0])
    away = half[1] + model.size[1] / 2 + rng.uniform(0, 0.01)
    base = room.instances[of]
    place = base.position + outwards * away + across * rng.uniform(-0.5, 0.5) * half[0]
    if room.free(model, place, turn):
        room.add(model, place, turn, base.support)


def _lean(room: Layout, on: int) -> None:
    """Lean a board or a box on a side of a thing, over the upper edge if longer."""
    rng = room.rng
    outwards, turn, half = _side(room, on)
    base = room.instances[on]
    height = float(base.model.size[2])
    length = rng.uniform(0.6, 1.6) * height
    thick = rng.uniform(0.06, 0.35) * length
    wide = rng.uniform(0.3, 1.0) * length + 0.02
    lean = rng.uniform(0.12, 0.7)
    board = block((wide, thick, length), (0, 0, 0), PLAIN, 0.1 * thick)
    model = assemble("board", [board.turned(-lean, 0)])
    # The face towards the thing starts at its foot and meets the thing's upper edge, if it gets that far.
    sunk = max(0.0, float(model.size[1]) - thick * np.cos(lean) - height * np.tan(lean))
    across = np.array([-outwards[1], outwards[0], 0.0])
    away = half[1] + float(model.size[1]) / 2 - sunk
    place = base.position + outwards * away + across * rng.uniform(-0.5, 0.5) * half[0]
    apart = [i for k, i in enumerate(room.instances) if k not in (on, base.support)]
    others = [part_boxes(i.model, i.position, i.yaw) for i in apart]
    own = part_boxes(model, place, turn)
    if not others or not overlaps(own, np.concatenate(others)).any():
        room.add(model, place, turn, base.support)


def _small(p: Palette, rng: Rng) -> ObjectModel:
    if rng.random() < SOLID_SHARE:
        return _solid(rng, 0.03, 0.3)
    return _stretched(SMALL[int(rng.integers(len(SMALL)))](p, rng), rng, 0.7, 1.4)


def _stretched(model: ObjectModel, rng: Rng, least: float, most: float) -> ObjectModel:
    """The model with each side of another length."""
    by = np.exp(rng.uniform(np.log(least), np.log(most), 3))
    parts = [ModelPart(part.vertices * by, part.faces, part.material) for part in model.parts]
    surfaces = [
        RestSurface(s.z * by[2], s.x0 * by[0], s.x1 * by[0], s.y0 * by[1], s.y1 * by[1], s.room * by[2])
        for s in model.surfaces
    ]
    return assemble(model.label, parts, surfaces)


def _block(rng: Rng, size: tuple[float, float, float]) -> ObjectModel:
    w, d, h = size
    part = block(size, (0, 0, 0), PLAIN, 0.05 * min(size))
    return assemble("block", [part], [RestSurface(h, -w / 2, w / 2, -d / 2, d / 2)])


def _solid(rng: Rng, least: float, most: float) -> ObjectModel:
    """A block, a cylinder (standing or lying), a ball or a cone, with log-uniform sides."""
    w, d, h = (float(x) for x in np.exp(rng.uniform(np.log(least), np.log(most), 3)))
    kind = int(rng.integers(6))
    if kind < 3:
        return _block(rng, (w, d, h))
    if kind == 3:
        standing = cylinder(w / 2, h, (0, 0, 0), PLAIN, 24)
        if rng.random() < 0.3:
            return assemble("cylinder", [standing.turned(np.pi / 2, 0)])
        k = 0.35 * w
        return assemble("cylinder", [standing], [RestSurface(h, -k, k, -k, k)])
    if kind == 4:
        return assemble("ball", [ball(w / 2, (0, 0, 0), PLAIN, (1, 1, rng.uniform(0.6, 1.2)))])
    return assemble("cone", [lathe([(0, 0), (w / 2, 0), (rng.uniform(0, 0.3) * w, h), (0, h)], (0, 0, 0), PLAIN, 24)])


def _plain_shell(width: float, depth: float, height: float) -> tuple[ModelPart, ...]:
    """A floor and four walls."""
    t = 0.1
    slabs = [((width + 2 * t, depth + 2 * t, t), (width / 2, depth / 2, -t))]
    slabs += [((t, depth, height), (x, depth / 2, 0.0)) for x in (-t / 2, width + t / 2)]
    slabs += [((width, t, height), (width / 2, y, 0.0)) for y in (-t / 2, depth + t / 2)]
    return tuple(block(size, at, PLAIN, 0.001) for size, at in slabs)


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
        hits = scene.tracer.first(place, pixel_rays(probe, v, u))
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
    f = focal * camera.width
    return replace(camera, K=intrinsics(f, f, (camera.width - 1) / 2, (camera.height - 1) / 2))
