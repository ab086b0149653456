"""Furnished rooms and table tops for measuring: what stands where, of house_models.py and house_things.py."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from benchmarks import house_models as m
from benchmarks import house_things as t
from benchmarks.house_models import Maker, Place, Rng, Thing, rod
from benchmarks.house_space import House, Placed

DINING: Sequence[Maker] = (
    t.mug,
    t.glass,
    t.bottle,
    t.bowl,
    t.plate,
    t.plate,
    t.apple,
    t.banana,
    t.teapot,
    t.vase,
    t.candle,
    t.tray,
    t.jar,
    t.small_box,
)
DESK: Sequence[Maker] = (
    t.mug,
    t.book,
    t.book,
    t.phone,
    t.pen_cup,
    t.desk_lamp,
    t.tissue_box,
    t.small_box,
    t.photo,
    t.can,
    t.speaker,
    t.bottle,
    t.small_plant,
    t.printer,
)
LIVING: Sequence[Maker] = (
    t.book,
    t.remote,
    t.mug,
    t.bowl,
    t.vase,
    t.candle,
    t.glass,
    t.photo,
    t.small_box,
    t.table_lamp,
    t.radio,
    t.teddy,
    t.small_plant,
    t.tissue_box,
)
KITCHEN: Sequence[Maker] = (
    t.kettle,
    t.toaster,
    t.microwave,
    t.pot,
    t.pot,
    t.jar,
    t.jar,
    t.bottle,
    t.cereal_box,
    t.bowl,
    t.plate,
    t.can,
    t.mug,
    t.tray,
    t.apple,
)
NIGHT: Sequence[Maker] = (t.table_lamp, t.table_lamp, t.alarm_clock, t.book, t.glass, t.phone, t.photo, t.candle)
SHELF: Sequence[Maker] = (
    t.vase,
    t.small_box,
    t.photo,
    t.speaker,
    t.jar,
    t.radio,
    t.teddy,
    t.small_plant,
    t.bowl,
    t.alarm_clock,
    t.bottle,
    t.candle,
)
HIGH_UP: Sequence[Maker] = (t.carton, t.small_box, t.vase, t.small_plant, t.basket, t.radio)
FLOOR: Sequence[Maker] = (
    t.carton,
    t.carton,
    t.wastebasket,
    t.suitcase,
    t.backpack,
    t.ball,
    t.basket,
    t.shoes,
    m.stool,
    t.plant,
    t.handbag,
    t.teddy,
)
STORES: Sequence[Maker] = (m.bookshelf, m.bookshelf, m.bookshelf, m.drawers, m.cupboard)
LEANING: Sequence[Maker] = (t.guitar, t.board, t.broom, t.ladder)


def _some(house: House, makers: Sequence[Maker], share: float) -> None:
    """Each with this chance, at a wall."""
    for maker in makers:
        if house.chance(share):
            house.wall(maker(house.rng))


def _seats(house: House, table: Placed | None, low: int, high: int) -> None:
    """Chairs at a table, most of a kind, each facing it, more or less pulled out."""
    if table is None:
        return
    rng, (hx, hy) = house.rng, table.thing.size[:2] / 2
    alike = int(rng.integers(1 << 30)) if house.chance(0.7) else None
    ends = [(x, 0.0) for x in (-1.0, 1.0)]
    slots = ends + [(x, y) for y in (-1.0, 1.0) for x in ([0.0] if hx < 0.75 else [-hx / 2, hx / 2])]
    for k in rng.permutation(len(slots))[: house.count(low, high)]:
        x, y = slots[k]
        chair = m.chair(rng if alike is None else np.random.default_rng(alike))
        turn = rng.normal(0, 0.12 if house.chance(0.8) else 0.6)
        away = chair.high[1] + rng.uniform(-0.18, 0.28) + 0.06 * np.arange(6)
        for far in away:
            if y:
                at, yaw = (x, y * (hy + far)), np.pi if y > 0 else 0.0
            else:
                at, yaw = (x * (hx + far), 0.0), x * np.pi / 2
            if house.near(table, chair, *at, yaw + turn):
                break


def _at_desk(house: House, desk: Placed | None, dense: float = 1.0) -> None:
    """A screen or a laptop, what else is on desks, and a chair."""
    if desk is None:
        return
    rng, (x0, x1, y0, y1, z, _) = house.rng, desk.thing.places[0]
    draw = rng.random()
    if draw < 0.6:
        screen, second = t.monitor(rng), t.monitor(rng)
        y = y0 + 0.02 - screen.low[1] + rng.uniform(0, 0.08)
        house.near(desk, screen, rng.normal(0, 0.1), y, rng.normal(0, 0.12), z)
        beside = (screen.size[0] + second.size[0]) / 2 + 0.03
        if house.chance(0.25) and beside + second.size[0] / 2 < x1:
            house.near(desk, second, beside, y0 + 0.05 - second.low[1], -0.2, z)
        house.near(desk, t.keyboard(rng), rng.normal(0, 0.04), y1 - 0.14, rng.normal(0, 0.05), z)
        house.near(desk, t.mouse(rng), 0.3, y1 - 0.13, rng.normal(0, 0.2), z)
    elif draw < 0.9:
        house.near(desk, t.laptop(rng), rng.normal(0, 0.1), (y0 + y1) / 2 + 0.05, rng.normal(0, 0.15), z)
    house.fill(desk, DESK, 1, round(5 * dense))
    if house.chance(0.3):
        house.books(desk, Place(x0, x1, y0 + 0.005, y0 + 0.22, z, 0.5), 2, 5)
    chair = (m.office_chair if house.chance(0.65) else m.chair)(rng)
    for far in rng.uniform(-0.12, 0.3) + 0.08 * np.arange(6):
        if house.near(desk, chair, rng.normal(0, 0.12), y1 + far + 0.8 * chair.high[1], np.pi + rng.normal(0, 0.5)):
            break


def _shelved(house: House, shelf: Placed | None, dense: float = 0.75) -> None:
    """Books and things in a shelf's shelves and upon it."""
    if shelf is None:
        return
    for place in shelf.thing.places[:-1]:
        if house.chance(dense):
            if house.chance(0.55):
                house.books(shelf, place, 3, 8)
            house.fill(shelf, SHELF, 0, 2, place)
    upper = shelf.thing.places[-1]
    if upper.z < 2 and house.chance(0.5):
        house.fill(shelf, SHELF if upper.z < 1.5 else HIGH_UP, 1, 3, upper)


