"""Rules on objects: mask, 2D box, 3D box and extents must show one thing, enough of it, and no thing twice.

Sizes are compared with what the class can be, and with the object's own kind in the dataset.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any

import numpy as np

from pipeline.datasets.plausible import doubt_by_sizes
from pipeline.geometry.boxes import CORNER_SIGNS, Box3D, iou_3d, most_iou_3d, paired_iou_2d
from pipeline.geometry.masks import MaskCrop
from pipeline.geometry.surface import surface_step
from pipeline.labels.check.view import Finding, FrameView, Severity
from pipeline.language.class_sizes import size_factor, size_range
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

NEAREST_M = 0.05
"""Corners nearer than this are projected as if they lay there."""


def corners_of(center: np.ndarray, rotation: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(N, 8, 3) corners in the camera frame, metres, of boxes given as (N, 3), (N, 3, 3), (N, 3)."""
    return center[:, None] + np.einsum("kj,nj,nij->nki", CORNER_SIGNS / 2, size, rotation)


def projected(corners: np.ndarray, K: np.ndarray) -> np.ndarray:
    """(N, 4) rectangles x0, y0, x1, y1 in pixels around (N, 8, 3) corners; edges exclusive, not clipped."""
    z = np.maximum(corners[..., 2], NEAREST_M)
    # Pixel centres are whole numbers, and edges lie half a pixel beyond.
    u = K[0, 0] * corners[..., 0] / z + K[0, 2] + 0.5
    v = K[1, 1] * corners[..., 1] / z + K[1, 2] + 0.5
    return np.stack([u.min(axis=1), v.min(axis=1), u.max(axis=1), v.max(axis=1)], axis=1)


