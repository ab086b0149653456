"""Surface of a depth map: normals, blocks, and a floor that is looked down at steeply told from a wall looked up at.

The two look alike, and so do most things on them: a box on a floor is a cabinet on a wall, a hole in a table a window.
But what hangs on a wall hangs straight, and what stands on a floor stands as it likes: a thing that is turned about the
plane's normal away from where up would be on a wall, stands on a floor.

A frame's surface is looked at in blocks of pixels: as much as its large planes need.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.system.frozen import dataclass

MIN_SHARE = 0.4
"""A plane is fitted where at least this share of the window has a depth."""
MIN_PIXELS = 6
"""Pixels of which a plane smooths the depth."""
MOST_OFF = 0.1
"""Share of the depth by which it may do so: pixels in a line bear no plane."""
MAX_RESIDUAL = 2.5
"""And where the depths lie this close to it, in standard deviations of the sensor's noise."""


def depth_noise(z: np.ndarray) -> np.ndarray:
    """Standard deviation of a structured-light camera's depth at depth z, metres.

    Quadratic in z (Khoshelham and Elberink 2012), with a floor of 1 mm for the
    quantisation and the registration to the colour image.
    """
    return np.float32(0.001) + np.float32(0.0012) * (np.float32(0.4) + z * z)


def surface_step(depth: np.ndarray) -> np.ndarray:
    """Largest depth difference of neighbouring pixels of a surface, at these depths: max(3 cm, 3 %), metres."""
    return np.maximum(np.float32(0.03), np.float32(0.03) * depth)


