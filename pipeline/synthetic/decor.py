"""Lamps, plants, containers, toys and wall pieces from parts."""

from __future__ import annotations

import numpy as np

from pipeline.synthetic.model import (
    BLACK,
    BRASS,
    PAPER,
    SIDES,
    Material,
    ModelPart,
    ObjectModel,
    Palette,
    RestSurface,
    assemble,
    ball,
    block,
    cloth,
    cylinder,
    each,
    joined,
    lathe,
    leaf,
    metal,
    paint,
    pick,
    rgb,
    ring,
    rod,
    wood,
)

Rng = np.random.Generator


def lamp(p: Palette, rng: Rng) -> ObjectModel:
    """A table lamp with a lit fabric shade."""
    foot = Material(rgb(pick(rng, p.accents)), ("plaster",), 0.2, gloss=0.4)
    r = rng.uniform(0.13, 0.15)
    body = [(0, 0), (0.06, 0), (0.065, 0.012), (0.05, 0.05), (0.075, 0.13), (0.05, 0.21), (0.016, 0.25), (0, 0.25)]
    shade = Material(rgb("#f3d9ae"), ("fabric",), 0.2, emission=1.1)
    rim = [(r, 0.27), (r * 0.72, 0.46), (r * 0.70, 0.46), (r * 0.98, 0.27)]
    return assemble(
        "lamp",
        [lathe(body, (0, 0, 0), foot), rod((0, 0, 0.24), (0, 0, 0.45), 0.006, BRASS), lathe(rim, (0, 0, 0), shade, 36)],
    )


def desk_lamp(p: Palette, rng: Rng) -> ObjectModel:
    """A jointed reading lamp."""
    m = paint(pick(rng, p.accents), 0.4)
    head = lathe(
        [(0.0, 0.07), (0.028, 0.065), (0.032, 0.045), (0.075, 0.0), (0.071, 0.0), (0.028, 0.042)], (0, 0, 0), m
    ).turned(0.5, 1)
    bulb = ball(0.026, (0, 0, 0.012), Material(rgb("#fff0cf"), emission=2.5)).turned(0.5, 1)
    tip = (-0.10, 0, 0.40)
    parts = [
        cylinder(0.075, 0.018, (0.05, 0, 0), m, 32),
        rod((0.05, 0, 0.01), (0.12, 0, 0.24), 0.007, BRASS),
        rod((0.12, 0, 0.24), (tip[0] + 0.03, 0, tip[2] + 0.06), 0.007, BRASS),
        ball(0.013, (0.12, 0, 0.24), m),
        head.moved(tip),
        bulb.moved(tip),
    ]
    return assemble("lamp", parts)


def floor_lamp(p: Palette, rng: Rng) -> ObjectModel:
    h = rng.uniform(1.45, 1.6)
    stand, shade = (
        (BRASS if rng.random() < 0.5 else metal(p)),
        Material(rgb("#f3d9ae"), ("fabric",), 0.25, emission=1.0),
    )
    parts = [
        cylinder(0.14, 0.025, (0, 0, 0), stand, 36),
        rod((0, 0, 0.02), (0, 0, h - 0.1), 0.011, stand),
        lathe([(0.20, h - 0.27), (0.15, h), (0.147, h), (0.197, h - 0.27)], (0, 0, 0), shade, 40),
        *(rod((0, 0, h - 0.1), (0.16 * np.cos(a), 0.16 * np.sin(a), h - 0.05), 0.003, stand) for a in (0.5, 2.6, 4.7)),
    ]
    return assemble("lamp", parts)


