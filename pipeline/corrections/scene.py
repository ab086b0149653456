"""A frame's corrected labels as objects in 3D, and as the cases that answers are judged by.

With what is known of a pair of objects, relation by relation, and where from; and views of a box from its sides.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, reduce
from operator import is_
from typing import Any

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject, pixels_inside
from pipeline.corrections.journal.edits import Edits, set_box
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef, box_of, object_ref, relation_ref, same_value
from pipeline.corrections.journal.replay import Origin
from pipeline.diagnosis.whatif.placement import pulled
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.camera import lift_pixels, project
from pipeline.geometry.frame import Frame
from pipeline.geometry.lifting import LiftedObject, Quality, lift
from pipeline.geometry.masks import decode_crop
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.cases import HIT, Case, FrameCases, frame_cases
from pipeline.language.class_sizes import is_thin
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.annotations import box_mask
from pipeline.relations.relations import U, letter
from pipeline.system.errors import InputError, Shown, needed, require
from pipeline.system.frozen import dataclass

# An edit changes one object of a frame; the pixels of the others are known already.
_crop = lru_cache(maxsize=256)(decode_crop)
_OF_THE_LABEL = ("text", "target", "reference", "targets", "acceptable")
_OF_THE_BOX = ("bbox", "mask", "box")


def labelled_objects(frame: EffectiveFrame) -> tuple[SceneObject, ...]:
    """Standing objects by number, from their rows, without points; the same ones where no row is another."""
    rows = tuple(row for _, row in sorted(frame.objects.items()))
    known_rows, known = frame.shown
    by_row = {id(row): entry for row, entry in zip(known_rows, known, strict=True)}
    if len(rows) != len(known_rows) or not all(map(is_, rows, known_rows)):
        frame.shown = rows, tuple(by_row.get(id(row)) or _labelled(row, frame.size) for row in rows)
    return frame.shown[1]


def labelled_box(row: dict[str, Any]) -> Box3D | None:
    """The 3D box of a row of `objects` (camera frame); None where it has none."""
    if row["center"] is None or not np.isfinite(np.array(row["center"], np.float64)).all():
        return None
    with suppress(TypeError, ValueError):
        return box_of(row)
    return None


def _labelled(row: dict[str, Any], size: tuple[int, int]) -> SceneObject:
    bbox = np.array(row["bbox"], np.float32)
    if row["mask"] is None:
        mask = box_mask(bbox, *size)
    else:
        mask = np.zeros(size, np.bool_)
        _crop(size, row["mask"], f"object {row['object']}").paint(mask)

    def number(name: str, nothing: float) -> float:
        return nothing if row[name] is None else float(row[name])

    quality = Quality(
        int(mask.sum()),
        int(number("points", 0)),
        number("kept", 0.0),
        number("depth_missing", 0.0),
        bool(row["touches_border"]),
        number("distance", float("nan")),
        bool(row["fallback"]),
        row["mask_source"] or "box",
    )
    lo, hi = (np.full(3, np.nan) if row[k] is None else np.array(row[k], np.float64) for k in ("lo", "hi"))
    sides = None if row["open_sides"] is None else tuple(row["open_sides"])
    lifted = LiftedObject(
        np.empty((0, 3), np.float32), labelled_box(row), number("yaw_confidence", 0.0), lo, hi, None, quality, sides
    )
    return SceneObject(row["object"], row["label"], number("score", 1.0), bbox, mask, lifted)


def effective_truth(frame: EffectiveFrame) -> FrameCases:
    """Cases of a frame and its objects, as `evaluation.cases.read_cases`; InputError for a rejected frame."""
    require(frame.stands, f"frame {frame.frame} was rejected: its labels are not to be used")
    rows = {
        name: {column: table.column(column).to_pylist() for column in table.column_names}
        for name, table in frame.tables().items()
    }
    names, relations = frame.setting.relations, rows["relations"]
    for name in names:
        # A relation that somebody took back has no state.
        relations[name] = [-1 if state is None else state for state in relations[name]]
    row = frame.row
    return frame_cases(
        frame.frame,
        row["frame_index"],
        row["scene"],
        rows["objects"],
        relations,
        rows["expressions"],
        names,
        row["rgb_hash"],
    )


def effective_mark(frame: EffectiveFrame, expression: str, mark: str | None) -> str | None:
    """Mark of an expression now: BAD_LABEL, BAD_BOX or None.

    A mark of the labels before does not hold after a correction, or an acceptance, of the expression.
    """
    if frame.version(FieldRef("expression", frame.frame, expression, "mark")):
        return frame.marks.get(expression)
    auto, now = frame.auto.expressions.get(expression), frame.expression(expression)
    if mark is None or auto is None or now is None:
        return mark
    if frame.statuses.get(FieldRef("expression", frame.frame, expression, "status")) in ("accepted", "corrected"):
        return None
    if mark == "BAD_LABEL":
        changed = not all(same_value(now[name], auto[name]) for name in _OF_THE_LABEL)
    else:
        cells = [FieldRef("object", frame.frame, str(now["target_object"]), name) for name in _OF_THE_BOX]
        changed = any(frame.origin(ref).source == "human" for ref in cells)
    return None if changed else mark


def withdrawn_by(frame: EffectiveFrame, expression: str) -> str | None:
    """Reason why a rejected expression is not judged; None otherwise."""
    ref = FieldRef("expression", frame.frame, expression, "status")
    return (
        None if frame.statuses.get(ref) != "rejected" else f"the expression was rejected by {frame.origin(ref).author}"
    )


def answered_case(frame: EffectiveFrame, truth: FrameCases, case: Case, trace: Trace) -> Case:
    """Case by which an answer is judged, where a person set or accepted the targets: all are meant.

    The labelled pair becomes that of the answer, else stays, or becomes the first one's where no longer right.
    """
    targets, status = (FieldRef("expression", frame.frame, case.id, field) for field in ("targets", "status"))
    vouched = frame.origin(targets).source == "human" or frame.statuses.get(status) in ("accepted", "corrected")
    if not vouched or not len(case.strict):
        return case
    target = case.target_object if case.target_object in case.strict else int(case.strict[0])
    if trace.ranking is not None and trace.ranking.pairs:
        answer = trace.objects[trace.ranking.pairs[0].target].bbox
        overlap = iou_2d(np.array([answer], np.float64), truth.boxes[case.strict])[0]
        if overlap.max() >= HIT:
            target = int(case.strict[overlap.argmax()])
    if target == case.target_object:
        return case
    references = truth.acceptable_pairs(case)[target] & (np.arange(len(truth.labels)) != target)
    reference = case.reference_object
    if references.any() and not references[reference]:
        reference = int(np.flatnonzero(references)[0])
    return replace(case, target_object=target, reference_object=reference)


ASKED_BEYOND_M = 0.1
"""A judgement that geometry contradicts by more metres than this is asked about before it is saved."""


@dataclass(frozen=True)
class RelationLine:
    """Relation of a pair."""

    relation: str
    state: int | None  # T (1), U (0), F (-1), or None
    margin: float | None  # metres, signed
    origin: Origin
    status: str | None
    version: int  # number of events

    def against(self, state: int) -> float:
        """Metres by which the rule's margin contradicts T or F; 0 for U."""
        return 0.0 if self.margin is None or state == U else max(0.0, -state * self.margin)

    def record(self) -> dict[str, Any]:
        """JSON record."""
        return {
            "relation": self.relation,
            "state": None if self.state is None else letter(self.state),
            "margin": self.margin,
            "origin": self.origin.source,
            "from": str(self.origin),
            "status": self.status,
            "version": self.version,
        }


