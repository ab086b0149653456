"""Table-top things from parts: electronics, crockery, books."""

from __future__ import annotations

import numpy as np

from pipeline.synthetic.model import (
    BLACK,
    BRASS,
    PAPER,
    SIDES,
    STEEL,
    WHITE,
    Material,
    ModelPart,
    ObjectModel,
    Palette,
    assemble,
    ball,
    block,
    cylinder,
    joined,
    lathe,
    leaf,
    paint,
    pick,
    rgb,
    ring,
    rod,
)

Rng = np.random.Generator


def _flat(size: tuple[float, float], at: tuple[float, float, float], material: Material) -> ModelPart:
    """A thin printed sheet lying on top of something."""
    return block((*size, 0.0015), at, material, 0.0005)


def laptop(p: Palette, rng: Rng) -> ObjectModel:
    shell = Material(rgb("#b4b7bb"), None, gloss=0.45)
    keys, screen = ("keys", True), ("screen", int(rng.integers(3)))
    w, d = 0.33, 0.23
    lid = [
        block((w, 0.008, d), (0, d / 2, 0.012), shell, 0.003),
        block((w - 0.008, 0.002, d - 0.008), (0, d / 2 - 0.0042, 0.016), BLACK, 0.0008),
        block(
            (w - 0.026, 0.0015, d - 0.032),
            (0, d / 2 - 0.0054, 0.030),
            Material((1, 1, 1), screen, 0, 0.2, 0.55),
            0.0005,
        ),
    ]
    parts = [
        block((w, d, 0.016), (0, 0, 0), shell, 0.005, 2),
        _flat((w - 0.04, d * 0.48), (0, 0.035, 0.0155), Material((1, 1, 1), keys, 0)),
        _flat((0.10, 0.062), (0, -0.068, 0.0152), Material(rgb("#a5a8ad"))),
        *(part.turned(-0.30, 0, (0, d / 2, 0.012)) for part in lid),
    ]
    return assemble("laptop", parts)


def tv(p: Palette, rng: Rng) -> ObjectModel:
    w = rng.uniform(1.05, 1.22)
    h = w * 0.57
    screen = Material((1, 1, 1), ("screen", 1 + 2 * int(rng.integers(2))), 0, 0.3, 0.5)
    parts = [
        block((w, 0.035, h), (0, 0, 0.06), BLACK, 0.008, 2),
        block((w - 0.025, 0.002, h - 0.03), (0, -0.0178, 0.078), screen, 0.0005),
        *(rod((s * w * 0.32, y, 0.008), (s * w * 0.30, 0, 0.08), 0.008, BLACK) for s in SIDES for y in (-0.09, 0.09)),
    ]
    return assemble("tv", parts)


def mouse(p: Palette, rng: Rng) -> ObjectModel:
    body = BLACK if rng.random() < 0.5 else WHITE
    parts = [
        block((0.06, 0.105, 0.036), (0, 0, 0), body, 0.017, 4),
        block((0.008, 0.02, 0.008), (0, -0.028, 0.030), STEEL, 0.003),
    ]
    return assemble("mouse", parts)


def mug(p: Palette, rng: Rng, color: str | None = None) -> ObjectModel:
    glaze = Material(rgb(color or pick(rng, p.accents)), ("speckle",), 0.12, gloss=0.5)
    r, h = 0.041, 0.095
    profile = [
        (0, 0),
        (r - 0.006, 0),
        (r, 0.008),
        (r, h - 0.002),
        (r - 0.002, h),
        (r - 0.005, h - 0.002),
        (r - 0.006, 0.012),
        (0, 0.010),
    ]
    handle = ring(0.027, 0.0062, (0, 0, 0), glaze).turned(np.pi / 2, 0).moved((r + 0.012, 0, h * 0.52))
    keep = handle.vertices[handle.faces][..., 0].max(axis=1) > r - 0.005
    handle = ModelPart(handle.vertices, handle.faces[keep], glaze)
    used = np.unique(handle.faces)
    handle = ModelPart(handle.vertices[used], np.searchsorted(used, handle.faces).astype(np.int32), glaze)
    coffee = cylinder(r - 0.0062, 0.002, (0, 0, h * 0.74), Material(rgb("#3a2417"), None, gloss=0.4), 24)
    return assemble("mug", [lathe(profile, (0, 0, 0), glaze), handle, coffee])


def bottle(p: Palette, rng: Rng) -> ObjectModel:
    tint = pick(rng, ("#3f5f49", "#5a3b23", "#33566b", "#7c2f2a"))
    glass = Material(rgb(tint), None, gloss=0.8)
    h = rng.uniform(0.26, 0.31)
    profile = [
        (0, 0),
        (0.034, 0),
        (0.037, 0.006),
        (0.037, h * 0.56),
        (0.032, h * 0.66),
        (0.015, h * 0.78),
        (0.0135, h * 0.95),
        (0.016, h * 0.955),
        (0.016, h * 0.98),
        (0, h * 0.98),
    ]
    label = lathe([(0.0374, h * 0.18), (0.0374, h * 0.46)], (0, 0, 0), Material(rgb("#efe3c9"), ("plaster",), 0.2))
    return assemble(
        "bottle", [lathe(profile, (0, 0, 0), glass), label, cylinder(0.0155, 0.022, (0, 0, h * 0.94), BRASS, 16)]
    )


