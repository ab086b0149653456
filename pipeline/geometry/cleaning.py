"""Cleaning of masks by depth: each pixel is kept, or dropped for one named reason."""

from __future__ import annotations

from enum import IntEnum
from typing import Literal

import cv2
import numpy as np

from pipeline.geometry.masks import MaskCrop
from pipeline.geometry.surface import surface_step
from pipeline.system.frozen import dataclass

BoxMode = Literal["upright", "gravity", "pca", "pca-raw"]
"""upright: sides along the outline in plan, the eroded rim given back, what hides behind it allowed for. gravity:
upright, yaw by PCA in plan, 1st to 99th percentile: that of all labels before 0.2. pca: the paper's PCA box,
canonicalised in the level camera frame. pca-raw: the same with the axes as PCA gives them."""


BoxExtent = Literal["seen", "completed"]
"""Boxes by which sizes are compared: of what is seen, or of the whole object, estimated. Relations are by what is
seen."""


class Pixel(IntEnum):
    """Outcome of a pixel of the mask, in the order of decision."""

    OUTSIDE = 0
    KEPT = 1
    NO_DEPTH = 2
    OUT_OF_RANGE = 3
    DEPTH_EDGE = 4
    MASK_BORDER = 5
    SMALL_PART = 6


SQUARE = np.ones((3, 3), np.uint8)
OUTSIDE, KEPT, NO_DEPTH, OUT_OF_RANGE, DEPTH_EDGE, MASK_BORDER, SMALL_PART = map(int, Pixel)
# As plain numbers: to compare pixels with a member of an enumeration costs more than to compare them.
DECIDED = np.zeros(256, np.uint8)
DECIDED[:5] = KEPT, MASK_BORDER, DEPTH_EDGE, OUT_OF_RANGE, NO_DEPTH
"""Outcomes of a pixel in rising precedence; OUTSIDE last."""
OUTCOMES = tuple(p.name.lower() for p in Pixel if p is not Pixel.OUTSIDE)


@dataclass(frozen=True)
class LiftConfig:
    """Cleaning thresholds; the defaults are the measured choice."""

    near: float = 0.3  # Valid depths lie strictly between, metres
    far: float = 10.0
    # A pixel is at a depth edge where its 3x3 neighbourhood spans more than max(edge, edge_relative * z), metres. Wider
    # than `surface_step`: a narrower one takes more of the object's own rim than of what leaks
    edge: float = 0.06
    edge_relative: float = 0.06
    erode: float = 2.0  # Pixels to erode from the mask at an image width of 640
    erode_keep: float = 0.4  # Erosion stops before less than this share of the mask remains
    part: float = 0.1  # Connected parts smaller than this share of the largest are dropped
    min_pixels: int = 30  # With fewer pixels left, the raw mask is used instead
    max_points: int = 8000  # Points are thinned evenly to this number
    box: BoxMode = "upright"
    smooth: int = 3  # Radius of the planes that smooth the points of upright boxes, pixels at an image width of 640
    fit_pixels: int = 1000  # Those points are thinned evenly to about this number
    boxes: BoxExtent = "seen"


@dataclass(frozen=True)
class PixelEvidence:
    """Outcomes of the pixels of a mask."""

    codes: np.ndarray  # (h, w) uint8, a `Pixel` value for each pixel of the mask's bounding rectangle
    x0: int  # Upper left corner of that rectangle in the image, pixels
    y0: int
    eroded: int = 0  # Pixels that erosion took from the mask's rim

    def counts(self) -> dict[str, int]:
        """Pixels by outcome, for example {"kept": 812, "depth_edge": 90}."""
        return {name: int(np.count_nonzero(self.codes == code)) for code, name in enumerate(OUTCOMES, 1)}

    def full(self, height: int, width: int) -> np.ndarray:
        """Codes in an image, (H, W) uint8."""
        image = np.zeros((height, width), np.uint8)
        h, w = self.codes.shape
        image[self.y0 : self.y0 + h, self.x0 : self.x0 + w] = self.codes
        return image


def depth_edges(depth: np.ndarray, config: LiftConfig | None = None) -> np.ndarray:
    """Mask of pixels with a depth step in the 3x3 neighbourhood, (H, W) bool. Pixels without depth take no part."""
    config = config or LiftConfig()
    span = cv2.dilate(depth, SQUARE)
    # One array for all that follows: fresh ones cost more than the work.
    own = np.where(depth > 0, depth, np.float32(np.inf))
    span -= cv2.erode(own, SQUARE, dst=own)
    np.multiply(depth, np.float32(config.edge_relative), out=own)
    return span > np.maximum(own, np.float32(config.edge), out=own)


