"""A draft: pixels drawn for one object, step by step, until they are saved as one edit or dropped; masks cut in parts.

A mask is cut by a polygon, along a line, or where its depth comes apart. Parts
never share a pixel.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pipeline.corrections.journal.edits import Edits, add_object, pixels_of, set_mask, split_object
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef, object_ref
from pipeline.drawing.depth_region import joined, link_grid, nearest_pixel
from pipeline.drawing.gestures import Canvas, Gesture, applied, goes_around, polygon_mask
from pipeline.geometry.lifting import LiftedObject, lift
from pipeline.geometry.masks import decode_run_length, encode_run_length
from pipeline.language.class_sizes import is_thin
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

MOST_STEPS = 500
LEAST_PIXELS, LEAST_SHARE = 30, 0.03
"""A part of a mask in depth has at least so many pixels, and this share of the mask; less goes to its neighbour."""
MOST_PARTS = 12


@dataclass(frozen=True)
class Draft:
    """Drawing of an object's pixels, step by step."""

    frame: str
    number: int | None  # None for a new object
    height: int
    width: int
    version: int  # of the mask at the begin
    steps: tuple[tuple[str, ...], ...]  # parts after each step, as run-length codes
    at: int = 0  # step that is looked at

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        """(H, W) bool each: the object's pixels; several where it is to be split."""
        return tuple(decode_run_length((self.height, self.width), code) for code in self.steps[self.at])

    @property
    def mask(self) -> np.ndarray:
        """(H, W) bool: all pixels."""
        return np.logical_or.reduce(self.parts)

    @property
    def changed(self) -> bool:
        """True where saving changes something."""
        return self.steps[self.at] != self.steps[0]

    @property
    def ref(self) -> FieldRef | None:
        """Mask cell; None for a new object."""
        return None if self.number is None else object_ref(self.frame, self.number, "mask")

    def back(self) -> Draft:
        """Draft without the last step."""
        return replace(self, at=max(self.at - 1, 0))

    def forth(self) -> Draft:
        """Draft with the step taken back last."""
        return replace(self, at=min(self.at + 1, len(self.steps) - 1))

    def after(self, *parts: np.ndarray) -> Draft:
        """Add a step, in place of steps taken back."""
        step = tuple(encode_run_length(np.ascontiguousarray(p)) for p in parts)
        if step == self.steps[self.at]:
            return self
        require(self.at + 1 <= MOST_STEPS, "too many steps", got=MOST_STEPS, cause="apply what is drawn")
        return replace(self, steps=(*self.steps[: self.at + 1], step), at=self.at + 1)


def new_draft(frame: EffectiveFrame, number: int | None) -> Draft:
    """Begin a draft of an old or new object; InputError for no such object."""
    mask = np.zeros(frame.size, np.bool_) if number is None else pixels_of(frame, number)
    version = 0 if number is None else frame.version(object_ref(frame.frame, number, "mask"))
    return Draft(frame.frame, number, *frame.size, version, ((encode_run_length(mask),),))


def with_gesture(draft: Draft, gesture: Gesture, canvas: Canvas | None = None) -> Draft:
    """Apply a gesture; InputError for a meaningless gesture."""
    if gesture.kind != "cut":
        require(len(draft.parts) <= 1, "the object is cut", cause="apply the parts, or take the cut back, then draw")
        return draft.after(applied(draft.mask, gesture, canvas))
    require(draft.number is not None, "a new object cannot be cut yet", cause="apply it first")
    cut = split_by_polygon if goes_around(gesture.points) else split_by_line
    # One more cut divides the part that it crosses.
    pieces: list[np.ndarray] = []
    problems: list[InputError] = []
    for part in draft.parts:
        try:
            pieces += cut(part, gesture.points)
        except InputError as error:
            pieces.append(part)
            problems.append(error)
    if len(problems) == len(draft.parts):
        raise problems[-1]
    return draft.after(*pieces)


def with_depth_split(draft: Draft, canvas: Canvas) -> Draft:
    """A draft split where the object's depth comes apart; raises as `split_by_depth`."""
    require(draft.number is not None, "a new object cannot be cut yet", cause="apply it first")
    return draft.after(*split_by_depth(draft.mask, canvas.context.frame.depth))