@dataclass(frozen=True)
class PairCard:
    """Ordered pair "a RELATION b"."""

    frame: str
    a: int
    b: int
    names: tuple[str, str]  # classes
    distance: float | None  # metres
    lines: tuple[RelationLine, ...]  # in the order of PAIRWISE
    why_none: str = ""  # why no relation; "" where any

    def record(self) -> dict[str, Any]:
        """JSON record."""
        return {
            "frame": self.frame,
            "a": {"object": self.a, "label": self.names[0]},
            "b": {"object": self.b, "label": self.names[1]},
            "distance": self.distance,
            "relations": [line.record() for line in self.lines],
            "why_none": self.why_none or None,
        }


def pair_card(frame: EffectiveFrame, a: int, b: int) -> PairCard:
    """Describe two objects by the labels; InputError for no such object, or twice the same."""
    for number in (a, b):
        require(number in frame.objects, f"frame {frame.frame} has no object {number}")
    require(a != b, "an object has no relation to itself", got=a)
    names = frame.objects[a]["label"], frame.objects[b]["label"]
    pairs = frame.pairs
    i, j = pairs.index_of(a), pairs.index_of(b)
    if i is None or j is None:
        gone = a if i is None else b
        row = frame.objects[gone]
        return PairCard(frame.frame, a, b, names, None, (), f"{row['label']}·{gone}: {row['reason'] or 'not usable'}")
    refs = {relation: relation_ref(frame.frame, a, b, relation) for relation in frame.setting.relations}
    lines = tuple(
        RelationLine(
            relation,
            pairs.state(a, b, relation),
            _number(pairs.margins[i, j, PAIRWISE.index(relation)]),
            frame.origin(ref),
            frame.statuses.get(replace(ref, field=f"{relation}.status")),
            frame.version(ref),
        )
        for relation, ref in refs.items()
    )
    return PairCard(frame.frame, a, b, names, _number(pairs.distance[i, j]), lines)