def _storing(house: House, thing: Thing, low: int, high: int, makers: Sequence[Maker] = SHELF) -> None:
    """What stores things, at a wall, with things in it or on it."""
    found = house.wall(thing)
    if found and found.thing.kind == "bookshelf":
        _shelved(house, found)
    elif found:
        house.fill(found, makers if found.thing.size[2] < 1.3 else HIGH_UP, low, high)


def _living(house: House) -> None:
    rng, sofa = house.rng, house.wall(m.sofa(house.rng))
    if sofa:
        seat, size = sofa.thing.places[0], sofa.thing.size
        for _ in range(house.count(0, 3)):
            _leant(house, sofa, t.cushion(rng), seat)
        if house.chance(0.3):
            house.fill(sofa, (t.handbag, t.teddy, t.book, t.laptop, t.remote), 1, 1)
        low = m.coffee_table(rng)
        off = size[1] / 2 + rng.uniform(0.3, 0.55) - low.low[1]
        house.fill(house.near(sofa, low, rng.normal(0, 0.15), off, rng.normal(0, 0.06)), LIVING, 1, 5)
        if house.chance(0.5):
            rug = m.rug(rng)
            house.near(sofa, rug, rng.normal(0, 0.1), (size[1] + rug.size[1]) / 2 + 0.05, rng.normal(0, 0.02))
        if house.chance(0.6):
            side = m.side_table(rng)
            x, y = rng.choice((-1, 1)) * ((size[0] + side.size[0]) / 2 + 0.04), (side.size[1] - size[1]) / 2 + 0.1
            house.fill(house.near(sofa, side, x, y, 0), NIGHT, 1, 2)
        if house.chance(0.5):
            house.hang(t.picture(rng), rng.uniform(1.2, 1.45), sofa)
    stand = house.wall(m.tv_stand(rng))
    if stand:
        house.near(stand, t.tv(rng), 0, rng.normal(0, 0.01), rng.normal(0, 0.05), stand.thing.places[0].z)
        house.fill(stand, (*SHELF, t.remote), 0, 3)
    for maker in (m.armchair, m.armchair, t.floor_lamp, t.plant):
        if house.chance(0.65):
            house.anywhere(maker(rng))
    for _ in range(house.count(0, 2)):
        _shelved(house, house.wall(m.bookshelf(rng)))


def _leant(house: House, base: Placed, cushion: Thing, seat: Place) -> None:
    """A cushion at the back of a seat."""
    rng = house.rng
    for _ in range(5):
        x = rng.uniform(seat.x0 + 0.02 - cushion.low[0], seat.x1 - 0.02 - cushion.high[0])
        y = seat.y0 - cushion.low[1] + abs(rng.normal(0, 0.02))
        if house.near(base, cushion, x, y, rng.normal(0, 0.1), seat.z):
            return


