"""What stands, lies, leans and hangs in furnished rooms, as trimesh meshes; see house_models.py."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from benchmarks.house_models import (
    CORNERS,
    DARK,
    SIDES,
    Block,
    Maker,
    Mesh,
    Rng,
    Thing,
    bar,
    joined,
    lathe,
    made,
    rod,
    sheet,
    soft,
    top,
    tube,
    turned,
)


def _plain(kind: str, low: Sequence[float], high: Sequence[float], absorbs: float = 0.0) -> Maker:
    """Maker of boxes whose sides are between these; cartons stack."""

    def maker(r: Rng) -> Thing:
        w, d, h = r.uniform(low, high)
        places = [top(w, d, h, 0.8)] if kind == "box" else []
        return made(kind, [bar(w, d, h)], places, absorbs=absorbs, stacks=kind == "box")

    return maker


small_box = _plain("box", (0.08, 0.06, 0.04), (0.24, 0.18, 0.16))
picture = _plain("picture", (0.25, 0.02, 0.25), (0.9, 0.03, 0.7))
mirror = _plain("mirror", (0.4, 0.02, 0.6), (0.7, 0.03, 1.4))
whiteboard = _plain("whiteboard", (0.9, 0.02, 0.7), (1.6, 0.03, 1.0))
alarm_clock = _plain("alarm clock", (0.1, 0.05, 0.06), (0.16, 0.07, 0.1))
tissue_box = _plain("tissue box", (0.2, 0.11, 0.07), (0.24, 0.13, 0.09))
radio = _plain("radio", (0.2, 0.08, 0.12), (0.32, 0.13, 0.2))
printer = _plain("printer", (0.36, 0.3, 0.16), (0.45, 0.4, 0.3))
cereal_box = _plain("cereal box", (0.14, 0.05, 0.22), (0.2, 0.08, 0.31))
phone = _plain("phone", (0.07, 0.145, 0.008), (0.078, 0.16, 0.01), DARK)
remote = _plain("remote", (0.04, 0.16, 0.016), (0.05, 0.2, 0.024), DARK)

# On the floor


def _shade(x: float, z: float, r0: float, r1: float, h: float) -> list[Mesh]:
    """A lamp's shade and what is inside."""
    shade = lathe((r0, 0), (r1, h), (r1 - 0.006, h), (r0 - 0.006, 0), (r0, 0))
    shade.apply_translation((x, 0, z))
    return [shade, rod(0.03, 0.08, x, 0, z + 0.3 * h), rod(r1 - 0.002, 0.004, x, 0, z + 0.75 * h)]


def floor_lamp(r: Rng) -> Thing:
    """A straight one or one whose lamp hangs from a bow."""
    h, parts = r.uniform(1.3, 1.75), [rod(0.15, 0.028)]
    if r.random() < 0.6:
        radius, tall, narrow = r.uniform((0.14, 0.2, 0.55), (0.24, 0.32, 0.95))
        parts += [rod(0.012, h - 0.1, z=0.02), *_shade(0, h - tall, radius, narrow * radius, tall)]
    else:
        reach, s = r.uniform(0.35, 0.7), np.linspace(0, 1, 14)
        parts += tube(0.012, *np.stack([reach * s**2, 0 * s, 0.02 + (h - 0.02) * (1 - (1 - s) ** 2)], axis=1))
        parts += _shade(reach, h - 0.22, 0.16, 0.05, 0.2)
    (x0, y0, _), (x1, y1, z1) = joined(parts).bounds
    return made("floor lamp", parts, blocks=[Block(-0.15, 0.15, -0.15, 0.15, 0, h), Block(x0, x1, y0, y1, 0.7 * h, z1)])


def ceiling_lamp(r: Rng) -> Thing:
    radius, h, narrow = r.uniform((0.13, 0.14, 0.2), (0.28, 0.26, 0.6))
    return made("ceiling lamp", [rod(0.03, 0.05, z=0.9 * h), *_shade(0, 0, radius, narrow * radius, h)])


def _leaf(r: Rng, tall: float, radius: float, z: float, wide: float, slender: bool) -> list[Mesh]:
    """A bent strip that starts near the pot's middle."""
    a, long, reach = r.uniform((0, 0.45 * tall, 0.15), (2 * np.pi, 0.9 * tall, 0.6))
    u, out = np.linspace(0, 1, 7), reach * long
    away = 0.1 * radius + out * u**1.6
    line = np.stack([away * np.cos(a), away * np.sin(a), z + long * u - 0.56 * out * u**3], axis=1)
    profile = np.sin(np.pi * np.linspace(0.08, 0.97, 7)) if slender else np.clip(2.6 * u - 1.6, 0.06, 1)
    across = wide * profile[:, None] * (-np.sin(a), np.cos(a), 0)
    edges = np.stack([line - across, line + across], axis=1)
    return [sheet(edges[k : k + 2].reshape(4, 3)) for k in range(6)]


