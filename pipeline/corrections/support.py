"""Edits of an object's 3D box that the picture decides: fitted to its points, brought down to what it stands on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from pipeline.answering.objects import PreparedFrame, SceneObject, pixels_inside
from pipeline.corrections.journal.edits import Edits, set_box
from pipeline.corrections.journal.effective import Corrector, Relifter
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import object_ref
from pipeline.corrections.scene import labelled_box, labelled_objects
from pipeline.diagnosis.whatif.placement import SMALLEST_SIDE
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.lifting import lift
from pipeline.geometry.normals import surface_normals
from pipeline.geometry.viewer import ViewerAxes
from pipeline.system.errors import needed, require

SnapMode = Literal["extend", "move"]
"""extend: the top stays, the bottom goes to the support. move: the whole box does, with the height that it has."""
LEVEL_DEG = 25.0
"""A pixel's surface is level up to this tilt: normals of a depth camera are some 10 degrees off."""
STEEPEST_DEG = 8.0
"""A fitted plane that is steeper follows the noise; its points' median height is taken."""
AROUND_M, AROUND_SHARE = 0.06, 0.15
"""How far around the footprint is looked: metres, and share of its longer side."""
WINDOW_M = 0.025
"""Points of one surface lie this close in height."""
LEAST_POINTS = 25
LEAST_SHARE = 0.08
"""Of the level points around the footprint; fewer are the edge of something else."""
CARRIED_SHARE = 0.5
"""Of the footprint that lies over an object which is to carry it."""
FARTHEST_M = 0.45
"""A support is not farther below, but for what is itself larger: the height of the lowest tables."""
CLOSE_M, TOUCH_M = 0.03, 0.05
"""A box made of points ends so close to what the thing stands on; and in all but the worst views so close."""
NEARBY_M, LEAST_LENGTH = 0.3, 0.7
"""So far beyond what is seen of it an object may still reach, where that is not much shorter in plan than the box."""
OWN_BORDER_PX = 3
"""Pixels just outside a mask may still be the object's."""
MOST_LEVELS = 6
_SAMPLES = 60_000
SAME_M = 0.0005
"""A box that would be moved by less is where it should be."""


@dataclass(frozen=True)
class Support:
    """Level surface."""

    height: float  # metres along up, under the middle of the box
    number: int | None  # None for the floor, or unlabelled
    points: int  # fitted
    spread: float  # RMS distance, metres

    def record(self) -> dict[str, Any]:
        """JSON record."""
        return {"height": self.height, "object": self.number, "points": self.points, "spread": self.spread}


@dataclass(frozen=True)
class _Level:
    """Points of level surfaces: along (right, forward) and up, and whose they are (-1: nobody's)."""

    plan: np.ndarray
    height: np.ndarray
    owner: np.ndarray


@dataclass(frozen=True)
class _Candidate:
    """A level surface that may carry the box; its points are places in `_Level`, none where only height is known."""

    height: float
    owner: int
    points: np.ndarray


