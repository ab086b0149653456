"""A room as shell and placed instances of models, and the rules of placing: rest on something, touch nothing else."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.synthetic.model import (
    BRASS,
    SIDES,
    Material,
    ModelPart,
    ObjectModel,
    Palette,
    axis_rotation,
    block,
    cylinder,
    each,
    rgb,
    rod,
    sheet,
)
from pipeline.system.frozen import dataclass

FLOOR, WALL = -1, -2
"""What an instance rests on, where that is not another instance."""

TOUCH_M = 0.0015
"""Boxes of parts may share this much before two things count as interpenetrating."""

SKIRTING_M = 0.022
"""Clearance to the walls, past the skirting board."""


@dataclass(frozen=True)
class Instance:
    """A model put into the world.

    Attributes
    ----------
    position : (3,) float64
        Where the model's origin (middle of its foot) is, metres, world.
    yaw : float
        Turn about the world's z axis, radians.
    support : int
        Index of the instance it rests on, or FLOOR, or WALL.
    """

    model: ObjectModel
    position: np.ndarray
    yaw: float
    support: int

    @property
    def R(self) -> np.ndarray:
        """(3, 3) world-from-model rotation."""
        return axis_rotation(self.yaw, 2)

    @property
    def T_world_model(self) -> np.ndarray:
        """(4, 4) world-from-model pose."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R, self.position
        return T

    @property
    def box(self) -> Box3D:
        """The exact box in the world."""
        middle = (self.model.low + self.model.high) / 2
        return Box3D(self.position + self.R @ middle, self.R, self.model.size)


@dataclass(frozen=True)
class Focus:
    """A place worth looking at. `target` (3,) in metres, world; `heading` the direction of view in plan, radians from
    +x; `spread` how far the heading may turn; `near` and `far` bound the distance."""

    target: np.ndarray
    heading: float
    spread: float
    near: float
    far: float


@dataclass(frozen=True, eq=False)
class Room:
    """A furnished room: x in 0..width, y in 0..depth, z up from the floor at 0, metres.

    Attributes
    ----------
    shell : tuple of ModelPart
        Floor, walls, ceiling, window and door, in world coordinates; not annotated.
    sun : (3,) float64
        Unit vector towards the sun.
    opening : (4,) tuple of float
        y0, y1, z0, z1 of the window in the wall x = width: the only way in for the sun.
    """

    seed: int
    kind: str
    width: float
    depth: float
    height: float
    shell: tuple[ModelPart, ...]
    instances: tuple[Instance, ...]
    focuses: tuple[Focus, ...]
    sun: np.ndarray
    opening: tuple[float, float, float, float]


def part_boxes(model: ObjectModel, position: np.ndarray, yaw: float) -> np.ndarray:
    """(P, 7): centre xyz, half size xyz and yaw of the box of each part."""
    low = np.array([part.low for part in model.parts])
    high = np.array([part.high for part in model.parts])
    centre = (low + high) / 2 @ axis_rotation(yaw, 2).T + position
    return np.concatenate([centre, (high - low) / 2, np.full((len(low), 1), yaw)], axis=1)


def foot_of(model: ObjectModel, yaw: float) -> np.ndarray:
    """Corners (4, 2) of the plan rectangle of a turned model's foot, about the origin."""
    parts = [part for part in model.parts if part.low[2] < 0.01]
    low, high = np.min([part.low[:2] for part in parts], axis=0), np.max([part.high[:2] for part in parts], axis=0)
    corners = np.array([[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]])
    return corners @ axis_rotation(yaw, 2)[:2, :2].T


