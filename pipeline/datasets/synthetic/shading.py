"""Colour: textured, lit and partly glossy surfaces, antialiased and developed for display."""

from __future__ import annotations

import numpy as np

from pipeline.datasets.synthetic.lighting import LightMap, gather, light_map, radiance, sky, sunlight
from pipeline.datasets.synthetic.raycast import Scene, pixel_rays
from pipeline.datasets.synthetic.surfaces import OFFSET_M, Surfaces, find_surfaces, looks, reflectance
from pipeline.geometry.camera import Camera

EXPOSURE = 0.72
PALENESS = 0.17
CHUNK = 1 << 16
"""Samples shaded at once: few enough to stay in the processor's cache."""


def render_colour(scene: Scene, camera: Camera, surfaces: Surfaces, directions: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 sRGB of what the central rays found, with antialiased edges."""
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
    scene: Scene, camera: Camera, s: Surfaces, directions: np.ndarray, lights: LightMap, v: np.ndarray, u: np.ndarray
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
