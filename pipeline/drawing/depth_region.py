"""The surface around a click: pixels that are connected in depth and in direction, never across a depth edge."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.camera import lift_pixels
from pipeline.errors import InputError
from pipeline.frame import Frame
from pipeline.lifting import LiftConfig
from pipeline.normals import surface_normals

TOLERANCE = 0.01
"""The default."""
LEAST, MOST = 0.001, 0.05
BEND = float(np.deg2rad(6)) / TOLERANCE
"""By how much a surface may turn from one pixel to the next, radians for each unit of tolerance."""
LOOSE = 0.03
"""From this tolerance on, pixels without a normal (creases, strong curvature) do not stop a region."""
NEAR = 3
"""A click on a pixel without depth, or without a normal, means one so close to it, pixels."""
RIM = 6
"""Normals are known up to so many pixels from a crease or edge; a region is carried over that rim."""


@dataclass(frozen=True)
class Surface:
    """What a frame's depth says of its surfaces.

    Attributes
    ----------
    points, normals : (H, W, 3) float32
        Camera frame, metres.
    known : (H, W) bool
        Where there is a normal.
    right, down : (H, W - 1), (H - 1, W) bool
        Neighbours that both have a depth, with no depth edge between them.
    """

    points: np.ndarray
    normals: np.ndarray
    known: np.ndarray
    right: np.ndarray
    down: np.ndarray

    @property
    def measured(self) -> np.ndarray:
        """(H, W) bool: where there is a depth."""
        return self.points[..., 2] > 0


def surface_of(frame: Frame, config: LiftConfig | None = None) -> Surface:
    """Points, normals and depth edges of a frame; an edge is what `lifting.depth_edges` calls one."""
    v, u = np.indices(frame.depth.shape)
    points = lift_pixels(frame.depth.ravel(), frame.camera, v.ravel(), u.ravel()).reshape(*frame.depth.shape, 3)
    normals, known = surface_normals(frame.depth, frame.camera)
    right, down = joined(frame.depth, config)
    return Surface(points, normals, known, right, down)


def joined(depth: np.ndarray, config: LiftConfig | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours to the right and below between which there is no depth edge: (H, W - 1) and (H - 1, W) bool."""
    config = config or LiftConfig()

    def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        allowed = np.maximum(np.float32(config.edge), np.float32(config.edge_relative) * np.minimum(a, b))
        return (a > 0) & (b > 0) & (np.abs(a - b) <= allowed)

    return same(depth[:, :-1], depth[:, 1:]), same(depth[:-1], depth[1:])


def grown_region(surface: Surface, seeds: np.ndarray, tolerance: float = TOLERANCE) -> np.ndarray:
    """The surfaces that some pixels lie on.

    From pixel to pixel a surface may leave its tangent plane by `tolerance`
    times the depth, and turn by 6 degrees where the tolerance is 0.01.

    Parameters
    ----------
    seeds : (N, 2) float
        x, y in pixels.
    tolerance : float
        From `LEAST` to `MOST`.

    Returns
    -------
    (H, W) bool

    Raises
    ------
    InputError
        A seed is outside of the picture or has no depth near it.
    """
    height, width = surface.known.shape
    if not LEAST <= tolerance <= MOST:
        raise InputError("the tolerance is out of range", got=tolerance, expected=f"{LEAST} to {MOST}")
    loose = tolerance >= LOOSE
    bound = surface.measured if loose else surface.known
    links = _alike(surface, tolerance, loose)
    either = _alike(surface, tolerance, True)
    found = np.zeros((height, width), np.bool_)
    for x, y in np.asarray(seeds, np.float64).reshape(-1, 2):
        if not (0 <= x < width and 0 <= y < height):
            raise InputError("the point is outside of the picture", got=f"{x:.1f}, {y:.1f}")
        pixel = int(x), int(y)
        seed = _nearest(bound, pixel)
        if seed is not None:
            region = flooded(bound, *links, seed)
        else:
            # Something small or strongly curved has no normals at all.
            seed = _nearest(surface.measured, pixel)
            if seed is None:
                raise InputError("there is no depth at this point", got=f"{x:.1f}, {y:.1f}")
            region = flooded(surface.measured & ~surface.known, *either, seed)
        found |= _with_rim(surface, region, tolerance)
    return found


def _alike(surface: Surface, tolerance: float, loose: bool) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours of one surface, to the right and below."""
    least = np.cos(min(BEND * tolerance, np.pi / 2))

    def same(one: tuple[slice, slice], other: tuple[slice, slice], joined: np.ndarray) -> np.ndarray:
        step = surface.points[other] - surface.points[one]
        n, m = surface.normals[one], surface.normals[other]
        reach = np.float32(tolerance) * surface.points[one][..., 2]
        across = np.maximum(np.abs((n * step).sum(axis=-1)), np.abs((m * step).sum(axis=-1)))
        flat = (across <= reach) & ((n * m).sum(axis=-1) >= least)
        both = surface.known[one] & surface.known[other]
        unknown = np.abs(step[..., 2]) <= reach if loose else np.False_
        return joined & np.where(both, flat, unknown)

    every = slice(None)
    right = same((every, slice(None, -1)), (every, slice(1, None)), surface.right)
    return right, same((slice(None, -1), every), (slice(1, None), every), surface.down)


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


def _with_rim(surface: Surface, region: np.ndarray, tolerance: float) -> np.ndarray:
    """A region with the pixels around it that lie in its surface, but have no normal of their own."""
    if not region.any():
        return region
    far, labels = cv2.distanceTransformWithLabels(
        (~region).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    label = np.asarray(labels, np.int64)
    candidates = (np.asarray(far) <= RIM) & ~region & ~surface.known & surface.measured
    place = np.zeros(int(label.max()) + 1, np.int64)
    place[label[region]] = np.flatnonzero(region)
    nearest = place[label[candidates]]
    normals, points = surface.normals.reshape(-1, 3)[nearest], surface.points.reshape(-1, 3)[nearest]
    across = np.abs((normals * (surface.points[candidates] - points)).sum(axis=1))
    candidates[candidates] = across <= np.float32(tolerance) * points[:, 2]
    grid = link_grid(region | candidates, surface.right, surface.down)
    _, parts = cv2.connectedComponents(grid, connectivity=4)
    pixels = np.asarray(parts[::2, ::2], np.int64)
    kept = np.zeros(int(pixels.max()) + 1, np.bool_)
    kept[pixels[region]] = True
    return kept[pixels] & (region | candidates)
