"""A room to put models in: where there is room, at walls, on each other, in stacks and rows; see house_rooms.py.

A room's corner is at the origin, its floor at z = 0. Things share no room by their blocks; they touch, lean and stack.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from benchmarks import house_models as m
from benchmarks import house_things as t
from benchmarks.house_models import Block, Maker, Mesh, Place, Rng, Thing, bar

TABLES = {"table", "coffee table", "side table", "desk", "workbench"}
BELOW = {
    "chair",
    "stool",
    "wastebasket",
    "box",
    "ball",
    "shoes",
    "rug",
    "backpack",
    "handbag",
    "basket",
    "teddy bear",
}
"""What may stand below a table."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A model in its room; `side` and `along` of the wall that it stands at, if it does."""

    thing: Thing
    yaw: float
    at: np.ndarray
    side: int = -1
    along: float = 0.0

    @property
    def mesh(self) -> Mesh:
        return m.turned(self.thing.mesh.copy(), self.yaw, "z", self.at)

    def world(self, x: float, y: float, z: float) -> np.ndarray:
        """A point of the model's."""
        return self.at + np.array([*_spun(self.yaw, x, y), z])


def _spun(yaw: float, x: float, y: float) -> np.ndarray:
    return np.array([np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y])


def _boxes(blocks: Sequence[Block], yaw: float, at: np.ndarray) -> np.ndarray:
    """(N, 7): middle, half sides, yaw and heights of blocks in the world."""
    x0, x1, y0, y1, z0, z1 = np.array(blocks).T
    x, y = _spun(yaw, (x0 + x1) / 2, (y0 + y1) / 2) + at[:2, None]
    return np.stack([x, y, (x1 - x0) / 2, (y1 - y0) / 2, np.full_like(x, yaw), z0 + at[2], z1 + at[2]], axis=1)


def _meet(a: np.ndarray, b: np.ndarray, slack: float = 0.001) -> bool:
    """Whether any upright box of one (N, 7) reaches into any of the other (M, 7)."""
    a, b = np.moveaxis(a, -1, 0)[:, :, None], np.moveaxis(b, -1, 0)[:, None]
    apart = (a[5] >= b[6] - slack) | (b[5] >= a[6] - slack)
    for angle in (a[4], a[4] + np.pi / 2, b[4], b[4] + np.pi / 2):
        reach = sum(q[2] * np.abs(np.cos(angle - q[4])) + q[3] * np.abs(np.sin(angle - q[4])) for q in (a, b))
        apart = apart | (np.abs(np.cos(angle) * (b[0] - a[0]) + np.sin(angle) * (b[1] - a[1])) >= reach - slack)
    return not apart.all()


