"""Four kinds of room, furnished by rule and seed: study, dining room, living room, bedroom."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from pipeline.synthetic import decor as c
from pipeline.synthetic import furniture as f
from pipeline.synthetic import objects as o
from pipeline.synthetic.layout import Focus, Layout, Room, build_shell, window_opening
from pipeline.synthetic.model import PALETTES, ModelPart, ObjectModel, Palette, RestSurface, assemble
from pipeline.system.errors import require

KINDS = ("study", "dining room", "living room", "bedroom")


def make_room(seed: int) -> Room:
    """Make the furnished room of a seed, of kind `KINDS[seed % 4]`. Equal seeds give equal rooms.

    Raises
    ------
    InputError
        The seed is negative.

    Examples
    --------
    >>> from pipeline.synthetic import make_room
    >>> room = make_room(0)
    >>> room.kind, room.instances[0].model.label
    ('study', 'desk')
    """
    require(seed >= 0, "a seed must not be negative", got=seed)
    rng = np.random.default_rng([seed, 7])
    kind = KINDS[seed % 4]
    # The first four seeds are the demo's; each has a colour scheme of its own.
    palette = PALETTES[seed if seed < len(KINDS) else int(rng.integers(len(PALETTES)))]
    width, depth = rng.uniform(4.3, 4.7), rng.uniform(4.3, 4.7)
    height = 2.65
    room = Layout(width, depth, height, rng)
    furnish = {"study": _study, "dining room": _dining, "living room": _living, "bedroom": _bedroom}[kind]
    focuses = furnish(room, palette)
    window = (depth * rng.uniform(0.46, 0.54), 1.5)
    shell = build_shell(palette, rng, width, depth, height, window, ("front", width * 0.72))
    azimuth, elevation = np.deg2rad(rng.uniform(-28, 24)), np.deg2rad(rng.uniform(30, 40))
    sun = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    opening = window_opening(window)
    return Room(seed, kind, width, depth, height, shell, tuple(room.instances), focuses, sun, opening)


def _focus(x: float, y: float, z: float, heading_deg: float, spread_deg: float, near: float, far: float) -> Focus:
    return Focus(np.array([x, y, z]), np.deg2rad(heading_deg), np.deg2rad(spread_deg), near, far)


def _turn(room: Layout, degrees: float) -> float:
    return float(np.deg2rad(room.rng.uniform(-degrees, degrees)))


Row = tuple[Any, ...]
"""How a thing is placed (a method of the layout), what makes it, where, and what else its making is told."""


def _place(room: Layout, p: Palette, *rows: Row) -> None:
    """Make and place things in turn; functions among the places are called on their turn, and draw numbers."""
    for how, make, where, *more in rows:
        how(make(p, room.rng, *more), *(w() if callable(w) else w for w in where))


def _book_pile(
    room: Layout, p: Palette, on: int | None, at: tuple[float, float], count: int, surface: int = 0
) -> int | None:
    """Books lying in a pile, largest lowest; returns the top book."""
    books = sorted((o.book(p, room.rng) for _ in range(count)), key=lambda b: -float(b.size[0]))
    top = room.put(books[0], on, at, _turn(room, 14), surface)
    for book in books[1:]:
        top = room.stack(book, top, _turn(room, 9))
    return top


def _study(room: Layout, p: Palette) -> tuple[Focus, ...]:
    rng, w, d = room.rng, room.width, room.depth
    put, near, turn = room.put, room.stand_near, partial(partial, _turn, room)
    x = w * 0.42
    table = room.against(f.desk(p, rng), "back", x, 0.02)
    _place(
        room,
        p,
        (near, c.plant, (0.40, d - 0.42, 0.4, 0.05), 1.15),
        (put, o.laptop, (table, (-0.08, 0.05), turn(5))),
        (put, o.mug, (table, (-0.50, -0.20), turn(40)), p.accents[0]),
        (put, o.mug, (table, (0.38, -0.30), turn(40)), p.accents[1]),
        (put, c.desk_lamp, (table, (-0.80, 0.60))),
    )
    _book_pile(room, p, table, (0.72, 0.30), 3)
    _place(
        room,
        p,
        (put, o.bottle, (table, (0.42, 0.70))),
        (put, o.mouse, (table, (0.21, -0.25), turn(10))),
        (put, c.plant, (table, (-0.42, 0.75)), 0.30),
    )
    furnish_wall_shelf(room, p, room.hang(stocked_wall_shelf(p, rng), "back", x - 0.25, 1.42))
    room.hang(c.picture(p, rng, 0.44, 0.58), "back", x + 0.62, 1.25)
    seat = room.stand_near(f.office_chair(p, rng), x + 1.00, d - 1.32, np.pi + np.deg2rad(rng.uniform(30, 60)), 0.06)
    _place(
        room,
        p,
        (near, c.trash_can, (x - 0.95, d - 0.85, 0, 0.04)),
        (near, c.box, (x - 0.15, d - 0.36, turn(8), 0.05)),
    )
    tall = room.against(stocked_bookshelf(p, rng), "back", w - 0.62, 0.02)
    furnish_bookshelf(room, p, tall)
    room.put(c.plant(p, rng, 0.36), tall, (-0.4, 0.0), surface=0)
    room.lay_rug(f.rug(p, rng, 1.5, 1.5), w * 0.58, d * 0.42)
    arm = room.stand_near(f.armchair(p, rng), w * 0.77, d * 0.50, -np.pi / 2 + 0.35, 0.1)
    room.put(f.throw_pillow(p, rng), arm, (0.0, 0.9), _turn(room, 6))
    stool = room.stand_near(f.stool(p, rng), w * 0.60, d * 0.35, 0.2)
    _book_pile(room, p, stool, (0, 0), 2)
    _place(
        room,
        p,
        (near, c.backpack, (x - 1.05, d - 1.35, lambda: np.deg2rad(rng.uniform(-40, -10)), 0.1)),
        (near, c.floor_lamp, (w - 0.40, d * 0.70, 0, 0.1)),
    )
    chest = room.against(f.cabinet(p, rng, 1.1), "left", d * 0.42)
    _place(room, p, (put, o.vase, (chest, (-0.6, 0.1))), (put, c.basket, (chest, (0.55, 0.0))))
    room.put(c.clock(p, rng), chest, None) if seat is None else room.hang(c.clock(p, rng), "left", d * 0.42, 1.55)
    room.hang(c.picture(p, rng, 0.6, 0.45), "front", w * 0.3, 1.35)
    return (
        _focus(x + 0.05, d - 0.45, 0.78, 90, 9, 1.45, 1.75),
        _focus(w * 0.34, d * 0.70, 0.60, 122, 12, 2.2, 3.2),
        _focus(w * 0.50, d * 0.60, 0.60, 24, 8, 2.0, 2.8),
        _focus(w * 0.40, d * 0.60, 0.60, 165, 10, 2.2, 3.0),
    )


def _dining(room: Layout, p: Palette) -> tuple[Focus, ...]:
    rng, w, d = room.rng, room.width, room.depth
    put, near, hang, turn = room.put, room.stand_near, room.hang, partial(partial, _turn, room)
    x, y = w * 0.47, d * 0.53
    room.lay_rug(f.rug(p, rng, 2.45, 2.3), x, y)
    table = room.stand(f.dining_table(p, rng), x, y)
    model = f.chair(p, rng)
    for dx, side, out in ((-0.36, 1, 0.63), (0.38, 1, 0.66), (-0.38, -1, 0.64), (0.42, -1, 0.82)):
        yaw = (0.0 if side > 0 else np.pi) + _turn(room, 10)
        room.stand_near(model, x + dx, y + side * out, yaw, 0.04)
    _place(room, p, (put, o.bowl, (table, (-0.05, 0.15))), (put, o.vase, (table, (0.28, 0.2))))
    cup = o.mug(p, rng, p.accents[0])
    for k, (u, v) in enumerate(((-0.46, 0.52), (0.55, 0.50), (-0.28, -0.55))):
        room.put(cup if k == 0 else o.mug(p, rng, p.accents[k]), table, (u, v), _turn(room, 60))
    _place(
        room,
        p,
        *((put, o.plate, (table, at)) for at in ((-0.62, 0.55), (0.42, -0.55), (-0.5, -0.60))),
        (put, o.bottle, (table, (0.06, 0.35))),
        (put, c.teapot, (table, (0.66, 0.0), turn(50))),
        (near, c.trash_can, (x - 1.62, y + 0.15, 0, 0.04)),
        (near, c.box, (x + 0.05, y + 0.02, 0.3, 0.05)),
    )
    side = room.against(f.cabinet(p, rng, 1.55, 0.80), "back", w * 0.47)
    _place(
        room,
        p,
        (put, c.teapot, (side, (-0.72, 0.1), 0.5)),
        (put, c.lamp, (side, (0.78, 0.1))),
        (put, c.basket, (side, (0.35, 0.0))),
        (put, o.bottle, (side, (-0.34, 0.1))),
    )
    _book_pile(room, p, side, (0.0, 0.0), 3)
    _place(
        room,
        p,
        *((hang, c.picture, ("back", w * 0.47 + out, 1.32), 0.52, 0.68) for out in (-0.36, 0.36)),
        (near, c.plant, (0.48, d - 0.50, 1.0), 1.2),
    )
    tall = room.against(stocked_bookshelf(p, rng), "back", w - 0.56)
    furnish_bookshelf(room, p, tall)
    _place(
        room,
        p,
        (put, c.candle, (side, (0.12, -0.5))),
        (put, c.candle, (side, (0.18, 0.3))),
        (near, c.plant, (0.45, d * 0.24, 0.6), 0.95),
        (hang, c.clock, ("left", d * 0.60, 1.55)),
        (near, f.stool, (w - 0.50, d * 0.40)),
        (near, c.basket, (w - 0.45, d * 0.66, 0.3)),
        (near, c.plant, (w - 0.5, d * 0.18, 1.0), 0.8),
    )
    return (
        _focus(x - 0.05, y + 0.2, 0.62, 90, 8, 2.3, 2.7),
        _focus(x, y + 0.25, 0.62, 58, 12, 2.4, 3.2),
        _focus(x, y + 0.05, 0.62, 154, 10, 2.2, 3.0),
        _focus(x, y + 0.10, 0.62, 18, 10, 2.2, 3.0),
    )


def _living(room: Layout, p: Palette) -> tuple[Focus, ...]:
    rng, w, d = room.rng, room.width, room.depth
    put, near, hang, turn = room.put, room.stand_near, room.hang, partial(partial, _turn, room)
    x = w * 0.46
    couch = room.stand(f.sofa(p, rng), x, d - 1.26)
    _place(
        room,
        p,
        *((put, f.throw_pillow, (couch, (u, 0.95), turn(7))) for u in (-0.82, -0.35, 0.72)),
        (put, c.teddy_bear, (couch, (0.28, 0.4), turn(10))),
        (put, o.book, (couch, (-0.60, -0.9), 0.3)),
        (near, c.plant, (x - 0.72, d - 0.42, 0.0, 0.02), 1.3),
        (near, c.floor_lamp, (x + 0.95, d - 0.30, 0, 0.05)),
        (near, c.box, (x + 0.25, d - 0.30, 0.05, 0.05)),
        (hang, c.picture, ("back", x - 0.1, 1.22), 0.62, 0.80),
        (hang, c.picture, ("back", x + 0.58, 1.52), 0.36, 0.46),
    )
    room.lay_rug(f.rug(p, rng, 1.8, 1.5), x, d - 2.50)
    low = room.stand(f.coffee_table(p, rng), x, d - 2.36)
    top = _book_pile(room, p, low, (-0.45, 0.2), 2)
    _place(
        room,
        p,
        (room.stack, c.candle, (top,)),
        (put, o.mug, (low, (0.10, -0.45), turn(60))),
        (put, o.mug, (low, (0.62, 0.10), turn(60))),
        (put, o.bowl, (low, (0.3, 0.5))),
        (near, c.toy_ball, (x - 0.85, d - 2.75, 0.5)),
    )
    stand = room.against(f.cabinet(p, rng, 1.55, 0.52), "left", d * 0.44)
    _place(
        room,
        p,
        (put, o.tv, (stand, (0.0, 0.4))),
        (put, o.vase, (stand, (-0.90, -0.2))),
        (put, c.candle, (stand, (0.92, -0.1))),
    )
    arm = room.stand_near(f.armchair(p, rng), x + 1.64, d - 2.45, np.deg2rad(-76), 0.05)
    room.put(f.throw_pillow(p, rng), arm, (0, 0.9), _turn(room, 8))
    tall = room.against(stocked_bookshelf(p, rng), "back", w - 0.56)
    furnish_bookshelf(room, p, tall)
    room.stand_near(c.basket(p, rng), x - 1.45, d - 1.55, 0.2, 0.1)
    stool = room.stand_near(f.stool(p, rng), x + 1.42, d - 1.35, 0.3, 0.06)
    _place(
        room,
        p,
        (put, o.mug, (stool, (0, 0))),
        (near, c.trash_can, (0.35, d * 0.70, 0, 0.08)),
        (near, c.plant, (0.42, d * 0.14, 0.8), 0.9),
        (hang, c.clock, ("left", d * 0.72, 1.65)),
        (hang, c.picture, ("front", w * 0.28, 1.3), 0.5, 0.65),
    )
    return (
        _focus(x + 0.1, d - 1.75, 0.50, 90, 10, 2.3, 2.7),
        _focus(x - 0.35, d - 1.75, 0.52, 132, 12, 2.2, 3.2),
        _focus(x + 0.15, d - 1.95, 0.48, 24, 8, 2.0, 2.7),
        _focus(x - 0.5, d - 2.2, 0.5, 172, 12, 2.0, 3.0),
    )


def _bedroom(room: Layout, p: Palette) -> tuple[Focus, ...]:
    rng, w, d = room.rng, room.width, room.depth
    put, near, turn = room.put, room.stand_near, partial(partial, _turn, room)
    x = w * 0.53
    place = room.against(f.bed(p, rng), "back", x)
    half = 0.0 if place is None else float(room.instances[place].model.size[0]) / 2
    _place(
        room,
        p,
        (put, f.bed_pillow, (place, (-0.52, 0.1), turn(4))),
        (put, f.bed_pillow, (place, (0.52, 0.1), turn(4))),
        (put, c.teddy_bear, (place, (0.05, 0.55), turn(12), 1)),
        (put, o.book, (place, (-0.45, 0.2), 0.4, 1)),
    )
    room.put(c.backpack(p, rng), place, None, 0.3, surface=1) if rng.random() < 0.2 else None
    stand = f.nightstand(p, rng)
    for s in (-1, 1):
        spot = room.against(stand, "back", x + s * (half + 0.36))
        room.put(c.lamp(p, rng), spot, (0.1 * s, 0.35))
        clock = (put, c.alarm_clock, (spot, (0.6, -0.5), 0.2)), (put, o.mug, (spot, (-0.55, -0.55), turn(60)))
        _place(room, p, *(clock if s < 0 else [(put, o.book, (spot, (-0.5, -0.7), 0.2))]))
    room.hang(c.picture(p, rng, 0.9, 0.6), "back", x, 1.32)
    room.lay_rug(f.rug(p, rng, 0.70, 1.7), x - half - 0.46, d - 1.60)
    closet = room.against(f.wardrobe(p, rng), "left", d - 1.15)
    room.stand_near(c.basket(p, rng), 0.55, d - 0.32, 0.2, 0.06)
    room.put(c.box(p, rng), closet, (0.3, 0.0))
    table = room.against(f.desk(p, rng), "left", d * 0.30)
    _place(
        room,
        p,
        (put, o.laptop, (table, (0.0, 0.0), turn(8))),
        (put, o.mug, (table, (-0.5, -0.1), turn(50))),
        (put, o.mug, (table, (0.45, -0.3), turn(50))),
        (put, c.desk_lamp, (table, (0.8, 0.5))),
    )
    _book_pile(room, p, table, (-0.8, 0.4), 3)
    _place(
        room,
        p,
        (near, f.chair, (1.12, d * 0.30, np.deg2rad(-105), 0.05)),
        (near, c.trash_can, (0.38, d * 0.30 + 1.0, 0, 0.06)),
        (near, c.toy_ball, (x - half - 0.55, d - 2.25, 0.3, 0.1)),
        (near, c.backpack, (x - half - 0.28, d - 2.45, np.deg2rad(-30), 0.08)),
    )
    stool = room.stand_near(f.stool(p, rng), x + 0.25, d - 2.55, 0.2, 0.1)
    _book_pile(room, p, stool, (0, 0), 2)
    _place(
        room,
        p,
        (near, c.plant, (w - 0.45, d - 1.35, 0.3), 1.2),
        (near, c.box, (x + half + 0.35, d - 1.0, 0.1, 0.1)),
    )
    chest = room.against(f.cabinet(p, rng, 1.1, 0.78), "right", d * 0.27)
    _place(
        room,
        p,
        (put, c.plant, (chest, (-0.6, 0.1)), 0.4),
        (put, o.vase, (chest, (0.6, 0.0))),
        (put, c.teapot, (chest, (0.0, 0.0), 0.4)),
    )
    room.hang(c.clock(p, rng), "left", d * 0.32, 1.6)
    return (
        _focus(x - 0.1, d - 1.15, 0.55, 90, 12, 2.4, 2.9),
        _focus(x - 0.1, d - 1.25, 0.55, 62, 12, 2.3, 3.2),
        _focus(w * 0.40, d * 0.52, 0.55, 158, 10, 2.0, 3.0),
        _focus(x - 0.35, d - 1.30, 0.55, 122, 14, 2.4, 3.3),
    )


Rng = np.random.Generator
FREE_M = 0.30
"""Width that a row of books leaves free on its board."""
THINGS = 3
"""Boards of a bookshelf that hold something of its own beside their books; one more holds a lying book."""


def stocked_bookshelf(p: Palette, rng: Rng) -> ObjectModel:
    """A bookshelf with rows of books as parts. Its surfaces are the top, then what the books leave free of each board
    from the lowest up. The books of one board end in a lying pile."""
    empty = f.bookshelf(p, rng)
    top, *boards = empty.surfaces
    piled = int(rng.integers(1, len(boards) - 1))
    parts, free = list(empty.parts), [top]
    for k, board in enumerate(boards):
        row, rest = _book_row(p, rng, board, int(rng.integers(7, 14)), FREE_M, 0.004, 0.03, bool(k % 2))
        parts += row
        if k == piled:
            parts += _lying_pile(p, rng, rest)
        else:
            free.append(rest)
    return assemble(empty.label, parts, free)


def stocked_wall_shelf(p: Palette, rng: Rng) -> ObjectModel:
    """A wall shelf with a short row of books as parts; the surface is the free rest."""
    empty = f.wall_shelf(p, rng)
    row, rest = _book_row(p, rng, empty.surfaces[0], 5, FREE_M, 0.05, 0.005, False)
    return assemble(empty.label, [*empty.parts, *row], [rest])


def furnish_bookshelf(room: Layout, p: Palette, shelf: int | None) -> None:
    """Put a different thing on each of most boards, and a book on another."""
    if shelf is None:
        return
    rng = room.rng
    things: list[ObjectModel] = [
        c.plant(p, rng, 0.26),
        o.bowl(p, rng),
        c.candle(p, rng),
        c.teapot(p, rng),
        c.alarm_clock(p, rng),
        o.bottle(p, rng),
    ]
    waiting = [things[k] for k in rng.permutation(len(things))]
    boards = 1 + rng.permutation(len(room.instances[shelf].model.surfaces) - 1)
    for surface in boards[:THINGS]:
        # A bowl or a plant may be too wide for what the books left.
        for thing in waiting:
            if room.put(thing, shelf, (0.0, 0.0), surface=int(surface)) is not None:
                waiting.remove(thing)
                break
    for surface in boards[THINGS:]:
        if room.put(o.book(p, rng), shelf, (0.0, 0.0), surface=int(surface)) is not None:
            break


def furnish_wall_shelf(room: Layout, p: Palette, shelf: int | None) -> None:
    """Put a small plant and a candle next to the books."""
    room.put(c.plant(p, room.rng, 0.24), shelf, (-0.25, 0.0))
    room.put(c.candle(p, room.rng), shelf, (0.75, 0.0))


def _book_row(
    p: Palette, rng: Rng, board: RestSurface, most: int, keep: float, start: float, back: float, from_right: bool
) -> tuple[list[ModelPart], RestSurface]:
    """Up to `most` upright books along a board from an end. They begin `start` from that end, stand `back` from the
    board's rear edge and leave at least `keep` metres free, which is the second result."""
    parts: list[ModelPart] = []
    reach = start
    for _ in range(most):
        book = o.standing_book(p, rng, min(0.27, board.room - 0.02))
        thick, deep, _ = book.size
        if board.x0 + reach + thick > board.x1 - keep:
            break
        x = board.x1 - reach - thick / 2 if from_right else board.x0 + reach + thick / 2
        parts += [part.moved((x, board.y1 - deep / 2 - back, board.z)) for part in book.parts]
        reach += float(thick) + 0.002
    gap = reach + 0.01
    x0, x1 = (board.x0, board.x1 - gap) if from_right else (board.x0 + gap, board.x1)
    return parts, RestSurface(board.z, x0, x1, board.y0, board.y1, board.room)


def _lying_pile(p: Palette, rng: Rng, place: RestSurface) -> list[ModelPart]:
    """Three books lying on each other in the middle of a place, the widest lowest."""
    x, z = (place.x0 + place.x1) / 2, place.z
    parts: list[ModelPart] = []
    for book in sorted((o.book(p, rng) for _ in range(3)), key=lambda model: -float(model.size[0])):
        parts += [part.moved((x, (place.y0 + place.y1) / 2, z)) for part in book.parts]
        z += float(book.size[2])
    return parts
