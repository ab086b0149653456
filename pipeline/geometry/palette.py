"""Fixed colours of roles and of dropped pixels: the same in 3D, 2D, tables and chips.

Roles stay distinct where one kind of cone is missing, and can be read as text on the page's grounds (tests hold
both); every role is doubled by a word, a line width or a line style wherever it is shown.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from pipeline.geometry.cleaning import Pixel

Role = Literal["target", "reference", "other", "truth", "edited", "bad"]
RGB = tuple[int, int, int]

ON_DARK: dict[Role, RGB] = {
    "target": (245, 127, 32),
    "reference": (72, 160, 248),
    "other": (155, 158, 166),
    "truth": (95, 216, 155),
    "edited": (246, 219, 90),
    "bad": (255, 107, 107),
}
ON_LIGHT: dict[Role, RGB] = {
    "target": (176, 81, 0),
    "reference": (33, 90, 201),
    "other": (100, 108, 119),
    "truth": (10, 125, 69),
    "edited": (92, 57, 0),
    "bad": (180, 17, 35),
}
"""ON_DARK over photos and in the scene, whatever the theme; ON_LIGHT for words on light panels. "bad" is a failure."""

LINE_WIDTH: dict[Role, float] = {"other": 1.3, "reference": 3.0, "target": 3.0, "truth": 3.0, "edited": 3.0}
"""Of boxes in 3D, pixels; a dark halo of a pixel stands around lines of three."""
FACE_OPACITY: dict[Role, float] = {"other": 0.035, "reference": 0.15, "target": 0.15, "truth": 0.1}
"""Of boxes in 3D."""

DROPPED: dict[Pixel, RGB] = {
    Pixel.NO_DEPTH: (120, 124, 132),
    Pixel.OUT_OF_RANGE: (84, 88, 96),
    Pixel.DEPTH_EDGE: (230, 70, 110),
    Pixel.MASK_BORDER: (250, 200, 60),
    Pixel.SMALL_PART: (64, 200, 220),
}
"""Colours of the pixels that cleaning dropped, by reason."""


def palette(dark: bool) -> dict[Role, RGB]:
    """Role colours for a dark or a light background."""
    return ON_DARK if dark else ON_LIGHT


def hex_color(color: RGB) -> str:
    """Hexadecimal form, "#rrggbb"."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def instance_colors(count: int) -> np.ndarray:
    """Calm, distinct colours of `count` objects, (count, 3) uint8, golden-ratio hues."""
    import cv2

    hues = np.round((np.arange(count) * 0.61803398875 % 1.0) * 179).astype(np.uint8)
    hsv = np.stack([hues, np.full(count, 140, np.uint8), np.full(count, 225, np.uint8)], axis=1)
    return cv2.cvtColor(hsv[None], cv2.COLOR_HSV2RGB)[0] if count else np.zeros((0, 3), np.uint8)


def depth_ends(depth: np.ndarray) -> tuple[float, float]:
    """Ends of the depth colours, metres: the 2nd and the 98th percentile of measured depths."""
    valid = depth > 0
    low, high = np.percentile(depth[valid], [2, 98]) if valid.any() else (0.0, 1.0)
    return float(low), float(high)


DEPTH_STOPS = ((246, 231, 194), (187, 182, 160), (113, 139, 137), (78, 92, 124), (63, 44, 85))
"""Colours of depths at equal steps, near to far: lightness tells them, and they stay near grey, so that the colours of
roles stand out of them (a test holds how far)."""


def depth_colors(depth: np.ndarray, ends: tuple[float, float] | None = None) -> np.ndarray:
    """Colours of depths in metres, (..., 3) uint8, near sand to far violet grey between `ends`, default `depth_ends`.

    Pixels without depth are dark grey.
    """
    low, high = ends or depth_ends(depth)
    at, stops = np.linspace(0, len(DEPTH_STOPS) - 1, 256), np.arange(len(DEPTH_STOPS))
    table = np.stack([np.interp(at, stops, channel) for channel in zip(*DEPTH_STOPS, strict=True)], axis=1)
    level = np.clip((depth - low) / max(high - low, 1e-6), 0, 1) * 255
    colors = np.round(table).astype(np.uint8)[level.astype(np.uint8)]
    colors[depth <= 0] = (40, 42, 46)
    return colors


SATURATION = 0.45
TOWARD = {True: (0.7, 0.0), False: (0.6, 0.45)}
"""Of dimmed points: the share of saturation that is kept; on a dark and a light ground the share of lightness, and the
grey that the rest is of. White stays darker than a light ground, so that what is dimmed keeps its form."""
LUMA = (0.2126, 0.7152, 0.0722)


def dimming(dark: bool) -> np.ndarray:
    """Matrix (3, 4) of dimming on a dark or a light ground: it turns a colour (r, g, b, 1), 0 to 1."""
    kept, grey = TOWARD[dark]
    turn = (1 - SATURATION) * np.tile(LUMA, (3, 1)) + SATURATION * np.eye(3)
    return np.column_stack([kept * turn, np.full(3, (1 - kept) * grey)])


VERDICTS: dict[str, RGB] = {
    "CORRECT": (5, 110, 67),
    "PARSE": (168, 203, 208),
    "LABEL": (246, 196, 91),
    "NOT-SEEN": (48, 57, 87),
    "OPM-TARGET": (105, 101, 248),
    "OPM-REF": (202, 190, 252),
    "LIFT": (9, 145, 150),
    "ATTRIBUTE": (133, 125, 58),
    "SRM": (207, 123, 185),
    "OPM-CONF": (130, 67, 147),
    "PRM": (151, 70, 0),
    "COMPOUND": (172, 161, 160),
    "UNEXPLAINED": (107, 110, 114),
}
"""A hue for each verdict, far from those of roles (tests hold it); violets are the detector. The word stands by it."""


def ink(color: str) -> str:
    """Black or white, whichever reads better on a colour "#rrggbb": at least 4.58 to 1, by WCAG 2.2's contrast."""
    channels = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    luminance = sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))
    return "#000000" if (luminance + 0.05) ** 2 > 0.05 * 1.05 else "#ffffff"
