"""Attributes of a sentence judged on each object: colour from pixels, size and shape from boxes and masks.

Colour: the share of people who call a colour by each basic term is a softmax over quadratic forms of its CIELAB
coordinates, fitted on the xkcd colour survey (222,500 people, 3.4 million answers; CC0) as J. Heer and M. Stone counted
it (CHI 2012). Answers with a basic term in them count for it, others for the terms they lie between. No picture took
part in the fit; `object_colors` says what is done about light and shade.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import IMAGE_UP
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.language.attributes import BASIC_COLORS, FURTHER_COLORS, Attribute
from pipeline.system.frozen import dataclass

_TERMS: dict[str, tuple[float, ...]] = {
    "black": (6.5, -12.6, -5.7, -2.0, -8.4, 3.1, 1.1, 0.1, -1.2, 2.0),
    "blue": (3.2, -2.0, -9.3, -15.1, 2.1, 1.4, -1.9, -6.9, 1.7, -5.5),
    "brown": (3.1, -2.9, 2.5, 6.5, 1.1, 0.8, -1.9, -1.3, 1.4, -1.4),
    "gray": (2.2, 10.7, -6.0, -5.1, -9.4, -6.5, -1.9, -0.5, 2.2, -2.4),
    "green": (3.8, -3.6, -12.1, 0.3, 1.1, 0.1, 5.8, -6.2, -3.9, 4.6),
    "orange": (-8.0, 4.4, 10.6, 9.2, 4.2, -1.9, 0.8, 4.3, -1.9, -3.5),
    "pink": (-5.0, 6.9, 10.9, -0.8, 1.7, 0.3, -2.0, 2.4, 4.8, -2.6),
    "purple": (1.9, 2.6, 4.3, -6.5, -2.1, 3.4, -0.4, -1.1, -0.2, 2.5),
    "red": (0.1, -5.3, 11.5, 1.2, -1.3, -2.4, -2.5, 4.8, 0.8, 4.3),
    "white": (-4.5, 4.9, -1.5, 4.6, 4.2, -0.6, 0.9, 1.0, -3.2, 1.0),
    "yellow": (-3.2, -3.1, -5.2, 7.6, 6.8, 2.1, 2.1, 3.5, -0.4, 0.9),
    "turquoise": (-5.2, 4.1, -11.2, -9.5, -3.7, -7.2, -6.8, -1.4, 6.2, -5.2, 0.72),
    "beige": (-10.9, 16.6, 4.2, 11.3, -7.7, -12.6, -8.8, -1.7, -1.2, -2.2, 0.7),
    "gold": (-13.5, 8.3, 2.8, 16.0, -8.1, -10.4, -6.4, -2.7, 1.5, -0.7, 0.4),
    "magenta": (-9.1, 10.0, 8.7, 3.1, -9.8, -1.6, -3.8, -3.0, -4.3, -2.0, 0.69),
}
"""Log weight of each term as a quadratic form: of 1, L, a, b, L², a², b², La, Lb, ab with L/100, a/60, b/60 (CIELAB,
D65). Further terms are logistic on their own, with their highest share in the survey last."""

_LIGHTNESS: dict[str, tuple[float, float]] = {
    "black": (35, 0), "blue": (59, 34), "brown": (51, 31), "gray": (71, 45), "green": (75, 54), "orange": (68, 59),
    "pink": (69, 55), "purple": (50, 33), "red": (50, 39), "white": (97, 85), "yellow": (89, 80),
    "turquoise": (72, 48), "beige": (85, 68), "gold": (72, 58), "magenta": (60, 45),
}  # fmt: skip
"""L above which people say light, and below which dark: halfway between the means of the plain and the shaded term in
the survey."""

MOST_PIXELS = 400
"""Of an object; spread evenly over its mask."""
PERCENTILE = 98.0
EXPOSURE = 0.8
TINT = 0.8
"""Of the frame's light, in each channel the value that all but 2 % of its pixels stay below: how much of its strength
and of its colour is taken out. Not all, as a frame need not show anything white."""
LIT = 75.0
UNSHADE = 0.3
UNSHADE_GRAY = 0.1
"""Pixels darker than this percentile of their object are taken for shaded and brightened by that power of what they
lack; gray ones less, for black print on white is no shade."""
CHROMA = 2.0
"""A vivid pixel counts three times as much as a gray one: a box with gray print on yellow is called yellow."""
TEMPER = 1.5
"""Names reach further in a scene, where few things compete, than for single patches on a screen."""
WHITE = 0.5
"""Added to the log weight of white: on a screen only the very brightest is called so, in a room what is about as bright
as the brightest surfaces."""
GRADE = 0.5
"""Likewise for things: one that has a quarter as much of a colour as of its main one is called so half as readily."""
LEAST = 0.02
"""No colour is held for more surely absent."""
_SOFT = 6.0
"""CIELAB units of lightness in which light and dark go over into the plain colour."""
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
_LINEAR = ((np.arange(256) / 255.0) ** 2.2).astype(np.float32)


@dataclass(frozen=True)
class ObjectColors:
    """Colours of objects."""

    # (N, 15) float64: of each object's pixels, by BASIC_COLORS and FURTHER_COLORS; the basic ones sum to 1. NaN for an
    # empty mask.
    shares: np.ndarray
    lightness: np.ndarray  # (N, 15) float64: mean CIELAB L of the pixels of that colour, in the light of the frame


def neutral_gains(rgb: np.ndarray) -> np.ndarray:
    """(3,) gains of linear RGB bringing the light of a frame ((H, W, 3) uint8) most of the way to white.

    Von Kries' scaling by a high percentile of each channel, which stands for a white surface in full light.
    """
    bright = np.maximum(np.percentile(_LINEAR[rgb[::4, ::4].reshape(-1, 3)], PERCENTILE, axis=0), 1e-3)
    level = bright @ _LUMINANCE
    return np.clip(level**-EXPOSURE, 0.5, 2.0) * np.clip(level / bright, 0.5, 2.0) ** TINT


def color_shares(lab: np.ndarray) -> np.ndarray:
    """(N, 15): share of people naming colours ((N, 3) CIELAB) so; of further terms relative to the best."""
    L, a, b = (lab / np.array((100, 60, 60), np.float32)).T
    forms = np.stack([np.ones_like(L), L, a, b, L * L, a * a, b * b, L * a, L * b, a * b], axis=1)
    logits = forms @ _WEIGHTS
    logits[:, _NAMES.index("white")] += WHITE
    basic = logits[:, : len(BASIC_COLORS)] / TEMPER
    basic = np.exp(basic - basic.max(axis=1, keepdims=True))
    further = 1 / (1 + np.exp(-logits[:, len(BASIC_COLORS) :])) / _PEAKS
    return np.concatenate([basic / basic.sum(axis=1, keepdims=True), np.minimum(further, 1)], axis=1)


_NAMES = (*BASIC_COLORS, *FURTHER_COLORS)
_WEIGHTS = np.array([_TERMS[name][:10] for name in _NAMES], np.float32).T
_PEAKS = np.array([_TERMS[name][10] for name in FURTHER_COLORS], np.float32)


def _interior(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(P, 3) uint8 pixels of a mask without its border, blended with the background; none for an empty mask."""
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    inside = mask[y : y + h, x : x + w].view(np.uint8)
    area = cv2.countNonZero(inside)
    if not area:
        return np.zeros((0, 3), np.uint8)
    width = 2 * min(int(np.sqrt(area) / 12), 4) + 1
    core = cv2.erode(inside, np.ones((width, width), np.uint8), borderValue=0)
    chosen = core if cv2.countNonZero(core) > 0.3 * area else inside
    pixels = cv2.blur(rgb[y : y + h, x : x + w], (3, 3))[chosen.view(np.bool_)]
    return pixels[:: max(1, -(-len(pixels) // MOST_PIXELS))]


def object_colors(rgb: np.ndarray, masks: Sequence[np.ndarray]) -> ObjectColors:
    """Colours of the objects of a frame.

    The frame's light is made nearly neutral, borders of masks are left out, noise is averaged over 3 by 3 pixels,
    shaded parts are brightened towards the lit ones; then every pixel is named and the names are averaged.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
    masks : sequence of N (H, W) bool
    """
    shares, lightness = np.full((2, len(masks), len(_NAMES)), np.nan)
    gains = neutral_gains(rgb)
    pixels = [_interior(rgb, mask) for mask in masks]
    count = [len(p) for p in pixels]
    seen = np.flatnonzero(count)
    if not len(seen):
        return ObjectColors(shares, lightness)
    lab = _lab(np.concatenate([_unshaded(_LINEAR[pixels[n]] * gains) for n in seen]).astype(np.float32))
    weight = 1 + CHROMA * np.minimum(np.hypot(lab[:, 1], lab[:, 2]) / 40, 1)
    parts = color_shares(lab) * weight[:, None]
    start = np.concatenate([[0], np.cumsum([count[n] for n in seen])[:-1]])
    total = np.add.reduceat(parts, start)
    shares[seen] = total / np.add.reduceat(weight, start)[:, None]
    lightness[seen] = np.add.reduceat(parts * lab[:, :1], start) / np.maximum(total, 1e-9)
    return ObjectColors(shares, lightness)


def _unshaded(linear: np.ndarray) -> np.ndarray:
    """Linear RGB ((P, 3), one object) with shaded pixels brightened towards the lit ones."""
    luminance = np.maximum(linear @ _LUMINANCE, 1e-3)
    top = np.maximum(linear.max(axis=1), 1e-3)
    power = UNSHADE_GRAY + (UNSHADE - UNSHADE_GRAY) * (1 - linear.min(axis=1) / top)
    return linear * (np.maximum(np.percentile(luminance, LIT) / luminance, 1) ** power)[:, None]


def _lab(linear: np.ndarray) -> np.ndarray:
    """(P, 3) CIELAB of linear RGB; beyond white is white of the same hue."""
    top = np.maximum(linear.max(axis=1, keepdims=True), 1)
    srgb = (linear / top) ** (1 / 2.2)
    return cv2.cvtColor(srgb.astype(np.float32)[None], cv2.COLOR_RGB2LAB)[0]


def color_probabilities(attribute: Attribute, colors: ObjectColors) -> np.ndarray:
    """(N,) 0..1: how readily each object is called by a colour.

    Goes by the share of the colour relative to that of the main one, so that a thing of two colours has both, and a
    thing between two names answers to both. A shade is asked of the pixels of that colour alone, and "dark" or "light"
    without a colour of all. A half where there are no pixels.
    """
    basic = colors.shares[:, : len(BASIC_COLORS)]
    if attribute.value in _NAMES:
        k = _NAMES.index(attribute.value)
        # A further term is measured by its best example and not against the basic ones.
        main = np.maximum(basic.max(axis=1), 0 if k < len(BASIC_COLORS) else 0.5)
        found = np.minimum(colors.shares[:, k] / main, 1) ** GRADE
        lightness, (light, dark), shade = colors.lightness[:, k], _LIGHTNESS[attribute.value], attribute.shade
    else:
        found, shade = np.ones(len(basic)), attribute.value
        lightness, light, dark = (basic * colors.lightness[:, : len(BASIC_COLORS)]).sum(axis=1), 65, 45
    if shade is not None:
        over = lightness - light if shade == "light" else dark - lightness
        found = found / (1 + np.exp(-over / _SOFT))
    return np.where(np.isnan(basic[:, 0]), 0.5, LEAST + (1 - LEAST) * found)


SIZES: dict[str, tuple[str, int]] = {
    "big": ("volume", 1),
    "small": ("volume", -1),
    "tall": ("height", 1),
    "short": ("height", -1),
    "long": ("length", 1),
    "wide": ("width", 1),
    "narrow": ("width", -1),
    "thick": ("thickness", 1),
    "thin": ("thickness", -1),
}
"""Which key of `size_keys` a size compares, and which end of it; for "biggest" and "taller" too."""

_JUST_NOTICED = 0.1
"""A difference of lengths, as a log ratio, at which the larger is called so in about three of four cases."""
_LEAST_SHARE = 0.1
"""Edges count as at least this share of the longest: the thickness of a seen surface says little of the whole."""


def size_keys(boxes: Sequence[Box3D | None], viewer: ViewerAxes | None = None) -> dict[str, np.ndarray]:
    """Sort keys of sizes and extremes of size.

    Parameters
    ----------
    boxes : sequence of Box3D or None
        In the camera's frame.
    viewer : ViewerAxes, optional
        By default those of a level camera.

    Returns
    -------
    dict of str to (N,) float64
        "volume" (cubic metres, no edge less than a tenth of the longest), "height" (vertical extent), "width" (extent
        from the viewer's left to right), "length" and "thickness" (longest and shortest edge of the box), metres; NaN
        without a box.
    """
    viewer = viewer or viewer_axes(IMAGE_UP)
    keys = {name: np.full(len(boxes), np.nan) for name in ("volume", "height", "width", "length", "thickness")}
    for n, box in enumerate(boxes):
        if box is None or not box.size.max() > 0:
            continue
        keys["volume"][n] = np.maximum(box.size, _LEAST_SHARE * box.size.max()).prod()
        keys["height"][n] = np.abs(viewer.up @ box.R) @ box.size
        keys["width"][n] = np.abs(viewer.right @ box.R) @ box.size
        keys["length"][n], keys["thickness"][n] = box.size.max(), box.size.min()
    return keys


def attribute_probabilities(
    attribute: Attribute,
    rgb: np.ndarray,
    masks: Sequence[np.ndarray],
    boxes: Sequence[Box3D | None],
    alike: np.ndarray,
    viewer: ViewerAxes | None = None,
    colors: ObjectColors | None = None,
) -> np.ndarray | None:
    """P(attribute | object) of every object.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
    masks : sequence of N (H, W) bool
    boxes : sequence of N Box3D or None
        In the camera's frame, metres.
    alike : (N, N) bool
        Row x: the objects that the name given to x means too. Sizes are compared among them.
    viewer : ViewerAxes, optional
        Whose up is up; by default a level camera's.
    colors : ObjectColors, optional
        Of the same masks, where several attributes of a frame are asked for: `object_colors` need then run once only.

    Returns
    -------
    (N,) float64 or None
        0..1, and a half where an object has no pixels or no box to judge by. None where nothing here can judge the
        attribute: materials, others, and most shapes.
    """
    if attribute.kind == "color":
        return color_probabilities(attribute, colors or object_colors(rgb, masks))
    if attribute.kind == "size":
        return size_probabilities(attribute.value, boxes, alike, viewer)
    if attribute.kind == "shape":
        return _shapes(attribute.value, masks, boxes, viewer or viewer_axes(IMAGE_UP))
    return None


def size_probabilities(
    value: str, boxes: Sequence[Box3D | None], alike: np.ndarray, viewer: ViewerAxes | None = None
) -> np.ndarray:
    """(N,) float64: chance of being called the bigger (smaller, taller ...) of two, averaged over objects of the same
    name."""
    keys = size_keys(boxes, viewer)
    key, sign = SIZES[value]
    # A volume goes with the cube of a length, so the same step of its edges is a step three times as large.
    step = _JUST_NOTICED * (3 if key == "volume" else 1)
    level = sign * np.log(np.maximum(keys[key], 1e-9)) / step
    others = np.array(alike, np.bool_) & ~np.eye(len(level), dtype=np.bool_)
    known = np.isfinite(level)
    others &= known[:, None] & known[None]
    wins = np.where(others, _logistic(np.clip(np.where(others, level[:, None] - level[None], 0), -50, 50)), 0)
    count = others.sum(axis=1)
    return np.where(count > 0, wins.sum(axis=1) / np.maximum(count, 1), 0.5)


def _shapes(
    value: str, masks: Sequence[np.ndarray], boxes: Sequence[Box3D | None], viewer: ViewerAxes
) -> np.ndarray | None:
    """Shapes independent of the other objects: flat, round, square, rectangular."""
    edges, plan = np.full((len(boxes), 3), np.nan), np.full((len(boxes), 2), np.nan)
    for n, box in enumerate(boxes):
        if box is not None:
            size = np.maximum(box.size, 1e-3)
            edges[n] = np.log(np.sort(size))
            plan[n] = np.log(np.sort(np.delete(size, np.abs(viewer.up @ box.R).argmax())))
    if value == "flat":
        # Even odds where the thickness is a quarter of the other two edges.
        found = _logistic((np.log(0.25) - (edges[:, 0] - edges[:, 1:].mean(axis=1))) / 0.3)
    elif value in ("round", "square", "rectangular"):
        disc = np.array([_roundness(mask) for mask in masks])
        equal = _logistic((edges[:, 1] - edges[:, 2] - np.log(0.8)) / 0.08)
        # As wide as deep: it may be round from above, as a stool or a mug is.
        upright = 0.5 * _logistic((plan[:, 0] - plan[:, 1] - np.log(0.8)) / 0.08)
        found = {
            "round": np.fmax(disc, upright),
            "square": equal * (1 - 0.8 * np.nan_to_num(disc, nan=0.5)),
            "rectangular": (1 - equal) * (1 - 0.8 * np.nan_to_num(disc, nan=0.5)),
        }[value]
    else:
        return None
    return np.where(np.isnan(found), 0.5, found)


def _roundness(mask: np.ndarray) -> float:
    """0..1: likeness of a mask to a disc seen from any side; NaN for an empty mask.

    The outline is stretched to equal second moments, which makes a circle of any ellipse: the spread of its radius is
    then 0 for a disc or a ball, and a tenth for a rectangle.
    """
    outlines, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return np.nan
    outline = max(outlines, key=len)
    if len(outline) < 8:
        return 0.5
    m = cv2.moments(outline)
    if m["m00"] <= 0:
        return 0.0
    covariance = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
    away = outline[:, 0] - np.array([m["m10"], m["m01"]]) / m["m00"]
    radius = np.sqrt(np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance + 1e-6 * np.eye(2)), away))
    return float(_logistic((0.07 - radius.std() / radius.mean()) / 0.015))


def _logistic(x: np.ndarray | float) -> np.ndarray:
    return 1 / (1 + np.exp(-np.asarray(x, np.float64)))