def bowl(p: Palette, rng: Rng) -> ObjectModel:
    """A shallow bowl holding fruit."""
    glaze = Material(rgb(pick(rng, p.accents)), ("speckle",), 0.2, gloss=0.45)
    r, h = rng.uniform(0.125, 0.15), 0.075
    outer = [(0, 0), (0.05, 0), (0.055, 0.008), (0.6 * r + 0.02, 0.022), (r, h)]
    inner = [(r - 0.006, h), (0.6 * r + 0.016, 0.032), (0.05, 0.016), (0, 0.014)]
    parts = [lathe([*outer, *inner], (0, 0, 0), glaze, 36)]
    fruits = ("#c8402c", "#d9822b", "#9aa83a", "#d8b13c")
    for k in range(4):
        a = 2 * np.pi * k / 3 + 0.4
        reach = 0.052 if k < 3 else 0.0
        at = (reach * np.cos(a), reach * np.sin(a), 0.066 if k < 3 else 0.105)
        parts.append(
            ball(0.036, at, Material(rgb(fruits[int(rng.integers(4))]), ("plaster",), 0.3, gloss=0.3), (1, 1, 0.92))
        )
    return assemble("bowl", parts)


def plate(p: Palette, rng: Rng) -> ObjectModel:
    r = 0.125
    profile = [(0, 0), (0.07, 0), (0.075, 0.004), (r, 0.018), (r - 0.002, 0.021), (0.078, 0.009), (0, 0.007)]
    band = lathe([(r - 0.016, 0.0195), (r - 0.006, 0.0212)], (0, 0, 0), paint(pick(rng, p.accents), 0.3), 36)
    return assemble("plate", [lathe(profile, (0, 0, 0), WHITE, 36), band])


def vase(p: Palette, rng: Rng) -> ObjectModel:
    """A vase with a few stems."""
    glaze = Material(rgb(pick(rng, (*p.accents, "#efe9dd"))), ("plaster",), 0.2, gloss=0.35)
    h, r = rng.uniform(0.19, 0.25), rng.uniform(0.055, 0.07)
    profile = [
        (0, 0),
        (0.55 * r, 0),
        (0.95 * r, 0.22 * h),
        (r, 0.42 * h),
        (0.75 * r, 0.68 * h),
        (0.36 * r, 0.88 * h),
        (0.46 * r, h),
        (0.36 * r, h),
        (0.28 * r, 0.88 * h),
    ]
    green, bloom = paint("#6d7f52", 0.05), paint(pick(rng, p.accents), 0.05)
    stems, heads, leaves = [], [], []
    for k in range(6):
        a, lean, tall = (
            2 * np.pi * k / 6 + rng.uniform(-0.3, 0.3),
            rng.uniform(0.02, 0.075),
            h + rng.uniform(0.10, 0.24),
        )
        top = (lean * np.cos(a), lean * np.sin(a), tall)
        stems.append(rod((0.1 * r * np.cos(a), 0.1 * r * np.sin(a), 0.8 * h), top, 0.0025, green))
        heads.append(ball(0.022, top, bloom, (1, 1, 0.8)))
        leaves.append(leaf((0.5 * top[0], 0.5 * top[1], 0.5 * (h + tall)), a, 0.075, 0.026, 0.8, 0.9, green))
    return assemble("vase", [lathe(profile, (0, 0, 0), glaze, 32), joined(stems), joined(heads), joined(leaves)])


BOOK_CODES = ("#7a3b2e", "#2f4b57", "#c9a227", "#56704f", "#e6dcc6", "#a8552f", "#3c3f58", "#8e9aa0", "#b98d7a")


def _book_parts(p: Palette, rng: Rng, w: float, d: float, t: float) -> list[ModelPart]:
    """A closed book lying down: spine at -x, cover upwards."""
    code = pick(rng, (*BOOK_CODES, *p.accents))
    cover = Material(
        (1, 1, 1), ("cover", int(rng.integers(2)), code, "#efe6d2" if code != "#e6dcc6" else "#5a4634"), 0, 0.1
    )
    plain = Material(rgb(code), None, gloss=0.1)
    return [
        block((w, d, 0.003), (0, 0, 0), plain, 0.001),
        block((w - 0.006, d - 0.008, t - 0.006), (0.001, 0, 0.003), PAPER, 0.001),
        block((w, d, 0.003), (0, 0, t - 0.003), cover, 0.001),
        block((0.004, d, t), (-w / 2 + 0.002, 0, 0), plain, 0.0015),
    ]


def book(p: Palette, rng: Rng) -> ObjectModel:
    """A book lying flat."""
    w, d, t = rng.uniform(0.14, 0.19), rng.uniform(0.20, 0.26), rng.uniform(0.018, 0.04)
    return assemble("book", _book_parts(p, rng, w, d, t))


def standing_book(p: Palette, rng: Rng, tallest: float = 0.27) -> ObjectModel:
    """A book upright on a shelf, spine to the front."""
    w, t = rng.uniform(0.13, 0.19), rng.uniform(0.018, 0.045)
    d = min(rng.uniform(0.18, 0.27), tallest)
    parts = [part.turned(np.pi / 2, 0).turned(np.pi / 2, 2) for part in _book_parts(p, rng, w, d, t)]
    return assemble("book", parts)
