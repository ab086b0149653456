"""Picture of a frame's points and boxes in 3D: each point a square, the nearest on top, boxes as lines."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.geometry.boxes import dashed
from pipeline.geometry.cloud import Cloud, Viewed
from pipeline.geometry.palette import RGB
from pipeline.system.frozen import dataclass

LEAST_DEPTH = 0.05
"""What is nearer to the eye is not drawn, metres."""
FINER = 2
"""The picture is drawn so many times as large, and then made smaller."""
LARGEST = 6
"""Side of a point at most, pixels of the picture."""
CLOSED = 1.3
"""Points are drawn so much larger than the sensor saw them, so that surfaces that are seen askew stay closed."""
HOLE = 7
"""Holes up to so wide are filled, pixels of the larger picture."""
GREY, DARK = 0.45, 0.7
"""Saturation and lightness that points of no interest keep."""
SEEN_BEHIND = 0.35
"""How much shows of a line behind points."""
BEHIND = 0.03
"""A line is behind points that are nearer by this share of the distance."""
HALO: RGB = (8, 10, 12)
FARTHER, COARSE = 1.1, 2.6
"""The eye is so much farther away than a viewpoint says, and far enough for neighbours to be no more pixels apart."""
PIECE, DASH, DASHED = 6.0, 11.0, 0.6
"""Length of what is either in front or behind, and of a dash with its gap, pixels; the share of the dash in it."""


@dataclass(frozen=True, eq=False)
class PictureView:
    """Eye on the shown frame."""

    eye: np.ndarray  # (3,) float64, metres
    axes: np.ndarray  # (3, 3) float64: rows right, down and ahead, shown frame
    focal: float  # Pixels
    size: tuple[int, int]  # Width and height, pixels

    @staticmethod
    def at(viewed: Viewed, size: tuple[int, int], spacing: float = 0.0) -> PictureView:
        """View of a viewpoint, with up upwards; farther away where `spacing`, metres, would be more than COARSE."""
        eye, look, fov = viewed
        least = size[1] / 2 / np.tan(fov / 2) * spacing / COARSE
        eye = look + (eye - look) * max(FARTHER, least / max(float(np.linalg.norm(eye - look)), 1e-9))
        ahead = (look - eye) / max(float(np.linalg.norm(look - eye)), 1e-9)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= max(float(np.linalg.norm(right)), 1e-9)
        return PictureView(eye, np.stack([right, np.cross(ahead, right), ahead]), size[1] / 2 / np.tan(fov / 2), size)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Column, row and distance ahead, (..., 3) float32, of points, (..., 3), shown frame."""
        found = (np.asarray(points, np.float32) - self.eye.astype(np.float32)) @ self.axes.T.astype(np.float32)
        ahead = np.maximum(found[..., 2:], 1e-6)
        found[..., :2] = found[..., :2] * np.float32(self.focal) / ahead + np.array(self.size, np.float32) / 2
        return found


@dataclass(frozen=True)
class Wire:
    """Lines to draw in 3D."""

    lines: np.ndarray  # (N, 2, 3) float32: start and end, shown frame, metres
    color: RGB
    dashes: bool = False


def quiet_colors(colors: np.ndarray, loud: np.ndarray) -> np.ndarray:
    """Colours, (N, 3) uint8, greyer and darker but for those of interest, (N,) bool."""
    grey = colors @ np.array([0.299, 0.587, 0.114], np.float32)
    quiet = (grey[:, None] * (1 - GREY) + colors * np.float32(GREY)) * np.float32(DARK)
    return np.where(loud[:, None], colors, quiet.astype(np.uint8))


def scene_picture(
    cloud: Cloud, colors: np.ndarray, wires: Sequence[Wire], view: PictureView, ground: RGB
) -> np.ndarray:
    """Picture of a cloud and lines, (H, W, 3) uint8.

    `colors`: (N, 3) uint8 of the cloud's points; `ground`: where nothing is.
    """
    width, height = view.size
    fine = PictureView(view.eye, view.axes, view.focal * FINER, (width * FINER, height * FINER))
    sizes = np.concatenate([np.zeros(0, np.float32)] + [np.full(p.at.stop - p.at.start, p.size) for p in cloud.parts])
    image, ahead = _splats(fine.seen(cloud.points), colors, sizes, fine, ground)
    image = cv2.resize(image, view.size, interpolation=cv2.INTER_AREA)
    ahead = ahead[::FINER, ::FINER]
    for wire in wires:
        _draw_wire(image, ahead, wire, view)
    return image


