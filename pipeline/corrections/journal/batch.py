"""Edits as a file: a JSON list of actions, checked as a whole and saved as one.

Pixels are run-length codes, polygons or rectangles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, create_model, model_validator

from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.edits import Edits
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Edit, Rival, Saved
from pipeline.corrections.journal.field_refs import OF_ALL, FieldRef, Kind, box_of, judged_item
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.scene import drag_box
from pipeline.drawing.gestures import Canvas, drawn, read_gesture
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import InputError, as_input_error, kind_and_text, require
from pipeline.system.reading import checked
from pipeline.system.safe_files import read_json

_STATES = {"T": T, "U": U, "F": F}
Mode = Literal["add", "remove", "replace"]


class Shapes(BaseModel):
    """Pixels by one of two shapes, in pixels, x before y."""

    polygon: list[list[float]] | None = None  # Corners
    # x0, y0, x1, y1; of a new object the depth segmenter's surface inside
    rectangle: Annotated[list[float], Field(min_length=4, max_length=4)] | None = None

    @property
    def shaped(self) -> bool:
        """True with a shape."""
        return self.polygon is not None or self.rectangle is not None

    def pixels(self, height: int, width: int, canvas: Canvas | None, *, surface: bool = False) -> np.ndarray:
        """Rasterise to (H, W) bool; InputError without pixels, or without the picture for a surface."""
        require(self.polygon is None or self.rectangle is None, "a polygon and a rectangle cannot both be meant")
        corners, kind = self.polygon, "polygon"
        if self.rectangle is not None:
            corners, kind = [self.rectangle[:2], self.rectangle[2:]], "surface" if surface else "rectangle"
        gesture = read_gesture({"do": kind, "at": corners}, height, width, fractions=False)
        return drawn(gesture, height, width, canvas)


class Action(BaseModel):
    """Fields of every action; `base` is the version of the (first) cell as the person saw it, by default the newest."""

    model_config = ConfigDict(extra="forbid", strict=True)

    edit: str  # Kind of action
    frame: str  # Id of the frame
    reason: str = ""  # Kept with the correction
    base: int | None = Field(default=None, ge=0)  # Version of the cell that the person saw; by default the newest


class OfObject(Action):
    object: int


class Mask(OfObject, Shapes):
    """Pixels by a run-length code or a shape; a shape replaces the mask, is added to it, or taken from it."""

    to: str | None = None
    mode: Mode = "replace"

    @model_validator(mode="after")
    def _one_way(self) -> Mask:
        if ("to" in self.model_fields_set) == self.shaped:
            raise ValueError("pixels are either a code (to) or one of polygon and rectangle")
        if not self.shaped and self.mode != "replace":
            raise ValueError("a code replaces the mask")
        return self


class OfItem(Action):
    """Action on an object, a relation of a pair, an expression, or by default the frame."""

    object: int | None = None  # Number of an object
    a: int | None = None  # With b and relation: of a pair
    b: int | None = None
    relation: str | None = None
    expression: str | None = None  # Id of an expression

    @property
    def ref(self) -> FieldRef:
        """Status cell of the item."""
        if self.object is not None:
            return FieldRef("object", self.frame, str(self.object), "status")
        if self.expression is not None:
            return FieldRef("expression", self.frame, self.expression, "status")
        if self.a is not None and self.b is not None and self.relation is not None:
            return FieldRef("relation", self.frame, f"{self.a},{self.b}", f"{self.relation}.status")
        return FieldRef("frame", self.frame, "", "status")


class NewObject(Action, Shapes):
    """Object from a mask, a 2D box, a 3D box, or a shape; a rectangle takes the depth segmenter's surface."""

    label: str
    mask: str | None = None
    bbox: list[float] | None = None
    box: dict[str, list[float]] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> NewObject:
        if self.mask is not None and self.shaped:
            raise ValueError("pixels are either a mask or one of polygon and rectangle")
        return self


