"""Schema of prediction files: a header, and a line for each expression, as plain values (`docs/predictions.md`).

A trace writes events: parts of lines during a run, with `frame`, `text` and any further fields of a line. One that only
says what is asked, and how its words are read, begins an expression: anew, where it was asked before. Its answer, or
the problem why there is none, ends it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, FiniteFloat, StrictBool

from pipeline.geometry.masks import RunLength
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

VERSION = 1
"""Of the schema; a reader refuses files of a later one."""
_STRICT = ConfigDict(extra="forbid")


def _no_text(value: Any) -> Any:
    """Whole number from 3.0, as tables write; "3" and true are none."""
    if isinstance(value, str | bool):
        raise InputError("no whole number", got=json.dumps(value))
    return value


Key = Annotated[int, Field(ge=0, lt=2**63)]
"""Of an object of JSON, where a number is text."""
Id = Annotated[Key, BeforeValidator(_no_text)]
Name = Annotated[str, Field(min_length=1)]
Number = Annotated[FiniteFloat, Field(strict=True)]
Share = Annotated[FiniteFloat, Field(strict=True, ge=0, le=1)]
Three = tuple[Number, Number, Number]
Four = tuple[Number, Number, Number, Number]
Row = Annotated[tuple[Id, Id, Share] | tuple[Id, Id, Id, Share], Field(union_mode="left_to_right")]
"""Two objects, of "between" three, and a probability."""


@dataclass(frozen=True)
class Weights:
    """Exponents of the three factors of a ranking by product."""

    __pydantic_config__ = _STRICT

    target: Number = 1.0  # Of P(target)
    reference: Number = 1.0  # Of P(reference)
    relation: Number = 1.0  # Of P(relation)


@dataclass(frozen=True)
class Header:
    """Header of a file of predictions, with its conventions; as JSON the first line."""

    __pydantic_config__ = _STRICT

    spatialviz_predictions: int = VERSION  # Version of the schema
    system: Name = "predictions"  # Name of the pipeline
    boxes: Literal["xyxy", "xywh", "cxcywh", "yxyx"] = "xyxy"  # How 2D boxes are written
    # What they and points are in: pixels, or shares (0..1) or thousandths of the picture's width and height
    box_unit: Literal["pixels", "shares", "thousandths"] = "pixels"
    # Frame of 3D boxes: the camera's with y down and z forward, or y up and z backward; or the dataset's world
    coordinates: Literal["camera_opencv", "camera_opengl", "world"] = "camera_opencv"
    length: Literal["m", "cm", "mm"] = "m"  # Unit of 3D boxes
    # How pairs are ranked: by the product of P(target), P(reference) and P(relation) with these weights; by scores of
    # the system's own, given as "pairs"; or "none": not told
    ranking: Literal["product", "pair_scores", "none"] = "none"
    # Of the three factors, where pairs are ranked by their product
    weights: Weights = field(default_factory=Weights)
    # Which proposals count as one thing, and so never as a pair: those with one id, or also those that overlap
    same: Literal["ids", "overlap"] = "ids"
    exact: StrictBool = False  # The proposals are the dataset's own annotations
    events: StrictBool = False  # The lines are events of a trace: what they tell of one expression is joined
    # A relation scorer of ours that made the probabilities ("rule", "trained", an ONNX file), which can be asked again;
    # None for one that cannot
    scorer: str | None = None
    # Score that is given to an object that was not proposed, where the truth is put in place; None for the median of
    # the right proposals
    confidence: Share | None = None
    settings: dict[str, Any] | None = None  # Of a run of ours that was exported: how it was answered
    notes: str = ""  # For people


@dataclass(frozen=True)
class Proposal:
    """Detection for a name."""

    __pydantic_config__ = _STRICT

    id: Id  # Which object of the frame it is: the same number in two names, or in two lines of a frame, is one object
    score: Share  # P(object | name), 0..1
    box: Four | None = None  # As the header says; may be left out where an earlier line of the frame told it of this id
    name: str = ""  # What the detector calls it; empty for the name that was asked
    # COCO's run-length code, of the frame's size; without it the box is all that is known
    mask: RunLength | None = None
    # It did not go on to the ranking: cut off by K, suppressed by a better one, or below the minimum score
    dropped: Literal["rank", "overlap", "threshold"] | None = None


@dataclass(frozen=True)
class PredictedBox:
    """3D box: center, size and rotation, or eight corners in any order; in the header's frame and unit."""

    __pydantic_config__ = _STRICT

    center: Three | None = None  # Its middle
    size: Three | None = None  # Full edge lengths along the box's own axes
    # Row by row; its columns are the box's axes. Null for a box along the axes of the frame
    rotation: Annotated[tuple[Number, ...], Field(min_length=9, max_length=9)] | None = None
    # In any order; in place of the other three
    corners: Annotated[tuple[Three, ...], Field(min_length=8, max_length=8)] | None = None