def plant(r: Rng) -> Thing:
    return _plant(r, "potted plant", r.uniform(0.5, 1.4), r.uniform(0.11, 0.2), 1.0)


def small_plant(r: Rng) -> Thing:
    tall = r.uniform(0.12, 0.3)
    return _plant(r, "small plant", tall, min(tall * r.uniform(0.28, 0.4), 0.06), 0.5)


def _plant(r: Rng, kind: str, tall: float, radius: float, scale: float) -> Thing:
    h = min(radius * r.uniform(1.3, 1.9), 0.11 if scale < 1 else 1)
    pot = lathe((0, 0), (0.72 * radius, 0), (radius, h), (0.88 * radius, h), (0.86 * radius, 0.88 * h), (0, 0.88 * h))
    parts, slender = [pot], r.random() < 0.5
    for _ in range(int(r.integers(9, 26))):
        wide = scale * (r.uniform(0.02, 0.045) if slender else r.uniform(0.05, 0.1))
        parts += _leaf(r, tall, radius, 0.88 * h, wide, slender)
    (x0, y0, _), (x1, y1, z1) = joined(parts).bounds
    crown = Block(0.8 * x0, 0.8 * x1, 0.8 * y0, 0.8 * y1, h, z1)
    return made(kind, parts, blocks=[Block(-radius, radius, -radius, radius, 0, h), crown])


def carton(r: Rng) -> Thing:
    """A box, or an open one with two flaps."""
    w, d, h = r.uniform((0.25, 0.22, 0.16), (0.6, 0.45, 0.45))
    if r.random() > 0.3:
        return made("box", [bar(w, d, h)], [top(w, d, h, 0.8)], stacks=True)
    parts = [bar(w, d, 0.006)]
    for s in SIDES:
        parts += [bar(0.006, d, h, s * w / 2), bar(w, 0.006, h, 0, s * d / 2)]
        a, x = r.uniform(0.3, 1.9), s * w / 2
        out, up = x + s * 0.4 * w * np.sin(a), h + 0.4 * w * np.cos(a)
        parts.append(sheet([(x, -d / 2, h), (x, d / 2, h), (out, -d / 2, up), (out, d / 2, up)]))
    return made("open box", parts)


def wastebasket(r: Rng) -> Thing:
    q, h = r.uniform((0.11, 0.25), (0.16, 0.4))
    inner = (q - 0.006, h), (0.8 * q - 0.006, 0.01), (0, 0.01)
    return made("wastebasket", [lathe((0, 0), (0.8 * q, 0), (q, h), *inner)])


def suitcase(r: Rng) -> Thing:
    w, d, h = r.uniform((0.36, 0.2, 0.5), (0.48, 0.3, 0.72))
    parts = [soft(w / 2, d / 2, h / 2, 0, 0, h / 2 + 0.04, 0.25)]
    parts += [soft(0.025, 0.025, 0.025, 0.38 * w * x, 0.35 * d * y, 0.025) for x, y in CORNERS]
    if r.random() < 0.4:
        y = -0.3 * d
        parts += tube(0.01, (-0.1, y, h), (-0.1, y, h + 0.35), (0.1, y, h + 0.35), (0.1, y, h))
    return made("suitcase", parts)


def backpack(r: Rng) -> Thing:
    h, leans = r.uniform((0.38, -0.02), (0.5, 0.25))
    parts = [soft(0.16, 0.1, h / 2, 0, 0, h / 2, 0.55), soft(0.12, 0.05, 0.22 * h, 0, 0.09, 0.3 * h, 0.5)]
    return made("backpack", [turned(part, leans, "x") for part in parts])


def handbag(r: Rng) -> Thing:
    handle = tube(0.008, (-0.09, 0, 0.22), (-0.07, 0, 0.36), (0.07, 0, 0.36), (0.09, 0, 0.22))
    deep, round_ = r.uniform((0.06, 0.4), (0.1, 0.6))
    return made("handbag", [soft(0.17, deep, 0.13, 0, 0, 0.13, round_), *handle])


