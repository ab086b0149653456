"""Pictures as the tensors that networks were trained on, resized by the very algorithms of their reference code."""

from __future__ import annotations

import numpy as np

IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
IMAGENET_STD = np.array([0.229, 0.224, 0.225], np.float32)
CLIP_MEAN = np.array([0.48145466, 0.4578275, 0.40821073], np.float32)
CLIP_STD = np.array([0.26862954, 0.26130258, 0.27577711], np.float32)


def pillow_resized(rgb: np.ndarray, height: int, width: int, *, cubic: bool = False) -> np.ndarray:
    """(height, width, 3) uint8: resized as Pillow does it, which widens its filter where a picture shrinks.

    OpenCV's bilinear filter skips pixels there, and its cubic filter has another coefficient (-0.75, not -0.5).
    """
    from PIL import Image

    resample = Image.Resampling.BICUBIC if cubic else Image.Resampling.BILINEAR
    return np.asarray(Image.fromarray(rgb).resize((width, height), resample))


def shortest_edge(height: int, width: int, shortest: int = 800, longest: int = 1333) -> tuple[int, int]:
    """Height and width with the shorter side `shortest`, or less so that the longer one is at most `longest`.

    The roundings are those of `get_size_with_aspect_ratio` in transformers and in IDEA-Research/GroundingDINO; a side
    that they round to nothing is 1.
    """
    low, high = min(height, width), max(height, width)
    exact = float(shortest)
    if high / low * shortest > longest:
        exact = longest * low / high
    short = round(exact)
    if low == short:
        return height, width
    short, long = max(short, 1), max(int(exact * high / low), 1)
    return (long, short) if width < height else (short, long)


def normalised(image: np.ndarray, mean: np.ndarray, std: np.ndarray) -> np.ndarray:
    """(1, 3, H, W) float32 of (H, W, 3) uint8, or of float32 in 0..1."""
    values = image.astype(np.float32) * np.float32(1 / 255) if image.dtype == np.uint8 else image
    return np.ascontiguousarray(((values - mean) / std).transpose(2, 0, 1)[None], dtype=np.float32)


def padded_square(rgb: np.ndarray, side: int, fill: float = 0.0) -> np.ndarray:
    """(side, side, 3) float32 in 0..1: the picture in the top left of a square of its longer side, resized.

    The algorithm of OWLv2's reference code, which is that of `skimage.transform.resize`: a Gaussian of
    sigma (factor - 1) / 2 where the picture shrinks, then linear interpolation between pixel centres with mirrored
    edges, then clipped to the values that were there.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
    side : int
    fill : float
        What the padding is made of, 0..1. transformers 5 pads with 0; releases before it and the original code
        padded with 0.5.
    """
    from scipy.ndimage import gaussian_filter

    longest = max(rgb.shape[:2])
    square = np.full((longest, longest, 3), fill, np.float32)
    square[: rgb.shape[0], : rgb.shape[1]] = rgb.astype(np.float32) * np.float32(1 / 255)
    low, high = square.min(), square.max()
    sigma = max(0.0, (longest / side - 1) / 2)
    if sigma:
        square = gaussian_filter(square, (sigma, sigma, 0), mode="mirror")
    place = (np.arange(side) + 0.5) * longest / side - 0.5
    before = np.floor(place).astype(np.int64)
    share = (place - before).astype(np.float32)
    first, second = _mirrored(before, longest), _mirrored(before + 1, longest)
    rows = square[first] * (1 - share)[:, None, None] + square[second] * share[:, None, None]
    return np.clip(rows[:, first] * (1 - share)[:, None] + rows[:, second] * share[:, None], low, high)


def _mirrored(index: np.ndarray, size: int) -> np.ndarray:
    """Indices just outside 0..size-1 reflected about the centre of the edge pixel."""
    return np.clip(np.where(index < 0, -index, np.where(index >= size, 2 * (size - 1) - index, index)), 0, size - 1)
