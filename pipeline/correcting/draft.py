"""A draft: pixels that are being drawn for one object, step by step, until they are saved as one edit or dropped."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.drawing.gestures import Canvas, Gesture, applied, goes_around
from pipeline.drawing.splitting import split_by_depth, split_by_line, split_by_polygon
from pipeline.errors import InputError
from pipeline.journal.cells import Cell, object_cell
from pipeline.journal.edits import Edits, add_object, pixels_of, set_mask, split_object
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.lifting import LiftedObject, lift
from pipeline.run_length import decode_run_length, encode_run_length

MOST_STEPS = 500


@dataclass(frozen=True)
class Draft:
    """What is drawn so far.

    Attributes
    ----------
    frame : str
    number : int or None
        The object; None for a new one.
    height, width : int
        Of the picture.
    version : int
        Of the object's mask when the draft was begun.
    steps : tuple of tuple of str
        After each step the masks of the parts, as COCO's compressed run-length codes; the first is before any. One
        part, or several of an object that is to be split.
    at : int
        The step that is looked at: later ones were taken back.
    """

    frame: str
    number: int | None
    height: int
    width: int
    version: int
    steps: tuple[tuple[str, ...], ...]
    at: int = 0

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
        """Whether saving it would change something."""
        return self.steps[self.at] != self.steps[0]

    @property
    def cell(self) -> Cell | None:
        """The cell that it will change; None for a new object."""
        return None if self.number is None else object_cell(self.frame, self.number, "mask")

    def back(self) -> Draft:
        """Without its last step."""
        return replace(self, at=max(self.at - 1, 0))

    def forth(self) -> Draft:
        """With the step that was taken back last."""
        return replace(self, at=min(self.at + 1, len(self.steps) - 1))

    def after(self, *parts: np.ndarray) -> Draft:
        """With another step, in place of those that were taken back."""
        step = tuple(encode_run_length(np.ascontiguousarray(p)) for p in parts)
        if step == self.steps[self.at]:
            return self
        if self.at + 1 > MOST_STEPS:
            raise InputError("too many steps", got=MOST_STEPS, cause="apply what is drawn")
        return replace(self, steps=(*self.steps[: self.at + 1], step), at=self.at + 1)


def begun(frame: EffectiveFrame, number: int | None) -> Draft:
    """A draft of an object as it is now, or of a new one; InputError where there is no such object."""
    height, width = int(frame.row["height"]), int(frame.row["width"])
    mask = np.zeros((height, width), np.bool_) if number is None else pixels_of(frame, number)
    version = 0 if number is None else frame.version(object_cell(frame.frame, number, "mask"))
    return Draft(frame.frame, number, height, width, version, ((encode_run_length(mask),),))


def continued(draft: Draft, gesture: Gesture, canvas: Canvas | None = None) -> Draft:
    """A draft after a gesture.

    Raises
    ------
    InputError
        The gesture means nothing here.
    """
    if gesture.kind != "cut":
        if len(draft.parts) > 1:
            raise InputError("the object is cut", cause="apply the parts, or take the cut back, then draw")
        return draft.after(applied(draft.mask, gesture, canvas))
    if draft.number is None:
        raise InputError("a new object cannot be cut yet", cause="apply it first")
    cut = split_by_polygon if goes_around(gesture.points) else split_by_line
    # One more cut divides the part that it crosses.
    pieces: list[np.ndarray] = []
    problem: InputError | None = None
    for part in draft.parts:
        try:
            pieces += list(cut(part, gesture.points))
        except InputError as error:
            pieces.append(part)
            problem = error
    if len(pieces) == len(draft.parts) and problem is not None:
        raise problem
    return draft.after(*pieces)


def come_apart(draft: Draft, canvas: Canvas) -> Draft:
    """A draft split where the object's depth comes apart; raises as `split_by_depth`."""
    if draft.number is None:
        raise InputError("a new object cannot be cut yet", cause="apply it first")
    return draft.after(*split_by_depth(draft.mask, canvas.context.frame.depth))


def edits_of_draft(draft: Draft, frame: EffectiveFrame, label: str = "") -> Edits:
    """The edits of one action that a draft comes down to.

    Parameters
    ----------
    frame : EffectiveFrame
        As it is now.
    label : str
        Class of a new object.

    Raises
    ------
    InputError
        Nothing has changed, no pixel is left, a new object has no class, or somebody else has changed the pixels.
    """
    if draft.frame != frame.frame:
        raise InputError("the draft is of another frame", got=draft.frame, expected=frame.frame)
    parts = draft.parts
    if not all(p.any() for p in parts):
        what = "nothing is drawn yet" if draft.number is None else "no pixel is left"
        raise InputError(what, cause=None if draft.number is None else "reject the object instead")
    if draft.number is None:
        if not label.strip():
            raise InputError("a new object needs a class")
        return add_object(frame, label.strip(), mask=parts[0])
    if not draft.changed:
        raise InputError("nothing has changed")
    assert draft.cell is not None
    if frame.version(draft.cell) != draft.version:
        origin = frame.origin(draft.cell)
        raise InputError(
            f"the pixels of object {draft.number} have changed since you began: {origin}",
            cause="apply again to replace them, cancel to keep them",
        )
    if len(parts) > 1:
        return split_object(frame, draft.number, parts)
    return set_mask(frame, draft.number, draft.mask)


def rebased(draft: Draft, frame: EffectiveFrame) -> Draft:
    """The same draft on what the object's pixels are now: saving it replaces them."""
    return draft if draft.cell is None else replace(draft, version=frame.version(draft.cell))


def fitted(canvas: Canvas, mask: np.ndarray) -> LiftedObject | None:
    """What a mask becomes in 3D: its points and its 3D box (camera frame), lifted as labels are; None for no pixels."""
    if not mask.any():
        return None
    context = canvas.context
    found = lift(
        context.frame.depth, context.frame.camera, [mask], context.viewer, config=context.config,
        mask_source="human", edges=context.edges,
    )  # fmt: skip
    return found[0]


