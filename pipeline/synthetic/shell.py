"""The room itself: floor, walls, ceiling, a window with curtains, a door, skirting boards."""

from __future__ import annotations

import numpy as np

from pipeline.synthetic.model import BRASS, Material, ModelPart, Palette, rgb
from pipeline.synthetic.shapes import SIDES, block, cylinder, each, rod, sheet

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