def clipped(boxes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(N, 4) rectangles within a picture of (height, width)."""
    height, width = size
    return np.clip(boxes, 0, [width, height, width, height])


def moved_towards(boxes: np.ndarray, targets: np.ndarray, slack: float | np.ndarray) -> np.ndarray:
    """Each side of (N, 4) rectangles moved towards the target's, by at most `slack` pixels."""
    return boxes + np.clip(targets - boxes, -slack, slack)


def cleared(known: np.ndarray, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """Zero the rows of arrays unknown by (N,) bool."""
    return tuple(np.where(known.reshape(-1, *[1] * (a.ndim - 1)), a, 0.0) for a in arrays)


SLACK_PIXELS = 4.0
"""At a width of 640, for what cleaning takes off a mask's border; measured on clean labels."""
BOX_ON_MASK, BOX_ON_MASK_WARNED = 0.2, 0.4
"""Least share of the projected 3D box on the mask's extents: upright boxes go on behind it. Clean labels: 0.24 and
more, 0.4 and more of all but 4 of 1,438."""
MASK_IN_BOX, MASK_IN_BOX_WARNED = 0.05, 0.15
"""Least share of the mask's extents on the projected box, for each share of its pixels that was kept: an object that
an occluder cuts in parts may lose most of them (clean labels: 0.18 and more)."""
BBOX_MASK, BBOX_MASK_WARNED = 0.2, 0.7
"""Least IoU of the 2D box with the mask's extents; annotations have 1."""
OUTSIDE_M, OUTSIDE_SHARE = (0.01, 0.05), (0.1, 0.2)
"""How far extents may reach beyond the box's corners, in metres plus a share of its length: for a warning, an error.
Clean labels: 7 mm. Noise is taken off the ends of upright boxes: theirs may reach a step of the surface farther (none
of 3,129 does more)."""
FILLED, FILLED_WARNED = 0.2, 0.35
"""Least length of the extents for the box's along an axis: a turned box is longer (clean labels: 0.41 and more). An
upright box goes on behind what is seen, and to its farthest points."""
FLAT_M = 0.02
"""A box may be so much longer than the extents in any case: that of a face without depth has no proportions."""
FEW_POINTS, MOST_MISSING = 100, 0.5
AXES = ("right", "up", "forward")


def check_objects(view: FrameView) -> Iterator[Finding]:
    """Compare mask, 2D box, 3D box and extents of each object, and judge visibility."""
    objects, named, size = view.objects, view.named, view.size
    stated, crops = objects["mask_pixels"], view.crops
    off = [isinstance(c, str) or (c is not None and c.area != n) for c, n in zip(crops, stated, strict=True)]
    yield from view.where(
        "object/mask",
        np.array(off, np.bool_),
        lambda k: (
            f"the mask of {named(k)} is damaged: {crops[k]}"
            if isinstance(crops[k], str)
            else f"the mask of {named(k)} has {crops[k].area} pixels, and {stated[k]} are stated"
        ),
        lambda k: {} if isinstance(crops[k], str) else {"area": crops[k].area, "stated": stated[k]},
    )
    masks = [c if isinstance(c, MaskCrop) and c.area else None for c in crops]
    sound = np.array([c is not None for c in masks], np.bool_)
    mask_box = np.array([(0, 0, 0, 0) if c is None else c.box for c in masks], np.float64).reshape(-1, 4)
    yield from _bbox(view, sound, mask_box)
    rotation = objects["R"].reshape(-1, 3, 3)
    boxed = np.isfinite(objects["center"]).all(axis=1) & np.isfinite(objects["size"]).all(axis=1)
    boxed &= rotation_fault(rotation) < 0.1
    corners = corners_of(*cleared(boxed, objects["center"], rotation, objects["size"]))
    behind = boxed & ((corners[..., 2].mean(axis=1) <= 0) | (corners[..., 2] <= 0).all(axis=1))
    yield from view.where(
        "object/box-mask",
        behind,
        lambda k: f"the 3D box of {named(k)} is behind the camera",
        lambda k: {"z": corners[k, :, 2].mean()},
    )
    if view.K is not None:
        box = moved_towards(clipped(projected(corners, view.K), size), mask_box, SLACK_PIXELS * size[1] / 640)
        yield from _projection(view, boxed & ~behind & sound, box, mask_box)
    if view.viewer is not None:
        yield from _extents(view, boxed, corners @ view.viewer.matrix.T)
    asked, points, missing = (objects[name] for name in ("usable", "points", "depth_missing"))
    yield from view.where(
        "object/few-points",
        asked & (points < FEW_POINTS),
        lambda k: f"{named(k)} has {points[k]} points",
        lambda k: {"points": points[k]},
    )
    yield from view.where(
        "object/no-depth",
        asked & (missing > MOST_MISSING),
        lambda k: f"{missing[k]:.0%} of the mask of {named(k)} has no depth",
        lambda k: {"depth_missing": missing[k]},
    )
    yield from view.where(
        "object/border", asked & objects["touches_border"], lambda k: f"{named(k)} is cut by the image border"
    )


def _bbox(view: FrameView, sound: np.ndarray, mask_box: np.ndarray) -> Iterator[Finding]:
    bbox, named = view.objects["bbox"], view.named
    finite = np.asarray(np.isfinite(bbox).all(axis=1))
    empty = finite & ((bbox[:, 2] <= bbox[:, 0]) | (bbox[:, 3] <= bbox[:, 1]))
    yield from view.where("object/bbox-mask", empty, lambda k: f"the 2D box of {named(k)} is empty")
    within = clipped(bbox, view.size)
    overlap = paired_iou_2d(moved_towards(within, mask_box, SLACK_PIXELS / 2 * view.size[1] / 640), mask_box)
    # Of an object without a mask of its own, pixels inside its annotated 3D box were taken: a part of the 2D box.
    overlap = np.where(view.objects["mask_source"] == "box3d", shared_share(mask_box, within), overlap)
    yield from view.where(
        "object/bbox-mask",
        finite & ~empty & sound & (overlap < BBOX_MASK_WARNED),
        lambda k: f"the 2D box of {named(k)} and its mask agree to {overlap[k]:.0%}",
        lambda k: {"agreement": overlap[k]},
        overlap < BBOX_MASK,
    )


def shared_share(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N,) share of each rectangle of `a` ((N, 4)) covered by `b`'s; 0 if empty."""
    low, high = np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, 2:], b[:, 2:])
    shared = np.clip(high - low, 0, None).prod(axis=1)
    area = np.clip(a[:, 2:] - a[:, :2], 0, None).prod(axis=1)
    return np.divide(shared, area, out=np.zeros_like(area), where=area > 0)


