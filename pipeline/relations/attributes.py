"""Attributes of a sentence judged on each object: colour from pixels, size and shape from boxes and masks."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import IMAGE_UP
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.language.attributes import Attribute
from pipeline.relations.colors import ObjectColors, color_probabilities, object_colors

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