class House:
    """A room and what is in it. `panes` are of the shell, and sensors see little of them."""

    def __init__(self, rng: Rng) -> None:
        self.rng = rng
        self.size = rng.uniform((3.0, 2.8, 2.35), (6.0, 5.2, 2.9))
        self.placed: list[Placed] = []
        self.boxes = self.under = np.zeros((0, 7))
        w, d, h = self.size
        self.shell = [bar(w + 0.2, d + 0.2, 0.1, w / 2, d / 2, z) for z in (-0.1, h)]
        self.shell += [bar(0.1, d, h, x, d / 2) for x in (-0.05, w + 0.05)]
        self.shell += [bar(w, 0.1, h, w / 2, y) for y in (-0.05, d + 0.05)]
        self.panes: list[Mesh] = []
        if self.chance(0.6):
            self._door()
        for _ in range(self.count(0, 2)):
            self._window()

    def chance(self, share: float) -> bool:
        return self.rng.random() < share

    def count(self, low: int, high: int) -> int:
        """Between these, both included."""
        return int(self.rng.integers(low, high + 1))

    def one(self, makers: Sequence[Maker]) -> Thing:
        return makers[int(self.rng.integers(len(makers)))](self.rng)

    # Where things go

    def add(self, thing: Thing, yaw: float, at: np.ndarray, side: int = -1, along: float = 0.0) -> Placed | None:
        """Put there, if there is room."""
        boxes = _boxes(thing.blocks, yaw, at)
        c, s = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
        reach = boxes[:, 2:4] @ np.array([[c, s], [s, c]])
        if (boxes[:, :2] < reach - 1e-6).any() or (boxes[:, :2] + reach > self.size[:2] + 1e-6).any():
            return None
        if _meet(boxes, self.boxes) or (thing.kind not in BELOW and _meet(boxes, self.under)):
            return None
        if thing.kind in TABLES:
            (x0, y0, _), (x1, y1, z1) = thing.low, thing.high
            under = _boxes([Block(x0, x1, y0, y1, 0, z1 - 0.03)], yaw, at)
            if _meet(under, self.boxes):
                return None
            self.under = np.concatenate([self.under, under])
        self.boxes = np.concatenate([self.boxes, boxes])
        self.placed.append(Placed(thing, yaw, at, side, along))
        return self.placed[-1]

    def near(self, base: Placed, thing: Thing, x: float, y: float, yaw: float, z: float = 0.0) -> Placed | None:
        """Put where that is in the frame of another thing."""
        return self.add(thing, base.yaw + yaw, base.world(x, y, z))

    def wall_pose(self, side: int, along: float, off: float, z: float = 0.0) -> tuple[float, np.ndarray]:
        """Yaw and place of what stands with its back to a wall."""
        w, d, _ = self.size
        spots = (along, off), (w - off, along), (w - along, d - off), (off, d - along)
        return side * np.pi / 2, np.array([*spots[side], z])

    def wall(
        self, thing: Thing, gap: float | None = None, z: float = 0.0, spot: tuple[int, float] | None = None
    ) -> Placed | None:
        """Put with its back to a wall: at a `spot` of it, or anywhere, at times in a corner."""
        rng = self.rng
        for _ in range(25 if spot is None else 1):
            side = int(rng.integers(4)) if spot is None else spot[0]
            low, high = 0.02 - thing.low[0], self.size[side % 2] - thing.high[0] - 0.02
            if high - low < 0.06:
                continue
            along = rng.uniform(low, high) if spot is None else spot[1]
            if spot is None and self.chance(0.2):
                along = low - 0.01
            off = 0.003 + abs(rng.normal(0, 0.02)) if gap is None else gap
            found = self.add(thing, *self.wall_pose(side, along, off - thing.low[1], z), side, along)
            if found:
                return found
        return None

    def floor(self, thing: Thing, yaw: float | None = None, middle: bool = False) -> Placed | None:
        """Put somewhere on the floor, turned anyhow or about as told."""
        rng, size = self.rng, self.size[:2]
        for _ in range(30):
            at = rng.normal(size / 2, 0.5) if middle else rng.uniform(0.2, size - 0.2)
            angle = rng.uniform(0, 2 * np.pi) if yaw is None else yaw + rng.normal(0, 0.08)
            found = self.add(thing, angle, np.array([*at, 0.0]))
            if found:
                return found
        return None

    def anywhere(self, thing: Thing) -> Placed | None:
        return self.wall(thing) if self.chance(0.5) else self.floor(thing)

    def hang(self, thing: Thing, z: float, above: Placed | None = None) -> Placed | None:
        """Put on a wall, at this height, over what stands there."""
        if z + thing.high[2] > self.size[2] - 0.03:
            return None
        over = None if above is None else (above.side, above.along + self.rng.normal(0, 0.12))
        return self.wall(thing, 0.001, z, over if over and over[0] >= 0 else None)

    def fill(
        self,
        base: Placed | None,
        makers: Sequence[Maker],
        low: int,
        high: int,
        place: Place | None = None,
        touch: float = 0.3,
        stack: float = 0.35,
    ) -> None:
        """Put so many things on another one, some beside each other, at times touching, some upon each other."""
        if base is None or not base.thing.places:
            return
        rng, place = self.rng, place or base.thing.places[0]
        done: list[tuple[np.ndarray, float, Thing]] = []
        for _ in range(self.count(low, high)):
            for _try in range(8):
                thing = self.one(makers)
                yaw = rng.normal(0, 0.12) if self.chance(0.75) else rng.uniform(-np.pi, np.pi)
                neighbour = done[int(rng.integers(len(done)))] if done and self.chance(touch) else None
                if neighbour:
                    yaw = neighbour[1]
                c, s = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
                half = np.array([[c, s], [s, c]]) @ thing.size[:2] / 2
                low_xy = np.array([place.x0, place.y0]) + half
                high_xy = np.array([place.x1, place.y1]) - half
                if thing.size[2] > place.clear - 0.01 or (low_xy > high_xy).any():
                    continue
                middle = self._beside(*neighbour, thing) if neighbour else rng.uniform(low_xy, high_xy)
                if (middle < low_xy).any() or (middle > high_xy).any():
                    continue
                found = self._centred(base, thing, middle, yaw, place.z)
                if found:
                    done.append((middle, yaw, thing))
                    self.stack(found, makers, place.clear - thing.size[2], stack)
                    break

    def _centred(self, base: Placed, thing: Thing, middle: np.ndarray, yaw: float, z: float) -> Placed | None:
        """Put with the middle of its plan there."""
        x, y = middle - _spun(yaw, *((thing.low + thing.high) / 2)[:2])
        return self.near(base, thing, x, y, yaw, z)

    def _beside(self, middle: np.ndarray, yaw: float, other: Thing, thing: Thing) -> np.ndarray:
        """Where a thing's middle is beside another's, at most 2 cm away."""
        rng, axis = self.rng, int(self.rng.integers(2))
        gap = 0.0015 if self.chance(0.6) else rng.uniform(0.002, 0.02)
        off = rng.normal(0, 0.015, 2)
        off[axis] = rng.choice((-1, 1)) * ((other.size[axis] + thing.size[axis]) / 2 + gap)
        return middle + _spun(yaw, *off)

    def stack(self, base: Placed, makers: Sequence[Maker], clear: float, share: float) -> None:
        """Something no larger on a thing that carries some, and perhaps on that one."""
        rng, below = self.rng, base.thing
        if not below.stacks or not self.chance(share):
            return
        place = below.places[0]
        like = t.book if below.kind == "book" else t.carton if below.kind == "box" and below.size[0] > 0.25 else None
        for _ in range(6):
            thing = like(rng) if like and self.chance(0.7) else self.one(makers)
            room = np.array([place.x1 - place.x0, place.y1 - place.y0]) * (1.15 if thing.kind == "book" else 1) + 0.02
            if thing.size[2] > min(clear, place.clear) - 0.02 or (thing.size[:2] > room).any():
                continue
            middle = np.array([place.x0 + place.x1, place.y0 + place.y1]) / 2 + rng.normal(0, 0.008, 2)
            found = self._centred(base, thing, middle, rng.normal(0, 0.2), place.z)
            if found:
                return self.stack(found, makers, clear - thing.size[2], 0.8 * share)

    def books(self, base: Placed, place: Place, low: int, high: int) -> None:
        """A row of standing books, the last ones often leaning."""
        rng, count = self.rng, self.count(low, high)
        x, last = rng.uniform(place.x0, max(place.x0, place.x1 - 0.05 * count)), 0.0
        for k in range(count):
            leans = max(2, count - 2) <= k and last > 0.16 and self.chance(0.6)
            thing = t.standing_book(rng, rng.uniform(0.08, 0.3) if leans else 0.0)
            spare = place.y1 - place.y0 - thing.size[1]
            if thing.size[2] > place.clear - 0.01 or spare < 0:
                continue
            if x + thing.size[0] > place.x1:
                return
            y = place.y1 - thing.high[1] - (rng.uniform(0.005, 0.03) if spare > 0.03 else 0.0)
            if self.near(base, thing, x - thing.low[0], y, 0, place.z):
                x += thing.size[0] + (0.0004 if self.chance(0.9) else rng.uniform(0.002, 0.02))
                last = thing.size[2]

    # The shell

    def _fixed(self, side: int, along: float, parts: Sequence[Mesh]) -> list[Mesh]:
        yaw, at = self.wall_pose(side, along, 0.0)
        return [m.turned(part, yaw, "z", at) for part in parts]

    def _door(self) -> None:
        side = int(self.rng.integers(4))
        along = self.rng.uniform(0.6, self.size[side % 2] - 0.6)
        parts = [bar(0.84, 0.035, 2.02, 0, 0.0075), bar(0.07, 0.035, 0.03, 0.36, 0.04, 1)]
        self.shell += self._fixed(side, along, parts)
        kept = Block(-0.42, 0.42, 0, 0.7, 0, 2.02)
        self.boxes = np.concatenate([self.boxes, _boxes([kept], *self.wall_pose(side, along, 0.0))])

    def _window(self) -> None:
        """A window with its sill, at times with curtains and a radiator."""
        rng, side = self.rng, int(self.rng.integers(4))
        w, z0, z1 = rng.uniform((0.8, 0.75, 1.9), (1.5, 1.0, 2.2))
        along = rng.uniform(w / 2 + 0.2, self.size[side % 2] - w / 2 - 0.2)
        kept = Block(-w / 2 - 0.06, w / 2 + 0.06, 0, 0.135, z0 - 0.08, z1 + 0.05)
        boxes = _boxes([kept], *self.wall_pose(side, along, 0.0))
        if _meet(boxes, self.boxes):
            return
        if self.chance(0.5):
            for x in (-w / 2 - 0.1, w / 2 + 0.1):
                self.wall(t.curtain(rng, z1 + 0.09), 0.04, 0.03, (side, along + x))
        if self.chance(0.4):
            self.wall(m.radiator(rng), 0.03, 0.0, (side, along))
        self.boxes = np.concatenate([self.boxes, boxes])
        frame = [bar(0.04, 0.03, z1 - z0 + 0.08, x, 0.015, z0 - 0.04) for x in (-w / 2 - 0.02, 0, w / 2 + 0.02)]
        frame += [bar(w, 0.03, 0.04, 0, 0.015, z) for z in (z0 - 0.04, z1)]
        self.shell += self._fixed(side, along, [*frame, bar(w + 0.1, 0.12, 0.03, 0, 0.06, z0 - 0.07)])
        self.panes += self._fixed(side, along, [bar(w, 0.016, z1 - z0, 0, -0.002, z0)])