def plant(p: Palette, rng: Rng, tall: float = 0.9) -> ObjectModel:
    """A pot with arching leaves or upright blades."""
    r = 0.12 * tall + 0.05
    pot_h = 1.5 * r
    pot = Material(rgb(pick(rng, ("#b8673f", "#efe9dd", "#4f5d57", *p.accents[:2]))), ("plaster",), 0.3, gloss=0.15)
    profile = [(0, 0), (0.72 * r, 0), (r, pot_h), (0.90 * r, pot_h), (0.85 * r, pot_h * 0.86), (0, pot_h * 0.86)]
    soil = Material(rgb("#3b2c22"), ("speckle",), 0.1)
    parts = [lathe(profile, (0, 0, 0), pot, 36), cylinder(0.86 * r, 0.012, (0, 0, pot_h * 0.86), soil, 28)]
    greens = [Material(rgb(code), ("plaster",), 0.2, gloss=0.18) for code in ("#3f6b3c", "#5b8348", "#2f5636")]
    upright = bool(rng.random() < 0.35)
    groups: list[list[ModelPart]] = [[], [], []]
    stems = []
    count = 15 if upright else int(16 + 16 * tall)
    for k in range(count):
        a, g = 2.399963 * k + rng.uniform(-0.2, 0.2), int(rng.integers(3))
        rest = tall - pot_h
        if upright:
            length = rest * rng.uniform(0.55, 1.0)
            base = (0.4 * r * np.cos(a), 0.4 * r * np.sin(a), pot_h * 0.86)
            groups[g].append(
                leaf(base, a, length, 0.055 + 0.03 * tall, rng.uniform(1.25, 1.5), rng.uniform(0.0, 0.25), greens[g])
            )
        else:
            up = rest * (0.15 + 0.72 * k / count)
            lean = (0.06 + 0.10 * rng.random()) * rest * (1.15 - k / count)
            tip = (lean * np.cos(a), lean * np.sin(a), pot_h * 0.86 + up)
            stems.append(rod((0.15 * r * np.cos(a), 0.15 * r * np.sin(a), pot_h * 0.85), tip, 0.005, greens[2], 0.003))
            size = rng.uniform(0.17, 0.25) * tall**0.8
            groups[g].append(
                leaf(
                    tip, a, size, size * rng.uniform(0.42, 0.6), rng.uniform(0.3, 0.9), rng.uniform(0.9, 1.5), greens[g]
                )
            )
    parts += [joined(group) for group in (*groups, stems) if group]
    return assemble("potted plant", parts)


def trash_can(p: Palette, rng: Rng) -> ObjectModel:
    body = paint(pick(rng, ("#4a4d52", p.accents[2], p.accents[3], "#d9d4c8")), 0.3)
    r, h = rng.uniform(0.125, 0.15), rng.uniform(0.30, 0.36)
    profile = [(0, 0), (0.80 * r, 0), (r, h), (r - 0.004, h), (0.80 * r - 0.004, 0.006), (0, 0.006)]
    bag = Material(rgb("#e9e7e2"), ("plaster",), 0.3)
    crumple = ball(0.05, (0.02, -0.01, h * 0.62), PAPER, (1, 0.9, 0.8))
    return assemble(
        "trash can",
        [
            lathe(profile, (0, 0, 0), body, 36),
            ring(r, 0.006, (0, 0, h), body),
            cylinder(0.86 * r, 0.004, (0, 0, h * 0.55), bag, 24),
            crumple,
        ],
    )


def basket(p: Palette, rng: Rng) -> ObjectModel:
    """A woven basket with a folded blanket."""
    cane = Material(rgb("#c59a63"), ("basket",), 0.13)
    r, h = rng.uniform(0.17, 0.21), rng.uniform(0.24, 0.30)
    profile = [
        (0, 0),
        (0.85 * r, 0),
        (r, 0.5 * h),
        (0.94 * r, h),
        (0.91 * r, h),
        (0.96 * r, 0.5 * h),
        (0.82 * r, 0.01),
        (0, 0.01),
    ]
    blanket = cloth(pick(rng, p.accents))
    handle = ring(0.045, 0.008, (0, 0, 0), cane).turned(np.pi / 2, 1).turned(np.pi / 2, 2)
    parts = [
        lathe(profile, (0, 0, 0), cane, 36),
        ring(0.93 * r, 0.012, (0, 0, h), cane),
        block((1.18 * r, 1.10 * r, 0.5 * h), (0, 0, 0.62 * h), blanket, 0.045, 4),
        *(handle.moved((0, s * 0.95 * r, h + 0.01)) for s in SIDES),
    ]
    return assemble("basket", parts)


