"""Furniture from parts: tables, seats, beds, storage. Metres; fronts look towards -y."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.synthetic.model import (
    BRASS,
    SIDES,
    WHITE,
    Material,
    ModelPart,
    ObjectModel,
    Palette,
    RestSurface,
    assemble,
    block,
    cloth,
    cylinder,
    each,
    joined,
    lathe,
    metal,
    paint,
    pick,
    pillow,
    rgb,
    rod,
    wood,
)

Rng = np.random.Generator


def _legs(
    w: float, d: float, h: float, inset: float, radius: float, material: Material, splay: float = 0.0
) -> list[ModelPart]:
    """Four tapered round legs under a w*d top at height h."""
    x, y = w / 2 - inset, d / 2 - inset
    return [
        rod((sx * x + sx * splay, sy * y + sy * splay, 0), (sx * x, sy * y, h), radius * 0.65, material, radius)
        for sx in SIDES
        for sy in SIDES
    ]


def _knob(radius: float, at: tuple[float, float, float]) -> ModelPart:
    """A round brass handle on a front."""
    return cylinder(radius, 0.02, (0, 0, 0), BRASS, 14).turned(np.pi / 2, 0).moved(at)


def dining_table(p: Palette, rng: Rng) -> ObjectModel:
    w, d, h = rng.uniform(1.45, 1.7), rng.uniform(0.85, 0.95), 0.75
    m = wood(p, rng)
    parts = [
        block((w, d, 0.036), (0, 0, h - 0.036), m, 0.012, 2),
        *_legs(w, d, h - 0.036, 0.09, 0.032, m),
        *each(SIDES, lambda s: (
            block((w - 0.24, 0.022, 0.08), (0, s * (d / 2 - 0.09), h - 0.116), m, 0.003),
            block((0.022, d - 0.24, 0.08), (s * (w / 2 - 0.09), 0, h - 0.116), m, 0.003),
        )),
    ]  # fmt: skip
    return assemble("dining table", parts, [RestSurface(h, -w / 2, w / 2, -d / 2, d / 2)])


def desk(p: Palette, rng: Rng) -> ObjectModel:
    w, d, h = rng.uniform(1.35, 1.5), rng.uniform(0.66, 0.72), 0.74
    m, body = wood(p, rng), paint(p.painted)
    x, low = w / 2 - 0.24, h - 0.53 + 0.012
    parts = [
        block((w, d, 0.03), (0, 0, h - 0.03), m, 0.008, 2),
        block((0.40, d - 0.10, 0.50), (x, 0.02, h - 0.53), body),
        *each(range(3), lambda k: (
            block((0.376, 0.018, 0.152), (x, -d / 2 + 0.064, low + k * 0.165), body, 0.004),
            block((0.10, 0.016, 0.010), (x, -d / 2 + 0.050, low + k * 0.165 + 0.10), BRASS, 0.004),
        )),
        *each(SIDES, lambda sy: (
            rod(
                (-w / 2 + 0.06, sy * (d / 2 - 0.08), 0), (-w / 2 + 0.10, sy * (d / 2 - 0.10), h - 0.03),
                0.014, m, 0.022,
            ),
            *(
                rod((x + dx, sy * (d / 2 - 0.12), 0), (x + dx, sy * (d / 2 - 0.12), h - 0.52), 0.013, m, 0.018)
                for dx in (-0.16, 0.16)
            ),
        )),
        block((0.02, d - 0.2, 0.06), (-w / 2 + 0.10, 0, h - 0.09), m, 0.003),
    ]  # fmt: skip
    return assemble("desk", parts, [RestSurface(h, -w / 2, w / 2, -d / 2, d / 2)])


def chair(p: Palette, rng: Rng) -> ObjectModel:
    m, seat = wood(p, rng), cloth(pick(rng, p.accents))
    w, d, h, top = 0.45, 0.44, 0.45, rng.uniform(0.80, 0.88)
    parts = [
        block((w, d, 0.03), (0, 0, h - 0.045), m, 0.010, 2),
        block((w - 0.03, d - 0.03, 0.035), (0, 0, h - 0.017), seat, 0.016, 3),
        *each(SIDES, lambda s: (
            rod(
                (s * (w / 2 - 0.02), -d / 2 + 0.025, 0), (s * (w / 2 - 0.04), -d / 2 + 0.04, h - 0.04),
                0.012, m, 0.019,
            ),
            rod((s * (w / 2 - 0.02), d / 2 + 0.02, 0), (s * (w / 2 - 0.035), d / 2 - 0.03, h - 0.02), 0.012, m, 0.019),
            rod(
                (s * (w / 2 - 0.035), d / 2 - 0.03, h - 0.03), (s * (w / 2 - 0.05), d / 2 + 0.05, top - 0.03),
                0.018, m, 0.012,
            ),
        )),
    ]  # fmt: skip
    if rng.random() < 0.5:
        parts += [
            block((w - 0.08, 0.016, 0.055), (0, d / 2 - 0.03 + 0.08 * t, h + t * (top - h) - 0.03), m, 0.007, 2)
            for t in (0.35 + 0.28 * k for k in range(3))
        ]
    else:
        parts.append(block((w - 0.04, 0.020, 0.10), (0, d / 2 + 0.045, top - 0.10), m, 0.009, 2))
        parts += [
            rod((x, d / 2 - 0.02, h - 0.01), (x * 1.08, d / 2 + 0.04, top - 0.09), 0.007, m)
            for x in (-0.13 + 0.065 * k for k in range(5))
        ]
    return assemble("chair", parts, [RestSurface(h + 0.018, -0.17, 0.17, -0.17, 0.13)])


def stool(p: Palette, rng: Rng) -> ObjectModel:
    m = wood(p, rng)
    h, r = rng.uniform(0.43, 0.48), 0.17
    feet = [(np.cos(a), np.sin(a)) for a in np.deg2rad([45, 135, 225, 315])]
    parts = [
        cylinder(r, 0.035, (0, 0, h - 0.035), m, 36),
        *(rod((0.17 * x, 0.17 * y, 0), (0.11 * x, 0.11 * y, h - 0.03), 0.012, m, 0.018) for x, y in feet),
        *(
            rod((0.15 * x0, 0.15 * y0, 0.16), (0.15 * x1, 0.15 * y1, 0.16), 0.007, m)
            for (x0, y0), (x1, y1) in zip(feet, feet[1:] + feet[:1], strict=True)
        ),
    ]
    return assemble("stool", parts, [RestSurface(h, -0.145, 0.145, -0.145, 0.145)])


def office_chair(p: Palette, rng: Rng) -> ObjectModel:
    dark, seat = metal(p), cloth(pick(rng, p.accents))
    spokes, wheels = [], []
    for k in range(5):
        a = 2 * np.pi * k / 5 + 0.3
        x, y, dx, dy = 0.28 * np.cos(a), 0.28 * np.sin(a), 0.012 * np.sin(a), 0.012 * np.cos(a)
        spokes.append(rod((0, 0, 0.10), (x, y, 0.075), 0.024, dark, 0.014))
        wheels.append(rod((x - dx, y + dy, 0.03), (x + dx, y - dy, 0.03), 0.03, dark))
    spine = [rod((0, 0.10, 0.43), (0, 0.305, 0.50), 0.018, dark), rod((0, 0.305, 0.49), (0, 0.315, 0.74), 0.018, dark)]
    parts = [
        rod((0, 0, 0.07), (0, 0, 0.42), 0.028, dark),
        joined(spokes),
        joined(wheels),
        block((0.48, 0.46, 0.075), (0, 0, 0.42), seat, 0.034, 3),
        block((0.44, 0.07, 0.44), (0, 0.235, 0.56), seat, 0.033, 3).turned(-0.12, 0, (0, 0.235, 0.56)),
        joined(spine),
        *each(SIDES, lambda s: (
            rod((s * 0.22, 0.05, 0.45), (s * 0.27, 0.05, 0.64), 0.013, dark),
            block((0.05, 0.26, 0.03), (s * 0.27, 0.02, 0.635), dark, 0.012, 2),
        )),
    ]  # fmt: skip
    return assemble("office chair", parts)


def sofa(p: Palette, rng: Rng, seats: int = 3) -> ObjectModel:
    fabric, m = cloth(p.seat), wood(p, rng)
    w, d, free = 0.64 * seats + 0.36, 0.88, 0.64 * seats / 2
    back = (0, d / 2 - 0.26, 0.45)
    parts = [
        block((w - 0.04, d - 0.06, 0.22), (0, 0.01, 0.13), fabric, 0.03, 3),
        block((w, 0.20, 0.66), (0, d / 2 - 0.10, 0.13), fabric, 0.06, 3),
        *(block((0.17, d, 0.46), (s * (w / 2 - 0.085), 0, 0.13), fabric, 0.06, 3) for s in SIDES),
        *each((0.64 * (k - (seats - 1) / 2) for k in range(seats)), lambda x: (
            block((0.63, d - 0.22, 0.16), (x, -0.10, 0.30), fabric, 0.05, 4),
            block((0.62, 0.17, 0.38), (x, *back[1:]), fabric, 0.07, 4).turned(-0.10, 0, back),
        )),
        *_legs(w, d, 0.14, 0.09, 0.022, m, 0.02),
    ]  # fmt: skip
    label = "sofa" if seats > 1 else "armchair"
    return assemble(label, parts, [RestSurface(0.46, -free, free, -d / 2 + 0.06, d / 2 - 0.37)])


def armchair(p: Palette, rng: Rng) -> ObjectModel:
    """An armchair: a sofa with a single seat in an accent colour."""
    return sofa(replace(p, seat=pick(rng, p.accents)), rng, 1)


def coffee_table(p: Palette, rng: Rng) -> ObjectModel:
    m = wood(p, rng)
    h = rng.uniform(0.38, 0.43)
    if rng.random() < 0.4:
        r = rng.uniform(0.40, 0.46)
        parts = [
            cylinder(r, 0.032, (0, 0, h - 0.032), m, 56),
            *_legs(1.1 * r + 0.1, 1.1 * r + 0.1, h - 0.03, 0.05, 0.024, m, 0.07),
        ]
        k = 0.70 * r
        return assemble("coffee table", parts, [RestSurface(h, -k, k, -k, k)])
    w, d = rng.uniform(0.95, 1.15), rng.uniform(0.55, 0.62)
    parts = [
        block((w, d, 0.034), (0, 0, h - 0.034), m, 0.014, 3),
        block((w - 0.2, d - 0.16, 0.018), (0, 0, 0.14), m, 0.006),
        *_legs(w, d, h - 0.03, 0.07, 0.024, m),
    ]
    below = RestSurface(0.158, -w / 2 + 0.14, w / 2 - 0.14, -d / 2 + 0.1, d / 2 - 0.1, h - 0.2)
    return assemble("coffee table", parts, [RestSurface(h, -w / 2, w / 2, -d / 2, d / 2), below])


def bookshelf(p: Palette, rng: Rng) -> ObjectModel:
    m, back = wood(p, rng), paint(p.painted, 0.05)
    w, d, shelves = rng.uniform(0.82, 0.98), 0.30, 5
    pitch = rng.uniform(0.345, 0.375)
    h = shelves * pitch + 0.08
    levels = [0.05 + k * pitch for k in range(shelves + 1)]
    parts = [
        *(block((0.024, d, h), (s * (w / 2 - 0.012), 0, 0), m, 0.003) for s in SIDES),
        block((w - 0.05, 0.008, h - 0.07), (0, d / 2 - 0.006, 0.05), back, 0.001),
        *(block((w - 0.05, d - 0.012, 0.022), (0, -0.004, z), m, 0.003) for z in levels),
        block((w - 0.06, 0.016, 0.045), (0, -d / 2 + 0.03, 0.003), m, 0.002),
    ]
    x = w / 2 - 0.03
    top = RestSurface(levels[-1] + 0.022, -x, x, -d / 2 + 0.03, d / 2 - 0.03)
    boards = [RestSurface(z + 0.022, -x, x, -d / 2 + 0.015, d / 2 - 0.015, pitch - 0.03) for z in levels[:-1]]
    return assemble("bookshelf", parts, [top, *boards])


def cabinet(p: Palette, rng: Rng, width: float = 1.5, height: float = 0.74) -> ObjectModel:
    """A sideboard on legs with doors and a bank of drawers."""
    m, front = wood(p, rng), paint(p.painted)
    w, d, foot = width, 0.43, 0.15
    parts = [block((w, d, height - foot), (0, 0, foot), m, 0.008, 2), *_legs(w, d, foot + 0.01, 0.10, 0.022, m, 0.03)]
    bays = 3 if w > 1.2 else 2
    bay = (w - 0.05) / bays
    for k in range(bays):
        x = (k - (bays - 1) / 2) * bay
        if k == bays // 2 and bays == 3:
            tall = (height - foot - 0.05) / 3
            parts += each((foot + 0.025 + j * tall for j in range(3)), lambda z, x=x, tall=tall: (
                block((bay - 0.012, 0.018, tall - 0.010), (x, -d / 2 - 0.006, z), front, 0.004),
                _knob(0.011, (x, -d / 2 - 0.012, z + tall / 2)),
            ))  # fmt: skip
        else:
            handle = x + (1 if k < bays / 2 - 0.5 else -1) * (bay / 2 - 0.04)
            parts += [
                block((bay - 0.012, 0.018, height - foot - 0.06), (x, -d / 2 - 0.006, foot + 0.03), front, 0.004),
                block((0.010, 0.018, 0.14), (handle, -d / 2 - 0.020, (foot + height) / 2 - 0.05), BRASS, 0.004),
            ]
    return assemble("cabinet", parts, [RestSurface(height, -w / 2 + 0.01, w / 2 - 0.01, -d / 2 + 0.01, d / 2 - 0.01)])


def wardrobe(p: Palette, rng: Rng) -> ObjectModel:
    m, front = wood(p, rng), paint(p.painted)
    w, d, h = rng.uniform(1.05, 1.2), 0.56, rng.uniform(1.9, 2.0)
    parts = [
        block((w, d, h - 0.08), (0, 0, 0.08), m, 0.008, 2),
        block((w - 0.06, d - 0.06, 0.09), (0, 0.01, 0), m, 0.003),
        *each(SIDES, lambda s: (
            block((w / 2 - 0.030, 0.020, h - 0.14), (s * (w / 4 - 0.0095), -d / 2 - 0.008, 0.11), front, 0.002),
            *(
                block((w / 2 - 0.15, 0.006, tall), (s * (w / 4 - 0.0095), -d / 2 - 0.019, z), front, 0.003)
                for z, tall in ((0.18, 0.70), (1.0, h - 1.12))
            ),
            block((0.012, 0.022, 0.22), (s * 0.05, -d / 2 - 0.024, 0.92), BRASS, 0.005),
        )),
    ]  # fmt: skip
    return assemble("wardrobe", parts, [RestSurface(h, -w / 2 + 0.05, w / 2 - 0.05, -d / 2 + 0.08, d / 2 - 0.02)])


def bed(p: Palette, rng: Rng) -> ObjectModel:
    m, sheet = wood(p, rng), Material(rgb("#f3efe8"), ("fabric",), 0.3)
    quilt = cloth(pick(rng, p.accents), 0.5)
    w, d = rng.uniform(1.45, 1.62), 2.05
    parts = [
        block((w, d, 0.14), (0, 0, 0.16), m, 0.012, 2),
        *_legs(w, d, 0.17, 0.10, 0.03, m),
        block((w + 0.06, 0.05, 0.62), (0, d / 2 + 0.025, 0.30), m, 0.02, 3),
        block((w - 0.06, d - 0.08, 0.20), (0, 0, 0.27), sheet, 0.06, 4),
        block((w + 0.02, d * 0.62, 0.235), (0, -d * 0.19 - 0.01, 0.265), quilt, 0.07, 5),
        block((w + 0.03, 0.24, 0.25), (0, d * 0.12 - 0.10, 0.262), sheet, 0.07, 5),
    ]
    pillows = RestSurface(0.47, -w / 2 + 0.08, w / 2 - 0.08, d / 2 - 0.62, d / 2 - 0.06)
    return assemble("bed", parts, [pillows, RestSurface(0.50, -w / 2 + 0.1, w / 2 - 0.1, -d / 2 + 0.1, d * 0.0)])


def nightstand(p: Palette, rng: Rng) -> ObjectModel:
    m, front = wood(p, rng), paint(p.painted)
    w, d, h = rng.uniform(0.42, 0.48), 0.38, rng.uniform(0.50, 0.56)
    tall = (h - 0.20) / 2
    parts = [
        block((w, d, h - 0.16), (0, 0, 0.16), m, 0.008, 2),
        *_legs(w, d, 0.17, 0.06, 0.018, m, 0.015),
        *each((0.18 + k * tall for k in range(2)), lambda z: (
            block((w - 0.05, 0.018, tall - 0.012), (0, -d / 2 - 0.006, z), front, 0.004),
            _knob(0.012, (0, -d / 2 - 0.012, z + tall / 2)),
        )),
    ]  # fmt: skip
    return assemble("nightstand", parts, [RestSurface(h, -w / 2 + 0.01, w / 2 - 0.01, -d / 2 + 0.02, d / 2 - 0.01)])


def wall_shelf(p: Palette, rng: Rng) -> ObjectModel:
    m, dark = wood(p, rng), metal(p)
    w, d = rng.uniform(0.8, 1.0), 0.21
    parts = [
        block((w, d, 0.03), (0, 0, 0.10), m, 0.005),
        *each(SIDES, lambda s: (
            block((0.016, 0.012, 0.10), (s * w * 0.36, d / 2 - 0.006, 0), dark, 0.003),
            rod((s * w * 0.36, d / 2 - 0.008, 0.01), (s * w * 0.36, -d / 2 + 0.04, 0.10), 0.006, dark),
        )),
    ]  # fmt: skip
    return assemble("shelf", parts, [RestSurface(0.13, -w / 2 + 0.02, w / 2 - 0.02, -d / 2 + 0.01, d / 2 - 0.02, 0.6)])


def bed_pillow(p: Palette, rng: Rng) -> ObjectModel:
    """A pillow lying flat."""
    code = ("#f6f2ec", pick(rng, p.accents))[int(rng.random() < 0.35)]
    return assemble("pillow", [pillow((0.60, 0.40, 0.15), (0, 0, 0), cloth(code))])


def throw_pillow(p: Palette, rng: Rng) -> ObjectModel:
    """A square cushion leaning back, as on a sofa."""
    code = pick(rng, p.accents)
    material = cloth(code) if rng.random() < 0.6 else Material((1, 1, 1), ("stripes", 7, code, "#f1e8da"), 0)
    part = pillow((0.42, 0.42, 0.15), (0, 0, 0), material)
    return assemble("pillow", [part.turned(np.pi / 2 - 0.28, 0)])


def rug(p: Palette, rng: Rng, width: float, depth: float) -> ObjectModel:
    """A woven rug, round where width equals depth."""
    material = Material((1, 1, 1), ("rug", int(rng.integers(4)), *p.rug), 0)
    if width == depth:
        profile = [(0, 0), (width / 2 - 0.004, 0), (width / 2, 0.006), (width / 2 - 0.004, 0.012), (0, 0.012)]
        return assemble("rug", [lathe(profile, (0, 0, 0), material, 72)])
    linen = Material(WHITE.color, ("fabric",), 0.12)
    # A hem closes the ends, whose sides would show the pattern seen from the top.
    parts = [
        block((width, depth, 0.012), (0, 0, 0), material, 0.005),
        *each(
            SIDES,
            lambda s: (
                block((0.014, depth + 0.001, 0.0125), (s * width / 2, 0, 0), linen, 0.004),
                block((0.05, depth - 0.01, 0.006), (s * (width / 2 + 0.024), 0, 0), linen, 0.002),
            ),
        ),
    ]
    return assemble("rug", parts)
