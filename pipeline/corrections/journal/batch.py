"""Edits as a file: a JSON list of actions, checked as a whole and saved as one.

Pixels are run-length codes, polygons, rectangles, strokes, or seeds of a surface.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from pipeline.corrections.drawing.depth_region import TOLERANCE
from pipeline.corrections.drawing.gestures import Canvas, drawn, gesture_of
from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Edit, Rival, Saved
from pipeline.corrections.journal.field_refs import OF_ALL, FieldRef, Kind, box_of, judged_item
from pipeline.corrections.journal.journal import Journal
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import InputError

_STATES = {"T": T, "U": U, "F": F}
SHAPES = ("polygon", "rectangle", "strokes", "seeds")
Mode = Literal["add", "remove", "replace"]


class Stroke(BaseModel):
    """Where a round brush went; pixels."""

    model_config = ConfigDict(extra="forbid", strict=True)

    points: list[list[float]]
    radius: float


class Shapes(BaseModel):
    """Pixels by one of several shapes; all numbers are pixels, x before y.

    Attributes
    ----------
    polygon : list of [x, y]
    rectangle : list of four numbers
        x0, y0, x1, y1; of a new object the surface of the depth segmenter inside.
    strokes : list of Stroke
    seeds : list of [x, y]
        The surfaces that these lie on.
    tolerance : float
        Of the seeds.
    """

    polygon: list[list[float]] | None = None
    rectangle: list[float] | None = None
    strokes: list[Stroke] | None = None
    seeds: list[list[float]] | None = None
    tolerance: float = TOLERANCE

    @property
    def shaped(self) -> bool:
        """Whether there is a shape."""
        return any(getattr(self, name) is not None for name in SHAPES)

    @model_validator(mode="after")
    def _one(self) -> Shapes:
        given = [name for name in SHAPES if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"only one of {', '.join(given)} can be meant")
        if self.rectangle is not None and len(self.rectangle) != 4:
            raise ValueError("a rectangle has four numbers")
        if self.strokes == []:
            raise ValueError("there are no strokes")
        return self

    def pixels(self, height: int, width: int, canvas: Canvas | None, *, surface: bool = False) -> np.ndarray:
        """(H, W) bool of the shape; InputError where it has no pixels or what it needs is not at hand."""
        if self.strokes is not None:
            each = [gesture_of("stroke", s.points, height, width, radius=s.radius) for s in self.strokes]
            return np.logical_or.reduce([drawn(g, height, width) for g in each])
        if self.polygon is not None:
            found = gesture_of("polygon", self.polygon, height, width)
        elif self.rectangle is not None:
            corners = [self.rectangle[:2], self.rectangle[2:]]
            found = gesture_of("surface" if surface else "rectangle", corners, height, width)
        else:
            found = gesture_of("depth", self.seeds, height, width, tolerance=self.tolerance)
        return drawn(found, height, width, canvas)


class Action(BaseModel):
    """What every action has. `base` is the version of its (first) cell that the person saw: the newest by default."""

    model_config = ConfigDict(extra="forbid", strict=True)

    frame: str
    reason: str = ""
    base: int | None = Field(default=None, ge=0)


class OfObject(Action):
    object: int


class ClassName(OfObject):
    edit: Literal["class"]
    to: str


class Mask(OfObject, Shapes):
    """Pixels by a run-length code or a shape; a shape is in place of the mask, is added to it, or taken from it."""

    edit: Literal["mask"]
    to: str | None = None
    mode: Mode = "replace"

    @model_validator(mode="after")
    def _said(self) -> Mask:
        if ("to" in self.model_fields_set) == self.shaped:
            raise ValueError("pixels are either a code (to) or one of polygon, rectangle, strokes, seeds")
        if not self.shaped and self.mode != "replace":
            raise ValueError("a code replaces the mask")
        return self


class Rectangle(OfObject):
    edit: Literal["bbox"]
    to: list[float]


class Solid(OfObject):
    """Null for the box that the object's points make."""

    edit: Literal["box"]
    to: dict[str, list[float]] | None


class OfItem(Action):
    """On an object, a relation of a pair, or an expression."""

    object: int | None = None
    a: int | None = None
    b: int | None = None
    relation: str | None = None
    expression: str | None = None
    to: str | None


class Status(OfItem):
    """Of the frame where none of them is named."""

    edit: Literal["status"]


class Judge(OfItem):
    """A reviewer's own word: a status, or of a relation T, U or F."""

    edit: Literal["judge"]


