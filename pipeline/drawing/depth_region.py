"""The surface around a click: pixels that are connected in depth and in direction, never across a step in depth."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.surface import surface_normals, surface_step
from pipeline.system.errors import needed, require
from pipeline.system.frozen import dataclass

TOLERANCE = 0.015
"""The default."""
LEAST, MOST = 0.001, 0.05
BEND = float(np.deg2rad(3.75)) / TOLERANCE
"""By how much a surface may turn towards the viewer from one pixel to the next, radians for each unit of tolerance."""
LOOSE = 0.03
"""From this tolerance on, creases and pixels without a normal do not end a region: only steps in depth do."""
NEAR = 3
"""A click on a pixel without depth, or without a normal, means one so close to it, pixels."""
RADIUS = 3
"""Of the window of a normal, pixels."""
RIM = 5
"""Normals are known up to so many pixels from a crease or edge; a region is carried over that rim."""
NOISE = 0.0012
"""Standard deviation of 1/z of a structured-light camera, 1/m (Khoshelham and Elberink 2012)."""


@dataclass(frozen=True)
class Links:
    """Of each pixel to its neighbour on the right, or below."""

    joined: np.ndarray  # both have a depth, and no step in depth between them
    # concave float32: how far one rises out of the other's tangent plane, as a share of the depth; infinite where a
    # normal is missing
    concave: np.ndarray
    # turn float32: the angle between the normals where they turn towards each other, as in the crease between a cup and
    # its table; 0 where they turn away, as over the edge of a box. Radians.
    turn: np.ndarray
    step: np.ndarray  # float32: the difference of the depths, as a share of the depth

    def alike(self, tolerance: float, loose: bool) -> np.ndarray:
        """Tell where both pixels are of one surface; with `loose`, across creases and missing normals too."""
        if loose:
            return self.joined & ((self.concave <= tolerance) | (np.isinf(self.concave) & (self.step <= tolerance)))
        return self.joined & (self.concave <= tolerance) & (self.turn <= BEND * tolerance)


@dataclass(frozen=True)
class Surface:
    """What a frame's depth says of its surfaces."""

    # points, normals (H, W, 3) float32: camera frame, metres; the depth is smoothed within surfaces
    points: np.ndarray
    normals: np.ndarray
    known: np.ndarray  # (H, W) bool: where there is a normal
    # right, down: (H, W - 1) and (H - 1, W)
    right: Links
    down: Links

    @property
    def measured(self) -> np.ndarray:
        """(H, W) bool: where there is a depth."""
        return self.points[..., 2] > 0


def surface_of(frame: Frame) -> Surface:
    """Points, normals and links of a frame; neighbours are linked up to `lifting.surface_step`."""
    has = frame.depth > 0
    inverse = np.divide(1, frame.depth, out=np.zeros_like(frame.depth), where=has)
    # The noise of 1/z is the same at every depth, so that one width suits all.
    smooth = cv2.bilateralFilter(inverse, 5, 4 * NOISE, 2.0)
    depth = np.divide(1, smooth, out=np.zeros_like(smooth), where=has & (smooth > 0))
    v, u = np.indices(depth.shape)
    points = lift_pixels(depth.ravel(), frame.camera, v.ravel(), u.ravel()).reshape(*depth.shape, 3)
    normals, known = surface_normals(depth, frame.camera, RADIUS)
    right, down = joined(frame.depth)
    every = slice(None)
    return Surface(
        points,
        normals,
        known,
        _links(points, normals, known, right, (every, slice(None, -1)), (every, slice(1, None))),
        _links(points, normals, known, down, (slice(None, -1), every), (slice(1, None), every)),
    )


def _links(
    points: np.ndarray,
    normals: np.ndarray,
    known: np.ndarray,
    joined: np.ndarray,
    one: tuple[slice, slice],
    other: tuple[slice, slice],
) -> Links:
    step = points[other] - points[one]
    n, m, z = normals[one], normals[other], np.maximum(points[one][..., 2], np.float32(1e-6))
    rises, falls = np.einsum("ijk,ijk->ij", n, step), np.einsum("ijk,ijk->ij", m, step)
    both = known[one] & known[other]
    concave = np.where(both, np.maximum(rises, -falls) / z, np.float32(np.inf))
    # Two normals turn towards each other where each point rises above the other's plane.
    angle = np.arccos(np.clip(np.einsum("ijk,ijk->ij", n, m), -1, 1))
    return Links(joined, concave, np.where(rises > falls, angle, np.float32(0)), np.abs(step[..., 2]) / z)


