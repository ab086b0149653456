"""LIFT: from a mask and a depth map to an object's cleaned points and 3D box.

Every pixel of the mask ends as kept or as dropped for one named reason, and
that evidence is kept with the object. Nothing is random.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Literal, cast

import numpy as np

from pipeline.geometry.boxes import Box3D, Side
from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.geometry.cleaning import (
    DEPTH_EDGE,
    KEPT,
    NO_DEPTH,
    OUT_OF_RANGE,
    BoxMode,
    LiftConfig,
    PixelEvidence,
    decided,
    depth_edges,
    depth_ranks,
)
from pipeline.geometry.fitting import (
    extents_along,
    gravity_box,
    mean_of,
    median,
    pca_box,
    upright_box,
    upright_boxes,
    with_thin_parts,
)
from pipeline.geometry.masks import MaskCrop
from pipeline.geometry.open_sides import open_sides
from pipeline.geometry.surface import plane_depths
from pipeline.geometry.viewer import ViewerAxes
from pipeline.system.frozen import dataclass

MaskSource = Literal["annotation", "detector", "box3d", "segmenter", "box", "human"]
"""Whose pixels they are: the dataset's mask, the detector's, those inside the
annotated 3D box, those a segmenter found in the 2D box, the whole 2D box, or
those of a person who corrected the labels."""


MAD_TO_DEVIATION = 1.4826
"""Standard deviation of a normal distribution of median absolute deviation 1."""
DROPPED_POINTS = 500
PART_PIXELS, PART_SHARE = 10, 0.02
"""Fewest dropped pixels that tell of a part of an object, and as a share of those kept."""


@dataclass(frozen=True)
class Quality:
    """Trustworthiness of an object's points."""

    mask_pixels: int
    points: int  # Pixels kept by the cleaning, before thinning
    kept: float  # Share of the mask that was kept, 0..1
    depth_missing: float  # Share of the mask without a valid depth, 0..1
    touches_border: bool  # The mask reaches the image border: part of the object is not seen
    distance: float  # Median depth of the kept points, metres; NaN without points
    fallback: bool  # Cleaning left too few pixels and the raw mask was used
    mask_source: MaskSource

    @property
    def concerns(self) -> tuple[str, ...]:
        """Reasons to doubt the box, in words."""
        concerns = (
            (self.points == 0, "no point has a valid depth"),
            (0 < self.points < 100, f"only {self.points} points"),
            (self.depth_missing > 0.5, f"{self.depth_missing:.0%} of the mask has no depth"),
            (self.fallback and self.points, "too small to clean, raw mask used"),
            (self.touches_border, "cut by the image border"),
            (self.mask_source == "box", "no mask: the whole 2D box was lifted"),
            (self.mask_source == "box3d", "no mask: the points inside the annotated 3D box were lifted"),
        )
        return tuple(text for holds, text in concerns if holds)


@dataclass(frozen=True)
class LiftedObject:
    """An object in 3D."""

    points: np.ndarray  # (N, 3) float32, cleaned, camera frame, metres; N may be 0
    box: Box3D | None  # In the camera frame; None where no point has a depth
    # 1 - (second / first variance) of the fit's own axes: 0 says that the yaw means nothing, 1 that it is certain
    yaw_confidence: float
    lo: np.ndarray  # (3,) float64, extents along (right, up, forward), metres; NaN without points and box
    hi: np.ndarray  # (3,) float64
    evidence: PixelEvidence | None
    quality: Quality
    # Sides that the view does not bound (`open_sides`), of boxes as `upright_box` fits them; None: not known of others
    open_sides: tuple[Side, ...] | None = None

    @cached_property
    def mean(self) -> np.ndarray:
        """Mean of the points, (3,) float64, camera frame, metres; of N > 0."""
        return mean_of(self.points)

    @property
    def goes_on(self) -> str:
        """Open sides in words, empty without any: "may go on: right, far"."""
        return f"may go on: {', '.join(self.open_sides)}" if self.open_sides else ""

    def __repr__(self) -> str:
        return f"<LiftedObject {len(self.points)} points, {self.box or 'no box'}>"

    def moved_to(self, box: Box3D, viewer: ViewerAxes) -> LiftedObject:
        """Object after an edit of the box: the points move by the same affine map."""
        if self.box is None or not len(self.points):
            lo, hi = extents(np.empty((0, 3)), box, viewer)
            return replace(self, box=box, lo=lo, hi=hi, open_sides=None)
        scale = box.size / np.maximum(self.box.size, 1e-6)
        local = (self.points - self.box.center) @ self.box.R * scale
        points = (local @ box.R.T + box.center).astype(np.float32)
        lo, hi = extents(points, box, viewer)
        return replace(self, points=points, box=box, lo=lo, hi=hi, open_sides=None)