def box(p: Palette, rng: Rng) -> ObjectModel:
    """A cardboard box with tape and label."""
    card = Material(rgb("#b78a58"), ("plaster",), 0.3)
    w, d, h = rng.uniform(0.30, 0.42), rng.uniform(0.24, 0.32), rng.uniform(0.20, 0.28)
    tape = Material(rgb("#d8bd8b"), None, gloss=0.4)
    label = Material(rgb("#f4f1ea"), ("stripes", 3, "#f4f1ea", "#cfcac0"), 0)
    parts = [
        block((w, d, h), (0, 0, 0), card, 0.004),
        *(block((w + 0.001, d / 2 - 0.001, 0.003), (0, s * d / 4, h - 0.0005), card, 0.001) for s in SIDES),
        block((w + 0.002, 0.05, 0.002), (0, 0, h + 0.002), tape, 0.0008),
        *(block((0.002, 0.05, 0.07), (s * w / 2, 0, h - 0.068), tape, 0.0008) for s in SIDES),
        block((0.11, 0.002, 0.075), (-w * 0.2, -d / 2, h * 0.35), label, 0.0008),
    ]
    return assemble("box", parts, [RestSurface(h + 0.004, -w / 2, w / 2, -d / 2, d / 2)])


def backpack(p: Palette, rng: Rng) -> ObjectModel:
    shell, trim = cloth(pick(rng, p.accents), 0.15), cloth("#3a3330", 0.15)
    parts = [
        block((0.31, 0.17, 0.44), (0, 0, 0), shell, 0.07, 4),
        block((0.23, 0.08, 0.21), (0, -0.10, 0.035), shell, 0.035, 4),
        block((0.235, 0.05, 0.022), (0, -0.118, 0.205), trim, 0.008, 2),
        block((0.30, 0.012, 0.02), (0, -0.083, 0.31), trim, 0.005),
        ring(0.035, 0.008, (0, 0, 0), trim).turned(np.pi / 2, 0).moved((0, 0.03, 0.445)),
        *(block((0.055, 0.03, 0.33), (s * 0.085, 0.10, 0.06), trim, 0.013, 3) for s in SIDES),
    ]
    return assemble("backpack", parts)


def clock(p: Palette, rng: Rng) -> ObjectModel:
    """A round wall clock with the back at the largest y."""
    r = rng.uniform(0.14, 0.17)
    rim = ring(r, 0.012, (0, 0, 0), wood(p, rng)).turned(np.pi / 2, 0)
    face = cylinder(r, 0.015, (0, 0, 0), Material((1, 1, 1), ("dial",), 0), 48).turned(np.pi / 2, 0)
    return assemble("clock", [rim, face.moved((0, 0.010, 0))])


def alarm_clock(p: Palette, rng: Rng) -> ObjectModel:
    body = paint(pick(rng, p.accents), 0.4)
    dial = Material((1, 1, 1), ("dial",), 0)
    parts = [
        cylinder(0.05, 0.035, (0, 0, 0), body, 32).turned(np.pi / 2, 0).moved((0, 0.02, 0.058)),
        cylinder(0.044, 0.003, (0, 0, 0), dial, 32).turned(np.pi / 2, 0).moved((0, -0.0145, 0.058)),
        *(rod((s * 0.034, 0.003, 0), (s * 0.022, 0.003, 0.03), 0.006, BRASS) for s in SIDES),
        *(ball(0.016, (s * 0.028, 0.003, 0.108), BRASS, (1, 1, 0.7)) for s in SIDES),
    ]
    return assemble("clock", parts)


