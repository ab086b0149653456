"""Furniture of furnished rooms, as trimesh meshes of many parts, for measuring; house_things.py has what is smaller.

A model has z up, its foot at z = 0 and its front towards +y; metres. See house_rooms.py for how they are arranged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh
from trimesh import creation

Rng = np.random.Generator
Mesh = trimesh.Trimesh
Maker = Callable[[Rng], "Thing"]
SIDES = (-1, 1)
CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
DARK = 0.18
"""Share of a dark thing's pixels that sensors measure nothing at."""


class Place(NamedTuple):
    """What carries things: its sides, its height, and how high things on it may be."""

    x0: float
    x1: float
    y0: float
    y1: float
    z: float
    clear: float


class Block(NamedTuple):
    """An upright box of a model that nothing else may reach into."""

    x0: float
    x1: float
    y0: float
    y1: float
    z0: float
    z1: float


@dataclass(frozen=True, eq=False)
class Thing:
    """A model. `absorbs`: the share of its pixels that is not measured; `stacks`: it may carry one of its like."""

    kind: str
    mesh: Mesh
    blocks: tuple[Block, ...]
    places: tuple[Place, ...] = ()
    absorbs: float = 0.0
    stacks: bool = False

    @property
    def low(self) -> np.ndarray:
        return self.mesh.bounds[0]

    @property
    def high(self) -> np.ndarray:
        return self.mesh.bounds[1]

    @property
    def size(self) -> np.ndarray:
        return self.high - self.low


def _bounds(mesh: Mesh) -> Block:
    (x0, y0, z0), (x1, y1, z1) = mesh.bounds
    return Block(x0, x1, y0, y1, z0, z1)


def made(
    kind: str,
    parts: Sequence[Mesh],
    places: Sequence[Place] = (),
    blocks: Sequence[Block] = (),
    hollow: bool = False,
    absorbs: float = 0.0,
    stacks: bool = False,
) -> Thing:
    """A model of parts, put on z = 0. Without blocks given they are its bounds, or those of each part: `hollow`."""
    up = -min(part.bounds[0][2] for part in parts)
    for part in parts:
        part.apply_translation((0, 0, up))
    mesh = joined(parts)
    blocks = blocks or [_bounds(m) for m in (parts if hollow else [mesh])]
    return Thing(kind, mesh, tuple(blocks), tuple(p._replace(z=p.z + up) for p in places), absorbs, stacks)


# Parts


def joined(parts: Sequence[Mesh]) -> Mesh:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [np.asarray(part.faces) + start for part, start in zip(parts, starts, strict=False)]
    return Mesh(np.concatenate([np.asarray(p.vertices) for p in parts]), np.concatenate(faces), process=False)


def _copied(unit: Mesh, size: Sequence[float], at: Sequence[float]) -> Mesh:
    return Mesh(np.asarray(unit.vertices) * size + at, np.asarray(unit.faces), process=False)


_CUBE = creation.box()
_CUBE.apply_translation((0, 0, 0.5))
_BALL = creation.icosphere(3)
_ROD = creation.cylinder(1, 1, sections=20)
_ROD.apply_translation((0, 0, 0.5))
_STICK = creation.cylinder(1, 1, sections=8)
_STICK.apply_translation((0, 0, 0.5))


def bar(w: float, d: float, h: float, x: float = 0, y: float = 0, z: float = 0) -> Mesh:
    """A box about (x, y) that stands at z."""
    return _copied(_CUBE, (w, d, h), (x, y, z))


def rod(r: float, h: float, x: float = 0, y: float = 0, z: float = 0) -> Mesh:
    return _copied(_ROD, (r, r, h), (x, y, z))


def sheet(corners: Sequence[Sequence[float]] | np.ndarray) -> Mesh:
    """Two triangles, (0, 1, 2) and (1, 3, 2)."""
    return Mesh(corners, [(0, 1, 2), (1, 3, 2)], process=False)


def lathe(*outline: tuple[float, float]) -> Mesh:
    """A solid of revolution of (radius, height)."""
    return creation.revolve(np.array(outline), sections=28)


