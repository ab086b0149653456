"""Lighting of a room (sun through the window, ceiling lamp, a single bounce) and shading: textured, partly glossy,
antialiased, developed for display."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np

from pipeline.geometry.camera import Camera
from pipeline.synthetic.raycast import (
    OFFSET_M,
    Looks,
    Surfaces,
    TracedRoom,
    find_surfaces,
    looks,
    pixel_rays,
    reflectance,
    resolve,
)
from pipeline.system.frozen import dataclass

SUN = np.array([3.7, 3.2, 2.5], dtype=np.float32)
LAMP = np.array([3.3, 2.9, 2.4], dtype=np.float32)
AMBIENT = np.array([0.60, 0.565, 0.53], dtype=np.float32)
SKY = np.array([3.4, 3.9, 4.6], dtype=np.float32)
"""Irradiance of the sun, intensity of the lamp, the room's mean light at a bounce, radiance of the sky."""

BOUNCES = 4
LAMPS = 2
"""Rays an entry of the light map: into the room, and towards places on the lamp."""


@dataclass(frozen=True)
class LightMap:
    """Indirect and lamp light at every second pixel. `entries` (rows * columns, 9) float32: irradiance, and the
    position and normal of the surface it belongs to, side by side so that each is fetched once."""

    entries: np.ndarray
    rows: int
    columns: int


def sunlight(scene: TracedRoom, s: Surfaces) -> np.ndarray:
    """Irradiance of the sun through the window."""
    room = scene.room
    sun = room.sun.astype(np.float32)
    cosine = s.normal @ sun
    out = np.zeros_like(s.position)
    # Where the way to the sun crosses the window's wall; what sticks out of it has crossed already.
    way = (np.float32(room.width) - s.position[:, 0]) / sun[0]
    y, z = s.position[:, 1] + way * sun[1], s.position[:, 2] + way * sun[2]
    y0, y1, z0, z1 = room.opening
    through = (y > y0) & (y < y1) & (z > z0) & (z < z1) | (way < 0.01)
    facing = np.flatnonzero(through & (cosine > 0) & s.hit)
    facing = facing[s.flat[facing] @ sun > 0]
    if len(facing):
        start = s.position[facing] + OFFSET_M * s.flat[facing]
        clear = ~scene.tracer.blocked(start, np.broadcast_to(sun, start.shape))
        lit = facing[clear]
        out[lit] = cosine[lit, None] * SUN
    return out


def _lamp_place(scene: TracedRoom) -> np.ndarray:
    room = scene.room
    return np.array([room.width * 0.48, room.depth * 0.42, room.height - 0.12], dtype=np.float32)