def overlaps(a: np.ndarray, b: np.ndarray, touch: float = TOUCH_M) -> np.ndarray:
    """Overlap (A, B) bool of upright boxes by more than `touch` metres along every separating axis. The separating axis
    theorem in plan (the two axes of each rectangle) and an interval test in height."""
    delta = b[None, :, :3] - a[:, None, :3]
    hit = np.abs(delta[..., 2]) < a[:, None, 5] + b[None, :, 5] - touch
    # Most boxes are far apart in plan, which the circles around them tell at a fraction of the cost.
    hit &= np.hypot(delta[..., 0], delta[..., 1]) < np.hypot(a[:, 3], a[:, 4])[:, None] + np.hypot(b[:, 3], b[:, 4])
    i, j = np.nonzero(hit)
    if not len(i):
        return hit
    a, b, delta = a[i], b[j], delta[i, j]
    shared = np.ones(len(i), np.bool_)
    for yaw in (a[:, 6], a[:, 6] + np.pi / 2, b[:, 6], b[:, 6] + np.pi / 2):
        c, s = np.cos(yaw), np.sin(yaw)
        reach = np.zeros(len(i))
        for boxes in (a, b):
            own = boxes[:, 6]
            reach = reach + boxes[:, 3] * np.abs(c * np.cos(own) + s * np.sin(own))
            reach = reach + boxes[:, 4] * np.abs(-c * np.sin(own) + s * np.cos(own))
        shared &= np.abs(delta[:, 0] * c + delta[:, 1] * s) < reach - touch
    hit[i, j] = shared
    return hit


@dataclass
class Layout:
    """A room being furnished."""

    width: float
    depth: float
    height: float
    rng: np.random.Generator
    instances: list[Instance] = field(default_factory=list)
    rugs: list[int] = field(default_factory=list)
    _boxes: list[np.ndarray] = field(default_factory=list)

    def free(self, model: ObjectModel, position: np.ndarray, yaw: float) -> bool:
        """Test whether the model fits inside the walls and clear of everything placed."""
        boxes = part_boxes(model, position, yaw)
        c, s = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
        middle = position + axis_rotation(yaw, 2) @ ((model.low + model.high) / 2)
        half = model.size / 2
        hx, hy = half[0] * c + half[1] * s, half[0] * s + half[1] * c
        if not (middle[0] - hx >= SKIRTING_M and middle[0] + hx <= self.width - SKIRTING_M):
            return False
        if not (middle[1] - hy >= SKIRTING_M and middle[1] + hy <= self.depth - SKIRTING_M):
            return False
        return not self._boxes or not overlaps(boxes, np.concatenate(self._boxes)).any()

    def add(self, model: ObjectModel, position: np.ndarray, yaw: float, support: int) -> int:
        """Add the model unchecked; returns the index."""
        self.instances.append(Instance(model, position, float(yaw), support))
        self._boxes.append(part_boxes(model, position, yaw))
        return len(self.instances) - 1

    def stand(self, model: ObjectModel, x: float, y: float, yaw: float = 0.0) -> int | None:
        """Stand the model on the floor, or on a rug large enough; None without room."""
        z, support = 0.0, FLOOR
        corners = foot_of(model, yaw) + np.array([x, y])
        for index in self.rugs:
            rug = self.instances[index]
            local = (corners - rug.position[:2]) @ rug.R[:2, :2]
            if (np.abs(local) < rug.model.size[:2] / 2).all():
                z, support = float(rug.position[2] + rug.model.high[2]), index
        position = np.array([x, y, z])
        return self.add(model, position, yaw, support) if self.free(model, position, yaw) else None

    def stand_near(
        self, model: ObjectModel, x: float, y: float, yaw: float = 0.0, wander: float = 0.15, tries: int = 40
    ) -> int | None:
        """Stand at the first free place, searching outwards from (x, y)."""
        for k in range(tries):
            dx, dy = self.rng.uniform(-wander, wander, 2) * (k / 8)
            index = self.stand(model, x + dx, y + dy, yaw)
            if index is not None:
                return index
        return None

    def put(
        self,
        model: ObjectModel,
        on: int | None,
        at: tuple[float, float] | None = None,
        yaw: float = 0.0,
        surface: int = 0,
        wander: float = 0.04,
    ) -> int | None:
        """Rest the model on a surface of instance `on`.

        `at` is in the surface's own -1..1 coordinates (x, y); without it any free place is taken. `yaw` is relative to
        the supporting object. None where nothing is free, or where `on` itself found no place.
        """
        if on is None:
            return None
        base = self.instances[on]
        top = base.model.surfaces[surface]
        if model.size[2] > top.room:
            return None
        corners = foot_of(model, yaw)
        x0, y0 = np.array([top.x0, top.y0]) - corners.min(axis=0)
        x1, y1 = np.array([top.x1, top.y1]) - corners.max(axis=0)
        if x1 < x0 or y1 < y0:
            return None
        for k in range(30):
            u, v = self.rng.uniform(-1, 1, 2)
            x, y = (x0 + x1) / 2 + u * (x1 - x0) / 2, (y0 + y1) / 2 + v * (y1 - y0) / 2
            if at is not None:
                x = (top.x0 + top.x1) / 2 + at[0] * (top.x1 - top.x0) / 2 + u * wander * k / 4
                y = (top.y0 + top.y1) / 2 + at[1] * (top.y1 - top.y0) / 2 + v * wander * k / 4
                x, y = float(np.clip(x, x0, x1)), float(np.clip(y, y0, y1))
            position = base.position + base.R @ np.array([x, y, top.z])
            if self.free(model, position, base.yaw + yaw):
                return self.add(model, position, base.yaw + yaw, on)
        return None

    def stack(self, model: ObjectModel, on: int | None, yaw: float = 0.0) -> int | None:
        """Rest the model on the middle of the top of instance `on`."""
        if on is None:
            return None
        base = self.instances[on]
        position = base.position + np.array([0, 0, base.model.high[2]])
        turn = base.yaw + yaw
        return self.add(model, position, turn, on) if self.free(model, position, turn) else None

    def hang(self, model: ObjectModel, wall: str, along: float, z: float) -> int | None:
        """Hang the model on a wall ("back", "left", "right", "front") at height z."""
        x, y, yaw = self._at_wall(wall, along, float(model.high[1]), 0.001)
        position = np.array([x, y, z])
        boxes = part_boxes(model, position, yaw)
        if self._boxes and overlaps(boxes, np.concatenate(self._boxes)).any():
            return None
        return self.add(model, position, yaw, WALL)

    def against(self, model: ObjectModel, wall: str, along: float, gap: float = 0.03) -> int | None:
        """Stand the model with its back to a wall."""
        x, y, yaw = self._at_wall(wall, along, float(model.high[1]) + SKIRTING_M + gap, 0.0)
        return self.stand(model, x, y, yaw)

    def _at_wall(self, wall: str, along: float, reach: float, gap: float) -> tuple[float, float, float]:
        """Position x, y and yaw at a wall for a model of depth `reach`, with a gap."""
        return {
            "back": (along, self.depth - reach - gap, 0.0),
            "left": (reach + gap, along, np.pi / 2),
            "right": (self.width - reach - gap, along, -np.pi / 2),
            "front": (along, reach + gap, np.pi),
        }[wall]

    def lay_rug(self, model: ObjectModel, x: float, y: float, yaw: float = 0.0) -> int | None:
        """Lay a rug on the floor; later models may stand on the rug."""
        index = self.stand(model, x, y, yaw)
        if index is not None:
            self.rugs.append(index)
        return index


