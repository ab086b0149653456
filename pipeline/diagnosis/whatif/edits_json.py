"""Edits as JSON: read without trust, written so that reading gives the same edits exactly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.diagnosis.whatif.edits import Edits, PlacedBox, RunLengthMask
from pipeline.diagnosis.whatif.settings_check import checked_lift, checked_profile, checked_rank
from pipeline.system.errors import InputError

Record = dict[str, Any]
M = TypeVar("M", bound=BaseModel)

FORMAT = "spatialviz-edits-1"
MOST_EDITS = 2000
"""Of one kind; a page cannot make more by hand."""
LARGEST_FILE = 32 * 2**20
_FAR = 1000.0
_LARGEST_SIDE = 16384

Key = Annotated[str, Field(min_length=1, max_length=300)]
Number = Annotated[float, Field(ge=-_FAR, le=_FAR)]
Length = Annotated[float, Field(ge=0, le=_FAR)]
Share = Annotated[float, Field(ge=0, le=1)]
Side = Annotated[int, Field(ge=1, le=_LARGEST_SIDE)]
Axis = tuple[Number, Number, Number]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Box(_Strict):
    center: tuple[Number, Number, Number]
    R: tuple[Axis, Axis, Axis]
    size: tuple[Length, Length, Length]


class _Mask(_Strict):
    size: tuple[Side, Side]
    counts: Annotated[str, Field(max_length=4 * 2**20)]


class _Confidence(_Strict):
    name: Key
    object: Key
    p: Share


class _Relation(_Strict):
    relation: Key
    a: Key
    b: Key
    p: Share


class EditsModel(_Strict):
    """Edits as they stand in a file or in a view's state."""

    format: Literal["spatialviz-edits-1"] = FORMAT
    boxes: Annotated[dict[Key, _Box], Field(max_length=MOST_EDITS)] = {}
    masks: Annotated[dict[Key, _Mask], Field(max_length=MOST_EDITS)] = {}
    hidden: Annotated[list[Key], Field(max_length=MOST_EDITS)] = []
    confidences: Annotated[list[_Confidence], Field(max_length=MOST_EDITS)] = []
    relations: Annotated[list[_Relation], Field(max_length=MOST_EDITS)] = []
    k: Annotated[int, Field(ge=1, le=100_000)] | None = None
    min_score: Share | None = None
    rank: dict[str, Any] = {}
    profile: dict[str, Any] = {}
    lift: dict[str, Any] = {}
    scorer: Annotated[str, Field(min_length=1, max_length=4096)] | None = None

    def edits(self) -> Edits:
        """The same, checked in what the fields alone do not say."""
        boxes = {key: PlacedBox(b.center, b.R, b.size) for key, b in self.boxes.items()}
        for box in boxes.values():
            box.box()
        confidences = {(c.name, c.object): c.p for c in self.confidences}
        relations = {(r.relation, r.a, r.b): r.p for r in self.relations}
        if len(confidences) < len(self.confidences) or len(relations) < len(self.relations):
            raise InputError("the edits give one and the same probability twice")
        same = next((r for r in self.relations if r.a == r.b), None)
        if same is not None:
            raise InputError("a relation is between two objects", got=f"{same.a} twice")
        return Edits(
            boxes=boxes,
            masks={key: RunLengthMask(m.size, m.counts) for key, m in self.masks.items()},
            hidden=frozenset(self.hidden),
            confidences=confidences,
            relations=relations,
            k=self.k,
            min_score=self.min_score,
            rank=checked_rank(self.rank),
            profile=checked_profile(self.profile),
            lift=checked_lift(self.lift),
            scorer=self.scorer,
        )


def edits_record(edits: Edits) -> Record:
    """Edits as a JSON object; what is not edited is left out."""
    record: Record = {
        "format": FORMAT,
        "boxes": {
            key: {"center": list(b.center), "R": [list(row) for row in b.R], "size": list(b.size)}
            for key, b in sorted(edits.boxes.items())
        },
        "masks": {key: {"size": list(m.size), "counts": m.counts} for key, m in sorted(edits.masks.items())},
        "hidden": sorted(edits.hidden),
        "confidences": [{"name": n, "object": key, "p": p} for (n, key), p in sorted(edits.confidences.items())],
        "relations": [{"relation": r, "a": a, "b": b, "p": p} for (r, a, b), p in sorted(edits.relations.items())],
        "k": edits.k,
        "min_score": edits.min_score,
        **{
            name: {k: list(v) if isinstance(v, tuple) else v for k, v in sorted(getattr(edits, name).items())}
            for name in ("rank", "profile", "lift")
        },
        "scorer": edits.scorer,
    }
    return {name: value for name, value in record.items() if value not in (None, {}, [])}


def read_edits(record: Record | str | bytes) -> Edits:
    """Edits from a JSON object, or from the text of one.

    Raises
    ------
    InputError
        It is not JSON, has an unknown field, or a value out of range.
    """
    return validated(EditsModel, record, "the edits").edits()


def load_edits(path: str | Path) -> Edits:
    """Edits from a file; InputError where it cannot be read or holds none."""
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError("the file of edits is too large", expected=f"at most {LARGEST_FILE} bytes", path=path)
        text = path.read_bytes()
    except OSError as error:
        raise InputError("the edits cannot be read", got=error.strerror, path=path) from error
    try:
        return read_edits(text)
    except InputError as error:
        raise InputError(str(error), path=path) from error


def validated(model: type[M], record: Record | str | bytes, what: str) -> M:
    """A JSON object, or the text of one, as a model; InputError in one line where it is none."""
    try:
        value = json.loads(record) if isinstance(record, str | bytes) else record
        # Once more through JSON: infinities (1e999) and what is not JSON end here.
        text = json.dumps(value, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{what} cannot be read as JSON", got=str(error)[:120]) from error
    try:
        return model.model_validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(p)[:60] for p in first["loc"])
        where = f"{what}: {place}" if place else what
        if first["type"] == "extra_forbidden":
            fields = ", ".join(model.model_fields) if len(first["loc"]) == 1 else None
            raise InputError(f"{what}: there is no field {place!r}", expected=fields) from error
        raise InputError(f"{where} cannot be this", got=repr(first["input"])[:80], expected=first["msg"]) from error