def ball(r: Rng) -> Thing:
    return made("ball", [soft(*[r.uniform(0.08, 0.13)] * 3)])


def basket(r: Rng) -> Thing:
    q, h = r.uniform((0.16, 0.22), (0.26, 0.45))
    parts = [lathe((0, 0), (0.85 * q, 0), (q, 0.6 * h), (0.93 * q, h), (0.88 * q, h), (0.8 * q, 0.02), (0, 0.02))]
    if r.random() < 0.6:
        parts.append(soft(0.8 * q, 0.8 * q, 0.22 * h, 0, 0, 0.85 * h, 0.8))
    return made("basket", parts)


def shoes(r: Rng) -> Thing:
    parts, high = [], r.uniform(0.045, 0.08)
    for x in (-0.06, 0.06):
        parts += [soft(0.045, 0.14, 0.03, x, 0, 0.03, 0.5), soft(0.042, 0.075, high, x, -0.06, 0.06, 0.7)]
    return made("shoes", parts)


# Leaning on walls


def ladder(r: Rng) -> Thing:
    h, w = r.uniform((1.5, 0.35), (2.1, 0.45))
    parts = [bar(0.03, 0.06, h, s * w / 2) for s in SIDES]
    parts += [bar(w, 0.04, 0.03, z=z) for z in np.arange(0.25, h - 0.1, 0.28)]
    return _leaning(r, "ladder", parts, 0.15, 0.3)


def guitar(r: Rng) -> Thing:
    parts = [turned(rod(q, 0.09), np.pi / 2, "x", (0, 0.045, z)) for q, z in ((0.19, 0.2), (0.145, 0.4))]
    parts += [bar(0.055, 0.025, 0.42, 0, 0.035, 0.5), bar(0.08, 0.02, 0.15, 0, 0.03, 0.92)]
    return _leaning(r, "guitar", parts, 0.15, 0.3)


def broom(r: Rng) -> Thing:
    parts = [rod(0.012, r.uniform(0.95, 1.25), z=0.15), bar(0.3, 0.05, 0.16)]
    return _leaning(r, "broom", parts, 0.1, 0.25)


def board(r: Rng) -> Thing:
    w, h = r.uniform((0.4, 0.5), (0.9, 1.2))
    return _leaning(r, "picture", [bar(w, 0.025, h)], 0.08, 0.25)


def _leaning(r: Rng, kind: str, parts: list[Mesh], least: float, most: float) -> Thing:
    angle = r.uniform(least, most)
    return made(kind, [turned(part, angle, "x") for part in parts])


# On walls


def wall_clock(r: Rng) -> Thing:
    q = r.uniform(0.12, 0.19)
    return made("wall clock", [turned(rod(q, 0.03), -np.pi / 2, "x")], absorbs=DARK)


def curtain(r: Rng, h: float) -> Thing:
    w, waves = r.uniform((0.35, 4), (0.7, 8))
    x = np.linspace(-w / 2, w / 2, 40)
    y = 0.035 * np.sin(x / w * 2 * np.pi * waves)
    low, high = np.stack([x, 0.9 * y, 0 * x], axis=1), np.stack([x, y, 0 * x + h], axis=1)
    return made("curtain", [sheet((low[k], low[k + 1], high[k], high[k + 1])) for k in range(39)])


# On furniture


def tv(r: Rng) -> Thing:
    w = r.uniform(0.85, 1.35)
    parts = [bar(w, 0.05, 0.57 * w, 0, -0.005, 0.06)]
    for x in (-0.33 * w, 0.33 * w):
        parts += tube(0.01, (x, -0.12, 0.008), (x, -0.005, 0.05), (x, 0.12, 0.008))
    return made("tv", parts, absorbs=0.3)


def monitor(r: Rng) -> Thing:
    w, flat, z, leans = r.uniform((0.46, 0.45, 0.1, 0), (0.72, 0.6, 0.18, 0.12))
    h = flat * w
    parts = [rod(0.11, 0.013), bar(0.05, 0.025, z + 0.3 * h, 0, -0.05, 0.01)]
    return made("monitor", [*parts, turned(bar(w, 0.032, h), leans, "x", (0, -0.01, z))], absorbs=0.25)


def laptop(r: Rng) -> Thing:
    w, d, leans = r.uniform((0.3, 0.21, 0.1), (0.37, 0.26, 0.55))
    return made("laptop", [bar(w, d, 0.016), turned(bar(w, 0.008, d), leans, "x", (0, -d / 2, 0.014))])