Rng = np.random.Generator
WALL_M = 0.16
SKIRTING_H = 0.09

SPANS = {"planks": 1.25, "herringbone": 0.85, "tiles": 1.5}


def build_shell(
    palette: Palette,
    rng: Rng,
    width: float,
    depth: float,
    height: float,
    window: tuple[float, float],
    door: tuple[str, float] | None,
) -> tuple[ModelPart, ...]:
    """The unannotated parts of a room. `window` (float, float): Middle of the window along the right-hand wall (y,
    metres) and its width; `door` (str, float) or None: The wall ("front" or "left") and the place along it."""
    w, d, h, t = width, depth, height, WALL_M
    wall = Material(rgb(palette.wall), ("plaster",), 1.3)
    feature = Material(rgb(palette.feature), ("plaster",), 1.3)
    white = Material(rgb("#f5f2eb"), None, gloss=0.2)
    floor = Material(rgb(palette.floor_tint), (palette.floor,), SPANS[palette.floor], gloss=0.22)
    ceiling = Material(rgb("#f7f4ee"), ("plaster",), 1.3)
    return (
        block((w + 2 * t, d + 2 * t, 0.1), (w / 2, d / 2, -0.1), floor, 0.001),
        block((w + 2 * t, d + 2 * t, 0.1), (w / 2, d / 2, h), ceiling, 0.001),
        block((w + 2 * t, t, h), (w / 2, d + t / 2, 0), feature, 0.001),
        block((w + 2 * t, t, h), (w / 2, -t / 2, 0), wall, 0.001),
        block((t, d, h), (-t / 2, d / 2, 0), wall, 0.001),
        *_window_wall(w, d, h, window, wall, white),
        *_curtains(w, h, window, palette),
        block((w, 0.014, SKIRTING_H), (w / 2, d - 0.007, 0), white, 0.004),
        block((w, 0.014, SKIRTING_H), (w / 2, 0.007, 0), white, 0.004),
        block((0.014, d - 0.03, SKIRTING_H), (0.007, d / 2, 0), white, 0.004),
        block((0.014, d - 0.03, SKIRTING_H), (w - 0.007, d / 2, 0), white, 0.004),
        *(_door(door, white) if door is not None else ()),
    )