def soft(a: float, b: float, c: float, x: float = 0, y: float = 0, z: float = 0, roundness: float = 1.0) -> Mesh:
    """A superellipsoid about (x, y, z) with these half axes; boxy where `roundness` is low."""
    ball = np.asarray(_BALL.vertices)
    reach = (np.abs(ball) ** (2 / roundness)).sum(axis=1, keepdims=True) ** (roundness / 2)
    return Mesh(ball / reach * (a, b, c) + (x, y, z), np.asarray(_BALL.faces), process=False)


def tube(r: float, *path: Sequence[float]) -> list[Mesh]:
    """Sticks along a path."""
    found = []
    for a, b in zip(np.array(path[:-1], float), np.array(path[1:], float), strict=True):
        along = b - a
        side = np.cross(along, (1, 0, 0) if abs(along[0]) < 0.7 * np.linalg.norm(along) else (0, 1, 0))
        side /= np.linalg.norm(side)
        frame = np.stack([r * side, r * np.cross(along, side) / np.linalg.norm(along), along])
        found.append(Mesh(np.asarray(_STICK.vertices) @ frame + a, np.asarray(_STICK.faces), process=False))
    return found


def turned(mesh: Mesh, angle: float, axis: str, at: Sequence[float] | np.ndarray = (0, 0, 0)) -> Mesh:
    """Turned about an axis through the origin, then moved."""
    matrix = trimesh.transformations.rotation_matrix(angle, np.eye(3)["xyz".index(axis)])
    matrix[:3, 3] = at
    return mesh.apply_transform(matrix)


def _legs(w: float, d: float, h: float, leg: float) -> list[Mesh]:
    return [bar(leg, leg, h, x * (w - leg) / 2, y * (d - leg) / 2) for x, y in CORNERS]


def top(w: float, d: float, z: float, clear: float, y: float = 0) -> Place:
    return Place(-w / 2, w / 2, y - d / 2, y + d / 2, z, clear)


# Furniture


def _board(r: Rng, kind: str, w: float, d: float, h: float) -> Thing:
    """A table on legs, on two feet or on two panels."""
    thick, leg, inset = r.uniform((0.02, 0.035, 0.0), (0.045, 0.075, 0.1))
    draw, parts, h0 = r.random(), [bar(w, d, thick, z=h - thick)], h - thick
    if draw < 0.6:
        parts += _legs(w - 2 * inset, d - 2 * inset, h0, leg)
        if r.random() < 0.6:
            parts += [bar(w - 2 * (inset + leg), 0.02, 0.07, 0, s * (d / 2 - inset - 0.01), h0 - 0.07) for s in SIDES]
    elif draw < 0.85:
        for x in (0.2 - w / 2, w / 2 - 0.2):
            parts += [bar(0.06, d * 0.8, 0.05, x), bar(0.05, 0.09, h0 - 0.05, x, z=0.05)]
        parts.append(bar(w - 0.4, 0.04, 0.06, z=0.3))
    else:
        parts += [bar(0.04, d, h0, s * (w / 2 - 0.02)) for s in SIDES]
    return made(kind, parts, [top(w, d, h, 1.2)], hollow=True)


def _round(r: Rng, kind: str, radius: float, h: float) -> Thing:
    parts = [rod(radius, 0.03, z=h - 0.03)]
    if r.random() < 0.6:
        parts += [rod(0.045, h - 0.06, z=0.03), lathe((0, 0), (radius * 0.55, 0), (radius * 0.5, 0.03), (0, 0.04))]
    else:
        for a in np.pi / 4 + np.pi / 2 * np.arange(4):
            x, y = radius * np.cos(a), radius * np.sin(a)
            parts += tube(0.018, (0.85 * x, 0.85 * y, 0.012), (0.55 * x, 0.55 * y, h - 0.03))
    return made(kind, parts, [top(1.36 * radius, 1.36 * radius, h, 1.2)], hollow=True)


def table(r: Rng) -> Thing:
    if r.random() < 0.3:
        return _round(r, "table", *r.uniform((0.38, 0.7), (0.62, 0.76)))
    return _board(r, "table", *r.uniform((1.1, 0.7, 0.71), (2.0, 0.95, 0.77)))