def keyboard(r: Rng) -> Thing:
    w = r.uniform(0.3, 0.45)
    keys = [bar(w - 0.02, 0.024, 0.007, 0, y, 0.015) for y in (-0.043, -0.015, 0.013, 0.041)]
    return made("keyboard", [bar(w, 0.13, 0.015), *keys], absorbs=DARK)


def mouse(r: Rng) -> Thing:
    return made("mouse", [soft(r.uniform(0.028, 0.034), 0.055, 0.018, roundness=0.8)], absorbs=DARK)


def microwave(r: Rng) -> Thing:
    w, d, h = r.uniform((0.44, 0.32, 0.26), (0.52, 0.4, 0.3))
    parts = [bar(w, d, h), bar(w - 0.15, 0.006, h - 0.07, -0.055, d / 2 + 0.003, 0.04)]
    return made("microwave", parts, [top(w, d, h, 0.4)])


def mug(r: Rng) -> Thing:
    q, h = r.uniform((0.035, 0.08), (0.046, 0.11))
    cup = lathe((0, 0), (0.92 * q, 0), (q, h), (q - 0.004, h), (0.9 * q - 0.004, 0.006), (0, 0.006))
    ring = [(0.96 * q + 0.028 * np.cos(t), 0, 0.52 * h + 0.032 * np.sin(t)) for t in np.linspace(-1.35, 1.35, 9)]
    return made("mug", [cup, *tube(0.0055, *ring)])


def glass(r: Rng) -> Thing:
    q, h = r.uniform((0.03, 0.09), (0.04, 0.16))
    outline = (0, 0), (0.8 * q, 0), (q, h), (q - 0.003, h), (0.8 * q - 0.003, 0.008), (0, 0.008)
    return made("glass", [lathe(*outline)], absorbs=0.5)


def bottle(r: Rng) -> Thing:
    q, h, thin, s = r.uniform((0.03, 0.18, 0.3, 0.55), (0.045, 0.33, 0.45, 0.72))
    n = thin * q
    outline = (0, 0), (q, 0), (q, h * s), (1.2 * n, h * (s + 0.16)), (n, 0.9 * h), (1.15 * n, h), (0, h)
    return made("bottle", [lathe(*outline)], absorbs=0.2 if r.random() < 0.4 else 0.0)


def can(r: Rng) -> Thing:
    return made("can", [rod(*r.uniform((0.028, 0.08), (0.04, 0.14)))])


def bowl(r: Rng) -> Thing:
    q, flat = r.uniform((0.06, 0.4), (0.13, 0.65))
    a = np.linspace(0.25, 1.5, 7)
    outer = np.stack([q * np.sin(a), q * flat * (1 - np.cos(a) / np.cos(0.25))], axis=1)
    inner = outer[::-1] + np.array([-0.004, 0.005])
    return made("bowl", [lathe((0, 0), *map(tuple, outer), *map(tuple, inner), (0, 0.006))])


def plate(r: Rng) -> Thing:
    """One, or a pile."""
    q, count = r.uniform(0.09, 0.14), int(r.integers(1, 6)) if r.random() < 0.3 else 1
    parts = [lathe((0, 0), (0.6 * q, 0), (q, 0.016), (q, 0.02), (0.6 * q, 0.006), (0, 0.006)) for _ in range(count)]
    for k, part in enumerate(parts):
        part.apply_translation((0, 0, 0.009 * k))
    return made("plate", parts, [top(0.8 * q, 0.8 * q, 0.006, 0.3)] if count == 1 else (), stacks=count == 1)


def book(r: Rng) -> Thing:
    w, d, h = r.uniform((0.13, 0.18, 0.012), (0.21, 0.28, 0.045))
    pages = bar(w - 0.007, d - 0.008, h - 0.004, -0.0005, 0, 0.002)
    parts = [bar(w, d, 0.002), bar(w, d, 0.002, z=h - 0.002), bar(0.003, d, h, 0.0015 - w / 2), pages]
    return made("book", parts, [top(w - 0.02, d - 0.02, h, 0.35)], stacks=True)


def standing_book(r: Rng, leans: float = 0.0) -> Thing:
    """Its back towards +y; leaning to the left."""
    upright = turned(turned(book(r).mesh, np.pi / 2, "x"), -np.pi / 2, "z")
    return made("book", [turned(upright, -leans, "y")])