def _splats(
    seen: np.ndarray, colors: np.ndarray, sizes: np.ndarray, view: PictureView, ground: RGB
) -> tuple[np.ndarray, np.ndarray]:
    """Colours, (H, W, 3) uint8, and distance ahead, (H, W) float32, infinite where nothing is."""
    width, height = view.size
    # The farthest first, so that what is nearer is written over it.
    index = np.argsort(-seen[:, 2])[: np.count_nonzero(seen[:, 2] > LEAST_DEPTH)]
    u, v, depth = seen[index].T
    side = np.clip(np.ceil(CLOSED * sizes[index] * view.focal / depth), 1, LARGEST * FINER)
    left, top = np.floor(u - (side - 1) / 2), np.floor(v - (side - 1) / 2)
    inside = np.flatnonzero((left >= 0) & (top >= 0) & (left + side <= width) & (top + side <= height))
    index, side = index[inside], side[inside].astype(np.int32)
    first = top[inside].astype(np.int32) * width + left[inside].astype(np.int32)
    count = side * side
    number = np.arange(count.sum(), dtype=np.int32) - np.repeat((np.cumsum(count) - count).astype(np.int32), count)
    wide = np.repeat(side, count)
    row = number // wide
    at = np.repeat(first, count) + row * width + (number - row * wide)
    nearest = np.full(height * width, -1, np.int32)
    nearest[at] = np.repeat(index.astype(np.int32), count)
    drawn = np.flatnonzero(nearest >= 0)
    image, ahead = np.zeros((height * width, 3), np.uint8), np.full(height * width, np.inf, np.float32)
    image[drawn], ahead[drawn] = colors[nearest[drawn]], seen[nearest[drawn], 2]
    shape = height, width
    return _filled(image.reshape(*shape, 3), (nearest >= 0).reshape(shape), ground), ahead.reshape(shape)


def _filled(image: np.ndarray, drawn: np.ndarray, ground: RGB) -> np.ndarray:
    """Picture, black where nothing is drawn, with small holes filled from around them, and the rest as the ground."""
    closed = cv2.morphologyEx(drawn.view(np.uint8), cv2.MORPH_CLOSE, np.ones((HOLE, HOLE), np.uint8)).astype(np.bool_)
    around, count = (
        cv2.boxFilter(a, cv2.CV_32F, (HOLE, HOLE), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for a in (image, drawn.view(np.uint8))
    )
    holes = closed & ~drawn & (count > 0)
    image[holes] = around[holes] / count[holes, None]
    image[~drawn & ~holes] = ground
    return image


def _draw_wire(image: np.ndarray, ahead: np.ndarray, wire: Wire, view: PictureView) -> None:
    height, width = image.shape[:2]
    seen = view.seen(_before_eye(wire.lines, view)).astype(np.float64)
    seen[..., 2] = 1 / seen[..., 2]  # On the picture, this is what changes evenly along a line.
    period, share = (DASH, DASHED) if wire.dashes else (PIECE, 1.0)
    pieces = dashed(_within(seen, width, height), period, share)
    middle = pieces.mean(axis=1)
    u, v = (np.clip(middle[:, k].astype(int), 0, n - 1) for k, n in ((0, width), (1, height)))
    hidden = ahead[v, u] * (1 + BEHIND) < 1 / middle[:, 2]
    cut = np.round(pieces[..., :2] * 16).astype(np.int32)
    for which, strength in ((hidden, SEEN_BEHIND), (~hidden, 1.0)):
        over = image.copy()
        for color, thick in ((HALO, 4), (wire.color, 2)):
            cv2.polylines(over, list(cut[which]), False, color, thick, cv2.LINE_AA, shift=4)
        image[:] = cv2.addWeighted(over, strength, image, 1 - strength, 0)


def _before_eye(lines: np.ndarray, view: PictureView) -> np.ndarray:
    """Lines before the eye, (M, 2, 3) float64, those that pass it cut."""
    ahead = (lines - view.eye) @ view.axes[2]
    keep = (ahead > LEAST_DEPTH).any(axis=1)
    lines, ahead = lines[keep].astype(np.float64), ahead[keep]
    span = ahead[:, 1] - ahead[:, 0]
    t = np.clip((LEAST_DEPTH - ahead[:, 0]) / np.where(np.abs(span) > 1e-9, span, 1e-9), 0, 1)[:, None]
    cut = lines[:, 0] + t * (lines[:, 1] - lines[:, 0])
    return np.where((ahead <= LEAST_DEPTH)[..., None], cut[:, None], lines)


def _within(lines: np.ndarray, width: int, height: int) -> np.ndarray:
    """Parts of lines, (M, 2, D), whose first two numbers lie on a picture."""
    start, step = lines[:, 0], lines[:, 1] - lines[:, 0]
    first, last = np.zeros(len(lines)), np.ones(len(lines))
    for k, most in ((0, width), (1, height)):
        slope = np.where(np.abs(step[:, k]) > 1e-9, step[:, k], 1e-9)
        ends = np.sort(np.stack([-start[:, k], most - start[:, k]]) / slope, axis=0)
        first, last = np.maximum(first, ends[0]), np.minimum(last, ends[1])
    t = np.stack([first, last], axis=1)[first < last]
    return start[first < last, None] + t[..., None] * step[first < last, None]