def window_opening(window: tuple[float, float]) -> tuple[float, float, float, float]:
    """y0, y1, z0, z1 of the hole in the right-hand wall."""
    y, wide = window
    return y - wide / 2, y + wide / 2, 0.85, 2.25


def _window_wall(
    w: float, d: float, h: float, window: tuple[float, float], wall: Material, white: Material
) -> list[ModelPart]:
    """The right-hand wall around the window, with the frame."""
    y, wide = window
    y0, y1, low, high = window_opening(window)
    t, bar = WALL_M, 0.05
    x = w + t * 0.6
    return [
        block((t, y0, h), (w + t / 2, y0 / 2, 0), wall, 0.001),
        block((t, d - y1, h), (w + t / 2, (y1 + d) / 2, 0), wall, 0.001),
        block((t, wide, low), (w + t / 2, y, 0), wall, 0.001),
        block((t, wide, h - high), (w + t / 2, y, high), wall, 0.001),
        block((0.12, wide + 0.08, 0.03), (w - 0.01, y, low - 0.012), white, 0.006),
        *(block((bar, wide, bar), (x, y, z), white, 0.006) for z in (low, high - bar)),
        *(block((bar, bar, high - low), (x, k, low), white, 0.006) for k in (y0 + bar / 2, y, y1 - bar / 2)),
        block((bar * 0.6, wide, bar * 0.6), (x, y, low + 0.62 * (high - low)), white, 0.005),
    ]


def _curtains(w: float, h: float, window: tuple[float, float], palette: Palette) -> list[ModelPart]:
    """A rail with a gathered curtain at either side."""
    y, wide = window
    linen = Material(rgb(palette.rug[0]), ("fabric",), 0.2)
    x, top = w - 0.08, 2.42
    parts = [rod((x, y - wide / 2 - 0.42, top), (x, y + wide / 2 + 0.42, top), 0.012, BRASS)]
    for s in (-1, 1):
        along = np.linspace(0, 1, 61)
        fold = 0.032 * np.sin(along * 2 * np.pi * 5.5)
        heights = np.linspace(0.02, top + 0.02, 7)
        points = np.empty((7, 61, 3))
        points[..., 0] = x + fold * (1.15 - 0.35 * heights[:, None] / top)
        points[..., 1] = y + s * (wide / 2 - 0.03 + 0.40 * along)
        points[..., 2] = heights[:, None]
        parts.append(sheet(points, linen))
    return parts


def _door(door: tuple[str, float], white: Material) -> list[ModelPart]:
    """A panelled door with a frame."""
    side, along = door
    wide, tall = 0.86, 2.04
    knob = cylinder(0.022, 0.05, (0, 0, 0), BRASS, 18).turned(np.pi / 2, 0)
    parts = [
        block((wide, 0.030, tall), (0, -0.012, 0), white, 0.004),
        *each(SIDES, lambda s: (
            block((0.075, 0.05, tall + 0.07), (s * (wide / 2 + 0.0375), -0.018, 0), white, 0.006),
            *(
                block((wide * 0.34, 0.012, panel), (s * wide * 0.215, -0.030, z), white, 0.005)
                for z, panel in ((0.16, 0.72), (1.02, 0.88))
            ),
        )),
        block((wide + 0.15, 0.05, 0.075), (0, -0.018, tall), white, 0.006),
        rod((wide / 2 - 0.06, -0.07, 1.0), (wide / 2 - 0.17, -0.07, 1.0), 0.009, BRASS),
        knob.moved((wide / 2 - 0.06, -0.025, 1.0)),
    ]  # fmt: skip
    turn, at = (np.pi / 2, (0.0, along, 0)) if side == "left" else (np.pi, (along, 0.0, 0))
    return [part.turned(turn, 2).moved(at) for part in parts]