def coffee_table(r: Rng) -> Thing:
    if r.random() < 0.3:
        return _round(r, "coffee table", *r.uniform((0.3, 0.36), (0.45, 0.48)))
    return _board(r, "coffee table", *r.uniform((0.8, 0.45, 0.36), (1.25, 0.65, 0.48)))


def side_table(r: Rng) -> Thing:
    if r.random() < 0.6:
        return _round(r, "side table", *r.uniform((0.2, 0.45), (0.28, 0.6)))
    return _board(r, "side table", *r.uniform((0.38, 0.38, 0.42), (0.5, 0.5, 0.6)))


def workbench(r: Rng) -> Thing:
    return _board(r, "workbench", *r.uniform((1.1, 0.7, 0.71), (2.0, 0.95, 0.77)))


def desk(r: Rng) -> Thing:
    w, d, h = r.uniform((1.1, 0.6, 0.71), (1.7, 0.8, 0.76))
    parts = [bar(w, d, 0.03, z=h - 0.03)]
    if r.random() < 0.55:
        side, wide = r.choice(SIDES), r.uniform(0.36, 0.46)
        x = side * (w - wide) / 2
        parts += [bar(wide - 0.02, d - 0.05, h - 0.07, x, -0.005, 0.04)]
        parts += [bar(wide - 0.06, 0.015, 0.18, x, d / 2 - 0.022, z) for z in (0.08, 0.28, 0.48)]
        parts += [bar(0.03, d - 0.02, h - 0.03, -side * (w / 2 - 0.02), -0.01)]
        parts += [bar(w - 0.1, 0.02, h - 0.38, 0, 0.02 - d / 2, 0.35)]
    else:
        for x in (0.12 - w / 2, w / 2 - 0.12):
            parts += [bar(0.07, d * 0.92, 0.03, x), bar(0.06, 0.09, h - 0.06, x, -0.05, 0.03)]
        parts.append(bar(w - 0.24, 0.04, 0.04, 0, -0.05, h - 0.07))
    return made("desk", parts, [top(w, d, h, 1.2)], hollow=True)


def chair(r: Rng) -> Thing:
    w, d, h, top, leg, thick, leans = r.uniform(
        (0.4, 0.4, 0.43, 0.78, 0.025, 0.03, 0.02), (0.48, 0.48, 0.48, 1.0, 0.04, 0.06, 0.1)
    )
    x, y = (w - leg) / 2, (d - leg) / 2

    def back(z: float) -> float:
        return -y - leans * (z - h) / (top - h)

    parts = [bar(w, d, thick, z=h - thick)]
    for s in SIDES:
        parts += [bar(leg, leg, h - thick, s * x, y)]
        parts += tube(leg / 2, (s * x, -y, 0), (s * x, -y, h), (s * x, back(top), top))
    draw = r.random()
    if draw < 0.4:
        bars = np.linspace(h + 0.15, top - 0.08, int(r.integers(2, 5)))
        parts += [bar(w - leg, 0.02, 0.06, 0, back(z), z) for z in bars]
    elif draw < 0.7:
        parts.append(bar(w - leg, 0.022, 0.06, 0, back(top - 0.05), top - 0.07))
        for u in np.linspace(0.07 - w / 2, w / 2 - 0.07, int(r.integers(3, 6))):
            parts += tube(0.009, (u, -y, h), (u, back(top - 0.04), top - 0.04))
    else:
        slab = bar(w - leg, 0.04, top - h - 0.12, z=0.12)
        parts.append(turned(slab, np.arctan2(leans, top - h), "x", (0, -y, h)))
    seat = Block(-w / 2, w / 2, -d / 2, d / 2, 0, h)
    behind = Block(-w / 2, w / 2, back(top) - leg / 2, leg - d / 2, 0, top)
    return made("chair", parts, [Place(0.02 - w / 2, w / 2 - 0.02, 0.05 - d / 2, d / 2, h, 0.4)], [seat, behind])


