"""Colour: textured surfaces under the sun, a ceiling lamp and one bounce of light from the room."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.camera import Camera
from pipeline.synthetic import textures
from pipeline.synthetic.raycast import Hits, Scene, pixel_rays

SUN = np.array([3.7, 3.2, 2.5], dtype=np.float32)
LAMP = np.array([3.3, 2.9, 2.4], dtype=np.float32)
AMBIENT = np.array([0.60, 0.565, 0.53], dtype=np.float32)
SKY = np.array([3.4, 3.9, 4.6], dtype=np.float32)
"""Irradiance of the sun, intensity of the lamp, the room's mean light at a bounce, radiance of the sky."""

EXPOSURE = 0.72
PALENESS = 0.17
BOUNCES = 4
LAMPS = 2
OFFSET_M = 2e-3


@dataclass(frozen=True)
class Looks:
    """The materials of a scene as arrays, one row a part."""

    color: np.ndarray
    mean: np.ndarray
    texture: np.ndarray
    keys: tuple[tuple[object, ...], ...]
    span: np.ndarray
    gloss: np.ndarray
    emission: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True)
class Surfaces:
    """What N rays see: float32, world; `normal` is smoothed, `flat` the triangle's own, both towards the viewer."""

    hit: np.ndarray
    part: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    depth: np.ndarray


@dataclass(frozen=True)
class LightMap:
    """Indirect and lamp light at every second pixel: irradiance, and the surface it belongs to."""

    light: np.ndarray
    position: np.ndarray
    normal: np.ndarray


@lru_cache(maxsize=4)
def looks(scene: Scene) -> Looks:
    """The scene's materials, with the mean colour of each texture for bounced light."""
    keys: dict[tuple[object, ...], int] = {}
    texture, mean = [], []
    for material in scene.materials:
        color = np.array(material.color)
        if material.texture is None:
            texture.append(-1)
            mean.append(color)
        else:
            texture.append(keys.setdefault(material.texture, len(keys)))
            mean.append(color * textures.pyramid(material.texture)[-1].mean(axis=(0, 1)))
    rng = np.random.default_rng(scene.room.seed)
    return Looks(
        np.array([m.color for m in scene.materials], dtype=np.float32),
        np.array(mean, dtype=np.float32),
        np.array(texture, dtype=np.int32),
        tuple(keys),
        np.array([m.span for m in scene.materials], dtype=np.float32),
        np.array([m.gloss for m in scene.materials], dtype=np.float32),
        np.array([m.emission for m in scene.materials], dtype=np.float32),
        rng.random((len(scene.materials), 2)).astype(np.float32),
    )