def desk_lamp(r: Rng) -> Thing:
    h, back, out, up = r.uniform((0.2, -0.12, 0.08, 0.05), (0.32, -0.03, 0.2, 0.18))
    parts = [rod(0.085, 0.02), *tube(0.007, (0, 0, 0.02), (back, 0, h), (out, 0, h + up))]
    shade = lathe((0.02, 0.06), (0.07, -0.06), (0.067, -0.06), (0.0, 0.05))
    return made("desk lamp", [*parts, turned(shade, -0.5, "y", (out, 0, h + up))])


def table_lamp(r: Rng) -> Thing:
    h, q, wide, narrow, tall = r.uniform((0.14, 0.05, 0.1, 0.5, 0.14), (0.25, 0.09, 0.17, 0.9, 0.22))
    foot = lathe((0, 0), (q, 0), (1.1 * q, 0.3 * h), (0.4 * q, 0.8 * h), (0.012, h), (0.012, h + 0.1), (0, h + 0.1))
    return made("table lamp", [foot, *_shade(0, h + 0.02, wide, narrow * wide, tall)])


def vase(r: Rng) -> Thing:
    """Some with flowers."""
    h, q = r.uniform((0.15, 0.04), (0.35, 0.08))
    outer = (0, 0), (0.6 * q, 0), (q, 0.4 * h), (0.45 * q, 0.8 * h), (0.6 * q, h)
    parts = [lathe(*outer, (0.52 * q, h), (0.38 * q, 0.8 * h), (0, 0.3 * h))]
    for _ in range(int(r.integers(3, 7)) if r.random() < 0.4 else 0):
        a, out, up = r.uniform((0, 0.03, 0.1), (2 * np.pi, 0.1, 0.25))
        x, y, z = out * np.cos(a), out * np.sin(a), h + up
        parts += [*tube(0.003, (0, 0, 0.4 * h), (0.3 * x, 0.3 * y, h), (x, y, z)), soft(0.025, 0.025, 0.02, x, y, z)]
    return made("vase", parts)


def apple(r: Rng) -> Thing:
    q = r.uniform(0.032, 0.042)
    return made("apple", [soft(q, q, 0.92 * q), rod(0.002, 0.02, z=0.83 * q)])


def banana(r: Rng) -> Thing:
    bow = r.uniform(0.1, 0.12)
    return made("banana", tube(0.017, *[(bow * np.sin(t), bow * np.cos(t), 0) for t in np.linspace(-0.9, 0.9, 10)]))


def teapot(r: Rng) -> Thing:
    q = r.uniform(0.06, 0.085)
    spout = (0.85 * q, 0, 0.6 * q), (1.35 * q, 0, q), (1.6 * q, 0, 1.5 * q)
    handle = (-0.8 * q, 0, 1.3 * q), (-1.5 * q, 0, 1.3 * q), (-1.55 * q, 0, 0.7 * q), (-0.9 * q, 0, 0.5 * q)
    body = [soft(q, q, 0.85 * q, 0, 0, 0.85 * q, 0.9), soft(0.015, 0.015, 0.015, 0, 0, 1.72 * q)]
    return made("teapot", [*body, *tube(0.012, *spout), *tube(0.008, *handle)])


def kettle(r: Rng) -> Thing:
    q, h = r.uniform((0.075, 0.18), (0.09, 0.23))
    body = lathe((0, 0), (q, 0), (q, 0.03), (0.95 * q, 0.03), (0.72 * q, h), (0, h + 0.01))
    handle = (-0.7 * q, 0, 0.95 * h), (-1.5 * q, 0, 0.9 * h), (-1.5 * q, 0, 0.3 * h), (-0.95 * q, 0, 0.2 * h)
    spout = tube(0.018, (0.75 * q, 0, 0.7 * h), (1.15 * q, 0, 0.95 * h))
    return made("kettle", [body, *tube(0.011, *handle), *spout], absorbs=0.2)


def toaster(r: Rng) -> Thing:
    w, d, h = r.uniform((0.26, 0.15, 0.17), (0.32, 0.18, 0.2))
    body = soft(w / 2, d / 2, h / 2, 0, 0, h / 2, 0.25)
    return made("toaster", [body, bar(0.02, 0.03, 0.02, w / 2 + 0.01, 0, 0.6 * h)])