def office_chair(r: Rng) -> Thing:
    h = r.uniform(0.44, 0.54)
    top, parts = h + r.uniform(0.42, 0.62), [rod(0.03, h - 0.17, z=0.1), soft(0.24, 0.24, 0.045, 0, 0, h - 0.04, 0.5)]
    for a in 0.3 + 2 * np.pi / 5 * np.arange(5):
        x, y = 0.29 * np.cos(a), 0.29 * np.sin(a)
        parts += [*tube(0.02, (0, 0, 0.12), (x, y, 0.075)), soft(0.03, 0.03, 0.03, x, y, 0.03)]
    parts += tube(0.02, (0, -0.12, h - 0.06), (0, -0.26, h - 0.02), (0, -0.28, h + 0.3))
    back = soft(0.22, 0.04, (top - h - 0.12) / 2, roundness=0.5)
    parts.append(turned(back, r.uniform(0.05, 0.2), "x", (0, -0.25, (top + h) / 2 + 0.06)))
    blocks = [Block(-0.24, 0.24, -0.3, 0.24, 0, h), Block(-0.22, 0.22, -0.36, -0.2, 0, top)]
    if r.random() < 0.6:
        for x in (-0.27, 0.27):
            parts += [*tube(0.013, (0.74 * x, 0, h - 0.05), (x, 0, h), (x, 0, h + 0.2))]
            parts.append(bar(0.07, 0.24, 0.03, x, 0.02, h + 0.2))
        blocks.append(Block(-0.31, 0.31, -0.1, 0.14, 0, h + 0.23))
    return made("chair", parts, blocks=blocks)


def _seating(r: Rng, kind: str, w: float, d: float) -> Thing:
    h, top, arm, arm_top, deep = r.uniform((0.38, 0.72, 0.12, 0.52, 0.16), (0.46, 0.92, 0.22, 0.66, 0.24))
    inner, low, behind = w - 2 * arm, h - 0.14, 0.6 * deep - d / 2
    parts = [bar(0.05, 0.05, 0.09, x * (w / 2 - 0.07), y * (d / 2 - 0.07)) for x, y in CORNERS]
    parts.append(bar(w, d, low - 0.08, z=0.08))
    parts += [bar(arm, d - 0.02, arm_top - low, s * (w - arm) / 2, -0.01, low) for s in SIDES]
    parts.append(bar(inner, 0.6 * deep, top - low, 0, behind - 0.3 * deep, low))
    count = max(1, round(inner / 0.65))
    for x in inner / count * (np.arange(count) + 0.5) - inner / 2:
        half = inner / count / 2
        parts.append(soft(half - 0.005, (d - deep) / 2 - 0.01, 0.085, x, deep / 2, h - 0.07, 0.35))
        back = soft(half - 0.01, 0.09, (top - h) / 2, roundness=0.45)
        parts.append(turned(back, 0.12, "x", (x, behind + 0.07, (top + h) / 2 + 0.01)))
    seat = h + 0.015
    blocks = [Block(-w / 2, w / 2, -d / 2, d / 2, 0, seat), Block(-w / 2, w / 2, -d / 2, behind + 0.15, 0, top)]
    blocks += [Block(x, x + arm, -d / 2, d / 2, 0, arm_top) for x in (-w / 2, w / 2 - arm)]
    return made(kind, parts, [Place(-inner / 2, inner / 2, behind + 0.16, d / 2 - 0.05, seat, 0.8)], blocks)


def sofa(r: Rng) -> Thing:
    return _seating(r, "sofa", *r.uniform((1.5, 0.8), (2.3, 0.98)))


def armchair(r: Rng) -> Thing:
    return _seating(r, "armchair", *r.uniform((0.7, 0.72), (0.9, 0.9)))


