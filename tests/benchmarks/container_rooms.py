"""Rooms with open containers, and things in them: "in" is rare in the rooms as they are."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from pipeline.synthetic import Instance, Room
from pipeline.synthetic import decor as c
from pipeline.synthetic import furniture as f
from pipeline.synthetic import objects as o
from pipeline.synthetic.layout import Layout
from pipeline.synthetic.model import PALETTES, Material, ObjectModel, Palette, RestSurface, assemble, block, cloth, wood

Rng = np.random.Generator
Maker = Callable[[Palette, Rng], ObjectModel]

CONTAINERS = ("crate", "drawer", "suitcase", "trunk", "hamper", "cart", "briefcase", "basket")
"""One of each in a room, so that a sentence can mean just one: half of them on furniture where there is room, the
others on the floor."""
CONTENTS = 3
STANDS = ("desk", "dining table", "coffee table", "cabinet", "bed", "wardrobe")
WALL = 0.014
CONTENT: tuple[Maker, ...] = (
    o.book,
    o.book,
    o.mug,
    o.bottle,
    o.bowl,
    o.mouse,
    c.candle,
    c.teapot,
    c.toy_ball,
    c.alarm_clock,
    c.teddy_bear,
    f.throw_pillow,
    lambda p, rng: c.plant(p, rng, 0.28),
)


def container(label: str, p: Palette, rng: Rng) -> ObjectModel:
    """An open container: a bottom and four walls."""
    kinds = (wood(p, rng), cloth(p.accents[0]), Material((0.55, 0.32, 0.12), ("basket",), 0.13))
    material = kinds[int(rng.integers(len(kinds)))]
    w, d, h = rng.uniform(0.40, 0.58), rng.uniform(0.32, 0.42), rng.uniform(0.11, 0.20)
    parts = [block((w, d, WALL), (0, 0, 0), material, 0.003)]
    parts += [block((WALL, d, h - WALL), (s * (w - WALL) / 2, 0, WALL), material, 0.003) for s in (-1, 1)]
    inner = w - 2 * WALL
    parts += [block((inner, WALL, h - WALL), (0, s * (d - WALL) / 2, WALL), material, 0.003) for s in (-1, 1)]
    gap = WALL + 0.003
    return assemble(label, parts, [RestSurface(WALL, -w / 2 + gap, w / 2 - gap, -d / 2 + gap, d / 2 - gap)])


def inside(room: Room, k: int) -> bool:
    """Whether an instance stands in what it stands on: in a container, or on a board between the sides of a shelf."""
    own = room.instances[k]
    if own.support < 0:
        return False
    base = room.instances[own.support]
    holds = base.model.label == "bookshelf" or base.model.label in CONTAINERS
    return holds and own.position[2] < base.position[2] + base.model.high[2] - 0.05


def without(room: Room, labels: Collection[str]) -> Room:
    """The room without the things of these classes; what stood on them goes too."""
    kept: dict[int, int] = {}
    instances: list[Instance] = []
    for k, instance in enumerate(room.instances):
        if instance.model.label in labels or (instance.support >= 0 and instance.support not in kept):
            continue
        kept[k] = len(instances)
        support = kept[instance.support] if instance.support >= 0 else instance.support
        instances.append(replace(instance, support=support))
    return replace(room, instances=tuple(instances))


def with_containers(room: Room, seed: int, leave_out: Collection[str] = ()) -> Room:
    """The room and containers with contents on its floor and its furniture; equal seeds give equal rooms."""
    rng = np.random.default_rng([seed, 29])
    p = PALETTES[int(rng.integers(len(PALETTES)))]
    layout = Layout(room.width, room.depth, room.height, rng)
    for k, instance in enumerate(room.instances):
        layout.add(instance.model, instance.position, instance.yaw, instance.support)
        if instance.model.label == "rug":
            layout.rugs.append(k)
    stands = [k for k, i in enumerate(room.instances) if i.model.label in STANDS and i.model.surfaces]
    for k, label in enumerate(rng.permutation(CONTAINERS)):
        made, index = container(str(label), p, rng), None
        if k % 2 and stands:
            stand = stands[int(rng.integers(len(stands)))]
            index = layout.put(made, stand, yaw=float(rng.uniform(-0.4, 0.4)))
        if index is None:
            x, y = rng.uniform(0.6, room.width - 0.6), rng.uniform(0.6, room.depth - 0.6)
            index = layout.stand_near(made, x, y, float(rng.uniform(-np.pi, np.pi)))
        for _ in range(CONTENTS):
            thing = CONTENT[int(rng.integers(len(CONTENT)))](p, rng)
            if thing.label not in leave_out:
                layout.put(thing, index, yaw=float(rng.uniform(-np.pi, np.pi)))
    return replace(room, instances=tuple(layout.instances))
