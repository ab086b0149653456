"""A 3D box as the few numbers that a person types: its centre in the viewer's axes, its size, its turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.diagnosis.whatif.edits import Three
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes

SMALLEST_SIDE = 0.01
"""Metres; a flatter box could not be taken hold of again."""


@dataclass(frozen=True)
class BoxNumbers:
    """A box in the viewer's level axes.

    Attributes
    ----------
    center : three floats
        Along (right, forward, up), metres.
    size : three floats
        Along the box's own axes, for an upright box (width, height, depth), metres.
    yaw : float
        Of the box's first axis in plan, degrees from right towards forward, in (-180, 180].
    """

    center: Three
    size: Three
    yaw: float


def box_numbers(box: Box3D, viewer: ViewerAxes) -> BoxNumbers:
    """The numbers of a box (camera frame)."""
    x, y, z = (_axes(viewer) @ box.center).tolist()
    width, height, depth = box.size.tolist()
    return BoxNumbers((x, y, z), (width, height, depth), float(np.rad2deg(_yaw(box, viewer))))


def with_numbers(
    box: Box3D,
    viewer: ViewerAxes,
    *,
    center: Three | None = None,
    size: Three | None = None,
    yaw: float | None = None,
) -> Box3D:
    """The box with some of its numbers changed; None leaves one as it is.

    Raises
    ------
    InputError
        For numbers that are no box. Sides below SMALLEST_SIDE become that.
    """
    axes = _axes(viewer)
    moved = box.center if center is None else axes.T @ np.array(center, np.float64)
    sides = box.size if size is None else np.maximum(np.array(size, np.float64), SMALLEST_SIDE)
    R = box.R
    if yaw is not None:
        angle = np.deg2rad(yaw) - _yaw(box, viewer)
        cos, sin = np.cos(angle), np.sin(angle)
        R = axes.T @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ axes @ R
    return Box3D(moved, R, sides)


def _axes(viewer: ViewerAxes) -> np.ndarray:
    """(3, 3): rotation of the camera frame into (right, forward, up)."""
    return np.stack([viewer.right, viewer.forward, viewer.up])


def _yaw(box: Box3D, viewer: ViewerAxes) -> float:
    x, y, _ = _axes(viewer) @ box.R[:, 0]
    return float(np.arctan2(y, x))