def extents(points: np.ndarray, box: Box3D | None, viewer: ViewerAxes) -> tuple[np.ndarray, np.ndarray]:
    """Extents of an object along (right, up, forward), (3,) float64 each, metres, for rules and features alike.

    1st and 99th percentile of the points; of the box's corners where there are no points; NaN where there is neither.
    """
    if len(points):
        return extents_along(viewer.matrix.astype(points.dtype) @ points.T)
    if box is not None:
        corners = box.corners @ viewer.matrix.T
        return corners.min(axis=0), corners.max(axis=0)
    return np.full(3, np.nan), np.full(3, np.nan)


def lift(
    depth: np.ndarray,
    camera: Camera,
    masks: Sequence[np.ndarray | MaskCrop],
    viewer: ViewerAxes,
    *,
    config: LiftConfig | None = None,
    mask_source: MaskSource | Sequence[MaskSource] = "annotation",
    edges: np.ndarray | None = None,
    boxes: bool = True,
    thin: Sequence[bool] | None = None,
) -> tuple[LiftedObject, ...]:
    """Lift masks to 3D.

    Parameters
    ----------
    depth : (H, W) float32
        Metres.
    masks : sequence of (H, W) bool or MaskCrop
    viewer : ViewerAxes
        The level frame for extents and boxes.
    mask_source : MaskSource, or a sequence of it
        Of all masks, or of each.
    edges : (H, W) bool, optional
        From `depth_edges`, where it is at hand already.
    boxes : bool
        Fit 3D boxes; without, `box` is None and `yaw_confidence` 0, all else is the same.
    thin : sequence of bool, optional
        Objects whose class may be thin (`language.is_thin`): upright boxes of others are at least half as deep as wide.

    Returns
    -------
    tuple of LiftedObject
        One for each mask, in order.

    Raises
    ------
    InputError
        The camera is only a stand-in (`Camera.untold`).

    >>> import numpy as np
    >>> from pipeline.geometry import IMAGE_UP, Camera, intrinsics, lift, viewer_axes
    >>> depth, mask = np.full((480, 640), 2, np.float32), np.zeros((480, 640), bool)
    >>> mask[200:280, 300:400] = True
    >>> lift(depth, Camera(intrinsics(500, 500, 320, 240), 640, 480), [mask], viewer_axes(IMAGE_UP))
    (<LiftedObject 7296 points, <Box3D center 0.114 -0.002 2.100, size 0.400 0.328 0.200 m>>,)
    """
    camera.check_metric()
    config = config or LiftConfig()
    if edges is None:
        edges = depth_edges(depth, config)
    sources = cast("Sequence[MaskSource]", [mask_source] * len(masks) if isinstance(mask_source, str) else mask_source)
    return _lifted(depth, camera, masks, viewer, config, sources, edges, boxes, thin or [False] * len(masks))