def find_support(context: PreparedFrame, box: Box3D, objects: Sequence[SceneObject], number: int) -> Support:
    """Find the highest level surface under a box with a chance to carry.

    An object can carry where at least half of the footprint lies within its extents: the book beside a mug does not
    carry it. Its level points are grouped by height, those in and around the footprint where there are enough, else
    all; where none are near its upper extent, that extent counts, too: of a book under another one no level pixel is
    seen. Unlabelled surfaces carry where their level points are in and around the footprint, and the floor, the lowest
    large level surface of the picture, everywhere. Of what is not above the middle of the box the highest is fitted
    with a plane. Where that is not close, the longest object beside the footprint whose surface the box nearly touches
    is taken before it: of the desk behind the laptop little is seen. `objects` are all of the frame, `box` in the
    camera frame. InputError where nothing level is seen under the box, or only far below.
    """
    level = _level_points(context, objects, number)
    viewer = context.viewer
    middle, highest = _in_plan(box.center[None], viewer)[0], float(box.center @ viewer.up)
    corners = _in_plan(box.corners, viewer)
    lo, hi = corners.min(axis=0), corners.max(axis=0)
    around = AROUND_M + AROUND_SHARE * float((hi - lo).max())
    near = ((level.plan >= lo - around) & (level.plan <= hi + around)).all(axis=1)
    others = [o for o in objects if o.id != number]
    # The floor is the lowest of the large level surfaces of the picture.
    large = sorted(_levels(level.height, max(LEAST_POINTS, len(level.height) // 20)), key=lambda entry: entry[0])
    found = [*_loose_surfaces(level, near), *(_Candidate(h, -1, at) for h, at in large[:1])]
    found += [c for o in others if _covered(o, lo, hi) >= CARRIED_SHARE for c in _surfaces_of(o, level, near)]
    found = [c for c in found if c.height <= highest]
    best = max(found, key=lambda c: c.height, default=None)
    bottom = gap_below(box, Support(0.0, None, 0, 0.0), viewer)
    if best is None or bottom - best.height > CLOSE_M:
        least = LEAST_LENGTH * float((hi - lo).max())
        nearby = sorted((o for o in others if _length(o) >= least), key=_length, reverse=True)
        reached = (o for o in nearby if _covered(o, lo, hi, NEARBY_M) >= CARRIED_SHARE)
        touched = (c for o in reached for c in _surfaces_of(o, level, near) if abs(bottom - c.height) <= TOUCH_M)
        best = next(touched, best)
    best = needed(best, "nothing level is seen under the box: there is nothing to stand it on")
    height, spread = best.height, 0.0
    if len(best.points):
        height, spread = _plane(level.plan[best.points] - middle, level.height[best.points])
    support = Support(height, None if best.owner < 0 else best.owner, len(best.points), spread)
    gap = bottom - height
    require(
        gap <= max(FARTHEST_M, float((hi - lo).max()), 2 * (highest - bottom)),
        "no level surface is seen close under the box",
        got=f"the next is {gap:.2f} m lower",
        cause="does it hang, or is what it stands on not seen?",
    )
    return support


def snapped(box: Box3D, support: Support, viewer: ViewerAxes, way: SnapMode = "extend") -> Box3D:
    """Box (camera frame) with its bottom at a support; a box too flat to extend is moved (see `SnapMode`)."""
    up = viewer.up
    axis = int(np.abs(box.R.T @ up).argmax())
    down = box.R[:, axis] * -np.sign(box.R[:, axis] @ up)
    bottom = box.center + down * box.size[axis] / 2
    # Along the box's own axis, which need not be quite upright.
    drop = (float(bottom @ up) - support.height) / float(-down @ up)
    if way == "extend" and box.size[axis] + drop >= SMALLEST_SIDE:
        return Box3D(box.center + down * drop / 2, box.R, box.size + drop * (np.arange(3) == axis))
    return Box3D(box.center + down * drop, box.R, box.size)


def gap_below(box: Box3D, support: Support, viewer: ViewerAxes) -> float:
    """Metres from a support to the middle of a box's bottom; negative where sunk in."""
    upright = np.abs(box.R.T @ viewer.up)
    reach = upright.max() * box.size[upright.argmax()] / 2
    return float(box.center @ viewer.up) - float(reach) - support.height


def _level_points(context: PreparedFrame, objects: Sequence[SceneObject], number: int) -> _Level:
    frame, viewer = context.frame, context.viewer
    normals, known = surface_normals(frame.depth, frame.camera)
    level = known & (normals @ viewer.up.astype(np.float32) > np.cos(np.deg2rad(LEVEL_DEG)))
    owners = np.full(frame.depth.shape, -1, np.int64)
    # Of two masks that hold a pixel the smaller one is in front.
    for entry in sorted(objects, key=lambda o: -int(np.count_nonzero(o.mask))):
        if entry.id != number:
            owners[entry.mask] = entry.id
            continue
        side = 2 * OWN_BORDER_PX + 1
        level &= cv2.dilate(entry.mask.view(np.uint8), np.ones((side, side), np.uint8)) == 0
    v, u = np.nonzero(level)
    if len(v) > _SAMPLES:
        even = np.linspace(0, len(v) - 1, _SAMPLES).astype(np.int64)
        v, u = v[even], u[even]
    points = lift_pixels(frame.depth[v, u], frame.camera, v, u).astype(np.float64)
    return _Level(_in_plan(points, viewer), points @ viewer.up, owners[v, u])


def _in_plan(points: np.ndarray, viewer: ViewerAxes) -> np.ndarray:
    """(N, 2) along right and forward."""
    return points @ np.stack([viewer.right, viewer.forward], axis=1)


def _covered(entry: SceneObject, lo: np.ndarray, hi: np.ndarray, margin: float = 0.0) -> float:
    """Share of a footprint within an object's extents in plan, plus `margin` metres."""
    own_lo, own_hi = entry.lifted.lo[[0, 2]] - margin, entry.lifted.hi[[0, 2]] + margin
    shared = np.clip(np.minimum(own_hi, hi) - np.maximum(own_lo, lo), 0, None)
    return float(np.prod(shared / np.maximum(hi - lo, 1e-6)))


def _length(entry: SceneObject) -> float:
    """Longer side of an object's extents in plan, metres; 0 for unknown."""
    return float(np.nan_to_num((entry.lifted.hi - entry.lifted.lo)[[0, 2]].max()))


def _surfaces_of(entry: SceneObject, level: _Level, near: np.ndarray) -> list[_Candidate]:
    """Level surfaces of an object, else the upper extent."""
    own = level.owner == entry.id
    mine = np.flatnonzero(own & near)
    if len(mine) < LEAST_POINTS:
        mine = np.flatnonzero(own)
    found = [_Candidate(h, entry.id, mine[at]) for h, at in _levels(level.height[mine], LEAST_POINTS)]
    top = float(entry.lifted.hi[1])
    if np.isfinite(top) and all(abs(c.height - top) > 2 * WINDOW_M for c in found):
        found.append(_Candidate(top, entry.id, np.zeros(0, np.int64)))
    return found


def _loose_surfaces(level: _Level, near: np.ndarray) -> list[_Candidate]:
    """The level surfaces in and around a footprint that are no object's."""
    least = max(LEAST_POINTS, round(LEAST_SHARE * int(near.sum())))
    mine = np.flatnonzero(near & (level.owner < 0))
    return [_Candidate(h, -1, mine[at]) for h, at in _levels(level.height[mine], least)]


def _levels(heights: np.ndarray, least: int) -> list[tuple[float, np.ndarray]]:
    """The heights where many points lie, fullest first, with the points: places in `heights`."""
    found: list[tuple[float, np.ndarray]] = []
    left = np.argsort(heights)
    while len(left) >= least and len(found) < MOST_LEVELS:
        ordered = heights[left]
        stop = np.searchsorted(ordered, ordered + WINDOW_M, side="right")
        first = int((stop - np.arange(len(left))).argmax())
        at = left[first : stop[first]]
        if len(at) < least:
            break
        found.append((float(np.median(heights[at])), at))
        # Its noise reaches beyond the window, and is no surface of its own.
        left = left[np.abs(ordered - found[-1][0]) > WINDOW_M]
    return found


def _plane(plan: np.ndarray, heights: np.ndarray) -> tuple[float, float]:
    """Height of a fitted plane at the plan's origin, and the spread of the points."""
    middle = float(np.median(heights))
    kept = np.ones(len(heights), np.bool_)
    fitted, slope = np.array([0.0, 0.0, middle]), np.tan(np.deg2rad(STEEPEST_DEG))
    for _ in range(2):
        design = np.column_stack([plan[kept], np.ones(int(kept.sum()))])
        fitted = np.linalg.lstsq(design, heights[kept], rcond=None)[0]
        off = np.abs(heights - plan @ fitted[:2] - fitted[2])
        kept = off <= max(2.5 * float(np.median(off)), 1e-4)
    lo, hi = plan.min(axis=0), plan.max(axis=0)
    # A plane through a strip of points says nothing of what is far beside it.
    beyond = bool((np.maximum(lo, -hi) > (hi - lo) / 2).any())
    if beyond or np.hypot(*fitted[:2]) > slope:
        return middle, float(np.sqrt(np.mean((heights - middle) ** 2)))
    off = heights[kept] - plan[kept] @ fitted[:2] - fitted[2]
    return float(fitted[2]), float(np.sqrt(np.mean(off**2)))


def fit_to_points(frame: EffectiveFrame, number: int, corrector: Corrector, reason: str = "") -> Edits:
    """Edit the box to the object's cleaned points, by the labels' estimator.

    An object added as a 3D box is fitted to the points inside. InputError for no object, no change, or no dataset.
    """
    reason = reason or "fitted to its points"
    row = _standing(frame, number)
    made_of_box = number not in frame.auto.objects and row["mask_source"] == "box3d"
    if not made_of_box:
        ref = object_ref(frame.frame, number, "box")
        require(
            frame.version(ref) != 0 and frame.origin(ref).source == "human",
            f"the box of object {number} is the one of its points already",
        )
        return set_box(frame, number, None, reason)
    box, context = _box(frame, number), _relifter(corrector).context(frame.frame)
    (mask,) = (o.mask for o in labelled_objects(frame) if o.id == number)
    inside = pixels_inside(box, mask, context.frame)
    (lifted,) = lift(
        context.frame.depth, context.frame.camera, [inside], context.viewer, config=context.config, edges=context.edges
    )
    return set_box(frame, number, needed(lifted.box, "no point with a depth lies in the box"), reason)


def support_of(frame: EffectiveFrame, number: int, corrector: Corrector) -> tuple[Support, float]:
    """Support of an object, and the gap in metres; raises as `find_support`."""
    context, box = _relifter(corrector).context(frame.frame), _box(frame, number)
    support = find_support(context, box, labelled_objects(frame), number)
    return support, gap_below(box, support, context.viewer)


def snap_to_support(
    frame: EffectiveFrame, number: int, corrector: Corrector, way: SnapMode = "extend", reason: str = ""
) -> Edits:
    """Edit the box down or up to the support; InputError as `find_support`, or for no object, box or change."""
    support, gap = support_of(frame, number, corrector)
    on = support_name(frame, support)
    require(abs(gap) >= SAME_M, f"object {number} stands on {on} already")
    box = snapped(_box(frame, number), support, _relifter(corrector).context(frame.frame).viewer, way)
    return set_box(frame, number, box, reason or f"{'extended' if way == 'extend' else 'moved'} to {on}")


def support_name(frame: EffectiveFrame, support: Support) -> str:
    """Name of a support."""
    row = None if support.number is None else frame.objects.get(support.number)
    return "the level surface below" if row is None else f"{row['label']}·{support.number}"


def _standing(frame: EffectiveFrame, number: int) -> dict:
    require(number in frame.objects, f"frame {frame.frame} has no object {number} that stands")
    return frame.objects[number]


def _box(frame: EffectiveFrame, number: int) -> Box3D:
    what = f"object {number} has no 3D box: there is no depth in its pixels"
    return needed(labelled_box(_standing(frame, number)), what)


def _relifter(corrector: Corrector) -> Relifter:
    return needed(corrector.relifter, "this needs the dataset's depth, and the dataset is not at hand")