def _mask(a: Mask, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> Edits:
    mask = a.to
    if a.shaped:
        was, pixels = actions.pixels_of(frame, a.object), a.pixels(*frame.size, canvas)
        mask = {"add": was | pixels, "remove": was & ~pixels, "replace": pixels}[a.mode]
    return actions.set_mask(frame, a.object, mask, a.reason)


def _new_object(a: NewObject, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> Edits:
    box = None if a.box is None else box_of(a.box)
    mask = a.pixels(*frame.size, canvas, surface=True) if a.shaped else a.mask
    return actions.add_object(frame, a.label, mask=mask, bbox=a.bbox, box=box, reason=a.reason)


def _value(a: Any, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> Edits:
    ref = FieldRef(a.kind, a.frame, a.key, a.field)
    whose = judged_item(ref.key)[0] if ref.kind == "review" else OF_ALL
    require(whose in (author.strip(), OF_ALL), "a judgement of another person", got=whose, expected=author)
    return actions.set_value(frame, ref, a.to, a.reason)


def _judge(a: Any, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> Edits:
    ref = a.ref
    if ref.kind == "relation" and a.to in _STATES:
        (one, other), relation = ref.numbers, ref.field.removesuffix(".status")
        return actions.judge_relation(frame, one, other, relation, _STATES[a.to], author, a.reason)
    return actions.judge(frame, ref, a.to, author, a.reason)


def _settle(a: Any, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> Edits:
    state = _STATES.get(a.to) if a.ref.kind == "relation" else None
    if state is None:
        return actions.settle(frame, a.ref, a.to, a.reason)
    return actions.settle(
        frame, a.ref, "accepted" if state == frame.value(actions.state_ref(a.ref)) else "corrected", a.reason, state
    )


KINDS: dict[str, tuple[type[Action], dict[str, Any], Callable[[Any, EffectiveFrame, str, Canvas | None], Edits]]] = {
    # Class name of an object
    "class": (OfObject, {"to": str}, lambda a, frame, *_: actions.set_class(frame, a.object, a.to, a.reason)),
    "mask": (Mask, {}, _mask),  # Its pixels: a code, or a shape that replaces, adds or removes
    # Its 2D box: x0, y0, x1, y1, pixels
    "bbox": (OfObject, {"to": list[float]}, lambda a, frame, *_: actions.set_bbox(frame, a.object, a.to, a.reason)),
    # Its 3D box: center, R, size; null for the box that its points make
    "box": (
        OfObject,
        {"to": dict[str, list[float]] | None},
        lambda a, frame, *_: actions.set_box(frame, a.object, None if a.to is None else box_of(a.to), a.reason),
    ),
    # Faces of its 3D box moved: ["face", axis 0 to 2, side 1 or -1, metres] each
    "drag": (OfObject, {"moves": list[list[Any]]}, lambda a, frame, *_: drag_box(frame, a.object, a.moves, a.reason)),
    # Review of an item for all: accepted, corrected, rejected, unsure; null takes it back
    "status": (OfItem, {"to": str | None}, lambda a, frame, *_: actions.set_status(frame, a.ref, a.to, a.reason)),
    # One reviewer's word on an item: a status, or of a relation T, U or F
    "judge": (OfItem, {"to": str | None}, _judge),
    "settle": (OfItem, {"to": str}, _settle),  # Last word where reviewers differ
    "new": (NewObject, {}, _new_object),  # New object
    # Objects become one: the first gets the pixels of all
    "merge": (Action, {"objects": list[int]}, lambda a, frame, *_: actions.merge_objects(frame, a.objects, a.reason)),
    # An object becomes several: one for each mask
    "split": (
        OfObject,
        {"masks": list[str]},
        lambda a, frame, *_: actions.split_object(frame, a.object, a.masks, a.reason),
    ),
    # State of "a RELATION b", and of its inverse
    "relation": (
        Action,
        {"a": int, "b": int, "relation": str, "to": Literal["T", "U", "F"]},
        lambda a, frame, *_: actions.set_relation(frame, a.a, a.b, a.relation, _STATES[a.to], a.reason),
    ),
    # New sentence that is true of a pair
    "true": (
        Action,
        {"text": str, "target": str, "relation": str, "reference": str, "a": int, "b": int},
        lambda a, frame, *_: actions.add_sentence(
            frame, a.text, (a.target, a.relation, a.reference), a.a, a.b, a.reason
        ),
    ),
    # Words of an expression
    "text": (
        Action,
        {"expression": str, "to": str},
        lambda a, frame, *_: actions.set_text(frame, a.expression, a.to, a.reason),
    ),
    # Objects that answer an expression
    "answers": (
        Action,
        {"expression": str, "targets": list[int], "acceptable": (list[int] | None, None)},
        lambda a, frame, *_: actions.set_answers(frame, a.expression, a.targets, a.acceptable, a.reason),
    ),
    # Several objects are acceptable, or one
    "ambiguous": (
        Action,
        {"expression": str, "to": bool},
        lambda a, frame, *_: actions.set_ambiguous(frame, a.expression, a.to, a.reason),
    ),
    # Mark on an expression; null takes it back
    "mark": (
        Action,
        {"expression": str, "to": str | None},
        lambda a, frame, *_: actions.set_mark(frame, a.expression, a.to, a.reason),
    ),
    # Note on the frame; null takes it away
    "note": (Action, {"to": str | None}, lambda a, frame, *_: actions.set_note(frame, a.to, a.reason)),
    # Any one field, as the journal keeps it
    "value": (Action, {"kind": (Kind, ...), "key": str, "field": str, "to": Any}, _value),
}
"""Kinds of actions by their `edit`: what they are on, the fields that they have besides, and what makes their edits.

"box" is null for the box that the object's points make; "judge" is a reviewer's own word (a status, or of a relation
T, U or F), "settle" the last one where reviewers differ; "value" is any one field of one entity as the journal keeps
it: nothing else is set with it, and of judgements it is one's own.
"""
_MODELS = tuple(
    create_model(
        edit,
        __base__=base,
        edit=(Literal[edit], ...),  # pyright: ignore
        **{name: kind if isinstance(kind, tuple) else (kind, ...) for name, kind in more.items()},  # pyright: ignore
    )
    for edit, (base, more, _) in KINDS.items()
)
_LIST: TypeAdapter[list[Any]] = TypeAdapter(
    list[Annotated[Union[_MODELS], Field(discriminator="edit")]]  # pyright: ignore  # noqa: UP007
)


def read_actions(path: Path) -> list[Any]:
    """Read actions from a JSON file; InputError names the wrong entry."""
    with as_input_error("the edits cannot be read", OSError, ValueError, RecursionError, got=kind_and_text, path=path):
        return actions_of(read_json(Path(path)), path)


def actions_of(entries: Any, path: Path | None = None) -> list[Any]:
    """Parse a JSON list of actions; raises as `read_actions`."""
    if not isinstance(entries, list) or not entries:
        got = "an empty list" if entries == [] else type(entries).__name__
        raise InputError("edits must be a list that is not empty", got=got, path=path)
    return checked(_LIST.validate_python, entries, "edit {} cannot be this", path)


def apply_actions(
    corrector: Corrector, journal: Journal, todo: Sequence[Action], author: str, *, again: str | None = None
) -> Saved | Conflict:
    """Save actions as a single event group, all or none.

    An action without `base` may not change another author's value: a conflict. `again` is `NotSaved.group` on a retry:
    an action that reached the journal is not saved twice. InputError names the action that cannot be done; NotSaved as
    `Journal.append`.
    """
    if again is not None and (saved := journal.events(group=again)):
        return Saved(saved)
    frames: dict[str, EffectiveFrame] = {}
    canvases: dict[str, Canvas] = {}
    edits: list[Edit] = []
    rivals: list[Rival] = []
    for k, action in enumerate(todo):
        try:
            if action.frame not in frames:
                frames[action.frame] = corrector.frame(action.frame, journal)
            if corrector.relifter is not None and isinstance(action, Shapes) and action.frame not in canvases:
                canvases[action.frame] = Canvas(corrector.relifter.context(action.frame))
            made = KINDS[action.edit][2](action, frames[action.frame], author, canvases.get(action.frame))
        except InputError as error:
            raise InputError(f"edit {k}: {error}") from error
        if action.base is not None:
            made = (replace(made[0], base=action.base), *made[1:])
        else:
            heads = journal.heads([e.ref for e in made])
            rivals += [Rival(e, heads[e.ref]) for e in made if e.ref in heads and heads[e.ref].author != author]
        edits += made
    return Conflict(tuple(rivals), tuple(edits)) if rivals else journal.append(edits, author, group=again)


def needs_pictures(actions: Sequence[Any]) -> bool:
    """True where an action follows the depth of a picture."""
    return any(isinstance(a, NewObject) and a.rectangle is not None for a in actions)