@dataclass(frozen=True)
class PredictedAnswer:
    """Answer in a single form; with an object also its reference."""

    __pydantic_config__ = _STRICT

    # object, reference: Ids of proposals
    object: Id | None = None
    reference: Id | None = None
    box: Four | None = None  # As the header says
    point: tuple[Number, Number] | None = None  # x, y in the unit of boxes
    mask: RunLength | None = None  # COCO's run-length code, of the frame's size
    yes: StrictBool | None = None  # Of questions that are answered by yes or no


@dataclass(frozen=True)
class Prediction:
    """Prediction for an expression on a frame; as JSON a line of the file."""

    __pydantic_config__ = _STRICT

    frame: Name  # Id of the dataset's frame
    text: Name  # The expression
    answer: PredictedAnswer | None = None  # None where there is none, or where the ranking that the file gives says it
    problem: str | None = None  # Why there is none
    # target, relation, reference: How the system read the words, where it did; else ours reads them
    target: Name | None = None
    relation: str | None = None
    reference: Name | None = None
    proposals: dict[Name, tuple[Proposal, ...]] | None = None  # By the name that was asked; from level 1 on
    unknown: dict[Name, str] | None = None  # Names that the detector could not be asked for, and why
    # dict of int to PredictedBox: by id, null where an object has none; from level 2 on
    boxes_3d: dict[Key, PredictedBox | None] | None = None
    # P("a RELATION b") by relation; from level 3 on. Of "between" rows of three objects.
    relations: dict[str, tuple[Row, ...]] | None = None
    attributes: dict[Name, tuple[tuple[Id, Share], ...]] | None = None  # P(attribute | object) by attribute ("red")
    # The system's own scores of pairs, higher is better; the reference is null where none is asked
    pairs: tuple[tuple[Id, Id | None, Number], ...] | None = None

    @property
    def level(self) -> int:
        """Level: 0 the answer, 1 with proposals, 2 with 3D boxes, 3 with relation probabilities (boxes or not)."""
        given = (self.relations, self.boxes_3d, self.proposals)
        return next((3 - k for k, part in enumerate(given) if part is not None), 0)

    @property
    def ranked(self) -> bool:
        """True for lines with pairs and their probabilities, and the answer, if any, among them.

        Modules can then be replaced by the truth. An answer of another kind stands by itself.
        """
        answered = self.answer is None or self.answer.object is not None
        return self.relations is not None and self.problem is None and answered

    @cached_property
    def objects(self) -> dict[int, Proposal]:
        """Proposals kept for the ranking, by id; of an id under several names the first."""
        every = [p for found in (self.proposals or {}).values() for p in found if p.dropped is None]
        return {p.id: p for p in reversed(every)}


_INSIDE = {
    "weights": Weights,
    "answer": PredictedAnswer,
    "proposals": Proposal,
    "boxes_3d": PredictedBox,
    "mask": RunLength,
}


def fields_beside(kind: type, place: tuple[Any, ...]) -> Iterable[str]:
    """Known fields of a header or line (`kind`), for messages on unknown ones."""
    if len(place) > 1:
        kind = _INSIDE.get(place[-2], _INSIDE.get(place[0], kind))
    return kind.__dataclass_fields__


_ASKED = {"frame", "text", "target", "relation", "reference"}
_BY_NAME = ("proposals", "boxes_3d", "relations", "attributes")
"""Fields whose parts, by name or by id, may come in events of their own."""
OPEN = "no answer was recorded"
"""The problem of an expression that a trace leaves without one."""
Numbered = tuple[int, Any]
"""A line's number in the file, and its JSON."""


def joined_events(events: Iterable[Numbered], path: Path) -> Iterator[Numbered]:
    """Join events to predictions, in the order of the file, with the numbers of their first lines.

    An expression without an end keeps its proposals, and has the problem `OPEN`: the rest may be incomplete. InputError
    for a field given twice and differently names both lines.
    """
    lines: dict[tuple[str, str], Numbered] = {}
    for number, event in events:
        key = (str(event.get("frame")), str(event.get("text"))) if isinstance(event, dict) else ("", f"{number}")
        if key not in lines or event.keys() <= _ASKED:
            lines.pop(key, None)
            lines[key] = number, event
            continue
        first, line = lines[key]
        for part, value in event.items():
            known = line.get(part)
            if part in _BY_NAME and isinstance(value, dict) and isinstance(known, dict):
                both = {name: _both(known.get(name), own) for name, own in value.items()}
                wrong, value = [f"{part}.{name}" for name, own in both.items() if own is Ellipsis], known | both
            else:
                value = _both(known, value)
                wrong = [part] if value is Ellipsis else []
            told = f"of the expression that line {first} begins"
            require(not wrong, f"line {number}, {', '.join(wrong)}: told before, and otherwise, {told}", path=path)
            line[part] = value
    for number, line in lines.values():
        if isinstance(line, dict) and not {"answer", "problem"} & line.keys():
            line = {k: v for k, v in line.items() if k in _ASKED or k == "proposals"} | {"problem": OPEN}
        yield number, line


def _both(known: Any, more: Any) -> Any:
    """Field of two events: lists are joined; `...` for a contradiction."""
    if known is None or known == more:
        return more
    return [*known, *more] if isinstance(known, list) and isinstance(more, list) else ...