def bed(r: Rng) -> Thing:
    """Its places: the blanket, and where pillows lie."""
    wide = r.uniform(0.9, 1.0) if r.random() < 0.4 else r.uniform(1.4, 1.8)
    long, h, head = r.uniform((1.95, 0.42, 0.8), (2.1, 0.56, 1.15))
    w, d, top = wide, long, 1.04 * h
    parts = [bar(w, d, h * 0.25, z=h * 0.35), bar(w + 0.04, 0.05, head, 0, -d / 2 - 0.025)]
    parts += [bar(0.07, 0.07, h * 0.4, s * (w / 2 - 0.05), d / 2 - 0.05) for s in SIDES]
    parts.append(soft(w / 2 - 0.01, d / 2 - 0.01, h * 0.2, 0, 0, h * 0.8, 0.2))
    parts.append(soft(w / 2 + 0.03, d * 0.38, h * 0.2, 0, d * 0.12, h * 0.84, 0.25))
    if r.random() < 0.5:
        parts.append(bar(w + 0.02, 0.04, h * 1.2, 0, d / 2 + 0.02))
    blocks = [Block(-w / 2 - 0.03, w / 2 + 0.03, -d / 2 - 0.05, d / 2 + 0.05, 0, top)]
    blocks.append(Block(-w / 2, w / 2, -d / 2 - 0.05, -d / 2, 0, head))
    middle = Place(0.1 - w / 2, w / 2 - 0.1, -0.22 * d, d / 2 - 0.15, top, 0.8)
    return made("bed", parts, [middle, Place(-w / 2, w / 2, 0.04 - d / 2, -0.22 * d, top, 0.8)], blocks)


def _doors(r: Rng, kind: str, w: float, d: float, h: float) -> Thing:
    foot, count = r.uniform(0.03, 0.1), max(1, round(w / 0.5))
    parts = [bar(w, d - 0.02, h - foot, 0, -0.01, foot), bar(w - 0.06, d - 0.07, foot, 0, -0.015)]
    for k, x in enumerate(w / count * (np.arange(count) + 0.5) - w / 2):
        parts.append(bar(w / count - 0.012, 0.02, h - foot - 0.02, x, d / 2 - 0.01, foot + 0.01))
        parts.append(bar(0.015, 0.02, 0.12, x + (-1) ** k * (w / count / 2 - 0.05), d / 2 + 0.01, h / 2))
    return made(kind, parts, [top(w - 0.04, d - 0.04, h, 0.5)])


def cupboard(r: Rng) -> Thing:
    return _doors(r, "cupboard", *r.uniform((0.7, 0.42, 1.5), (1.6, 0.62, 2.15)))


def wall_cupboard(r: Rng, w: float) -> Thing:
    return _doors(r, "wall cupboard", w, *r.uniform((0.32, 0.55), (0.37, 0.75)))


def _drawers(r: Rng, kind: str, w: float, d: float, h: float) -> Thing:
    rows, columns = int(r.integers(2, 5)), 1 if w < 0.9 else 2
    parts = [bar(0.05, 0.05, 0.08, x * (w / 2 - 0.04), y * (d / 2 - 0.06)) for x, y in CORNERS]
    parts.append(bar(w, d - 0.02, h - 0.07, 0, -0.01, 0.07))
    tall, wide = (h - 0.1) / rows, w / columns
    for z in 0.09 + tall * np.arange(rows):
        for x in wide * (np.arange(columns) + 0.5) - w / 2:
            parts += [bar(wide - 0.03, 0.02, tall - 0.015, x, d / 2 - 0.01, z)]
            parts += [bar(0.1, 0.02, 0.015, x, d / 2 + 0.01, z + 0.6 * tall)]
    return made(kind, parts, [top(w, d - 0.03, h, 1.2, -0.005)])


def drawers(r: Rng) -> Thing:
    return _drawers(r, "chest of drawers", *r.uniform((0.6, 0.4, 0.6), (1.3, 0.5, 1.05)))


def nightstand(r: Rng) -> Thing:
    return _drawers(r, "nightstand", *r.uniform((0.38, 0.34, 0.45), (0.5, 0.42, 0.6)))


def tv_stand(r: Rng) -> Thing:
    return _drawers(r, "tv stand", *r.uniform((1.2, 0.36, 0.38), (1.8, 0.46, 0.55)))


def counter(r: Rng, least: float = 0.5, most: float = 1.2) -> Thing:
    return _drawers(r, "kitchen counter", r.uniform(least, most), 0.6, r.uniform(0.86, 0.92))