def teapot(p: Palette, rng: Rng) -> ObjectModel:
    glaze = Material(rgb(pick(rng, p.accents)), ("speckle",), 0.2, gloss=0.5)
    profile = [
        (0, 0),
        (0.055, 0),
        (0.085, 0.035),
        (0.088, 0.07),
        (0.065, 0.11),
        (0.04, 0.12),
        (0.038, 0.127),
        (0.012, 0.138),
        (0, 0.138),
    ]
    parts = [
        lathe(profile, (0, 0, 0), glaze, 36),
        ball(0.012, (0, 0, 0.145), glaze),
        rod((0.07, 0, 0.05), (0.145, 0, 0.115), 0.017, glaze, 0.009),
        ring(0.042, 0.007, (0, 0, 0), glaze).turned(np.pi / 2, 0).moved((-0.105, 0, 0.075)),
    ]
    return assemble("teapot", parts)


def candle(p: Palette, rng: Rng) -> ObjectModel:
    h = rng.uniform(0.08, 0.14)
    wax = Material(rgb("#f2e6cc"), ("plaster",), 0.2, gloss=0.15)
    parts = [
        cylinder(0.055, 0.010, (0, 0, 0), BRASS, 28),
        cylinder(0.032, h, (0, 0, 0.01), wax, 28),
        rod((0, 0, h), (0, 0, h + 0.02), 0.0015, BLACK),
    ]
    return assemble("candle", parts)


def teddy_bear(p: Palette, rng: Rng) -> ObjectModel:
    fur, pale = cloth(pick(rng, ("#a9774a", "#c49a6c", "#8a5d3b")), 0.08), cloth("#e6cfa8", 0.08)
    eyes = [ball(0.008, (s * 0.026, -0.068, 0.25), BLACK) for s in SIDES]
    parts = [
        ball(0.085, (0, 0, 0.095), fur, (1, 0.9, 1.1)),
        ball(0.07, (0, -0.01, 0.235), fur),
        ball(0.03, (0, -0.07, 0.222), pale, (1, 0.8, 0.8)),
        joined([*eyes, ball(0.009, (0, -0.095, 0.23), BLACK)]),
        *each(SIDES, lambda s: (
            ball(0.027, (s * 0.052, 0, 0.29), fur, (1, 0.6, 1)),
            ball(0.035, (s * 0.095, -0.03, 0.13), fur, (0.8, 1, 1.5)),
            ball(0.042, (s * 0.06, -0.09, 0.042), fur, (0.9, 1.5, 0.95)),
        )),
    ]  # fmt: skip
    return assemble("teddy bear", parts)


def toy_ball(p: Palette, rng: Rng) -> ObjectModel:
    r = rng.uniform(0.09, 0.12)
    a, b = p.accents[int(rng.integers(2))], p.accents[-1]
    parts = [
        ball(r, (0, 0, r), Material((1, 1, 1), ("stripes", 3, a, b), 0, 0.3)),
        ball(0.012, (0, 0, 2 * r - 0.008), paint(b, 0.3)),
    ]
    return assemble("ball", parts)


def picture(p: Palette, rng: Rng, width: float = 0.5, height: float = 0.65) -> ObjectModel:
    """A framed painting with the back at the largest y."""
    frame = wood(p, rng) if rng.random() < 0.6 else BLACK
    art = Material((1, 1, 1), ("picture", int(rng.integers(4)), int(rng.integers(50)), *p.accents[:4]), 0)
    t = 0.022
    parts = [
        block((width - t, 0.008, height - t), (0, 0.006, t / 2), art, 0.001),
        *each(
            SIDES,
            lambda s: (
                block((t, 0.024, height), (s * (width - t) / 2, 0, 0), frame, 0.003),
                block((width - 2 * t, 0.024, t), (0, 0, (height - t) / 2 * (1 + s)), frame, 0.003),
            ),
        ),
    ]
    return assemble("picture", parts)