def surface_normals(
    depth: np.ndarray, camera: Camera, radius: int = 4, noise: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals by least squares in inverse depth, where a plane is an affine function of the pixel.

    Parameters
    ----------
    depth : (H, W) float32
        Metres, 0 where missing.
    radius : int
        The window has 2 * radius + 1 pixels a side.
    noise : float
        Noise of the sensor, in multiples of `depth_noise`.

    Returns
    -------
    normals : (H, W, 3) float32
        Towards the camera, camera frame.
    known : (H, W) bool
        False where the window holds too few depths or is no plane (a depth edge, strong curvature).
    """
    has = depth > 0
    x = (np.arange(depth.shape[1]) - camera.cx) / camera.fx
    y = (np.arange(depth.shape[0]) - camera.cy) / camera.fy
    side = 2 * radius + 1
    sums = _plane_sums(depth, has, x, y, side, np.float64)[:, : len(depth)]
    count, (*plane, explained) = sums[0], _planes(sums)
    plane = np.stack(plane, axis=-1)
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape, np.float64), where=has)
    spread = _sum(inverse * inverse, side) / np.maximum(count, 1)
    residual = np.sqrt(np.maximum(spread - explained, 0.0))
    length = np.sqrt((plane * plane).sum(axis=-1))
    # The noise of 1/z is that of z divided by z squared.
    known = has & (count >= MIN_SHARE * side * side) & (length > 1e-9)
    known &= residual < MAX_RESIDUAL * noise * depth_noise(depth) * inverse * inverse
    return (-plane / np.maximum(length, 1e-9)[..., None]).astype(np.float32), known


def plane_depth(depth: np.ndarray, has: np.ndarray, x: np.ndarray, y: np.ndarray, radius: int) -> np.ndarray:
    """Depth with the sensor's noise averaged away along the surface: of the plane fitted around each pixel, metres.

    Parameters
    ----------
    depth : (H, W) float32
        Metres.
    has : (H, W) bool
        Pixels of one surface or object; no others take part.
    x, y : (W,) and (H,) float64
        Pixel coordinates divided by the focal length, (u - cx) / fx and (v - cy) / fy.
    radius : int
        The window has 2 * radius + 1 pixels a side.

    Returns
    -------
    (H, W) float32
        The depth itself where the window holds fewer than MIN_PIXELS pixels, where the plane is off by more than
        MOST_OFF, and where `has` is False.
    """
    ((v, u, z),) = plane_depths([(depth, has, x, y)], radius)
    smooth = depth.copy()
    smooth[v, u] = z
    return smooth


Patch = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""`depth`, `has`, `x` and `y` of `plane_depth`."""


def plane_depths(patches: Sequence[Patch], radius: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Depths of `plane_depth` where there are any, of several patches: rows, columns, and (N,) float32 metres."""
    if not patches:
        return []
    rows, columns, sums, at_x, at_y, depths = [], [], [], [], [], []
    for depth, has, x, y in patches:
        # About the middle, where single precision suffices.
        x, y = (x - x[len(x) // 2]).astype(np.float32), (y - y[len(y) // 2]).astype(np.float32)
        places = np.flatnonzero(has)
        v = places // has.shape[1]
        u = places - v * has.shape[1]
        rows.append(v)
        columns.append(u)
        sums.append(_plane_sums(depth, has, x, y, 2 * radius + 1, np.float32).reshape(9, -1).take(places, axis=1))
        at_x.append(x[u])
        at_y.append(y[v])
        depths.append(depth[v, u])
    own, z = np.concatenate(sums, axis=1), np.concatenate(depths)
    a, b, c, _ = _planes(own)
    inverse = a * np.concatenate(at_x) + b * np.concatenate(at_y) + c
    plane = np.divide(1, inverse, out=z.copy(), where=(own[0] >= MIN_PIXELS) & (inverse > 0))
    smooth = np.where(np.abs(plane - z) < MOST_OFF * z, plane, z)
    return list(zip(rows, columns, np.split(smooth, np.cumsum([len(d) for d in depths])[:-1]), strict=True))


def _plane_sums(
    depth: np.ndarray, has: np.ndarray, x: np.ndarray, y: np.ndarray, side: int, dtype: type[np.floating[Any]]
) -> np.ndarray:
    """Sums around each pixel that its plane is made of, (9, H + side // 2, W); the last rows are none of a pixel.

    In the order of the images below; the first counts pixels.
    """
    height, width = depth.shape
    # One filter for all: images one above the other, apart by more than its reach.
    apart = np.zeros((9, height + side // 2, width), dtype)
    images = apart[:, :height]
    images[0] = has
    np.multiply(images[0], x, out=images[1])
    np.multiply(images[0], y[:, None], out=images[2])
    np.divide(images[0], np.maximum(depth, dtype(1e-6)), out=images[3])
    np.multiply(images[1], images[1:4], out=images[4:7])
    np.multiply(images[2], images[2:4], out=images[7:9])
    return _sum(apart.reshape(-1, width), side).reshape(apart.shape)


def _planes(sums: np.ndarray) -> tuple[np.ndarray, ...]:
    """Planes 1/z = a x + b y + c of sums (9, ...): a, b, c, and mean square explained.

    With x = X/Z and y = Y/Z that is the plane a X + b Y + c Z = 1.
    """
    mx, my, mq, xx, xy, xq, yy, yq = sums[1:] * (1 / np.maximum(sums[0], 1))
    xx -= mx * mx
    xy -= mx * my
    xq -= mx * mq
    yy -= my * my
    yq -= my * mq
    determinant = np.maximum(xx * yy - xy * xy, sums.dtype.type(1e-18))
    a = (xq * yy - yq * xy) / determinant
    b = (yq * xx - xq * xy) / determinant
    return a, b, mq - a * mx - b * my, mq * mq + a * xq + b * yq


def _sum(values: np.ndarray, side: int) -> np.ndarray:
    return cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)


PARALLEL_DEG = 8.0
UPRIGHT_DEG = 10.0
UPRIGHT = float(np.sin(np.deg2rad(UPRIGHT_DEG)))

LOOKED_UP_DEG = 38.0
"""No one looks up at a wall by more than this."""
HIGHEST_CAMERA_M = 2.7
"""And no one holds a camera higher above a floor."""

LEAST_THING_M, TALLEST_M = 0.02, 1.5
"""What is nearer to the plane belongs to it; what is farther from it is none that things make."""
ROLLS_DEG = np.arange(-16.0, 17.0, 4.0)
"""By how much a camera that looks up at a wall may be rolled."""
STRAIGHT_DEG = 8.0
"""A thing on a wall hangs as straight as this."""
MIN_PATCH_BLOCKS = 8
AT_BORDER = 2
"""A patch within so many blocks of the picture's border may be cut by it."""
CORNER, LEAST_EDGE, TURNED_EDGES = 0.12, 0.4, 0.8
"""The outline of a level patch is drawn to a share of its size, its edges are at least as long as another, and it is
turned where so much of their length is."""
MOST_HIDDEN = 0.3
"""A patch shows its edges while no more of what is around it is in front of it."""
BY_CHANCE = 0.25
"""Of surfaces that face anywhere, a wall explains so many."""
FACE_DEG = 30.0
"""Normals of a patch that lie so close together are taken for one face."""
LEAST_BEHIND = 0.25
"""So much of what is around the side of a thing is behind it."""
LEAST_TURNED, TURNED_LEAD = 0.003, 0.5
"""A floor has so much of the surface in turned things, and so many times what only a wall explains."""

_LEVEL = float(np.cos(np.deg2rad(1.5 * PARALLEL_DEG)))
_RING = np.ones((9, 9), np.uint8)
_STRAIGHT = float(np.cos(np.deg2rad(1.5 * STRAIGHT_DEG)))


def may_be_wall(up: np.ndarray) -> bool:
    """Test if a plane with a normal, (3,), towards the camera, may be a wall seen from below."""
    return bool(_on_wall(up)[0][2] <= np.sin(np.deg2rad(LOOKED_UP_DEG)))


def is_floor(surface: SurfaceBlocks, up: np.ndarray, offset: float) -> bool:
    """Test if objects are turned on a plane as on a floor, and on no wall.

    `up` is the plane's unit normal, (3,), towards the camera; `offset` is `points @ up` in the plane, metres, negative.
    """
    if -offset > HIGHEST_CAMERA_M:
        return False
    height = surface.points @ up - offset
    off = surface.flat & (np.abs(height) > np.maximum(LEAST_THING_M, 3 * plane_tolerance(surface.points)))
    off &= height < TALLEST_M
    along = surface.normals @ up
    level, upright = off & (along > _LEVEL), off & (np.abs(along) < UPRIGHT)
    above, across = _on_wall(up)
    rolls = np.deg2rad(ROLLS_DEG)
    wall_up = (above[:, None] * np.cos(rolls) + across[:, None] * np.sin(rolls)).astype(np.float32)

    def straight(blocks: np.ndarray) -> np.ndarray:
        cosine = np.abs(surface.normals[blocks] @ wall_up)
        return (cosine > _STRAIGHT) | (cosine < UPRIGHT)

    turned = np.zeros(len(rolls))
    for patch, around in _patches(surface, upright):
        if _stands_out(surface, patch, around, above, across):
            turned += np.count_nonzero(~straight(patch), axis=0)
    for patch, around in _patches(surface, level):
        hidden = height[around] > height[patch].max() + LEAST_THING_M
        if np.count_nonzero(hidden) < MOST_HIDDEN * len(around):
            turned += len(patch) * _is_turned(surface, patch, above, across)
    others = np.flatnonzero(off & ~level & ~upright)
    only_wall = np.count_nonzero(straight(others), axis=0) - BY_CHANCE * len(others)
    roll = int((turned - only_wall).argmin())
    return bool(turned[roll] > max(LEAST_TURNED * len(height), TURNED_LEAD * only_wall[roll]))


def _on_wall(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors on a wall with a normal, for an unrolled camera: up and sideways."""
    above = np.array([0.0, normal[2], -normal[1]])
    above /= np.linalg.norm(above)
    return above, np.cross(normal, above)


def _patches(surface: SurfaceBlocks, chosen: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Connected patches of chosen blocks, each with the blocks around."""
    mask = np.zeros(surface.shape, np.uint8)
    mask[surface.v[chosen], surface.u[chosen]] = 1
    count, patches, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    for k in range(1, count):
        if stats[k, cv2.CC_STAT_AREA] < MIN_PATCH_BLOCKS:
            continue
        own = (patches == k).view(np.uint8)
        ring = cv2.dilate(own, _RING) - own
        yield np.flatnonzero(own[surface.v, surface.u]), np.flatnonzero(ring[surface.v, surface.u])


def _stands_out(
    surface: SurfaceBlocks, patch: np.ndarray, around: np.ndarray, above: np.ndarray, across: np.ndarray
) -> bool:
    """Test a side for standing free, unlike a wall or a slope of a roof: the surroundings lie behind."""
    points, normals = surface.points[patch], surface.normals[patch]
    ring, tolerance = surface.points[around], plane_tolerance(surface.points[around])
    behind = np.zeros(len(around), np.bool_)
    facing = np.rint(np.rad2deg(np.arctan2(normals @ above, normals @ across)) / FACE_DEG)
    for face in (facing == k for k in np.unique(facing)):
        if np.count_nonzero(face) >= MIN_PATCH_BLOCKS:
            behind |= (ring - points[face].mean(axis=0)) @ normals[face].mean(axis=0) < -tolerance
    return bool(np.count_nonzero(behind) > LEAST_BEHIND * len(around))


def _is_turned(surface: SurfaceBlocks, patch: np.ndarray, above: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Flag each roll in which most edges of a level patch run neither along nor across up on a wall."""
    points = surface.points[patch]
    plan = np.stack([points @ across, points @ above], axis=1).astype(np.float32)
    hull = np.asarray(cv2.convexHull(plan, returnPoints=False)[:, 0], np.int64)
    size = np.sqrt(cv2.contourArea(plan[hull]))
    corners = _corners(plan[hull], hull, CORNER * size)
    edges = plan[np.roll(corners, -1)] - plan[corners]
    v, u = surface.v[patch[corners]], surface.u[patch[corners]]
    rows, columns = surface.shape
    sides = np.stack([v <= AT_BORDER, u <= AT_BORDER, v >= rows - 1 - AT_BORDER, u >= columns - 1 - AT_BORDER])
    length = np.hypot(*edges.T)
    length[(sides & np.roll(sides, -1, axis=1)).any(axis=0) | (length < LEAST_EDGE * size)] = 0
    angle = np.rad2deg(np.arctan2(edges[:, 1], edges[:, 0]))
    off = np.abs((angle[:, None] + ROLLS_DEG + 45) % 90 - 45) > STRAIGHT_DEG
    return (length @ off > TURNED_EDGES * length.sum()) & (length.sum() > size)


def _corners(outline: np.ndarray, numbers: np.ndarray, slack: float) -> np.ndarray:
    """Numbers of the points of an outline, (N, 2), needed to draw the outline within `slack` metres."""
    drawn = cv2.approxPolyDP(outline, slack, True)[:, 0]
    return numbers[[int(np.abs(outline - corner).sum(axis=1).argmin()) for corner in drawn]]


NEAREST_M, FARTHEST_M = 0.15, 10.0
GRID_BLOCKS = 12_000
_TWICE_DIFFERENT = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_MEDIAN_OF_LEFT = 6 * 0.6745
"""Of noise of deviation 1: the kernel's norm, and the median of the absolute values of a normal distribution."""
VOTERS = 4000


@dataclass(frozen=True)
class SurfaceBlocks:
    """Surface points and normals, for each block of pixels with a depth."""

    points: np.ndarray  # (N, 3) float32, camera frame, metres; normals point towards the camera
    normals: np.ndarray  # (N, 3) float32
    flat: np.ndarray  # (N,) bool, the normal is known
    v: np.ndarray  # (N,) int64, row of the block
    u: np.ndarray  # (N,) int64, column of the block
    shape: tuple[int, int]  # Rows and columns of blocks

    @cached_property
    def voters(self) -> np.ndarray:
        """Some of the flat normals, evenly: enough to weigh directions; planes are fitted to all points."""
        normals = self.normals[self.flat]
        return normals[:: max(1, len(normals) // VOTERS)]


def surface_blocks(depth: np.ndarray, camera: Camera, noise: int = 1) -> SurfaceBlocks:
    """Build surface points and normals of blocks of pixels.

    Where the sensor is `noise` times as noisy as a structured-light camera, normals are fitted to wider windows.
    """
    z, side = _block_depths(depth)
    rows, columns = z.shape
    K = camera.K.copy()
    K[:2] /= side
    K[:2, 2] -= (side - 1) / (2 * side)
    blocks = Camera(K, columns, rows)
    normals, known = surface_normals(z, blocks, radius=1 + noise, noise=noise)
    v, u = np.nonzero(z > 0)
    return SurfaceBlocks(lift_pixels(z[v, u], blocks, v, u), normals[v, u], known[v, u], v, u, (rows, columns))


def _block_depths(depth: np.ndarray) -> tuple[np.ndarray, int]:
    """Mean depths over blocks of pixels, in inverse depth (a plane stays a plane), and the side of a block, pixels."""
    height, width = depth.shape
    side = max(1, round(float(np.sqrt(height * width / GRID_BLOCKS))))
    rows, columns = height // side, width // side
    cut = depth[: rows * side, : columns * side]
    has = (cut > NEAREST_M) & (cut < FARTHEST_M)
    inverse = np.divide(1.0, cut, out=np.zeros(cut.shape, np.float32), where=has)
    filled = cv2.resize(has.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    mean = cv2.resize(inverse, (columns, rows), interpolation=cv2.INTER_AREA)
    return np.divide(filled, mean, out=np.zeros_like(mean), where=filled > 0.5), side


def block_noise(depth: np.ndarray) -> float:
    """Noise of blocks of pixels, in standard deviations of a structured-light camera's single pixel.

    By the median over the frame of what is left of inverse depth when the planes of 3x3 blocks are taken away; about
    0.25 with such a camera, as blocks are means of 16 pixels; 0 without depth.
    """
    z, _ = _block_depths(depth)
    whole = cv2.erode((z > 0).view(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    inverse = np.divide(1.0, z, out=np.zeros_like(z), where=z > 0)
    left = np.abs(cv2.filter2D(inverse, -1, _TWICE_DIFFERENT))[whole] / _MEDIAN_OF_LEFT
    return float(np.median(left * z[whole] ** 2 / depth_noise(z[whole]))) if len(left) else 0.0


def plane_tolerance(points: np.ndarray) -> np.ndarray:
    """Distances, (N,), metres, within which points, (N, 3), count as in a plane."""
    return 0.008 + 0.006 * points[:, 2] ** 2
