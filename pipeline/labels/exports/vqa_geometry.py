"""Geometry of objects that questions are asked of, and what it rests on.

Sizes and centres are those of the object's 3D box: a person's, else the dataset's, else the fitted one of an object
seen whole. Boxes fitted as before 0.2 (`estimator`) say nothing: they are a sixth too narrow. Gaps are between the raw
points of two objects, with the rim that cleaning took off where it goes on as the surface that was kept: boxes around
them, exact ones too, would close or widen them by centimetres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import xxhash

from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera, lift_pixels
from pipeline.geometry.cleaning import LiftConfig, Pixel, clean, depth_edges, flying_pixels
from pipeline.geometry.masks import decode_run_length
from pipeline.geometry.surface import surface_step
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.exports.base import ExportFrame
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass

EXACT, HUMAN, FITTED, POINTS = "the dataset's box", "a person's box", "the fitted box", "points of the mask"
LEAST_SIZE, LEAST_SIZE_RELATIVE = 0.07, 0.04
"""Fitted extents below max(7 cm, 4 % of the distance) are as much noise and the mask's rim as the object's."""
MOST_POINTS = 4000
"""Of each object in a gap, thinned evenly."""
MASKS = ("annotation", "detector", "segmenter", "human")
"""Sources of masks that follow the object's outline."""


@dataclass(frozen=True)
class Figures:
    """What is known of one object; coordinates along the viewer's (right, up, forward), metres."""

    rests_on: str | None
    """What centre and extents come from: EXACT, HUMAN or FITTED; None where nothing is known."""
    center: np.ndarray
    """(3,) float64: NaN where it is not known."""
    extents: np.ndarray
    """(3,) float64: NaN along an axis of which nothing is known."""
    points: np.ndarray
    """(N, 3) float32: its raw points, empty where it is not seen whole."""


NOTHING = Figures(None, np.full(3, np.nan), np.full(3, np.nan), np.empty((0, 3), np.float32))


class Depths:
    """The depth maps that labels were made from, read when first asked for.

    `missing`: how many were asked for in vain. `problem`: why, of the last.
    """

    def __init__(self, dataset: Callable[[], Dataset] | None) -> None:
        self._open = dataset
        self._dataset: Dataset | None = None
        self.missing, self.problem = 0, ""

    def of(self, frame: Mapping[str, Any]) -> np.ndarray | None:
        """(H, W) float32 metres, exactly as labelled, or None."""
        try:
            if self._dataset is None:
                self._dataset = needed(self._open, "no dataset is given")()
            depth = load_picture(self._dataset, frame["frame"]).depth
            require(
                xxhash.xxh3_128_hexdigest(np.ascontiguousarray(depth).data) == frame["depth_hash"],
                f"frame {frame['frame']}: another depth than was labelled",
                path=self._dataset.root,
            )
        except InputError as error:
            self.missing, self.problem = self.missing + 1, str(error)
            return None
        return depth


def figures_of(rows: ExportFrame, config: VqaConfig, depths: Depths, human: frozenset[int]) -> list[Figures]:
    """Geometry of each object of a frame, as far as known.

    `depths`: asked only where some object is seen whole. `human`: numbers of the objects whose 3D box a person set.
    """
    if rows.frame["up"] is None:
        return [NOTHING] * len(rows.objects)
    viewer = viewer_axes(np.array(rows.frame["up"]))
    whole = [seen_whole(row, config) for row in rows.objects]
    depth = depths.of(rows.frame) if any(whole) else None
    raw = None if depth is None else _RawPoints(rows.frame, depth, viewer)
    found = []
    for row, ok in zip(rows.objects, whole, strict=True):
        given = HUMAN if row["object"] in human else EXACT if row["exact_size"] else None
        fitted = FITTED if ok and row["estimator"] == "upright" else None
        known = _measured(row, viewer, given or fitted)
        found.append(replace(known, points=raw.of(row)) if ok and raw is not None else known)
    return found


def _measured(row: Mapping[str, Any], viewer: ViewerAxes, rests_on: str | None) -> Figures:
    prefix = "exact_" if rests_on == EXACT else ""
    if rests_on is None or row["touches_border"] or row[f"{prefix}size"] is None:
        return NOTHING
    box = Box3D(
        np.array(row[f"{prefix}center"]), np.array(row[f"{prefix}R"]).reshape(3, 3), np.array(row[f"{prefix}size"])
    )
    extents = np.ptp(box.corners @ viewer.matrix.T, axis=0)
    if rests_on == FITTED:
        # From one side the far end of the forward axis is never seen.
        told = (extents >= max(LEAST_SIZE, LEAST_SIZE_RELATIVE * row["distance"])) & (True, True, False)
        extents = np.where(told, extents, np.nan)
    return Figures(rests_on, viewer.matrix @ box.center, extents, NOTHING.points)


