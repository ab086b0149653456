"""Whole boxes of a scene's objects: each view's box, completed, and of several views one that is joined side by side.

A side lies where the views that know it best put it: those that measured it, else, by the network, those that are
surest. No box ends before the places that other views saw of its object.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.answering.whole_boxes import CompletedBox
from pipeline.geometry.boxes import SIDES, Box3D, Side
from pipeline.geometry.fitting import canonicalised
from pipeline.geometry.viewer import ViewerAxes
from pipeline.system.frozen import dataclass

MEASURED_M = 0.02
"""Metres within which a side that a view measured lies in 80 % of cases."""
STRAY, SLACK_M = 3.0, 0.03
"""Percent of an object's places at either end that do not count, and metres by which the others may lie outside."""
LEAST_SURE = 0.03
"""Yaw confidence that a view counts with at least."""
NUMBERS = 28
"""Of a `ViewBox`."""


@dataclass(frozen=True, eq=False)
class ViewBox:
    """Whole box of an object as one view completes it."""

    box: Box3D  # World
    ends: np.ndarray  # (2, 6) float64: 10 and 90 % of where each of SIDES lies, metres outwards from the box's
    sure: float  # Yaw confidence of the view's fit

    @classmethod
    def of(cls, entry: SceneObject, pose: np.ndarray, viewer: ViewerAxes) -> ViewBox | None:
        """Box of an object of a frame that asks for completed ones, by its pose; None without one."""
        if (whole := entry.whole) is None:
            return None
        # Boxes that were given may have their axes in any order; they have no interval.
        box = whole.box if whole.interval else _near_viewer(whole.box, viewer)
        shift = (whole.box.center - whole.seen.center) @ whole.seen.R
        moved = np.repeat(whole.box.size - whole.seen.size, 2) / 2 + np.stack([-shift, shift], axis=1).ravel()
        ends = np.zeros((2, 6))
        for side, own in whole.interval.items():
            k = SIDES.index(side)
            ends[:, k] = np.array(own) - moved[k]
        return cls(box.transformed(pose), ends, entry.lifted.yaw_confidence)

    @property
    def row(self) -> np.ndarray:
        """All of it as NUMBERS, float64; `of_row` reads it."""
        return np.concatenate([self.box.center, self.box.R.ravel(), self.box.size, self.ends.ravel(), [self.sure]])

    @classmethod
    def of_row(cls, row: np.ndarray) -> ViewBox:
        """Box of NUMBERS; InputError for numbers of no box."""
        return cls(Box3D(row[:3], row[3:12].reshape(3, 3), row[12:15]), row[15:27].reshape(2, 6), float(row[27]))

    def along(self, R: np.ndarray) -> np.ndarray:
        """(3, 6): place, 10 and 90 % of the sides along axes, the columns of R, metres outwards from the world's
        origin."""
        center, sides = self.box.center @ R, sides_along(self.box.R, R)
        place = np.stack([-center, center], axis=1).ravel() + np.repeat(self.box.size, 2)[sides] / 2
        return np.stack([place, *(place + self.ends[:, sides])])


def sides_along(own: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Places in SIDES, (6,), of a box with axes `own` that face as the sides of a box with axes `R`."""
    turn = own.T @ R
    axis = np.abs(turn).argmax(axis=0)
    same = turn[axis, range(3)] > 0
    return np.stack([2 * axis + ~same, 2 * axis + same], axis=1).ravel()


def joined_box(views: Sequence[ViewBox], places: np.ndarray, up: np.ndarray) -> CompletedBox:
    """Whole box of an object of N > 0 views.

    Parameters
    ----------
    views : sequence of ViewBox
    places : (M, 3) float64
        What was seen of the object, world, metres.
    up : (3,) float64
        Of the scene, world.

    Returns
    -------
    CompletedBox
        World; its seen box is the same, its completed sides are those that no view measured, and its intervals are
        metres outwards from its own sides.
    """
    R = _axes(views, up)
    place, low, high = np.stack([view.along(R) for view in views], axis=1)
    spread = np.maximum((high - low) / 2, MEASURED_M)
    found = _medians(place, spread**-2)
    if len(views) > 1 and len(places):
        ends = np.percentile(places @ R, (STRAY, 100 - STRAY), axis=0)
        found = np.maximum(found, np.stack([-ends[0], ends[1]], axis=1).ravel() - SLACK_M)
    best, side = spread.argmin(axis=0), np.arange(6)
    unmeasured = (high > low).all(axis=0)
    low = np.where(unmeasured, np.minimum(low[best, side] - found, -MEASURED_M), -MEASURED_M)
    high = np.where(unmeasured, np.maximum(high[best, side] - found, MEASURED_M), MEASURED_M)
    size = np.maximum(found[::2] + found[1::2], 0.0)
    box = Box3D(R @ (found[1::2] - found[::2]) / 2, R, size)
    sides: tuple[Side, ...] = tuple(SIDES[k] for k in np.flatnonzero(unmeasured))
    return CompletedBox(box, box, sides, {SIDES[k]: (low[k], high[k]) for k in range(6)}, len(views))


def _medians(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted medians of the columns of (N, D) values, each between the two nearest to it: one wrong view of several
    moves nothing far."""
    order = values.argsort(axis=0, kind="stable")
    values, weights = (np.take_along_axis(given, order, axis=0) for given in (values, weights))
    shares = (weights.cumsum(axis=0) - weights / 2) / weights.sum(axis=0)
    return np.array([np.interp(0.5, *column) for column in zip(shares.T, values.T, strict=True)])


def _axes(views: Sequence[ViewBox], up: np.ndarray) -> np.ndarray:
    """Axes of a box, (3, 3), of which the second points down: the mean direction of its views' sides in plan."""
    right = views[0].box.R[:, 0] - (views[0].box.R[:, 0] @ up) * up
    right /= np.linalg.norm(right)
    ahead = np.cross(right, -up)
    sides = np.array([view.box.R[:, 0] for view in views])
    weight = np.array([max(view.sure, LEAST_SURE) ** 2 for view in views])
    # A quarter turn only exchanges sides.
    yaw = np.angle((weight * np.exp(4j * np.arctan2(sides @ ahead, sides @ right))).sum()) / 4
    x = np.cos(yaw) * right + np.sin(yaw) * ahead
    return np.stack([x, -up, np.cross(x, -up)], axis=1)


def seen_by(whole: CompletedBox, pose: np.ndarray, viewer: ViewerAxes) -> CompletedBox:
    """World box in the camera frame of a pose, with its axes near the viewer's (right, down, forward)."""
    box = _near_viewer(whole.box.transformed(np.linalg.inv(pose)), viewer)
    sides = sides_along(pose[:3, :3].T @ whole.box.R, box.R).tolist()
    interval: dict[Side, tuple[float, float]] = {
        SIDES[place]: whole.interval[SIDES[k]] for place, k in enumerate(sides)
    }
    completed: tuple[Side, ...] = tuple(SIDES[place] for place, k in enumerate(sides) if SIDES[k] in whole.completed)
    return CompletedBox(box, box, completed, interval, whole.views)


def _near_viewer(box: Box3D, viewer: ViewerAxes) -> Box3D:
    """Camera-frame box with its axes renamed to be near the viewer's (right, down, forward)."""
    level = viewer.R_level_camera
    return canonicalised(box.turned(level)).turned(level.T)