def fridge(r: Rng) -> Thing:
    w, d, h = r.uniform((0.55, 0.6, 1.4), (0.7, 0.68, 1.9))
    z = h * r.uniform(0.55, 0.7)
    parts = [bar(w, d - 0.05, h - 0.02, 0, -0.025, 0.02), bar(w, d - 0.08, 0.03, 0, -0.02)]
    parts += [bar(w, 0.05, b - a, 0, d / 2 - 0.025, a) for a, b in ((0.04, z - 0.004), (z + 0.004, h))]
    parts += [bar(0.02, 0.03, long, w / 2 - 0.06, d / 2 + 0.015, a) for long, a in ((0.28, z - 0.35), (0.2, z + 0.06))]
    return made("fridge", parts, [top(w, d - 0.05, h, 0.5, -0.025)])


def oven(r: Rng) -> Thing:
    h = r.uniform(0.86, 0.92)
    parts = [bar(0.6, 0.58, h, 0, -0.01), bar(0.52, 0.02, h - 0.35, 0, 0.29, 0.15)]
    parts.append(bar(0.5, 0.025, 0.02, 0, 0.32, h - 0.19))
    return made("oven", parts, [top(0.6, 0.52, h, 0.6, -0.01)])


def bookshelf(r: Rng) -> Thing:
    """Its places: the shelves from below, then the top."""
    w, d, h = r.uniform((0.5, 0.24, 0.8), (1.2, 0.34, 2.1))
    count, inner = max(2, round(h / r.uniform(0.32, 0.42))), w - 0.04
    parts = [bar(0.02, d, h, s * (w / 2 - 0.01)) for s in SIDES]
    if r.random() < 0.75:
        parts.append(bar(inner, 0.01, h - 0.02, 0, 0.005 - d / 2, 0.02))
    heights = np.linspace(0.05, h - 0.02, count + 1)
    parts += [bar(inner, d - 0.01, 0.02, 0, 0.005, z) for z in heights]
    apart = heights[1] - heights[0]
    places = [top(inner - 0.008, d - 0.024, z + 0.02, apart - 0.04, 0.002) for z in heights[:-1]]
    blocks = [*(_bounds(part) for part in parts), Block(-w / 2, w / 2, -d / 2, 0.012 - d / 2, 0, h)]
    return made("bookshelf", parts, [*places, top(w, d, h, 0.6)], blocks)


def wall_shelf(r: Rng) -> Thing:
    w, d = r.uniform((0.5, 0.18), (1.2, 0.27))
    return made("wall shelf", [bar(w, d, 0.025)], [top(w, d - 0.005, 0.025, 0.4, 0.0025)])


def stool(r: Rng) -> Thing:
    radius, h = r.uniform((0.15, 0.42), (0.2, 0.65))
    parts = [rod(radius, 0.035, z=h - 0.035)]
    for a in np.pi / 4 + np.pi / 2 * np.arange(4):
        x, y = radius * np.cos(a), radius * np.sin(a)
        parts += tube(0.014, (1.05 * x, 1.05 * y, 0), (0.7 * x, 0.7 * y, h - 0.03))
    return made("stool", parts, [top(1.2 * radius, 1.2 * radius, h, 0.5)])


def radiator(r: Rng) -> Thing:
    w, h = r.uniform((0.6, 0.4), (1.4, 0.6))
    count = int(w / 0.06)
    parts = [bar(0.75 * w / count, 0.09, h, x, 0, 0.1) for x in w / count * (np.arange(count) + 0.5) - w / 2]
    parts += [bar(w, 0.06, 0.04, z=0.14), bar(w, 0.06, 0.04, z=h)]
    return made("radiator", parts + [bar(0.03, 0.03, 0.12, s * 0.42 * w) for s in SIDES])


def rug(r: Rng) -> Thing:
    """It is no obstacle: what is upon it stands on the floor."""
    w, d = r.uniform((1.0, 0.8), (2.2, 1.6))
    mesh = rod(0.6 * d, 0.009) if r.random() < 0.25 else bar(w, d, 0.009)
    (x0, y0, _), (x1, y1, _) = mesh.bounds
    return made("rug", [mesh], blocks=[Block(x0, x1, y0, y1, -0.02, -0.01)])