def render_colour(scene: Scene, camera: Camera, surfaces: Surfaces, directions: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 sRGB of what the central rays found, with antialiased edges."""
    h, w = camera.height, camera.width
    lights = _light_map(scene, surfaces, h, w)
    v, u = (g.ravel() for g in np.meshgrid(np.arange(h), np.arange(w), indexing="ij"))
    image = _shade(scene, camera, surfaces, directions, lights, v, u).reshape(h, w, 3)
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


def find_surfaces(scene: Scene, camera: Camera, directions: np.ndarray) -> Surfaces:
    """What the rays from the camera's centre ((N, 3) directions) see first."""
    assert camera.T_world_camera is not None
    origin = camera.T_world_camera[:3, 3].astype(np.float32)
    return _resolve(scene, scene.trace(origin, directions), origin, directions)


def _resolve(scene: Scene, hits: Hits, origin: np.ndarray, directions: np.ndarray, round_off: bool = True) -> Surfaces:
    """The surfaces at hits; without `round_off` their normals are the triangles' own."""
    hit = hits.face >= 0
    face = np.where(hit, hits.face, 0)
    # Sheets are seen from both sides: the normal looks back at the viewer.
    flat = scene.face_normals.take(face, axis=0)
    away = np.where(np.einsum("ij,ij->i", flat, directions) > 0, np.float32(-1), np.float32(1))[:, None]
    flat *= away
    normal = flat
    if round_off:
        corner = scene.corner_normals.reshape(-1, 9).take(face, axis=0)
        u, v = hits.u[:, None], hits.v[:, None]
        normal = (1 - u - v) * corner[:, :3] + u * corner[:, 3:6] + v * corner[:, 6:]
        normal *= away / np.maximum(np.sqrt(np.einsum("ij,ij->i", normal, normal)), 1e-9)[:, None]
    t = np.where(hit, hits.t, 0).astype(np.float32)
    return Surfaces(hit, scene.face_part.take(face), origin + t[:, None] * directions, normal, flat, t)


def _shade(
    scene: Scene, camera: Camera, s: Surfaces, directions: np.ndarray, lights: LightMap, v: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """Display colours ((N, 3) float32, sRGB 0..1) of samples at pixels (u, v)."""
    look = looks(scene)
    albedo = _albedo(scene, look, s, 1.0 / camera.fx)
    light = _gather(lights, s, v, u) + _sunlight(scene, s)
    color = albedo * (light + look.emission[s.part][:, None])
    gloss = look.gloss[s.part]
    shiny = np.flatnonzero((gloss > 0.1) & s.hit)
    if len(shiny):
        view = directions[shiny] / np.linalg.norm(directions[shiny], axis=1, keepdims=True)
        n = s.normal[shiny]
        cosine = np.clip(-np.einsum("ij,ij->i", view, n), 0, 1)
        mirrored = view + 2 * cosine[:, None] * n
        start = s.position[shiny] + OFFSET_M * n
        seen = _radiance(scene, look, start, mirrored)
        # Schlick's approximation; metals (high gloss) reflect in their own colour.
        g = gloss[shiny][:, None]
        f0 = np.where(g > 0.6, 0.45 * albedo[shiny], 0.04)
        fresnel = f0 + (1 - f0) * ((1 - cosine) ** 5)[:, None]
        color[shiny] += np.minimum(seen, 4.0) * fresnel * np.clip(1.6 * g, 0, 1)
    color[~s.hit] = _sky(directions[~s.hit])
    return _develop(color)


def _albedo(scene: Scene, look: Looks, s: Surfaces, pixel: float) -> np.ndarray:
    """Linear reflectance of each sample, textures projected along the nearest axis of the model's frame."""
    part = s.part
    out = look.color[part]
    kind = np.where(s.hit, look.texture[part], -1)
    textured = np.flatnonzero(kind >= 0)
    if len(textured) == 0:
        return out
    p = part[textured]
    local = _into_model(scene, p, s.position[textured] - scene.part_t[p])
    normal = np.abs(_into_model(scene, p, s.normal[textured]))
    across, upright = normal[:, 0] >= normal.max(axis=1), normal[:, 2] >= normal.max(axis=1)
    low, size = scene.part_low.take(p, axis=0), (scene.part_high - scene.part_low).take(p, axis=0)
    (u, u_low, u_size), (v, v_low, v_size) = (
        [np.where(side, a[:, 1], a[:, other]) for a in (local, low, np.maximum(size, np.float32(1e-4)))]
        for side, other in ((across, 0), (upright & ~across, 2))
    )
    span = look.span[p]
    fitted = span == 0
    # Grain runs along the longer side of each face.
    turn = ~fitted & (v_size > u_size)
    u, v = np.where(turn, v, u), np.where(turn, u, v)
    scale = np.where(fitted, u_size, span)
    # Fitted pictures must not wrap their far edge into the near one.
    u = np.where(fitted, np.clip((u - u_low) / u_size, 0.002, 0.998), u / scale + look.offset[p, 0])
    v = np.where(fitted, np.clip(1 - (v - v_low) / v_size, 0.002, 0.998), v / scale + look.offset[p, 1])
    uv = np.stack([u, v], axis=1)
    footprint = s.depth[textured] * pixel / scale
    kind = kind[textured]
    for k in np.unique(kind):
        chosen = np.flatnonzero(kind == k)
        out[textured[chosen]] *= textures.sample(look.keys[k], uv[chosen], footprint[chosen])
    return np.minimum(out, 0.95)


def _into_model(scene: Scene, part: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """World vectors ((N, 3)) in the axes of their parts' models, which only ever turn about z."""
    cosine, sine = scene.part_R[part, 0, 0], scene.part_R[part, 1, 0]
    x, y, z = vectors.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def _sunlight(scene: Scene, s: Surfaces) -> np.ndarray:
    """Irradiance of the sun: only the window lets it in, so most points are in shade."""
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
        clear = ~scene.blocked(start, np.broadcast_to(sun, start.shape))
        lit = facing[clear]
        out[lit] = cosine[lit, None] * SUN
    return out


def _lamp_place(scene: Scene) -> np.ndarray:
    room = scene.room
    return np.array([room.width * 0.48, room.depth * 0.42, room.height - 0.12], dtype=np.float32)


def _radiance(scene: Scene, look: Looks, start: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Radiance ((N, 3)) that comes back along rays, from mean colours and unshadowed lamp light."""
    found = _resolve(scene, scene.trace(start, directions), start, directions, round_off=False)
    to_lamp = _lamp_place(scene) - found.position
    square = np.maximum(np.einsum("ij,ij->i", to_lamp, to_lamp), 0.25)
    cosine = np.clip(np.einsum("ij,ij->i", found.normal, to_lamp) / np.sqrt(square), 0, 1)
    light = AMBIENT + (0.6 * cosine / square)[:, None] * LAMP + _sunlight(scene, found)
    out = look.mean[found.part] * (light + look.emission[found.part][:, None])
    out[~found.hit] = _sky(directions[~found.hit])
    return out


def _sky(directions: np.ndarray) -> np.ndarray:
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
    """(16, BOUNCES, 3) cosine-distributed directions about +z: one set for each cell of a 4x4 tile.

    The points are the R2 low-discrepancy sequence (Roberts 2018); consecutive
    points go to different cells, so any 4x4 window holds the whole sequence.
    """
    n = np.arange(16 * BOUNCES)
    a, b = (0.5 + n * 0.7548776662) % 1, (0.5 + n * 0.5698402910) % 1
    radius, angle = np.sqrt(a), 2 * np.pi * b
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - a)], -1)
    return points.reshape(BOUNCES, 16, 3).transpose(1, 0, 2).astype(np.float32)


def _light_map(scene: Scene, s: Surfaces, h: int, w: int) -> LightMap:
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
        total += np.minimum(_radiance(scene, look, start, rays), 4.5)
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
        found = scene.trace(start[facing], to_lamp[facing])
        lit = facing[~(found.t < 0.98)]
        down = to_lamp[lit, 2] / distance[lit]
        total[lit] += (cosine[lit] * (0.25 + 0.75 * down) / np.maximum(square[lit], 0.2) / LAMPS)[:, None] * LAMP
    shape = (rows, columns, 3)
    total, position, normal = total.reshape(shape), position.reshape(shape), normal.reshape(shape)
    depth = s.depth[chosen].reshape(rows, columns)
    # The wide passes even out what so few rays leave on walls; contact shadows differ by more than they may.
    for step, reach, likeness in ((1, (-1, 3), 0.0), (3, (-1, 2), 0.0), (5, (-1, 2), 0.12), (9, (-1, 2), 0.06)):
        total = _smooth(total, position, normal, depth, step, reach, likeness)
    return LightMap(total, position, normal)


def _smooth(
    light: np.ndarray,
    position: np.ndarray,
    normal: np.ndarray,
    depth: np.ndarray,
    step: int,
    reach: tuple[int, int],
    likeness: float,
) -> np.ndarray:
    """Mean over neighbours `step` apart that lie on the same smooth surface.

    With a `likeness` above 0, only over those whose light is within that share of its own.
    """
    h, w = depth.shape
    offsets = [step * k for k in range(*reach)]
    pad = step * max(abs(reach[0]), reach[1])
    widths = ((pad, pad), (pad, pad), (0, 0))
    L, P, N = (np.pad(a, widths, mode="edge") for a in (light, position, normal))
    tolerance = 1.0 / (0.006 * np.maximum(depth, 0.3))
    total, weight = np.zeros_like(light), np.zeros((h, w), dtype=np.float32)
    for dy in offsets:
        for dx in offsets:
            window = (slice(pad + dy, pad + dy + h), slice(pad + dx, pad + dx + w))
            off = np.abs(np.einsum("ijk,ijk->ij", normal, P[window] - position))
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


def _gather(lights: LightMap, s: Surfaces, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Light map values at samples, from the four nearest entries on the same surface."""
    rows, columns = lights.light.shape[:2]
    y, x = (
        np.clip(np.asarray(v, dtype=np.float32) / 2, 0, rows - 1),
        np.clip(np.asarray(u, dtype=np.float32) / 2, 0, columns - 1),
    )
    y0, x0 = np.minimum(y.astype(np.int32), max(rows - 2, 0)), np.minimum(x.astype(np.int32), max(columns - 2, 0))
    fy, fx = y - y0, x - x0
    # One row an entry, so that each is fetched once.
    entries = np.concatenate([a.reshape(-1, 3) for a in (lights.light, lights.position, lights.normal)], axis=1)
    here = np.einsum("ij,ij->i", s.normal, s.position)
    total, weight = np.zeros_like(s.position), np.zeros(len(y), dtype=np.float32)
    tolerance = 1.0 / (0.01 * np.maximum(s.depth, 0.3))
    for dy in (0, 1):
        for dx in (0, 1):
            index = np.minimum(y0 + dy, rows - 1) * columns + np.minimum(x0 + dx, columns - 1)
            bilinear = (fy if dy else 1 - fy) * (fx if dx else 1 - fx)
            entry = entries.take(index, axis=0)
            off = np.abs(np.einsum("ij,ij->i", s.normal, entry[:, 3:6]) - here)
            alike = np.einsum("ij,ij->i", s.normal, entry[:, 6:])
            k = (bilinear + 0.02) * (np.clip(1.5 - off * tolerance, 0, 1) * np.clip(2 * alike - 1, 0, 1) + 1e-4)
            total += k[:, None] * entry[:, :3]
            weight += k
    return total / weight[:, None]


def _develop(linear: np.ndarray) -> np.ndarray:
    """Display values from radiance: Narkowicz's fit of the ACES filmic curve, then sRGB's transfer function."""
    grey = linear @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    x = np.maximum(linear + PALENESS * (grey[:, None] - linear), 0) * EXPOSURE
    y = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    return np.where(y <= 0.0031308, 12.92 * y, 1.055 * y ** (1 / 2.4) - 0.055).astype(np.float32)
