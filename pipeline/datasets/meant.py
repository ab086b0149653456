"""Depth and pictures as they are meant: depth along rays or inverse, mirrored pictures, turned depth maps.

The settings of the same names declare it, and `doctor` tries it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.datasets.base import ChangedFrames, Dataset, load_picture
from pipeline.datasets.settings import MEANT
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.frame import Annotation, Frame
from pipeline.system.errors import require

LEFT_RIGHT = MEANT["mirrored"][0]
SAME = 1e-5
"""A depth has a value where it is no farther from it, as a share."""


def ray_lengths(K: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """Length (H, W) float64 of each pixel's ray up to the plane z = 1. `K`: (3, 3); `size`: height, width."""
    x = (np.arange(size[1]) - K[0, 2]) / K[0, 0]
    y = (np.arange(size[0]) - K[1, 2]) / K[1, 1]
    return np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2)


def depth_of(stored: np.ndarray, K: np.ndarray, depth_is: str) -> np.ndarray:
    """Depth (H, W) float32 along z of a map of another kind, in metres or their reciprocals; 0 where missing."""
    if depth_is == "distance":
        return (stored / ray_lengths(K, stored.shape)).astype(np.float32)
    if depth_is == "inverse":
        return np.divide(1, stored, out=np.zeros(stored.shape, np.float32), where=stored > 0)
    return stored


def laid_over(depth: np.ndarray, turned: str) -> np.ndarray:
    """Depth map (H, W) that lies over the colour, of one that is turned or mirrored.

    Raises
    ------
    InputError
        A quarter turn of a map that is not square, as colour of its size would be of another shape.
    """
    if turned in MEANT["mirrored"]:
        return np.ascontiguousarray(depth[:, ::-1] if turned == LEFT_RIGHT else depth[::-1])
    require(
        turned == "180" or depth.shape[0] == depth.shape[1],
        "a quarter turn is of square pictures",
        got=f"{depth.shape[1]}x{depth.shape[0]}",
    )
    return np.ascontiguousarray(np.rot90(depth, int(turned) // 90))


def mirrored_frame(frame: Frame, way: str) -> Frame:
    """Frame whose colour, depth, principal point and annotated pixels are mirrored; pose and 3D boxes stay."""
    camera, across = frame.camera, way == LEFT_RIGHT
    flip = (slice(None), slice(None, None, -1)) if across else (slice(None, None, -1),)
    cx = camera.width - 1 - camera.cx if across else camera.cx
    cy = camera.cy if across else camera.height - 1 - camera.cy
    found = replace(camera, K=intrinsics(camera.fx, camera.fy, cx, cy))

    def other(a: Annotation) -> Annotation:
        bbox, k, side = a.bbox.copy(), *((0, camera.width) if across else (1, camera.height))
        bbox[[k, k + 2]] = side - a.bbox[[k + 2, k]]
        return replace(a, bbox=bbox, mask=None if a.mask is None else np.ascontiguousarray(a.mask[flip]))

    rgb, depth = (np.ascontiguousarray(array[flip]) for array in (frame.rgb, frame.depth))
    return replace(frame, rgb=rgb, depth=depth, camera=found, annotations=tuple(map(other, frame.annotations)))


def as_meant(frame: Frame, declared: Mapping[str, Any], units: float | None = None) -> Frame:
    """Frame as it is meant, of one as it is stored.

    Parameters
    ----------
    declared : dict
        Of the settings of `Settings.meant`; others are ignored.
    units : float, optional
        Depth units in a metre by which it was read, for `depth_nothing`; none for metres.

    Raises
    ------
    InputError
        What is left is no depth of a room, or no map that can be turned so.
    """
    depth = frame.depth
    if "depth_nothing" in declared:
        nothing = declared["depth_nothing"] / (units or 1.0)
        depth = np.where(np.abs(depth - nothing) <= SAME * nothing, np.float32(0), depth)
    if "depth_turned" in declared:
        depth = laid_over(depth, declared["depth_turned"])
    if "depth_is" in declared:
        depth = depth_of(depth, frame.camera.K, declared["depth_is"])
    if depth is not frame.depth and not frame.depth_source:
        frame = replace(frame, depth=depth)
    return mirrored_frame(frame, declared["mirrored"]) if "mirrored" in declared else frame


class AsMeant(ChangedFrames):
    """A dataset with frames as they are meant. `declared`: `Settings.meant`."""

    def __init__(self, inner: Dataset, declared: Mapping[str, Any]) -> None:
        super().__init__(inner)
        self.declared = dict(declared)

    def load_depth(self, frame_id: str) -> np.ndarray | None:
        """See `base.load_depth`."""
        frame = self.changed(load_picture(self.inner, frame_id))
        return None if frame.depth_source else frame.depth

    def changed(self, frame: Frame) -> Frame:
        """Frame as it is meant."""
        units = getattr(self.inner, "depth_units", None)
        return as_meant(frame, self.declared, units and units(frame.id))
