"""Three views along the axes of a 3D box, what a hand does to the box in them, and a box fitted to its points.

The views are level where the box is: their axes a, b, c are the box's own, c the one that is most upright, a to the
viewer's right and b away. Seen from above stand a and b, from the front a and c, from the side b and c.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from pipeline.answering.objects import pixels_inside
from pipeline.corrections.journal.edits import Edits, set_box
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import object_ref
from pipeline.corrections.scene import labelled_box, labelled_objects
from pipeline.diagnosis.whatif.placement import pulled
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import lift
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.system.errors import InputError, Shown, needed, require

VIEWS = {"top": (0, 1), "front": (0, 2), "side": (1, 2)}
"""The axes of each view: to the right, and up."""
MOST_POINTS = 6000
AROUND_M, AROUND_SHARE = 0.15, 0.35
"""How far around the box other points are shown: metres, and share of its longest side."""
TRIMMED = (1.0, 99.0)
"""Percentiles of the points that a face is fitted to: as extents are, see `lifting.extents`."""
FARTHEST_M = 20.0
"""A hand moves a face no farther."""
MOST_MOVES = 12
Move = Sequence[Any]
"""["face", AXIS, SIDE, METRES]: a face (side 1 or -1) goes outwards; ["move", AXIS, METRES]; ["turn", AXIS, ANGLE]."""


@dataclass(frozen=True)
class SideViews:
    """Points and box of an object in three views."""

    axes: np.ndarray  # (3, 3) float64, rows a, b, c, camera frame
    box: Box3D  # camera frame
    points: np.ndarray  # (N, 3) int16, along a, b, c from the box's middle, millimetres
    own: np.ndarray  # (N,) bool, of the object's pixels

    def record(self) -> dict[str, Any]:
        """JSON record: `size` along a, b, c in metres, `points` as base64, the object's first."""
        mine, others = (
            base64.b64encode(np.ascontiguousarray(self.points[chosen], "<i2").tobytes()).decode()
            for chosen in (self.own, ~self.own)
        )
        order = np.abs(self.axes @ self.box.R).argmax(axis=1)
        return {"size": self.box.size[order].tolist(), "points": mine, "around": others}


def box_axes(box: Box3D, viewer: ViewerAxes) -> np.ndarray:
    """(3, 3): rows a, b, c of a box (camera frame), right-handed."""
    up = int(np.abs(box.R.T @ viewer.up).argmax())
    level = [k for k in range(3) if k != up]
    first = max(level, key=lambda k: abs(box.R[:, k] @ viewer.right))
    a, c = box.R[:, first], box.R[:, up]
    a = a if a @ viewer.right >= 0 else -a
    c = c if c @ viewer.up >= 0 else -c
    return np.stack([a, np.cross(c, a), c])