def _number(value: Any) -> float | None:
    return None if np.isnan(value) else float(value)


VIEWS = {"top": (0, 1), "front": (0, 2), "side": (1, 2)}
"""The axes of each view: to the right, and up."""
MOST_POINTS = 6000
AROUND_M, AROUND_SHARE = 0.15, 0.35
"""How far around the box other points are shown: metres, and share of its longest side."""
TRIMMED = (1.0, 99.0)
"""Percentiles of the points that a face is fitted to: as extents are, see `lifting.extents`."""
DOUBT = 1e-5
"""Share of the largest depth by which single precision may be wrong."""
NEAREST_M = 0.05
"""Before the camera: what is nearer has no end in the picture."""
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
    # Only the part of the picture in which the views' points can be.
    corners = box.center + np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 3) * half @ axes
    part = _seen_part(corners, frame)
    near, edge = _within(frame, part, axes, box.center, half)

    def along(pixels: np.ndarray) -> np.ndarray:
        """(N, 3) float64 along the axes of pixels of the part."""
        v, u = np.unravel_index(pixels, near.shape)
        v, u = v + part[0].start, u + part[1].start
        return (lift_pixels(frame.depth[v, u], frame.camera, v, u) - box.center.astype(np.float32)) @ axes.T

    near.flat[edge] = (np.abs(along(edge)) <= half).all(axis=1)
    own = mask[part]
    mine, others = (_thinned(np.flatnonzero(near & which), most // 2) for which in (own, ~own))
    points = np.rint(along(np.concatenate([mine, others])) * 1000).clip(-32767, 32767).astype(np.int16)
    return SideViews(axes, box, points, np.arange(len(points)) < len(mine))


def _within(
    frame: Frame, part: tuple[slice, slice], axes: np.ndarray, center: np.ndarray, half: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of a part of the picture that are as near to a place as a box of half sides is large, (H, W) bool; and
    those, (N,) int, for which single precision cannot tell."""
    depth, camera = frame.depth[part], frame.camera
    v, u = (np.arange(side.start, side.stop, dtype=np.float32) for side in part)
    doubt = np.float32(DOUBT * max(1.0, float(depth.max(initial=0.0))))
    near = depth > 0
    sure = near.copy()
    for (x, y, z), reach in zip(axes, half, strict=True):
        down = ((v - camera.cy) * (y / camera.fy) + z).astype(np.float32)
        across = ((u - camera.cx) * (x / camera.fx)).astype(np.float32)
        away = down[:, None] + across
        away *= depth
        away -= np.float32((x, y, z) @ center)
        np.abs(away, out=away)
        near &= away <= np.float32(reach) + doubt
        sure &= away < np.float32(reach) - doubt
    return near, np.flatnonzero(near & ~sure)


def _seen_part(corners: np.ndarray, frame: Frame) -> tuple[slice, slice]:
    """Rows and columns of the picture in which points between corners (8, 3) are; all of it where some are behind."""
    ends = project(corners, frame.camera)
    if corners[:, 2].min() <= NEAREST_M:
        return slice(0, frame.height), slice(0, frame.width)
    (x0, y0), (x1, y1) = np.floor(ends.min(axis=0)) - 1, np.ceil(ends.max(axis=0)) + 2
    (x0, x1), (y0, y1) = np.clip((x0, x1), 0, frame.width), np.clip((y0, y1), 0, frame.height)
    return slice(int(y0), int(y1)), slice(int(x0), int(x1))


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
        context.frame.depth,
        context.frame.camera,
        [inside],
        context.viewer,
        config=context.config,
        edges=context.edges,
        thin=[is_thin(row["label"])],
    )
    return set_box(frame, number, needed(lifted.box, "no point with a depth lies in the box"), reason)


def _standing(frame: EffectiveFrame, number: int) -> tuple[dict[str, Any], Box3D]:
    row = needed(frame.objects.get(number), f"frame {frame.frame} has no object {number} that stands")
    return row, needed(labelled_box(row), f"object {number} has no 3D box: there is no depth in its pixels")