def seen_whole(row: Mapping[str, Any], config: VqaConfig) -> bool:
    """Tell objects seen whole from the front: not cut, not covered, and with depth."""
    return (
        row["mask"] is not None
        and row["mask_source"] in MASKS
        and not row["touches_border"]
        and not row["fallback"]
        and row["occluded"] <= config.max_occluded
        and row["depth_missing"] <= config.max_depth_missing
        and row["kept"] >= config.min_kept
        and (row["visible"] is None or row["visible"] >= config.min_visible)
    )


def gap_between(a: Figures, b: Figures) -> float | None:
    """Gap between the nearest raw points of two objects, metres; None for an object not seen whole."""
    from scipy.spatial import KDTree

    return None if not len(a.points) or not len(b.points) else float(KDTree(a.points).query(b.points)[0].min())


class _RawPoints:
    """One frame's depth, ready for taking the raw points of masks."""

    def __init__(self, frame: Mapping[str, Any], depth: np.ndarray, viewer: ViewerAxes) -> None:
        self.depth, self.config = depth, LiftConfig()
        self.camera = Camera(np.array(frame["K"]).reshape(3, 3), frame["width"], frame["height"])
        self.matrix = viewer.matrix.T.astype(np.float32)
        self.edges, self.flying = depth_edges(depth, self.config), flying_pixels(depth)

    def of(self, row: Mapping[str, Any]) -> np.ndarray:
        evidence, _ = clean(decode_run_length(self.depth.shape, row["mask"]), self.depth, self.edges, self.config)
        height, width = evidence.codes.shape
        window = np.s_[evidence.y0 : evidence.y0 + height, evidence.x0 : evidence.x0 + width]
        z, kept = self.depth[window], evidence.codes == Pixel.KEPT
        if not kept.any():
            return NOTHING.points
        rim = (evidence.codes != Pixel.OUTSIDE) & (z > self.config.near) & (z < self.config.far)
        v, u = np.nonzero(kept | (rim & ~self.flying[window] & self._continues(z, kept)))
        some = np.linspace(0, len(v) - 1, min(len(v), MOST_POINTS)).astype(np.int64)
        v, u = v[some], u[some]
        return lift_pixels(z[v, u], self.camera, v + evidence.y0, u + evidence.x0) @ self.matrix

    def _continues(self, z: np.ndarray, kept: np.ndarray) -> np.ndarray:
        from scipy.ndimage import distance_transform_edt

        away, (row, column) = distance_transform_edt(~kept, return_indices=True)  # pyright: ignore[reportGeneralTypeIssues]
        of = z[row, column]
        return np.abs(z - of) <= surface_step(of) + away * of / self.camera.fx


Kind = Literal["relation", "which", "grounding", "distance", "size"]
KINDS: tuple[Kind, ...] = ("relation", "which", "grounding", "distance", "size")


@dataclass(frozen=True)
class VqaConfig:
    """What is asked."""

    per_frame: int = 24
    """At most so many questions of a frame."""
    kinds: tuple[Kind, ...] = KINDS
    """Out of KINDS; they take turns."""
    min_margin: float = 0.05
    """Metres that a relation must stand from its thresholds to be asked for."""
    max_occluded: float = 0.05
    """Gaps, and distances and sizes without a given 3D box, are asked only of objects with at most this share of their
    border covered, that do not touch the picture's border."""
    min_visible: float = 0.9
    """And of which the dataset, where it says so, sees at least this share."""
    max_depth_missing: float = 0.5
    """And with at most this share of their pixels without depth."""
    min_kept: float = 0.6
    """And of whose mask cleaning kept at least this share."""
    min_distance: float = 0.1
    """Distances below it, metres, are not asked for."""
    box_decimals: int = 3
    """2 or 3: digits of the normalised box in an answer."""
    seed: int = 0
    """Of the row hashes that choose questions and wordings."""

    def __post_init__(self) -> None:
        require(self.per_frame >= 1, "per_frame must be at least 1", got=self.per_frame)
        require(
            self.kinds and not (set(self.kinds) - set(KINDS)),
            "kinds of questions",
            got=", ".join(self.kinds) or "none",
            expected=" | ".join(KINDS),
        )
        require(self.box_decimals in (2, 3), "box_decimals", got=self.box_decimals, expected="2 or 3")
        require(self.min_margin >= 0 and self.min_distance >= 0, "a least margin or distance cannot be negative")