def side_views(frame: Frame, viewer: ViewerAxes, box: Box3D, mask: np.ndarray, most: int = MOST_POINTS) -> SideViews:
    """Points in and around a box (camera frame), thinned evenly to `most`, half from the mask (H, W) bool."""
    axes, reach = box_axes(box, viewer), AROUND_M + AROUND_SHARE * float(box.size.max())
    half = np.abs(axes @ box.R) @ box.size / 2 + reach
    v, u = np.nonzero(frame.depth > 0)
    found = (lift_pixels(frame.depth[v, u], frame.camera, v, u) - box.center.astype(np.float32)) @ axes.T
    near = (np.abs(found) <= half).all(axis=1)
    own = mask[v, u]
    chosen = np.concatenate(
        [_thinned(np.flatnonzero(near & own), most // 2), _thinned(np.flatnonzero(near & ~own), most // 2)]
    )
    return SideViews(axes, box, np.rint(found[chosen] * 1000).clip(-32767, 32767).astype(np.int16), own[chosen])


def _thinned(indices: np.ndarray, most: int) -> np.ndarray:
    return indices if len(indices) <= most else indices[np.linspace(0, len(indices) - 1, most).astype(np.int64)]


def dragged(box: Box3D, axes: np.ndarray, moves: Sequence[Move]) -> Box3D:
    """Box after moves in the views, one after the other; opposite faces stay; InputError for a wrong move."""
    require(0 < len(moves) <= MOST_MOVES, "not what a hand does to a box", got=Shown(moves), expected="1 to 12 moves")
    own = np.abs(axes @ box.R).argmax(axis=1)
    return reduce(lambda found, move: _moved(found, axes, own, move), moves, box)


def _moved(box: Box3D, axes: np.ndarray, own: np.ndarray, move: Move) -> Box3D:
    try:
        what, axis, *rest = move
        *side, by = (float(x) for x in rest)
        direction = axes[axis] if axis in (0, 1, 2) else None
    except (TypeError, ValueError):
        what, side, by, direction, axis = "", [], 0.0, None, 0
    sides = {"face": ([1.0], [-1.0]), "move": ([],), "turn": ([],)}.get(what if isinstance(what, str) else "", ())
    if direction is None or side not in sides or not abs(by) <= FARTHEST_M:
        raise InputError("not what a hand does to a box", got=Shown(move), expected="face, move or turn")
    if what == "move":
        return Box3D(box.center + direction * by, box.R, box.size)
    k = int(own[axis])
    if what == "turn":
        # About the axis of the view, as the hand sees it.
        x, y, z = direction
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return Box3D(box.center, (np.eye(3) + np.sin(by) * cross + (1 - np.cos(by)) * cross @ cross) @ box.R, box.size)
    return pulled(box, k, float(np.sign(box.R[:, k] @ direction) or 1.0) * side[0], by)


def face_to_points(views: SideViews, axis: int, side: int) -> Move:
    """Move of a face to the object's points within the other faces; InputError for no points."""
    half = np.abs(views.axes @ views.box.R) @ views.box.size / 2
    points = views.points[views.own] / 1000
    beside = [k for k in range(3) if k != axis]
    within = points[(np.abs(points[:, beside]) <= half[beside]).all(axis=1), axis]
    require(len(within), "no point of the object lies there")
    end = float(np.percentile(within, TRIMMED[side > 0]))
    return ["face", axis, side, side * end - float(half[axis])]


def drag_box(frame: EffectiveFrame, number: int, moves: Sequence[Move], reason: str = "") -> Edits:
    """Edit a 3D box by moves in the views; InputError as `dragged`, or without object, box or up vector."""
    box = _standing(frame, number)[1]
    up = needed(frame.row["up"], f"frame {frame.frame}: which way is up was not kept")
    return set_box(frame, number, dragged(box, box_axes(box, viewer_axes(np.array(up))), moves), reason)


def fit_to_points(frame: EffectiveFrame, number: int, corrector: Corrector, reason: str = "") -> Edits:
    """Edit the box to the object's cleaned points, by the labels' estimator.

    An object added as a 3D box is fitted to the points inside. InputError for no object, no change, or no dataset.
    """
    reason = reason or "fitted to its points"
    row, box = _standing(frame, number)
    if number in frame.auto.objects or row["mask_source"] != "box3d":
        ref = object_ref(frame.frame, number, "box")
        require(
            frame.version(ref) != 0 and frame.origin(ref).source == "human",
            f"the box of object {number} is the one of its points already",
        )
        return set_box(frame, number, None, reason)
    relifter = needed(corrector.relifter, "this needs the dataset's depth, and the dataset is not at hand")
    context = relifter.context(frame.frame)
    (mask,) = (o.mask for o in labelled_objects(frame) if o.id == number)
    inside = pixels_inside(box, mask, context.frame)
    (lifted,) = lift(
        context.frame.depth, context.frame.camera, [inside], context.viewer, config=context.config, edges=context.edges
    )
    return set_box(frame, number, needed(lifted.box, "no point with a depth lies in the box"), reason)


def _standing(frame: EffectiveFrame, number: int) -> tuple[dict[str, Any], Box3D]:
    row = needed(frame.objects.get(number), f"frame {frame.frame} has no object {number} that stands")
    return row, needed(labelled_box(row), f"object {number} has no 3D box: there is no depth in its pixels")