def radiance(scene: TracedRoom, look: Looks, start: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Radiance ((N, 3)) along rays, from mean colours and unshadowed lamp light."""
    found = resolve(scene, scene.tracer.first(start, directions), start, directions, round_off=False)
    to_lamp = _lamp_place(scene) - found.position
    square = np.maximum(np.einsum("ij,ij->i", to_lamp, to_lamp), 0.25)
    cosine = np.clip(np.einsum("ij,ij->i", found.normal, to_lamp) / np.sqrt(square), 0, 1)
    light = AMBIENT + (0.6 * cosine / square)[:, None] * LAMP + sunlight(scene, found)
    out = look.mean[found.part] * (light + look.emission[found.part][:, None])
    out[~found.hit] = sky(directions[~found.hit])
    return out


def sky(directions: np.ndarray) -> np.ndarray:
    """Radiance outside the window: a pale sky over hazy green."""
    slope = directions[:, 2] / np.maximum(np.linalg.norm(directions[:, :2], axis=1), 1e-6)
    up = np.clip(slope * 2.5, 0, 1)[:, None]
    haze = np.array([4.2, 4.1, 3.8], dtype=np.float32)
    ground = np.array([1.25, 1.45, 0.85], dtype=np.float32)
    wave = 0.05 * np.sin(9 * np.arctan2(directions[:, 1], directions[:, 0]))
    sky = haze + up * (SKY - haze)
    return np.where((slope < -0.03 + wave)[:, None], ground, sky).astype(np.float32)


@lru_cache(maxsize=1)
def _directions() -> np.ndarray:
    """Cosine-distributed directions (16, BOUNCES, 3) about +z: a set per cell of a 4x4 tile.

    The points are the R2 low-discrepancy sequence (Roberts 2018); consecutive
    points go to different cells, so any 4x4 window holds the whole sequence.
    """
    n = np.arange(16 * BOUNCES)
    a, b = (0.5 + n * 0.7548776662) % 1, (0.5 + n * 0.5698402910) % 1
    radius, angle = np.sqrt(a), 2 * np.pi * b
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - a)], -1)
    return points.reshape(BOUNCES, 16, 3).transpose(1, 0, 2).astype(np.float32)


def light_map(scene: TracedRoom, s: Surfaces, h: int, w: int) -> LightMap:
    look = looks(scene)
    keep = np.zeros((h, w), dtype=bool)
    keep[::2, ::2] = True
    chosen = np.flatnonzero(keep)
    rows, columns = -(-h // 2), -(-w // 2)
    position, normal = s.position[chosen], s.normal[chosen]
    start = position + OFFSET_M * normal
    y, x = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    cell = ((y % 4) * 4 + x % 4).ravel()
    # A frame about each normal (Duff et al. 2017).
    sign = np.where(normal[:, 2] >= 0, 1.0, -1.0).astype(np.float32)
    a = -1.0 / (sign + normal[:, 2])
    b = normal[:, 0] * normal[:, 1] * a
    tangent = np.stack([1 + sign * normal[:, 0] ** 2 * a, sign * b, -sign * normal[:, 0]], -1)
    other = np.stack([b, sign + normal[:, 1] ** 2 * a, -normal[:, 1]], -1)
    total = np.zeros_like(position)
    for k in range(BOUNCES):
        d = _directions()[cell, k]
        rays = d[:, :1] * tangent + d[:, 1:2] * other + d[:, 2:] * normal
        total += np.minimum(radiance(scene, look, start, rays), 4.5)
    total /= BOUNCES
    place = _lamp_place(scene)
    for k in range(LAMPS):
        n = cell * LAMPS + k
        panel = np.stack([(n * 0.7548776662) % 1 - 0.5, (n * 0.5698402910) % 1 - 0.5, np.zeros(len(n))], -1)
        to_lamp = (place + 0.9 * panel - start).astype(np.float32)
        square = np.einsum("ij,ij->i", to_lamp, to_lamp)
        distance = np.sqrt(square)
        cosine = np.einsum("ij,ij->i", normal, to_lamp) / distance
        facing = np.flatnonzero((cosine > 0) & (to_lamp[:, 2] > 0))
        found = scene.tracer.first(start[facing], to_lamp[facing])
        lit = facing[~(found.t < 0.98)]
        down = to_lamp[lit, 2] / distance[lit]
        total[lit] += (cosine[lit] * (0.25 + 0.75 * down) / np.maximum(square[lit], 0.2) / LAMPS)[:, None] * LAMP
    shape = (rows, columns, 3)
    total, position, normal = total.reshape(shape), position.reshape(shape), normal.reshape(shape)
    depth = s.depth[chosen].reshape(rows, columns)
    # The wide passes even out what so few rays leave on walls; contact shadows differ by more than they may.
    total = _tame(total, position, depth)
    for step, reach, likeness in ((1, (-1, 3), 0.0), (3, (-1, 2), 0.0), (5, (-1, 2), 0.12), (9, (-1, 2), 0.06)):
        total = _smooth(total, position, normal, depth, step, reach, likeness)
    return LightMap(np.concatenate([total, position, normal], axis=2).reshape(-1, 9), rows, columns)


def _tame(light: np.ndarray, position: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Clip entries much darker or brighter than the neighbourhood. On folds finer than the map no neighbour lies on the
    same smooth surface, so that the noise of an entry's few rays would stay."""
    h, w = depth.shape
    widths = ((2, 2), (2, 2), (0, 0))
    L, P = (np.pad(a, widths, mode="edge") for a in (light, position))
    total, weight = np.full_like(light, 1e-6), np.full((h, w), 1e-6, dtype=np.float32)
    reach = np.square(0.04 * np.maximum(depth, 0.3))
    for dy, dx in product((-2, 0, 2), repeat=2):
        window = (slice(2 + dy, 2 + dy + h), slice(2 + dx, 2 + dx + w))
        away = P[window] - position
        near = np.einsum("ijk,ijk->ij", away, away) < reach
        total += near[..., None] * L[window]
        weight += near
    mean = total / weight[..., None]
    return np.clip(light, 0.72 * mean, 1.8 * mean)


def _smooth(
    light: np.ndarray,
    position: np.ndarray,
    normal: np.ndarray,
    depth: np.ndarray,
    step: int,
    reach: tuple[int, int],
    likeness: float,
) -> np.ndarray:
    """Mean over neighbours `step` apart on the same smooth surface. With a `likeness` above 0, only over those whose
    light is within that share of its own."""
    h, w = depth.shape
    offsets = [step * k for k in range(*reach)]
    pad = step * max(abs(reach[0]), reach[1])
    widths = ((pad, pad), (pad, pad), (0, 0))
    L, P, N = (np.pad(a, widths, mode="edge") for a in (light, position, normal))
    tolerance = 1.0 / (0.006 * np.maximum(depth, 0.3))
    total, weight = np.zeros_like(light), np.zeros((h, w), dtype=np.float32)
    for dy, dx in product(offsets, repeat=2):
        window = (slice(pad + dy, pad + dy + h), slice(pad + dx, pad + dx + w))
        # A chord of a round surface lies across the mean of the normals at its ends.
        off = 0.5 * np.abs(np.einsum("ijk,ijk->ij", normal + N[window], P[window] - position))
        alike = np.einsum("ijk,ijk->ij", normal, N[window])
        k = np.clip(1.5 - off * tolerance, 0, 1) * np.clip(4 * alike - 3, 0.0, 1)
        if likeness:
            change = np.abs(L[window][..., 1] / light[..., 1] - 1) / likeness
            k *= np.clip(2 - 2 * change, 0, 1)
        if dy == dx == 0:
            k += 1e-4
        total += k[..., None] * L[window]
        weight += k
    return total / weight[..., None]


def gather(lights: LightMap, s: Surfaces, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Light map values at samples, from the four nearest entries on the same surface."""
    rows, columns = lights.rows, lights.columns
    y, x = (
        np.clip(np.asarray(v, dtype=np.float32) / 2, 0, rows - 1),
        np.clip(np.asarray(u, dtype=np.float32) / 2, 0, columns - 1),
    )
    y0, x0 = np.minimum(y.astype(np.int32), max(rows - 2, 0)), np.minimum(x.astype(np.int32), max(columns - 2, 0))
    fy, fx = y - y0.astype(np.float32), x - x0.astype(np.float32)
    here = np.einsum("ij,ij->i", s.normal, s.position)
    total, weight = np.zeros_like(s.position), np.zeros(len(y), dtype=np.float32)
    tolerance = 1.0 / (0.01 * np.maximum(s.depth, 0.3))
    for dy, dx in product((0, 1), repeat=2):
        index = np.minimum(y0 + dy, rows - 1) * columns + np.minimum(x0 + dx, columns - 1)
        bilinear = (fy if dy else 1 - fy) * (fx if dx else 1 - fx)
        entry = lights.entries.take(index, axis=0)
        off = np.abs(np.einsum("ij,ij->i", s.normal, entry[:, 3:6]) - here)
        alike = np.einsum("ij,ij->i", s.normal, entry[:, 6:])
        k = (bilinear + 0.02) * (np.clip(1.5 - off * tolerance, 0, 1) * np.clip(2 * alike - 1, 0, 1) + 1e-4)
        total += k[:, None] * entry[:, :3]
        weight += k
    return total / weight[:, None]


EXPOSURE = 0.72
PALENESS = 0.17
CHUNK = 1 << 16
"""Samples shaded at once: few enough to stay in the processor's cache."""


def render_colour(scene: TracedRoom, camera: Camera, surfaces: Surfaces, directions: np.ndarray) -> np.ndarray:
    """Colour (H, W, 3) uint8 sRGB of the central rays, with antialiased edges."""
    h, w = camera.height, camera.width
    lights = light_map(scene, surfaces, h, w)
    v, u = (g.ravel() for g in np.meshgrid(np.arange(h), np.arange(w), indexing="ij"))
    image = np.empty((h * w, 3), dtype=np.float32)
    for first in range(0, h * w, CHUNK):
        k = slice(first, first + CHUNK)
        image[k] = _shade(scene, camera, surfaces.part_of(k), directions[k], lights, v[k], u[k])
    image = image.reshape(h, w, 3)
    # Only pixels where a neighbour differs gain from more rays.
    step = np.zeros((h, w), dtype=np.float32)
    grey = image.mean(axis=2)
    part = np.where(surfaces.hit, surfaces.part, -1).reshape(h, w)
    for a, b in (
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
    ):
        # Relative to the brightness, as the eye sees it: thin seams on dark doors count too.
        change = np.abs(grey[a] - grey[b]) / (0.25 + np.minimum(grey[a], grey[b])) + 0.03 * (part[a] != part[b])
        step[a] = np.maximum(step[a], change)
        step[b] = np.maximum(step[b], change)
    ev, eu = np.nonzero(step > 0.07)
    total = image[ev, eu]
    for dv, du in ((-0.37, -0.10), (0.10, 0.37), (0.27, -0.27)):
        rays = pixel_rays(camera, ev + dv, eu + du)
        total += _shade(scene, camera, find_surfaces(scene, camera, rays), rays, lights, ev + dv, eu + du)
    image[ev, eu] = total / 4
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)


def _shade(
    scene: TracedRoom,
    camera: Camera,
    s: Surfaces,
    directions: np.ndarray,
    lights: LightMap,
    v: np.ndarray,
    u: np.ndarray,
) -> np.ndarray:
    """Display colours ((N, 3) float32, sRGB 0..1) of samples at pixels (u, v)."""
    look = looks(scene)
    albedo = reflectance(scene, look, s, 1.0 / camera.fx)
    light = gather(lights, s, v, u) + sunlight(scene, s)
    color = albedo * (light + look.emission[s.part][:, None])
    gloss = look.gloss[s.part]
    shiny = np.flatnonzero((gloss > 0.1) & s.hit)
    if len(shiny):
        view = directions[shiny] / np.linalg.norm(directions[shiny], axis=1, keepdims=True)
        n = s.normal[shiny]
        cosine = np.clip(-np.einsum("ij,ij->i", view, n), 0, 1)
        mirrored = view + 2 * cosine[:, None] * n
        start = s.position[shiny] + OFFSET_M * n
        seen = radiance(scene, look, start, mirrored)
        # Schlick's approximation; metals (high gloss) reflect in their own colour.
        g = gloss[shiny][:, None]
        f0 = np.where(g > 0.6, 0.45 * albedo[shiny], 0.04)
        fresnel = f0 + (1 - f0) * ((1 - cosine) ** 5)[:, None]
        color[shiny] += np.minimum(seen, 4.0) * fresnel * np.clip(1.6 * g, 0, 1)
    color[~s.hit] = sky(directions[~s.hit])
    return _develop(color)


def _develop(linear: np.ndarray) -> np.ndarray:
    """Display values from radiance: Narkowicz's fit of the ACES filmic curve, then sRGB's transfer function."""
    grey = linear @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    x = np.maximum(linear + PALENESS * (grey[:, None] - linear), 0) * EXPOSURE
    y = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    return np.where(y <= 0.0031308, 12.92 * y, 1.055 * y ** (1 / 2.4) - 0.055).astype(np.float32)