def flying_pixels(depth: np.ndarray, neighbours: int = 3) -> np.ndarray:
    """Mask of pixels that hang between two surfaces, (H, W) bool, for display.

    A pixel flies where fewer than `neighbours` of the eight around it have its
    depth to within `surface_step`. The border of a surface does not fly.
    """
    tolerance = surface_step(depth)
    padded = np.pad(depth, 1, constant_values=-1)
    height, width = depth.shape
    support = np.zeros(depth.shape, np.uint8)
    for dy in range(3):
        for dx in range(3):
            if (dy, dx) != (1, 1):
                support += np.abs(padded[dy : dy + height, dx : dx + width] - depth) < tolerance
    return (depth > 0) & (support < neighbours)


def clean(
    mask: np.ndarray | MaskCrop, depth: np.ndarray, edges: np.ndarray, config: LiftConfig | None = None
) -> tuple[PixelEvidence, bool]:
    """Decide each pixel of a mask, (H, W) bool, by depth, (H, W) float32, metres, and edges from `depth_edges`.

    The flag is True where cleaning left fewer than `min_pixels` and all valid pixels of the raw mask are kept instead.
    """
    config = config or LiftConfig()
    return decided(mask, depth, depth_ranks(depth, edges, config), config)


def depth_ranks(depth: np.ndarray, edges: np.ndarray, config: LiftConfig) -> np.ndarray:
    """What depth alone says of each pixel of a frame, (H, W) uint8, as a rank in DECIDED."""
    out_of_range = ~((depth > config.near) & (depth < config.far))
    # Arithmetic on bytes is faster than writing where a reason applies.
    ranks = edges.view(np.uint8) * np.uint8(2)
    for k, reason in ((3, out_of_range), (4, depth <= 0)):
        np.maximum(ranks, reason.view(np.uint8) * np.uint8(k), out=ranks)
    return ranks


def decided(
    mask: np.ndarray | MaskCrop, depth: np.ndarray, ranks: np.ndarray, config: LiftConfig
) -> tuple[PixelEvidence, bool]:
    """`clean` by the ranks of all pixels of the frame."""
    height, width = depth.shape
    crop = mask if isinstance(mask, MaskCrop) else MaskCrop.of(mask)
    left, top, right, bottom = crop.box
    # One pixel of margin keeps erosion right at the crop; at the image border
    # there is none, because there the object does not end.
    x0, y0, x1, y1 = max(left - 1, 0), max(top - 1, 0), min(right + 1, width), min(bottom + 1, height)
    inside = np.zeros((y1 - y0, x1 - x0), np.bool_)
    inside[top - y0 : bottom - y0, left - x0 : right - x0] = crop.mask[
        top - crop.y : bottom - crop.y, left - crop.x : right - crop.x
    ]

    # The last outcome that applies.
    solid, eroded = _eroded(inside, width, config)
    codes = cv2.LUT(np.maximum(ranks[y0:y1, x0:x1], (~solid).view(np.uint8)), DECIDED)
    np.multiply(codes, inside.view(np.uint8), out=codes)

    kept = codes == KEPT
    count, part = cv2.connectedComponents(kept.view(np.uint8), connectivity=4)
    pixels = int(np.count_nonzero(kept))
    if count > 2:
        area = np.bincount(part.ravel(), minlength=count)
        area[0] = 0
        small = area < config.part * area.max()
        small[0] = False
        np.putmask(codes, small.take(part), SMALL_PART)
        pixels -= int(area[small].sum())

    fallback = pixels < config.min_pixels
    if fallback:
        z = depth[y0:y1, x0:x1]
        codes[inside & (z > config.near) & (z < config.far)] = KEPT
    return PixelEvidence(codes, x0, y0, 0 if fallback else eroded), fallback


def _eroded(inside: np.ndarray, width: int, config: LiftConfig) -> tuple[np.ndarray, int]:
    floor = config.erode_keep * np.count_nonzero(inside)
    current, steps = inside.view(np.uint8), 0
    for _ in range(round(config.erode * width / 640)):
        smaller = cv2.erode(current, SQUARE)
        if np.count_nonzero(smaller) < floor:
            break
        current, steps = smaller, steps + 1
    return current.view(np.bool_), steps