def _bedroom(house: House) -> None:
    rng, bed = house.rng, house.wall(m.bed(house.rng), 0.02)
    if bed:
        head, size = bed.thing.places[1], bed.thing.size
        for x in (-1, 1) if size[0] > 1.3 else (0,):
            pillow = t.pillow(rng)
            at = x * size[0] * 0.24 + rng.normal(0, 0.03), head.y0 - pillow.low[1]
            house.near(bed, pillow, *at, rng.normal(0, 0.08), head.z)
        house.fill(bed, (t.book, t.laptop, t.handbag, t.teddy, t.tray, t.lying_cushion), 0, 2)
        for x in (-1, 1):
            small = m.nightstand(rng)
            if house.chance(0.7):
                at = x * ((size[0] + small.size[0]) / 2 + 0.05), bed.thing.low[1] - small.low[1] + 0.05
                house.fill(house.near(bed, small, *at, 0), NIGHT, 1, 3)
        if house.chance(0.6):
            house.hang(t.picture(rng), rng.uniform(1.3, 1.5), bed)
        if house.chance(0.4):
            rug = m.rug(rng)
            house.near(bed, rug, rng.normal(0, 0.1), bed.thing.high[1] + rug.size[1] / 2 + 0.05, 0)
    for maker in (m.cupboard, m.drawers):
        if house.chance(0.7):
            _storing(house, maker(rng), 0, 3, (*SHELF, *NIGHT))
    if house.chance(0.7):
        _at_desk(house, house.wall(m.desk(rng)), 0.7)
    _some(house, (m.armchair, t.floor_lamp, t.plant, m.chair, t.suitcase), 0.4)


def _office(house: House) -> None:
    rng = house.rng
    for _ in range(house.count(1, 3)):
        desk = m.desk(rng)
        at_wall = house.chance(0.75)
        found = house.wall(desk) if at_wall else house.floor(desk, rng.integers(4) * np.pi / 2)
        _at_desk(house, found)
        if found and house.chance(0.4):
            house.hang((t.whiteboard if house.chance(0.3) else t.picture)(rng), rng.uniform(1.3, 1.5), found)
    for _ in range(house.count(1, 3)):
        _storing(house, house.one(STORES), 1, 3, DESK)
    _some(house, (t.plant, t.wastebasket, t.wastebasket, m.armchair, t.floor_lamp), 0.5)


def _kitchen(house: House) -> None:
    """A row along a wall, cupboards above it, and where one eats."""
    rng, side = house.rng, int(house.rng.integers(4))
    x, long, row = rng.uniform(0.05, 0.6), house.size[side % 2], []
    for k in range(5):
        draw = rng.random()
        outermost = k == 0 or x > long - 1.6
        thing = m.oven(rng) if draw < 0.2 else m.fridge(rng) if draw < 0.35 and outermost else m.counter(rng)
        if x + thing.size[0] > long - 0.02:
            break
        row.append(house.wall(thing, 0.004, 0.0, (side, x - thing.low[0])))
        x += thing.size[0] + 0.0015
    for found in filter(None, row):
        kind = found.thing.kind
        if kind == "kitchen counter":
            house.fill(found, KITCHEN, 1, 3)
        elif kind == "oven":
            house.fill(found, (t.pot,), 0, 2)
        elif house.chance(0.5):
            house.fill(found, (*HIGH_UP, t.microwave), 1, 1)
        if kind != "fridge" and house.chance(0.65):
            above = m.wall_cupboard(rng, found.thing.size[0])
            z = min(rng.uniform(1.38, 1.5), house.size[2] - above.size[2] - 0.02)
            house.wall(above, 0.002, z, (side, found.along))
    _dining(house)


def _dining(house: House) -> None:
    rng, table = house.rng, house.floor(m.table(house.rng), house.rng.integers(2) * np.pi / 2, middle=True)
    _seats(house, table, 2, 6)
    house.fill(table, DINING, 1, 7)
    if table and house.chance(0.5):
        lamp, z = t.ceiling_lamp(rng), rng.uniform(1.4, 1.75)
        found = house.near(table, lamp, rng.normal(0, 0.1), rng.normal(0, 0.1), 0, z)
        if found:
            (x, y, _), up = found.at, z + lamp.size[2]
            house.shell.append(rod(0.007, house.size[2] - up, x, y, up))
    for maker in (m.drawers, m.cupboard, m.bookshelf):
        if house.chance(0.5):
            _storing(house, maker(rng), 0, 3)
    _some(house, (t.plant,), 0.5)