def pot(r: Rng) -> Thing:
    """With or without a lid, with one handle or two."""
    q, h = r.uniform((0.08, 0.08), (0.13, 0.16))
    parts = [lathe((0, 0), (q, 0), (q, h), (q - 0.004, h), (q - 0.004, 0.006), (0, 0.006))]
    if r.random() < 0.6:
        parts += [lathe((q, h), (0.6 * q, h + 0.02), (0, h + 0.025)), soft(0.015, 0.015, 0.018, 0, 0, h + 0.04)]
    if r.random() < 0.5:
        return made("pot", [*parts, *tube(0.011, (q, 0, 0.8 * h), (q + 0.17, 0, 0.95 * h))])
    for x, far in ((0.98 * q, q + 0.03), (-0.98 * q, -q - 0.03)):
        parts += tube(0.007, (x, -0.03, 0.8 * h), (far, 0, 0.8 * h), (x, 0.03, 0.8 * h))
    return made("pot", parts)


def photo(r: Rng) -> Thing:
    w, h, leans = r.uniform((0.12, 0.15, 0.12), (0.24, 0.28, 0.25))
    prop = tube(0.003, (0, -0.03 - 0.18 * h, 0.003), (0, -0.1 * h, 0.5 * h))
    return made("photo frame", [turned(bar(w, 0.016, h), leans, "x"), *prop])


def speaker(r: Rng) -> Thing:
    w, d, h = r.uniform((0.11, 0.13, 0.18), (0.2, 0.2, 0.34))
    cone = turned(rod(0.38 * w, 0.006), -np.pi / 2, "x", (0, d / 2, 0.35 * h))
    return made("speaker", [bar(w, d, h), cone], [top(w, d, h, 0.3)], absorbs=DARK, stacks=True)


def pen_cup(r: Rng) -> Thing:
    q, h = r.uniform((0.03, 0.08), (0.042, 0.11))
    parts = [lathe((0, 0), (q, 0), (q, h), (q - 0.003, h), (q - 0.003, 0.005), (0, 0.005))]
    for _ in range(int(r.integers(2, 7))):
        a, up = r.uniform((0, 0.02), (2 * np.pi, 0.08))
        x, y = q * np.cos(a), q * np.sin(a)
        parts += tube(0.0035, (-0.4 * x, -0.4 * y, 0.01), (0.85 * x, 0.85 * y, h + up))
    return made("pen cup", parts)


def candle(r: Rng) -> Thing:
    q, h = r.uniform((0.025, 0.06), (0.045, 0.18))
    return made("candle", [rod(q, h), rod(0.0015, 0.012, z=h)])


def jar(r: Rng) -> Thing:
    q, h = r.uniform((0.035, 0.1), (0.06, 0.2))
    outline = (0, 0), (q, 0), (q, 0.85 * h), (0.8 * q, 0.9 * h), (0.85 * q, 0.9 * h), (0.85 * q, h), (0, h)
    return made("jar", [lathe(*outline)])


def teddy(r: Rng) -> Thing:
    s = r.uniform(0.8, 1.6)
    halves: list[tuple[float, ...]] = [(0.05, 0.045, 0.06, 0, 0, 0.06), (0.04, 0.038, 0.038, 0, 0, 0.145)]
    for x in SIDES:
        halves += [(0.015, 0.01, 0.015, 0.03 * x, 0, 0.18), (0.018, 0.04, 0.018, 0.035 * x, 0.05, 0.02)]
        halves.append((0.015, 0.015, 0.04, 0.055 * x, 0.01, 0.08))
    return made("teddy bear", [soft(*(s * np.array(half))) for half in halves])


def cushion(r: Rng) -> Thing:
    half, leans = r.uniform((0.18, 0.15), (0.25, 0.4))
    return made("cushion", [turned(soft(half, 0.07, half, roundness=0.6), leans, "x")])


def lying_cushion(r: Rng) -> Thing:
    half = r.uniform(0.18, 0.25)
    return made("cushion", [soft(half, half, 0.07, roundness=0.6)])


def pillow(r: Rng) -> Thing:
    w, d, leans = r.uniform((0.28, 0.18, 0), (0.36, 0.24, 0.35))
    return made("pillow", [turned(soft(w, d, 0.075, roundness=0.55), -leans, "x")])


def tray(r: Rng) -> Thing:
    """Things may stand within its rim."""
    w, d = r.uniform((0.3, 0.22), (0.45, 0.3))
    parts = [bar(w, d, 0.01), *(bar(0.01, d, 0.035, s * w / 2) for s in SIDES)]
    parts += [bar(w, 0.01, 0.035, 0, s * d / 2) for s in SIDES]
    inside = Block(-w / 2, w / 2, -d / 2, d / 2, 0, 0.012)
    return made("tray", parts, [top(w - 0.02, d - 0.02, 0.01, 0.3)], [inside], stacks=True)
