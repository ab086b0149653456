"""Shelves that come stocked: rows and piles of books belong to the shelf, and room is left for other things."""

from __future__ import annotations

import numpy as np

from pipeline.datasets.synthetic import decor as c
from pipeline.datasets.synthetic import furniture as f
from pipeline.datasets.synthetic import objects as o
from pipeline.datasets.synthetic.layout import Layout
from pipeline.datasets.synthetic.model import Model, Part, Surface, assemble
from pipeline.datasets.synthetic.palettes import Palette

Rng = np.random.Generator

FREE_M = 0.30
"""Width that a row of books leaves free on its board."""

THINGS = 3
"""Boards of a bookshelf that hold something of its own beside their books; one more holds a lying book."""


def stocked_bookshelf(p: Palette, rng: Rng) -> Model:
    """A bookshelf whose rows of books are parts of it.

    Its surfaces are the top, then what the books leave free of each board from
    the lowest up. The books of one board end in a lying pile.
    """
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


def stocked_wall_shelf(p: Palette, rng: Rng) -> Model:
    """A wall shelf with a short row of books as parts of it; its surface is what they leave free."""
    empty = f.wall_shelf(p, rng)
    row, rest = _book_row(p, rng, empty.surfaces[0], 5, FREE_M, 0.05, 0.005, False)
    return assemble(empty.label, [*empty.parts, *row], [rest])


def furnish_bookshelf(room: Layout, p: Palette, shelf: int | None) -> None:
    """Put a few things of their own on the boards: something different on each of most, a book on one."""
    if shelf is None:
        return
    rng = room.rng
    things: list[Model] = [
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
    """A small plant and a candle beside the books."""
    room.put(c.plant(p, room.rng, 0.24), shelf, (-0.25, 0.0))
    room.put(c.candle(p, room.rng), shelf, (0.75, 0.0))


def _book_row(
    p: Palette, rng: Rng, board: Surface, most: int, keep: float, start: float, back: float, from_right: bool
) -> tuple[list[Part], Surface]:
    """Up to `most` upright books along a board from one of its ends.

    They begin `start` from that end, stand `back` from the board's rear edge
    and leave at least `keep` metres free, which is the second result.
    """
    parts: list[Part] = []
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
    return parts, Surface(board.z, x0, x1, board.y0, board.y1, board.room)


def _lying_pile(p: Palette, rng: Rng, place: Surface) -> list[Part]:
    """Three books lying on each other in the middle of a place, the widest lowest."""
    x, z = (place.x0 + place.x1) / 2, place.z
    parts: list[Part] = []
    for book in sorted((o.book(p, rng) for _ in range(3)), key=lambda model: -float(model.size[0])):
        parts += [part.moved((x, (place.y0 + place.y1) / 2, z)) for part in book.parts]
        z += float(book.size[2])
    return parts