def _storage(house: House) -> None:
    rng = house.rng
    for _ in range(house.count(2, 4)):
        found = house.wall(house.one(STORES))
        if found and found.thing.kind == "bookshelf":
            for place in found.thing.places:
                house.fill(found, (*SHELF, *[t.small_box] * 6, t.pot, t.jar), 0, 3, place)
        else:
            house.fill(found, HIGH_UP, 2, 2)
    if house.chance(0.6):
        house.fill(house.wall(m.workbench(rng)), (*DESK, *[t.small_box] * 3), 2, 6)
    for _ in range(house.count(3, 7)):
        _stacked(house, (t.carton, t.carton, t.small_box), 0.5)
    for maker in (t.ladder, t.broom, t.suitcase, t.suitcase):
        if house.chance(0.5):
            house.wall(maker(rng), 0.001 if maker in LEANING else None)


def _stacked(house: House, makers: Sequence[Maker], share: float) -> None:
    found = house.anywhere(t.carton(house.rng))
    if found:
        house.stack(found, makers, 1.2, share)


ROOMS: Sequence[Callable[[House], None]] = (_living, _bedroom, _office, _kitchen, _dining, _storage)


def _one_room(house: House) -> None:
    ROOMS[int(house.rng.integers(len(ROOMS)))](house)


def _on_walls(house: House) -> None:
    rng = house.rng
    for _ in range(house.count(0, 3)):
        draw = rng.random()
        if draw < 0.6:
            house.hang(t.picture(rng), rng.uniform(1.1, 1.5))
        elif draw < 0.75:
            house.hang(t.wall_clock(rng), rng.uniform(1.6, 1.9))
        elif draw < 0.85:
            house.hang(t.mirror(rng), rng.uniform(1.1, 1.5))
        else:
            shelf = house.hang(m.wall_shelf(rng), rng.uniform(1.15, 1.7))
            if shelf and house.chance(0.5):
                house.books(shelf, shelf.thing.places[0], 2, 4)
            house.fill(shelf, SHELF, 1, 3)


def _extras(house: House) -> None:
    """What hangs and leans on walls and lies about anywhere."""
    _on_walls(house)
    for _ in range(house.count(1, 4)):
        found = house.anywhere(house.one(FLOOR))
        if found and found.thing.kind == "box":
            house.stack(found, (t.carton, t.small_box, t.book), 1.2, 0.4)
    if house.chance(0.3):
        house.wall(house.one(LEANING), 0.001)


def furnished(rng: Rng) -> House:
    """A room of one kind, a large one at times of two."""
    house = House(rng)
    _one_room(house)
    if house.size[0] * house.size[1] > 14 and house.chance(0.6):
        _one_room(house)
    _extras(house)
    return house


def table_top(rng: Rng) -> tuple[House, list[Placed]]:
    """A room with much on one piece of furniture, and what is upon that."""
    house, draw = House(rng), rng.random()
    if draw < 0.35:
        base = house.floor(m.table(rng), rng.integers(2) * np.pi / 2, middle=True)
        makers = (*DINING, t.laptop, t.book, t.pot, t.cereal_box)
    elif draw < 0.6:
        base, makers = house.wall(m.desk(rng)), (*DESK, t.laptop, t.keyboard, t.mouse)
        if house.chance(0.5):
            _at_desk(house, base, 1.5)
    elif draw < 0.75:
        base, makers = house.wall(m.counter(rng, 1.0, 1.8)), KITCHEN
    elif draw < 0.85:
        base, makers = house.floor(m.coffee_table(rng), middle=True), LIVING
    elif draw < 0.93:
        base, makers = house.wall(m.drawers(rng)), (*SHELF, *NIGHT)
    else:
        base, makers = house.wall(m.tv_stand(rng)), (*LIVING, *SHELF)
    if base is None:
        return house, []
    place = base.thing.places[0]
    x0, x1, y0, y1, z, clear = place
    if house.chance(0.5):
        (x, y), far = rng.uniform((0.6 * x0, 0.5 * y0), (0.6 * x1, 0.5 * y1)), rng.uniform(0.25, 0.45)
        crowded = Place(max(x0, x - far), min(x1, x + far), max(y0, y - far), min(y1, y + far), z, clear)
        house.fill(base, makers, 5, 14, crowded, touch=0.4, stack=0.5)
    else:
        house.fill(base, makers, 5, 14, place, stack=0.5)
    if house.chance(0.2):
        house.books(base, Place(x0, x1, y0, min(y1, y0 + 0.25), z, 0.5), 2, 5)
    if base.thing.kind == "table":
        _seats(house, base, 0, 4)
    upon = [found for found in house.placed if found is not base and found.at[2] >= z - 0.01]
    if house.chance(0.7):
        _one_room(house)
    _extras(house)
    return house, upon