def _projection(view: FrameView, seen: np.ndarray, box: np.ndarray, mask_box: np.ndarray) -> Iterator[Finding]:
    """3D boxes against masks, in the picture."""
    on_mask, in_box, kept = shared_share(box, mask_box), shared_share(mask_box, box), view.objects["kept"]
    relative = in_box / np.maximum(kept, 1e-6)
    # The raw mask of an object too small to clean holds pixels of what is behind it.
    raw = view.objects["fallback"]
    bad = np.where(raw, on_mask <= 0, (on_mask < BOX_ON_MASK) | (relative < MASK_IN_BOX))
    warned = (on_mask < np.where(raw, BOX_ON_MASK, BOX_ON_MASK_WARNED)) | (relative < MASK_IN_BOX_WARNED)
    yield from view.where(
        "object/box-mask",
        seen & (bad | warned),
        lambda k: (
            f"seen by the camera, {on_mask[k]:.0%} of the 3D box of {view.named(k)} is where its mask is, "
            f"and {in_box[k]:.0%} of the mask where the box is"
        ),
        lambda k: {"box_on_mask": on_mask[k], "mask_in_box": in_box[k], "kept": kept[k]},
        bad,
    )


def _extents(view: FrameView, boxed: np.ndarray, level: np.ndarray) -> Iterator[Finding]:
    """Extents and mean point against the (N, 8, 3) corners of the box, along (right, up, forward)."""
    (lo, hi), named = view.extents, view.named
    known = np.isfinite(lo).all(axis=1) & np.isfinite(hi).all(axis=1)
    first, last = level.min(axis=1), level.max(axis=1)
    length = last - first
    # A box by percentiles is exactly as high as the extents; along the other axes, and tilted, it may be longer.
    same = (view.objects["estimator"] == "gravity")[:, None] & (np.arange(3) == 1)
    upright = (view.objects["estimator"] == "upright")[:, None]
    reach = np.maximum(np.maximum(first - lo, hi - last), 0)
    reach = np.where(same, np.maximum(np.abs(lo - first), np.abs(hi - last)), reach)
    step = np.where(upright, surface_step(np.nan_to_num(view.objects["distance"]))[:, None] * (1, 0, 1), 0)
    warn, fail = (m + s * length + step for m, s in zip(OUTSIDE_M, OUTSIDE_SHARE, strict=True))
    warn = np.where(same, OUTSIDE_M[0], warn)
    longer = ~upright & (length - (hi - lo) > FLAT_M)
    filled = np.where(longer, (hi - lo) / np.maximum(length, 1e-3), 1.0)
    bad = (reach > fail).any(axis=1) | (filled < FILLED).any(axis=1) | (hi < lo).any(axis=1)
    off = known & boxed & (bad | (reach > warn).any(axis=1) | (filled < FILLED_WARNED).any(axis=1))
    axes = np.where((reach > warn).any(axis=1), np.argmax(reach - warn, axis=1), np.argmin(filled, axis=1)).tolist()
    yield from view.where(
        "object/extent-box",
        off,
        lambda k: (
            f"along {AXES[axes[k]]} the extents of {named(k)} are {lo[k, axes[k]]:.3f} to "
            f"{hi[k, axes[k]]:.3f} m, its box {first[k, axes[k]]:.3f} to {last[k, axes[k]]:.3f} m"
        ),
        lambda k: {"axis": AXES[axes[k]], "off": reach[k, axes[k]], "filled": filled[k, axes[k]]},
        bad,
    )
    centroid = view.objects["centroid"]
    stray = np.maximum(np.maximum(lo - centroid, centroid - hi), 0)
    yield from view.where(
        "object/extent-box",
        known & ~off & (stray > OUTSIDE_M[0] + OUTSIDE_SHARE[0] * np.abs(hi - lo)).any(axis=1),
        lambda k: f"the mean point of {named(k)} is {stray[k].max():.3f} m outside its extents",
        lambda k: {"outside": stray[k].max()},
        np.zeros(len(lo), np.bool_),
    )
    yield from view.where("object/extent-box", boxed & ~known, lambda k: f"{named(k)} has a 3D box and no extents")


SAME_NAME_IOU = 0.7
OTHER_NAME_IOU = 0.9


