"""Procedural periodic textures with mip levels, and lookup."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from pipeline.synthetic.model import TextureKey, rgb

SIZE = 512


@lru_cache(maxsize=256)
def pyramid(key: TextureKey) -> tuple[np.ndarray, ...]:
    """Texture of `key` and halvings down to 4 pixels: (S, S, 3) float32, linear. Tinted kinds (wood, fabric, ...) have
    a mean near 1; painted kinds (rug, picture, screen, ...) hold the final colours."""
    kind, *arguments = key
    image = np.clip(_KINDS[str(kind)](*arguments), 0.0, 2.0).astype(np.float32)
    levels = [np.ascontiguousarray(image)]
    while min(levels[-1].shape[:2]) > 4:
        height, width = levels[-1].shape[:2]
        levels.append(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return tuple(levels)


def sample(key: TextureKey, uv: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Colours ((N, 3) float32) at texture coordinates `uv` ((N, 2) in repeats). `footprint` ((N,)) is the width of a
    pixel in repeats; it selects the mip level, so that far floors do not shimmer."""
    levels = pyramid(key)
    level = np.clip(np.rint(np.log2(np.maximum(footprint * SIZE, 1e-6))), 0, len(levels) - 1).astype(np.int8)
    out = np.empty((len(uv), 3), dtype=np.float32)
    for k in np.unique(level):
        chosen = np.flatnonzero(level == k)
        image = levels[k]
        height, width = image.shape[:2]
        # remap takes at most 32767 rows, so the points are laid out as a picture.
        pad = -len(chosen) % 256
        at = np.pad(uv[chosen] % 1.0, ((0, pad), (0, 0))).astype(np.float32).reshape(-1, 256, 2)
        x, y = at[..., 0] * width - 0.5, at[..., 1] * height - 0.5
        found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        out[chosen] = found.reshape(-1, 3)[: len(chosen)]
    return out


def _rng(name: str, seed: int = 0) -> np.random.Generator:
    return np.random.default_rng([seed, *name.encode()])


def _noise(rng: np.random.Generator, fx: float, fy: float, size: int = SIZE) -> np.ndarray:
    """Periodic smooth noise, mean 0, deviation 1, with about fx and fy waves across."""
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    ky = np.fft.fftfreq(size)[:, None] * size / fy
    kx = np.fft.rfftfreq(size)[None] * size / fx
    field = np.fft.irfft2(spectrum * np.exp(-0.5 * (kx**2 + ky**2)), s=(size, size))
    field -= field.mean()
    return field / field.std()


def _grey(value: np.ndarray) -> np.ndarray:
    return np.repeat(value[..., None], 3, axis=2)


def _grain(rng: np.random.Generator, size: int = SIZE) -> np.ndarray:
    """Wood grain running along x, about -1..1."""
    y = np.arange(size)[:, None] / size
    bend = 0.05 * _noise(rng, 2, 3, size) + 0.01 * _noise(rng, 8, 8, size)
    rings = np.sin(2 * np.pi * (9 * y + 9 * bend))
    return 0.45 * rings + 0.35 * _noise(rng, 4, 90, size) + 0.25 * _noise(rng, 14, 160, size)


def _wood() -> np.ndarray:
    rng = _rng("wood")
    grain = _grain(rng)
    tone = np.array([1.0, 1.06, 1.15])
    return np.clip(1 + 0.13 * grain, 0.5, 1.4)[..., None] ** tone