def _lifted(
    depth: np.ndarray,
    camera: Camera,
    masks: Sequence[np.ndarray | MaskCrop],
    viewer: ViewerAxes,
    config: LiftConfig,
    sources: Sequence[MaskSource],
    edges: np.ndarray,
    boxes: bool,
    thin: Sequence[bool],
) -> tuple[LiftedObject, ...]:
    ranks = depth_ranks(depth, edges, config)
    decisions = [decided(mask, depth, ranks, config) for mask in masks]
    upright = boxes and config.box == "upright"
    kept = [np.flatnonzero(own.codes == KEPT) for own, _ in decisions]
    thinned = [_evenly(places, config.max_points) for places in kept]
    dropped = [np.flatnonzero(own.codes >= DEPTH_EDGE) if upright else thinned[0][:0] for own, _ in decisions]
    steps = [1 + len(places) // DROPPED_POINTS for places in dropped]
    thinned += [places[::step] for places, step in zip(dropped, steps, strict=True)]
    clouds = _lifted_places(thinned, [own for own, _ in decisions] * 2, depth, camera)
    qualities = [
        _quality(own, len(places), points, depth, fallback, source)
        for (own, fallback), places, points, source in zip(decisions, kept, clouds, sources, strict=False)
    ]
    fits: list[tuple[Box3D | None, float]] = [(None, 0.0)] * len(masks)
    sides: dict[int, tuple[Side, ...]] = {}
    seen = [k for k, quality in enumerate(qualities) if boxes and quality.points]
    if upright:
        evidence = [decisions[k][0] for k in seen]
        smooth = _smooth_points(depth, evidence, camera, config)
        found = upright_boxes(
            [points for points, _, _ in smooth],
            viewer,
            margins=[rim * qualities[k].distance / camera.fx for k, (_, rim, _) in zip(seen, smooth, strict=True)],
            noises=[noise for _, _, noise in smooth],
            thin=[thin[k] for k in seen],
        )
        # So many dropped points tell of a part of the object.
        least = [max(PART_PIXELS, PART_SHARE * qualities[k].points) / steps[k] for k in seen]
        found = [
            (with_thin_parts(box, clouds[len(masks) + k], enough), sure)
            for (box, sure), k, enough in zip(found, seen, least, strict=True)
        ]
        crops = [(own.codes, own.x0, own.y0) for own in evidence]
        sides.update(zip(seen, open_sides([box for box, _ in found], crops, depth, camera), strict=True))
    else:
        found = [fit_box(clouds[k], viewer, config.box) for k in seen]
    for k, fit in zip(seen, found, strict=True):
        fits[k] = fit
    return tuple(
        LiftedObject(points, box, sure, *extents(points, box, viewer), own, quality, sides.get(k))
        for k, ((own, _), points, (box, sure), quality) in enumerate(
            zip(decisions, clouds, fits, qualities, strict=False)
        )
    )


def _evenly(places: np.ndarray, most: int) -> np.ndarray:
    """At most so many of (N,) places."""
    n = len(places)
    return places[np.linspace(0, n - 1, most).astype(np.int64)] if n > most else places


def _quality(
    evidence: PixelEvidence, kept: int, points: np.ndarray, depth: np.ndarray, fallback: bool, source: MaskSource
) -> Quality:
    """Quality of an object of so many kept pixels and its points."""
    codes = evidence.codes
    area = int(np.count_nonzero(codes))
    missing = int(np.count_nonzero((codes == NO_DEPTH) | (codes == OUT_OF_RANGE)))
    h, w = codes.shape
    border = bool(
        (evidence.y0 == 0 and codes[0].any())
        or (evidence.x0 == 0 and codes[:, 0].any())
        or (evidence.y0 + h == depth.shape[0] and codes[-1].any())
        or (evidence.x0 + w == depth.shape[1] and codes[:, -1].any())
    )
    return Quality(
        mask_pixels=area,
        points=kept,
        kept=kept / max(area, 1),
        depth_missing=missing / max(area, 1),
        touches_border=border,
        distance=float(median(points[:, 2])) if kept else float("nan"),
        fallback=fallback,
        mask_source=source,
    )


def _smooth_points(
    depth: np.ndarray, evidence: Sequence[PixelEvidence], camera: Camera, config: LiftConfig
) -> list[tuple[np.ndarray, float, float]]:
    """Kept points of objects, (N, 3), without the sensor's noise, which lengthens boxes; the rim that they lack,
    pixels; their noise, metres.
    """
    patches, rims = [], []
    for own in evidence:
        kept = own.codes == KEPT
        h, w = kept.shape
        step = max(1, round(math.sqrt(np.count_nonzero(kept) / config.fit_pixels)))
        if not kept[::step, ::step].any():
            step = 1
        sensed = depth[own.y0 : own.y0 + h : step, own.x0 : own.x0 + w : step]
        x = (np.arange(own.x0, own.x0 + w, step) - camera.cx) / camera.fx
        y = (np.arange(own.y0, own.y0 + h, step) - camera.cy) / camera.fy
        patches.append((sensed, np.ascontiguousarray(kept[::step, ::step]), x, y))
        # What erosion and thinning leave out beyond the outermost points' centres.
        rims.append(own.eroded + 0.5 + (step - 1) / 2)
    planes = plane_depths(patches, max(1, round(config.smooth * depth.shape[1] / 640)))
    if not planes:
        return []
    z = np.concatenate([smooth for *_, smooth in planes])
    # All at once; what is of one object is only cut out of it.
    x = np.concatenate([patch[2].take(u) for patch, (_, u, _) in zip(patches, planes, strict=True)])
    y = np.concatenate([patch[3].take(v) for patch, (v, _, _) in zip(patches, planes, strict=True)])
    off = np.abs(np.concatenate([patch[0][v, u] for patch, (v, u, _) in zip(patches, planes, strict=True)]) - z)
    points = np.array([x * z, y * z, z])
    ends = np.cumsum([len(smooth) for *_, smooth in planes]).tolist()
    return [
        (points[:, start:end].T, rim, MAD_TO_DEVIATION * float(median(off[start:end])))
        for start, end, rim in zip([0, *ends], ends, rims, strict=False)
    ]


def _lifted_places(
    places: Sequence[np.ndarray], evidence: Sequence[PixelEvidence], depth: np.ndarray, camera: Camera
) -> list[np.ndarray]:
    """Points, (N, 3) each, of places, (N,) each, in rectangles of evidence, row by row."""
    if not places:
        return []
    wide = np.int32(depth.shape[1])
    pixels = []
    for own, part in zip(evidence, places, strict=True):
        part = part.astype(np.int32)
        # `divmod` is several times as slow.
        row = part // np.int32(own.codes.shape[1])
        row *= wide - np.int32(own.codes.shape[1])
        part += row
        part += np.int32(own.y0) * wide + np.int32(own.x0)
        pixels.append(part)
    pixel = np.concatenate(pixels)
    v = pixel // wide
    points = lift_pixels(depth.take(pixel), camera, v, pixel - v * wide)
    return np.split(points, np.cumsum([len(part) for part in places])[:-1])


def fit_box(points: np.ndarray, viewer: ViewerAxes, mode: BoxMode = "gravity") -> tuple[Box3D | None, float]:
    """Fit a 3D box to points, (N, 3), camera frame, with its yaw confidence; (None, 0) for no points."""
    if not len(points):
        return None, 0.0
    if mode == "upright":
        return upright_box(points, viewer)
    if mode == "gravity":
        return gravity_box(points, viewer)
    return pca_box(points, None if mode == "pca-raw" else viewer)