class Settle(OfItem):
    """The last word where reviewers differ."""

    edit: Literal["settle"]
    to: str  # pyright: ignore[reportIncompatibleVariableOverride]


class NewObject(Action, Shapes):
    """With a mask, a 2D box, a 3D box, or a shape; in a rectangle the pixels are those of the depth segmenter."""

    edit: Literal["new"]
    label: str
    mask: str | None = None
    bbox: list[float] | None = None
    box: dict[str, list[float]] | None = None

    @model_validator(mode="after")
    def _said(self) -> NewObject:
        if self.mask is not None and self.shaped:
            raise ValueError("pixels are either a mask or one of polygon, rectangle, strokes, seeds")
        return self


class Merge(Action):
    edit: Literal["merge"]
    objects: list[int]


class Split(OfObject):
    edit: Literal["split"]
    masks: list[str]


class Relation(Action):
    edit: Literal["relation"]
    a: int
    b: int
    relation: str
    to: Literal["T", "U", "F"]


class OfExpression(Action):
    expression: str


class Text(OfExpression):
    edit: Literal["text"]
    to: str


class Answers(OfExpression):
    edit: Literal["answers"]
    targets: list[int]
    acceptable: list[int] | None = None


class Ambiguous(OfExpression):
    edit: Literal["ambiguous"]
    to: bool


class Mark(OfExpression):
    edit: Literal["mark"]
    to: str | None


class Note(Action):
    edit: Literal["note"]
    to: str | None


class Value(Action):
    """One field of one entity, as the journal keeps it; nothing else is set with it. Of judgements, one's own."""

    edit: Literal["value"]
    kind: Kind
    key: str
    field: str
    to: Any


AnyAction = Annotated[
    ClassName | Mask | Rectangle | Solid | Status | Judge | Settle | NewObject | Merge | Split | Relation | Text
    | Answers | Ambiguous | Mark | Note | Value,
    Field(discriminator="edit"),
]  # fmt: skip


_LIST: TypeAdapter[list[AnyAction]] = TypeAdapter(list[AnyAction])


def read_actions(path: Path) -> list[AnyAction]:
    """Actions from a file.

    Raises
    ------
    InputError
        It cannot be read, or an entry is no action: which, and why.
    """
    try:
        return actions_of(json.loads(Path(path).read_text(encoding="utf-8")), path)
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("the edits cannot be read", got=reason, expected="a JSON list", path=path) from error


def actions_of(entries: Any, path: Path | None = None) -> list[AnyAction]:
    """Actions from parsed JSON; raises as `read_actions`."""
    if not isinstance(entries, list) or not entries:
        got = "an empty list" if entries == [] else type(entries).__name__
        raise InputError("edits must be a list that is not empty", got=got, path=path)
    try:
        return _LIST.validate_python(entries)
    except ValidationError as error:
        first = error.errors()[0]
        index, where = first["loc"][0], ".".join(str(p) for p in first["loc"][2:])
        message = f"edit {index}: {where}: {first['msg']}" if where else f"edit {index}: {first['msg']}"
        raise InputError(message, got=repr(first.get("input"))[:60], path=path) from error


def edits_of(action: AnyAction, frame: EffectiveFrame, author: str, canvas: Canvas | None = None) -> tuple[Edit, ...]:
    """The edits that an action comes down to; InputError where it cannot be done to the frame.

    `canvas` is the frame's picture, for shapes that follow its depth.
    """
    return _EDITS[action.edit](action, frame, author, canvas)