def _planks() -> np.ndarray:
    """Eight boards across, with staggered ends, for a span of 1.2 m."""
    rng = _rng("planks")
    size = SIZE
    out = np.empty((size, size, 3))
    width = size // 8
    base = _grain(rng)
    for k in range(8):
        cut = int(rng.integers(size))
        other = (cut + int(rng.integers(size // 3, size // 2))) % size
        shift = int(rng.integers(size))
        tone = np.full(size, 1 + 0.10 * rng.standard_normal())
        low, high = sorted((cut, other))
        tone[low:high] = 1 + 0.10 * rng.standard_normal()
        strip = 1 + 0.10 * np.roll(base, (shift, 2 * shift), (0, 1))[:width]
        strip = strip * tone
        strip[:2] *= 0.66
        strip[:, [cut, (cut + 1) % size, other, (other + 1) % size]] *= 0.72
        out[k * width : (k + 1) * width] = strip[..., None] ** np.array([1.0, 1.04, 1.1])
    return out


def _herringbone() -> np.ndarray:
    """Blocks of 4 to 1 at right angles, for a span of 0.9 m."""
    rng = _rng("herringbone")
    n = 8
    cell = SIZE // n
    grain = _grain(rng)
    tones = 1 + 0.09 * rng.standard_normal(2 * n)
    yy, xx = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    i, j = yy // cell, xx // cell
    phase = (j - i) % n
    level = phase < n // 2
    tone = tones[np.where(level, i, n + j)] * (1 + 0.10 * np.where(level, grain, grain.T))
    u, v = xx % cell, yy % cell
    seam = np.where(level, (v < 2) | ((phase == 0) & (u < 2)), (u < 2) | ((phase == n - 1) & (v < 2)))
    return _grey(np.where(seam, 0.68 * tone, tone)) ** np.array([1.0, 1.04, 1.1])


def _tiles() -> np.ndarray:
    """Four by four square tiles with pale joints, for a span of 1.6 m."""
    rng = _rng("tiles")
    cell = SIZE // 4
    tone = np.kron(1 + 0.05 * rng.standard_normal((4, 4)), np.ones((cell, cell)))
    tone = tone * (1 + 0.035 * _noise(rng, 9, 9) + 0.02 * _noise(rng, 60, 60))
    k = np.arange(SIZE) % cell
    joint = (k < 3)[:, None] | (k < 3)[None, :]
    return _grey(np.where(joint, 0.74, tone))


def _plaster() -> np.ndarray:
    rng = _rng("plaster")
    return _grey(1 + 0.006 * _noise(rng, 5, 5) + 0.010 * _noise(rng, 70, 70))


def _fabric() -> np.ndarray:
    """A plain weave, for a span of 0.25 m."""
    rng = _rng("fabric")
    k = np.arange(SIZE)
    weave = np.sin(2 * np.pi * k * 48 / SIZE)[:, None] * np.sin(2 * np.pi * k * 48 / SIZE)[None, :]
    return _grey(1 + 0.10 * weave + 0.015 * _noise(rng, 6, 6) + 0.06 * _noise(rng, 110, 110))


def _basket() -> np.ndarray:
    """Woven cane, for a span of 0.16 m."""
    rng = _rng("basket")
    n = 8
    cell = SIZE // n
    yy, xx = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    over = ((yy // cell) + (xx // cell)) % 2 == 0
    u, v = (xx % cell) / cell, (yy % cell) / cell
    bump = np.where(
        over, np.sin(np.pi * v) * (0.6 + 0.4 * np.sin(np.pi * u)), np.sin(np.pi * u) * (0.5 + 0.4 * np.sin(np.pi * v))
    )
    return _grey(0.45 + 0.75 * bump + 0.05 * _noise(rng, 40, 40))


def _speckle() -> np.ndarray:
    rng = _rng("speckle")
    return _grey(np.where(_noise(rng, 70, 70) > 2.1, 0.55, 1.0) + 0.02 * _noise(rng, 6, 6))


def _rug(style: int, ground: str, figure: str, accent: str) -> np.ndarray:
    """A whole rug: 0 bordered, 1 diamonds, 2 stripes, 3 Berber lines."""
    rng = _rng("rug", style)
    c0, c1, c2 = (np.array(rgb(c)) for c in (ground, figure, accent))
    y, x = np.meshgrid(np.linspace(-1, 1, SIZE), np.linspace(-1, 1, SIZE), indexing="ij")
    edge = np.maximum(np.abs(x), np.abs(y))
    out = np.broadcast_to(c0, (SIZE, SIZE, 3)).copy()
    if style == 0:
        out[(edge > 0.78) & (edge < 0.90)] = c1
        out[(edge > 0.72) & (edge < 0.745)] = c2
        field = (edge < 0.72) & (np.abs(((np.abs(x) + np.abs(y)) * 5) % 1 - 0.5) < 0.11)
        out[field] = 0.5 * c0 + 0.5 * c1
    elif style == 1:
        a, b = (x * 4 + y * 4) % 2 - 1, (x * 4 - y * 4) % 2 - 1
        out[(np.abs(a) < 0.10) | (np.abs(b) < 0.10)] = c1
        out[(np.abs(np.abs(a) - 0.5) < 0.12) & (np.abs(np.abs(b) - 0.5) < 0.12)] = c2
        out[edge > 0.93] = c1
    elif style == 2:
        band = (x * 8 + 8).astype(int) % 8
        out[(band == 1) | (band == 6)] = c1
        out[(band == 3)] = c2
        out[np.abs(((x * 8) % 1) - 0.5) > 0.47] = c0 * 0.9
    else:
        zig = np.abs((x * 3 + 0.12 * np.abs(((y * 9) % 2) - 1)) % 1 - 0.5)
        out[zig < 0.05] = c1
        out[edge > 0.96] = c0 * 0.85
    pile = 1 + 0.07 * _noise(rng, 110, 110) + 0.05 * _noise(rng, 12, 12)
    return 0.86 * out * pile[..., None]


def _picture(style: int, seed: int, *colours: str) -> np.ndarray:
    """A painting: 0 hills under a sun, 1 overlapping shapes, 2 a leaf study, 3 soft blocks of colour."""
    rng = _rng("picture", 100 * seed + style)
    c = [np.array(rgb(colour)) for colour in colours]
    paper = np.array(rgb("#f3ece0"))
    y, x = np.meshgrid(np.linspace(0, 1, SIZE), np.linspace(0, 1, SIZE), indexing="ij")
    out = np.broadcast_to(paper, (SIZE, SIZE, 3)).copy()
    if style == 0:
        out[:] = paper * (1 - 0.35 * y[..., None]) + c[0] * 0.35 * y[..., None]
        out[(x - rng.uniform(0.3, 0.7)) ** 2 + (y - 0.36) ** 2 < 0.13**2] = c[1]
        for k in range(4):
            ridge = (
                0.45 + 0.13 * k + 0.07 * np.sin(x * rng.uniform(4, 8) + rng.uniform(0, 6)) + 0.02 * np.sin(x * 17 + k)
            )
            out[y > ridge] = c[(k + 2) % len(c)] * (1.0 - 0.12 * k)
    elif style == 1:
        for k in range(5):
            u, v, r = rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.8), rng.uniform(0.12, 0.28)
            inside = (x - u) ** 2 + (y - v) ** 2 < r**2
            if k % 2:
                inside &= y < v
            out[inside] = c[k % len(c)]
    elif style == 2:
        stem = np.abs(x - 0.5 - 0.05 * np.sin(4 * y)) < 0.006
        out[stem & (y > 0.15) & (y < 0.9)] = c[0] * 0.6
        for k in range(9):
            side, v = (-1) ** k, 0.2 + 0.07 * k
            u = (x - 0.5 - side * 0.17) * side
            w = (y - v) + 0.55 * u
            out[(u / 0.15) ** 2 + (w / 0.038) ** 2 < 1] = c[k % min(2, len(c))]
    else:
        for k in range(4):
            u, v, a, b = 0.22 + 0.19 * k, rng.uniform(0.35, 0.65), rng.uniform(0.10, 0.17), rng.uniform(0.18, 0.33)
            field = (np.abs(x - u) / a) ** 4 + (np.abs(y - v) / b) ** 4 < 1
            out[field] = 0.25 * out[field] + 0.75 * c[(k + seed) % len(c)]
        out *= (1 + 0.05 * _noise(rng, 30, 6))[..., None]
    margin = (np.minimum(x, 1 - x) < 0.07) | (np.minimum(y, 1 - y) < 0.07)
    if style > 0:
        out[margin] = paper
    return out


def _screen(seed: int) -> np.ndarray:
    """A desktop: a graded wallpaper with two windows, or hills at dusk."""
    rng = _rng("screen", seed)
    y, x = np.meshgrid(np.linspace(0, 1, SIZE), np.linspace(0, 1, SIZE), indexing="ij")
    top, bottom = (("#2b4a78", "#d88a6a"), ("#1f5d6b", "#9ccbb5"), ("#39386b", "#c97b94"))[seed % 3]
    out = (1 - y[..., None]) * np.array(rgb(top)) + y[..., None] * np.array(rgb(bottom))
    for k in range(3):
        ridge = 0.6 + 0.1 * k + 0.06 * np.sin(x * (5 + 2 * k) + seed + k)
        out[y > ridge] = np.array(rgb(top)) * (0.6 - 0.15 * k)
    if seed % 2 == 0:
        for u0, v0, u1, v1 in ((0.08, 0.12, 0.55, 0.78), (0.6, 0.2, 0.93, 0.6)):
            window = (x > u0) & (x < u1) & (y > v0) & (y < v1)
            out[window] = np.array(rgb("#f4f5f2"))
            out[window & (y < v0 + 0.06)] = np.array(rgb("#d7dbe0"))
            rows = np.floor((y - v0) * 28).astype(int)
            length = u0 + 0.03 + (u1 - u0 - 0.06) * (0.35 + 0.65 * rng.random(40))[np.clip(rows, 0, 39)]
            text = window & (rows > 2) & (((y - v0) * 28) % 1 < 0.45) & (x > u0 + 0.03) & (x < length)
            out[text] = np.array(rgb("#7b8794"))
    out[y > 0.96] = np.array(rgb("#22262e"))
    return out


def _keys(dark: bool) -> np.ndarray:
    """A keyboard seen from above: five rows of keys."""
    key, gap = (rgb("#34373c"), rgb("#17181b")) if dark else (rgb("#f2f2f0"), rgb("#b9bcc0"))
    y, x = np.meshgrid(np.linspace(0, 1, SIZE, endpoint=False), np.linspace(0, 1, SIZE, endpoint=False), indexing="ij")
    row = np.floor(y * 5)
    wide = (row == 0) & (x > 0.25) & (x < 0.7)
    u = (x * 14 + 0.35 * row) % 1
    inside = ((u > 0.1) & (u < 0.9) | wide) & (np.abs(y * 5 % 1 - 0.5) < 0.4) & (np.abs(x - 0.5) < 0.485)
    return np.where(inside[..., None], np.array(key), np.array(gap))


def _dial() -> np.ndarray:
    """A clock face showing ten past ten."""
    y, x = np.meshgrid(np.linspace(1, -1, SIZE), np.linspace(-1, 1, SIZE), indexing="ij")
    radius, angle = np.hypot(x, y), np.arctan2(x, y)
    out = np.broadcast_to(np.array(rgb("#f6f2e9")), (SIZE, SIZE, 3)).copy()
    ink = np.array(rgb("#2b2b2b"))
    tick = (np.abs((angle / (np.pi / 6) + 0.5) % 1 - 0.5) < 0.05) & (radius > 0.72) & (radius < 0.86)
    out[tick] = ink
    for degrees, length, width in ((-55, 0.5, 0.035), (60, 0.7, 0.025)):
        a = np.deg2rad(degrees)
        along, off = x * np.sin(a) + y * np.cos(a), x * np.cos(a) - y * np.sin(a)
        out[(along > -0.08) & (along < length) & (np.abs(off) < width)] = ink
    out[radius < 0.06] = np.array(rgb("#b5532f"))
    return out


def _cover(seed: int, ground: str, ink: str) -> np.ndarray:
    """A book's cover: a title block, a rule and an emblem."""
    y, x = np.meshgrid(np.linspace(0, 1, SIZE), np.linspace(0, 1, SIZE), indexing="ij")
    out = np.broadcast_to(np.array(rgb(ground)), (SIZE, SIZE, 3)).copy()
    c = np.array(rgb(ink))
    out[(np.abs(x - 0.5) < 0.3) & (np.abs(y - 0.2) < 0.025)] = c
    out[(np.abs(x - 0.5) < 0.2) & (np.abs(y - 0.29) < 0.018)] = c
    if seed % 2:
        out[((x - 0.5) ** 2 + (y - 0.62) ** 2) < 0.03] = c
    else:
        out[(np.abs(x - 0.5) < 0.3) & (np.abs((y * 12) % 1 - 0.5) < 0.12) & (y > 0.5) & (y < 0.8)] = c
    return out


def _stripes(count: int, a: str, b: str) -> np.ndarray:
    """`count` bands of colour a on b, along x."""
    rng = _rng("stripes")
    band = (np.arange(SIZE) * count / SIZE % 1 < 0.5)[:, None, None]
    out = np.where(band, np.array(rgb(a)), np.array(rgb(b))) * np.ones((1, SIZE, 1))
    return out * (1 + 0.05 * _noise(rng, 90, 90))[..., None]


_KINDS: dict[str, Any] = {
    "wood": _wood,
    "planks": _planks,
    "herringbone": _herringbone,
    "tiles": _tiles,
    "plaster": _plaster,
    "fabric": _fabric,
    "basket": _basket,
    "speckle": _speckle,
    "rug": _rug,
    "picture": _picture,
    "screen": _screen,
    "keys": _keys,
    "dial": _dial,
    "cover": _cover,
    "stripes": _stripes,
}