def joined(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours to the right and below with no step in depth between them: (H, W - 1) and (H - 1, W) bool."""

    def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a > 0) & (b > 0) & (np.abs(a - b) <= surface_step(np.minimum(a, b)))

    return same(depth[:, :-1], depth[:, 1:]), same(depth[:-1], depth[1:])


def grown_region(surface: Surface, seeds: np.ndarray, tolerance: float = TOLERANCE) -> np.ndarray:
    """The surfaces that some pixels lie on.

    A surface ends at steps in depth and at concave creases, as where a cup stands
    on its table (after the local convexity of Stein et al. 2014); it goes on
    over the edges of a box. From pixel to pixel it may rise out of its tangent
    plane by `tolerance` times the depth.

    `seeds` (N, 2) float: x, y in pixels. Returns (H, W) bool.

    Raises InputError: a seed is outside of the picture or has no depth near it.
    """
    height, width = surface.known.shape
    require(LEAST <= tolerance <= MOST, "the tolerance is out of range", got=tolerance, expected=f"{LEAST} to {MOST}")
    loose = tolerance >= LOOSE
    bound = surface.measured if loose else surface.known
    links = surface.right.alike(tolerance, loose), surface.down.alike(tolerance, loose)
    found = np.zeros((height, width), np.bool_)
    for x, y in np.asarray(seeds, np.float64).reshape(-1, 2):
        require(0 <= x < width and 0 <= y < height, "the point is outside of the picture", got=f"{x:.1f}, {y:.1f}")
        pixel = int(x), int(y)
        seed = _nearest(bound, pixel)
        if seed is not None:
            region = flooded(bound, *links, seed)
        else:
            # Something small or strongly curved has no normals at all.
            seed = _nearest(surface.measured, pixel)
            seed = needed(seed, "there is no depth at this point", got=f"{x:.1f}, {y:.1f}")
            either = surface.right.alike(tolerance, True), surface.down.alike(tolerance, True)
            region = flooded(surface.measured & ~surface.known, *either, seed)
        found |= _with_rim(surface, region, tolerance)
    return found


def _nearest(allowed: np.ndarray, pixel: tuple[int, int]) -> tuple[int, int] | None:
    """The allowed pixel closest to one, no further than `NEAR`."""
    u, v = pixel
    top, left = max(v - NEAR, 0), max(u - NEAR, 0)
    rows, columns = np.nonzero(allowed[top : v + NEAR + 1, left : u + NEAR + 1])
    if not len(rows):
        return None
    best = int(np.argmin((rows + top - v) ** 2 + (columns + left - u) ** 2))
    return int(columns[best]) + left, int(rows[best]) + top


def link_grid(nodes: np.ndarray, right: np.ndarray, down: np.ndarray) -> np.ndarray:
    """(2H - 1, 2W - 1) uint8 in which pixels are joined where they are linked: every other cell is a link."""
    height, width = nodes.shape
    grid = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)
    grid[::2, ::2] = nodes
    grid[::2, 1::2] = right & nodes[:, :-1] & nodes[:, 1:]
    grid[1::2, ::2] = down & nodes[:-1] & nodes[1:]
    return grid


def flooded(nodes: np.ndarray, right: np.ndarray, down: np.ndarray, seed: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: the pixels that links lead to from a seed (u, v)."""
    if not nodes[seed[1], seed[0]]:
        return np.zeros(nodes.shape, np.bool_)
    grid = link_grid(nodes, right, down)
    # A mask of its own: OpenCV sets it, and wants a frame of one cell around.
    visited = np.zeros((grid.shape[0] + 2, grid.shape[1] + 2), np.uint8)
    cv2.floodFill(grid, visited, (2 * seed[0], 2 * seed[1]), (2,), flags=4)
    return grid[::2, ::2] == 2


def nearest_pixel(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far the nearest pixel of a mask ((H, W) bool) is, pixels, and its index in the flat picture; (H, W) each."""
    far, found = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    label = np.asarray(found, np.int64)
    index = np.zeros(int(label.max()) + 1, np.int64)
    index[label[mask]] = np.flatnonzero(mask)
    return np.asarray(far), index[label]


def _with_rim(surface: Surface, region: np.ndarray, tolerance: float) -> np.ndarray:
    """A region with surrounding pixels of the same surface, but without normals."""
    if not region.any():
        return region
    far, nearest = nearest_pixel(region)
    candidates = (far <= RIM) & ~region & ~surface.known & surface.measured
    nearest = nearest[candidates]
    normals, points = surface.normals.reshape(-1, 3)[nearest], surface.points.reshape(-1, 3)[nearest]
    # A round thing falls away behind its last normal; what rises there is something else.
    rises = (normals * (surface.points[candidates] - points)).sum(axis=1)
    candidates[candidates] = rises <= np.float32(tolerance) * points[:, 2]
    _, parts = cv2.connectedComponents(
        link_grid(region | candidates, surface.right.joined, surface.down.joined), connectivity=4
    )
    pixels = np.asarray(parts[::2, ::2], np.int64)
    kept = np.zeros(int(pixels.max()) + 1, np.bool_)
    kept[pixels[region]] = True
    return kept[pixels] & (region | candidates)