def check_duplicates(view: FrameView) -> Iterator[Finding]:
    """Find pairs of objects with the same pixels or volume."""
    if len(view.ids) < 2:
        return
    masks, named = mask_overlaps(view), view.named
    boxes = box_overlaps(view, view.alike, masks >= SAME_NAME_IOU)
    same = view.alike & ((masks >= SAME_NAME_IOU) | (boxes >= SAME_NAME_IOU))
    yield from view.where(
        "object/duplicate",
        np.triu(same | (~view.alike & (masks >= OTHER_NAME_IOU)), 1),
        lambda a, b: (
            f"{named(a)} and {named(b)} are one thing: their masks overlap by {masks[a, b]:.0%}, their boxes by "
            f"{boxes[a, b]:.0%}"
            if same[a, b]
            else f"{named(a)} and {named(b)} share {masks[a, b]:.0%} of their pixels: one thing under two names?"
        ),
        lambda a, b: {"mask_iou": masks[a, b], "box_iou": boxes[a, b]},
        same,
    )


def mask_overlaps(view: FrameView) -> np.ndarray:
    """(N, N) float64 IoU of the masks; 0 if unreadable."""
    found = np.zeros((len(view.ids), len(view.ids)))
    sound = [k for k, c in enumerate(view.crops) if isinstance(c, MaskCrop) and c.area]
    if len(sound) < 2:
        return found
    from pycocotools import mask as coco

    codes: Any = [{"size": view.size, "counts": str(view.objects["mask"][k]).encode("ascii")} for k in sound]
    found[np.ix_(sound, sound)] = coco.iou(codes, codes, np.zeros(len(codes), np.uint8))
    return found


def box_overlaps(view: FrameView, wanted: np.ndarray, found_out: np.ndarray) -> np.ndarray:
    """(N, N) float64 IoU of the 3D boxes of the wanted pairs, if SAME_NAME_IOU is in reach; else 0.

    Pairs that are `found_out` anyway need no close look at what is in reach.
    """
    objects = view.objects
    center, rotation, size = objects["center"], objects["R"].reshape(-1, 3, 3), objects["size"]
    known = np.isfinite(center).all(axis=1) & np.isfinite(rotation).all(axis=(1, 2))
    known = np.asarray(known & (size > 0).all(axis=1))
    found = np.zeros((len(center), len(center)))
    if known.sum() < 2:
        return found
    corners = corners_of(*cleared(known, center, rotation, size))
    low, high, volume = corners.min(axis=1), corners.max(axis=1), np.where(known, size.prod(axis=1), 1.0)
    # No solid is larger than the box around it, and no union smaller than the larger of two.
    shared = np.clip(np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None]), 0, None).prod(axis=2)
    larger, smaller = np.maximum(volume[:, None], volume[None]), np.minimum(volume[:, None], volume[None])
    possible = wanted & known[:, None] & known[None, :] & (np.minimum(shared, smaller) >= SAME_NAME_IOU * larger)
    for a, b in np.argwhere(np.triu(possible, 1)).tolist():
        try:
            boxes = [Box3D(center[k], rotation[k], size[k]) for k in (a, b)]
        except InputError:
            continue
        # The exact overlap loads Qhull, 200 ms.
        if found_out[a, b] or most_iou_3d(*boxes) >= SAME_NAME_IOU:
            found[a, b] = found[b, a] = iou_3d(*boxes)
    return found


LEAST_EXAMPLES = 8
DEVIATIONS = 6.0
LEAST_FACTOR = 2.0
"""An object unlike its kind is at least so many times larger or smaller than the median."""
MAD_SIGMA = 1.4826
"""Standard deviations in one median absolute deviation of a normal distribution."""
HARDLY_OCCLUDED = 0.05
_BINS, _LOWEST, _HIGHEST = 600, np.log(1e-3), np.log(1e2)
_STEP = (_HIGHEST - _LOWEST) / _BINS


@dataclass
class SizeSurvey:
    """How long the objects of each class are: histograms of the logarithm, so that memory grows with classes alone."""

    counts: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, rows: Mapping[str, np.ndarray]) -> None:
        """Count objects that are seen whole and well."""
        longest, _ = lengths(rows)
        good = np.isfinite(longest) & (longest > 0) & seen_whole(rows)
        for label, length in zip(rows["label"][good], longest[good], strict=True):
            bins = self.counts.setdefault(label, np.zeros(_BINS, np.int64))
            bins[int(np.clip((np.log(length) - _LOWEST) / _STEP, 0, _BINS - 1))] += 1

    def spread(self, label: str) -> tuple[float, float, int]:
        """Median and robust deviation of the logarithm, and of how many; to one step of 2 %."""
        bins = self.counts.get(label)
        n = 0 if bins is None else int(bins.sum())
        if bins is None or not n:
            return float("nan"), float("nan"), 0
        center = _LOWEST + (np.arange(_BINS) + 0.5) * _STEP
        median = float(center[np.searchsorted(np.cumsum(bins), n / 2)])
        away = np.abs(center - median)
        order = np.argsort(away)
        deviation = float(away[order][np.searchsorted(np.cumsum(bins[order]), n / 2)])
        return median, max(MAD_SIGMA * deviation, 2 * _STEP), n