def _mask(a: Mask, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> actions.Edits:
    mask = a.to
    if a.shaped:
        mask = combined(actions.pixels_of(frame, a.object), a.pixels(*actions.size_of(frame), canvas), a.mode)
    return actions.set_mask(frame, a.object, mask, a.reason)


def _new_object(a: NewObject, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> actions.Edits:
    box = None if a.box is None else box_of(a.box)
    mask = a.pixels(*actions.size_of(frame), canvas, surface=True) if a.shaped else a.mask
    return actions.add_object(frame, a.label, mask=mask, bbox=a.bbox, box=box, reason=a.reason)


def _value(a: Value, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> actions.Edits:
    ref = FieldRef(a.kind, a.frame, a.key, a.field)
    if ref.kind == "review" and judged_item(ref.key)[0] not in (author.strip(), OF_ALL):
        raise InputError("a judgement of another person", got=judged_item(ref.key)[0], expected=author)
    return actions.set_value(frame, ref, a.to, a.reason)


def _judge(a: Judge, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> actions.Edits:
    ref = _status_cell(a)
    if ref.kind == "relation" and a.to in _STATES:
        (one, other), relation = ref.numbers, ref.field.removesuffix(".status")
        return actions.judge_relation(frame, one, other, relation, _STATES[a.to], author, a.reason)
    return actions.judge(frame, ref, a.to, author, a.reason)


def _settle(a: Settle, frame: EffectiveFrame, author: str, canvas: Canvas | None) -> actions.Edits:
    ref = _status_cell(a)
    state = _STATES.get(a.to) if ref.kind == "relation" else None
    if state is None:
        return actions.settle(frame, ref, a.to, a.reason)
    now = frame.value(actions.state_ref(ref))
    return actions.settle(frame, ref, "accepted" if state == now else "corrected", a.reason, state)


_EDITS: dict[str, Callable[[Any, EffectiveFrame, str, Canvas | None], actions.Edits]] = {
    "class": lambda a, frame, *_: actions.set_class(frame, a.object, a.to, a.reason),
    "mask": _mask,
    "bbox": lambda a, frame, *_: actions.set_bbox(frame, a.object, a.to, a.reason),
    "box": lambda a, frame, *_: actions.set_box(frame, a.object, None if a.to is None else box_of(a.to), a.reason),
    "status": lambda a, frame, *_: actions.set_status(frame, _status_cell(a), a.to, a.reason),
    "judge": _judge,
    "settle": _settle,
    "new": _new_object,
    "merge": lambda a, frame, *_: actions.merge_objects(frame, a.objects, a.reason),
    "split": lambda a, frame, *_: actions.split_object(frame, a.object, a.masks, a.reason),
    "relation": lambda a, frame, *_: actions.set_relation(frame, a.a, a.b, a.relation, _STATES[a.to], a.reason),
    "text": lambda a, frame, *_: actions.set_text(frame, a.expression, a.to, a.reason),
    "answers": lambda a, frame, *_: actions.set_answers(frame, a.expression, a.targets, a.acceptable, a.reason),
    "ambiguous": lambda a, frame, *_: actions.set_ambiguous(frame, a.expression, a.to, a.reason),
    "mark": lambda a, frame, *_: actions.set_mark(frame, a.expression, a.to, a.reason),
    "note": lambda a, frame, *_: actions.set_note(frame, a.to, a.reason),
    "value": _value,
}
"""What makes the edits of an action, by its `edit`."""


def _status_cell(action: OfItem) -> FieldRef:
    if action.object is not None:
        return FieldRef("object", action.frame, str(action.object), "status")
    if action.expression is not None:
        return FieldRef("expression", action.frame, action.expression, "status")
    if action.a is not None and action.b is not None and action.relation is not None:
        return FieldRef("relation", action.frame, f"{action.a},{action.b}", f"{action.relation}.status")
    return FieldRef("frame", action.frame, "", "status")


def apply_actions(
    corrector: Corrector, journal: Journal, todo: Sequence[AnyAction], author: str, *, again: str | None = None
) -> Saved | Conflict:
    """Save actions as one: all of them, or none.

    An action that does not say which version it was made on may not change
    what somebody else has said: that is a conflict.

    Parameters
    ----------
    again : str, optional
        `NotSaved.group`, where this is another try: what was saved after all is not saved again.

    Raises
    ------
    InputError
        An action cannot be done: which, and why.
    NotSaved
        As `Journal.append`.
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
            made = edits_of(action, frames[action.frame], author, canvases.get(action.frame))
        except InputError as error:
            raise InputError(f"edit {k}: {error}") from error
        if action.base is not None:
            first = made[0]
            made = (Edit(first.ref, first.before, first.after, action.base, first.reason, first.anchor), *made[1:])
        else:
            heads = journal.heads([e.ref for e in made])
            rivals += [Rival(e, heads[e.ref]) for e in made if e.ref in heads and heads[e.ref].author != author]
        edits += made
    return Conflict(tuple(rivals), tuple(edits)) if rivals else journal.append(edits, author, group=again)


def combined(mask: np.ndarray, pixels: np.ndarray, mode: Mode) -> np.ndarray:
    """A mask with other pixels added to it, taken from it, or in its place."""
    if mode == "add":
        return mask | pixels
    return mask & ~pixels if mode == "remove" else pixels


def needs_pictures(actions: Sequence[Any]) -> bool:
    """Whether one of the actions follows the depth of a picture."""
    shapes = [a for a in actions if isinstance(a, Shapes)]
    return any(a.seeds is not None or (a.rectangle is not None and not hasattr(a, "object")) for a in shapes)