def edits_of_draft(draft: Draft, frame: EffectiveFrame, label: str = "") -> Edits:
    """Edits for saving a draft; `label` is the class of a new object.

    InputError for no change, no pixel, no class, or pixels that somebody else has changed.
    """
    require(draft.frame == frame.frame, "the draft is of another frame", got=draft.frame, expected=frame.frame)
    parts = draft.parts
    if not all(p.any() for p in parts):
        what = "nothing is drawn yet" if draft.number is None else "no pixel is left"
        raise InputError(what, cause=None if draft.number is None else "reject the object instead")
    if draft.number is None:
        require(label.strip(), "a new object needs a class")
        return add_object(frame, label.strip(), mask=parts[0])
    require(draft.changed, "nothing has changed")
    assert draft.ref is not None
    if frame.version(draft.ref) != draft.version:
        origin = frame.origin(draft.ref)
        raise InputError(
            f"the pixels of object {draft.number} have changed since you began: {origin}",
            cause="apply again to replace them, cancel to keep them",
        )
    return split_object(frame, draft.number, parts) if len(parts) > 1 else set_mask(frame, draft.number, draft.mask)


def rebased(draft: Draft, frame: EffectiveFrame) -> Draft:
    """Draft on the object's pixels now: saving replaces them."""
    return draft if draft.ref is None else replace(draft, version=frame.version(draft.ref))


def lifted_draft(canvas: Canvas, mask: np.ndarray, label: str = "") -> LiftedObject | None:
    """Points and 3D box (camera frame) of a mask of a class, lifted as labels are; None for no pixels."""
    context = canvas.context
    return (
        lift(
            context.frame.depth,
            context.frame.camera,
            [mask],
            context.viewer,
            config=context.config,
            mask_source="human",
            edges=context.edges,
            thin=[is_thin(label)],
        )[0]
        if mask.any()
        else None
    )


def split_by_polygon(mask: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split a mask (H, W) bool by a polygon (N, 2), x, y in pixels; the larger part first; InputError for an empty
    part.
    """
    return _parts(mask, polygon_mask(points, *mask.shape))


def split_by_line(mask: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split a mask (H, W) bool by a line (N, 2), x, y in pixels, extended straight; the larger part first.

    InputError for no line, or an empty part.
    """
    line = np.asarray(points, np.float64).reshape(-1, 2)
    line = line[np.concatenate([[True], (np.diff(line, axis=0) != 0).any(axis=1)])]
    require(len(line) >= 2, "a cut needs a line", got="one point")
    height, width = mask.shape
    reach = 4.0 * (height + width) + float(np.abs(line).max())
    # The hand's first and last pixels jitter: the ends go on in the direction of a good piece of the line.
    piece = max(1, len(line) // 4)
    ahead, behind = _unit(line[-1] - line[-1 - piece]), _unit(line[0] - line[piece])
    start, end = line[0] + reach * behind, line[-1] + reach * ahead
    from_, to = np.arctan2(ahead[1], ahead[0]), np.arctan2(behind[1], behind[0])
    turn = (to - from_) % (2 * np.pi)
    # One side of the line is closed by an arc far outside of the picture.
    angles = from_ + turn * np.linspace(0, 1, 34)[1:-1]
    arc = line.mean(axis=0) + 2 * reach * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return _parts(mask, polygon_mask(np.concatenate([[start], line, [end], arc]), height, width))


def split_by_depth(mask: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, ...]:
    """Split a mask (H, W) bool where no surface of the depth (H, W), metres, joins the parts; the largest first.

    Pixels without depth, and small parts, go to the nearest part. InputError for one part, or too many.
    """
    _, grid = cv2.connectedComponents(link_grid(mask & (depth > 0), *joined(depth)), connectivity=4)
    labels = np.asarray(grid[::2, ::2], np.int64)
    counts = np.bincount(labels[mask], minlength=int(labels.max()) + 1)
    counts[0] = 0
    least = max(LEAST_PIXELS, LEAST_SHARE * int(mask.sum()))
    chosen = [int(k) for k in np.argsort(-counts, kind="stable") if counts[k] >= least]
    require(len(chosen) >= 2, "the object is of one piece in depth", cause="draw a line across it")
    require(
        len(chosen) <= MOST_PARTS,
        "the object falls into too many parts",
        got=len(chosen),
        expected=f"at most {MOST_PARTS}",
    )
    _, nearest = nearest_pixel(mask & np.isin(labels, chosen))
    whose = labels.ravel()[nearest]
    return tuple(mask & (whose == k) for k in chosen)


def _unit(direction: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(direction))
    return direction / length if length > 0 else np.array([1.0, 0.0])


def _parts(mask: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    one, other = mask & ~inside, mask & inside
    require(one.any() and other.any(), "the cut leaves one of both parts empty")
    return (one, other) if one.sum() >= other.sum() else (other, one)