def lengths(rows: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Longest edges in metres of the lifted box and of the dataset's own; two (N,), NaN if absent."""
    return rows["size"].max(axis=1), rows["exact_size"].max(axis=1)


def seen_whole(rows: Mapping[str, np.ndarray]) -> np.ndarray:
    """(N,) bool: objects neither hidden nor cut, with a cleaned box."""
    return ~rows["touches_border"] & (rows["occluded"] < HARDLY_OCCLUDED) & ~rows["fallback"]


def check_sizes(view: FrameView, survey: SizeSurvey) -> Iterator[Finding]:
    """Find objects too large or too small for the class, or unlike others of the class."""
    rows = view.objects
    columns = (
        *lengths(rows.columns),
        seen_whole(rows.columns),
        np.isin(rows["mask_source"].astype(str), ["annotation", "detector"]),
    )
    for k, (label, lifted, exact, whole, own) in enumerate(zip(view.labels, *columns, strict=True)):
        own_pixels = bool(own) and not rows["fallback"][k]
        found = _against_table(label, lifted, exact, bool(whole), own_pixels) or _against_kind(
            label, lifted, bool(whole), survey
        )
        if found:
            message, figures, severity = found
            yield view.finding(
                "object/implausible-size", (view.ids[k],), f"{view.named(k)} {message}", figures, severity
            )


def check_depth(view: FrameView) -> Iterator[Finding]:
    """Find a frame with things too large or too small by a common factor, as by a wrong depth scale."""
    if not view.usable:
        return
    lifted, whole = lengths(view.objects.columns)[0], seen_whole(view.objects.columns)
    found = size_factor([label for label, sound in zip(view.labels, whole, strict=True) if sound], lifted[whole])
    doubt = doubt_by_sizes(found)
    if found is not None and doubt is not None:
        figures = {"factor": found.middle, "things": found.things, "fit": found.fitting}
        yield view.finding("frame/implausible-depth", (), doubt.text, figures)


Verdict = tuple[str, dict[str, Any], Severity]


def _against_table(label: str, lifted: float, exact: float, whole: bool, own_pixels: bool) -> Verdict | None:
    low, high = size_range(label) or (0.0, np.inf)
    longest, shortest = np.fmax(lifted, exact), exact if np.isfinite(exact) else lifted
    if longest > high:
        # A box around pixels that are not all the object's own proves little.
        severity: Severity = "error" if exact > high or own_pixels else "warning"
        figures = {"longest_edge": longest, "least": low, "most": high}
        return f"is {longest:.2f} m long; its class is at most {high:g} m", figures, severity
    if shortest < low and (whole or np.isfinite(exact)):
        figures = {"longest_edge": shortest, "least": low, "most": high}
        return f"is {shortest:.3f} m long; its class is at least {low:g} m", figures, "warning"
    return None


def _against_kind(label: str, lifted: float, whole: bool, survey: SizeSurvey) -> Verdict | None:
    median, deviation, n = survey.spread(label)
    if n < LEAST_EXAMPLES or not lifted > 0:
        return None
    away = float(np.log(lifted)) - median
    if abs(away) <= max(DEVIATIONS * deviation, np.log(LEAST_FACTOR)) or (away < 0 and not whole):
        return None
    figures = {"longest_edge": lifted, "median": np.exp(median), "deviations": away / deviation, "examples": n}
    return f"is {lifted:.2f} m long; the median of {n} is {np.exp(median):.2f} m", figures, "warning"


def rotation_fault(rotation: np.ndarray) -> np.ndarray:
    """(N,) how far (N, 3, 3) matrices are from rotations: the greatest entry of R R^T - I, at least 2 for a mirror."""
    fault = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        return np.where(np.linalg.det(np.nan_to_num(rotation)) < 0, np.maximum(fault, 2.0), fault)
