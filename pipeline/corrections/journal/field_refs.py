"""What can be corrected: a cell is one field of one entity of a frame, and each field has its kind of value."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection
from functools import lru_cache, partial
from typing import Any, Literal

import numpy as np

from pipeline.diagnosis.marks import MARKS
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import run_lengths
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import letter
from pipeline.system.errors import InputError, Shown, as_input_error, require
from pipeline.system.frozen import dataclass

Kind = Literal["object", "relation", "expression", "frame", "review"]
KINDS: tuple[Kind, ...] = ("object", "relation", "expression", "frame", "review")
OF_ALL = ""
"""Stands for the author in the key of a judgement that is not one person's: see `corrections.journal.replay`."""
STATUSES = ("accepted", "corrected", "rejected", "unsure")
"""What a reviewer says of something; null is unreviewed. A rejected object or expression is left out."""
FIRST_NEW_OBJECT = 10_000
"""Objects that people add are numbered from here, so that labels made again never take their numbers."""
LONGEST_NAME, LONGEST_TEXT = 200, 2_000
TOLERANCE = 1e-6


@dataclass(frozen=True, order=True)
class FieldRef:
    """Field of an entity of a frame: the cell that is locked, versioned and corrected as one.

    `key` is an object's number, "a,b" of a relation, an expression's id, "" of a frame, and of a judgement the JSON of
    [author, kind, a, b, what] (see `corrections.journal.replay`).
    """

    kind: Kind  # object, relation, expression, frame or review
    frame: str  # Id of the frame
    key: str  # Number of an object, "a,b" of a relation, id of an expression, empty for a frame
    field: str  # What was changed of it

    def __post_init__(self) -> None:
        # A frame has thousands of cells, of which each is named again and again.
        texts = all(type(part) is str for part in (self.kind, self.frame, self.key, self.field))
        (_check_ref if texts else _check_ref.__wrapped__)(self.kind, self.frame, self.key, self.field)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Objects named by the key."""
        if self.kind == "review":
            _, kind, a, b, _ = judged_item(self.key)
            return tuple(n for n in (a, b) if n is not None and n >= 0 and kind != "expression")
        return tuple(map(int, self.key.split(","))) if self.kind in ("object", "relation") else ()

    @property
    def entity(self) -> str:
        """Entity in words: "object 3", "relation 2,5 left"."""
        if self.kind == "review":
            _, kind, a, b, what = judged_item(self.key)
            ends = "" if kind == "expression" else f"{a}" if b is None else f"{a},{b}"
            return " ".join(filter(None, (kind, ends, what)))
        return f"{self.kind} {self.key}".rstrip()

    def __str__(self) -> str:
        return f"{self.field} of {self.entity} in {self.frame}"


@lru_cache(maxsize=1 << 14)
def _check_ref(kind: Kind, frame: str, key: str, field: str) -> None:
    require(kind in KINDS, "no such kind of entity", got=repr(kind), expected=" | ".join(KINDS))
    if field not in FIELDS[kind]:
        expected = ", ".join(FIELDS[kind])
        raise InputError(f"a {kind} has no such field", got=repr(field)[:60], expected=expected)
    plain_text(frame, "the frame's id", LONGEST_TEXT)
    if kind in ("object", "relation"):
        numbers = key.split(",")
        require(
            len(numbers) == (2 if kind == "relation" else 1) and all(map(_is_number, numbers)),
            f"not the key of a {kind}",
            got=Shown(key),
        )
    elif kind == "review":
        require(
            (judged_item(key)[0] == OF_ALL) == (field == "settled"),
            "what is said has an author, what is settled has none",
            got=Shown(key),
        )
    elif (kind == "frame") != (key == "") or len(key) > LONGEST_NAME:
        raise InputError(f"not the key of a {kind}", got=repr(key)[:60])


def object_ref(frame: str, number: int, field: str) -> FieldRef:
    """Cell of an object.

    >>> str(object_ref("kitchen/0", 3, "label"))
    'label of object 3 in kitchen/0'
    """
    return FieldRef("object", frame, str(int(number)), field)


def relation_ref(frame: str, a: int, b: int, relation: str) -> FieldRef:
    """Cell of a relation of an ordered pair.

    >>> str(relation_ref("kitchen/0", 3, 5, "left"))
    'left of relation 3,5 in kitchen/0'
    """
    return FieldRef("relation", frame, f"{int(a)},{int(b)}", relation)


def judged_item(key: str) -> tuple[str, str, int, int | None, str]:
    """Parse the key of a judgement to author, kind, a, b and what; InputError for any other text."""
    return (_judged_item if type(key) is str else _judged_item.__wrapped__)(key)


@lru_cache(maxsize=1 << 12)
def _judged_item(key: str) -> tuple[str, str, int, int | None, str]:
    with as_input_error("not the key of a review", ValueError, TypeError, RecursionError, got=Shown(key)):
        author, kind, a, b, what = found = json.loads(key)
        written = judged_key(*found)
    texts = kind in ("object", "relation", "expression") and isinstance(author, str) and isinstance(what, str)
    numbers = type(a) is int and (b is None or type(b) is int) and -1 <= a < 2**31 and -1 <= (b or 0) < 2**31
    require(texts and numbers and written == key, "not the key of a review", got=Shown(key))
    if author != OF_ALL:
        plain_text(author, "an author", LONGEST_NAME)
    require(
        kind != "relation" or (what in PAIRWISE and b is not None and min(a, b) >= 0),
        "not the key of a relation's review",
        got=Shown(key),
    )
    if what:
        plain_text(what, "what is judged", LONGEST_NAME)
    return author, kind, a, b, what


def judged_key(author: str, kind: str, a: int, b: int | None, what: str) -> str:
    """Make the key of a judgement."""
    return json.dumps([author, kind, a, b, what], ensure_ascii=False, separators=(",", ":"))


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 10 and str(int(text)) == text and int(text) < 2**31


def plain_text(value: Any, what: str, longest: int) -> str:
    """Check a text for any database; InputError for an empty or long text, or no characters."""
    require(isinstance(value, str) and value.strip(), f"{what} must be a text that is not empty", got=Shown(value))
    require(len(value) <= longest, f"{what} is too long", got=f"{len(value)} characters", expected=f"at most {longest}")
    if "\x00" in value or any("\ud800" <= c <= "\udfff" for c in value):
        raise InputError(f"{what} holds a character that cannot be kept", got=ascii(value)[:60])
    return value


def checked(ref: FieldRef, value: Any) -> Any:
    """Check a cell's value, with plain numbers; InputError for no value of the field."""
    return None if value is None and ref.field in _NULLABLE[ref.kind] else FIELDS[ref.kind][ref.field](value)


def same_value(a: Any, b: Any) -> bool:
    """Compare two values, numbers to within rounding.

    >>> same_value([1, 2.0], [1.0, 2]), same_value(True, 1)
    (True, False)
    """
    if a is b:
        return True
    if isinstance(a, bool) or isinstance(b, bool):
        return False
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
    if isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
        return len(a) == len(b) and all(map(same_value, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same_value(a[k], b[k]) for k in a)
    return a == b


def shown_value(ref: FieldRef, value: Any) -> str:
    """Word a value for messages and lists."""
    if value is None:
        return "nothing"
    if ref.kind == "relation" and ref.field in PAIRWISE:
        return letter(value)
    if ref.field == "mask":
        runs = run_lengths(value)
        return "a mask" if isinstance(runs, str) else f"a mask ({int(runs[1::2].sum())} pixels)"
    if ref.kind == "review":
        state = value.get("value")
        return value["status"] if state is None else f"{value['status']}: {letter(state)}"
    if ref.field == "exists":
        return f"a new {value['label']}" if ref.kind == "object" else f"“{value['text']}” is true"
    if ref.field == "box":
        middle, size = (" ".join(f"{x:.3f}" for x in value[n]) for n in ("center", "size"))
        # Seen from the camera: what is up is not known here.
        turn = math.degrees(math.atan2(value["R"][6], value["R"][0]))
        return f"a box at {middle}, size {size}, turned {turn:.0f} deg"
    return str(value) if len(str(value)) <= 60 else f"{str(value)[:57]}..."


def box_value(box: Box3D) -> dict[str, list[float]]:
    """JSON value of a 3D box."""
    return {"center": box.center.tolist(), "R": box.R.ravel().tolist(), "size": box.size.tolist()}


def box_of(value: Any) -> Box3D:
    """3D box of a JSON value; InputError for none."""
    with as_input_error(
        "a 3D box must have center, R and size", LookupError, TypeError, ValueError, OverflowError, got=Shown(value)
    ):
        center, R, size = (np.array(value[n], np.float64) for n in ("center", "R", "size"))
        shaped = R.reshape(3, 3)
    return Box3D(center, shaped, size)


_name = partial(plain_text, what="a class name", longest=LONGEST_NAME)
_sentence = partial(plain_text, what="a text", longest=LONGEST_TEXT)


def _one_of(what: str, allowed: Collection[str]) -> Callable[[Any], str]:
    def check(value: Any) -> str:
        require(value in allowed, f"no such {what}", got=repr(value)[:60], expected=" | ".join(allowed))
        return value

    return check


_status = _one_of("status", STATUSES)


def _judgement(value: Any) -> dict[str, Any]:
    require(
        isinstance(value, dict) and not set(value) - {"status", "value"} and "status" in value,
        "a judgement has a status, and of a relation a value",
        got=Shown(value),
    )
    state = value.get("value")
    return {"status": _status(value["status"]), "value": None if state is None else _state(state)}


def _mark(value: Any) -> str:
    return _one_of("mark", MARKS)(value)


def _flag(value: Any) -> bool:
    require(isinstance(value, bool), "must be true or false", got=repr(value)[:60])
    return value


def _state(value: Any) -> int:
    require(
        not isinstance(value, bool) and value in (-1, 0, 1),
        "no such state",
        got=Shown(value),
        expected="1 (T), 0 (U) or -1 (F)",
    )
    return int(value)


def _numbers(value: Any) -> list[int]:
    sound = isinstance(value, (list, tuple)) and all(isinstance(n, int) and not isinstance(n, bool) for n in value)
    require(
        sound and min(value, default=0) >= 0 and max(value, default=0) < 2**31,
        "must be a list of numbers of objects",
        got=Shown(value),
    )
    return sorted({int(n) for n in value})


def _number(value: Any) -> int:
    return _numbers([value])[0]


def _rectangle(value: Any) -> list[float]:
    with as_input_error("a 2D box must be four numbers", TypeError, ValueError, OverflowError, got=Shown(value)):
        box = [float(x) for x in value]
    require(
        len(box) == 4 and all(map(math.isfinite, box)) and box[2] > box[0] and box[3] > box[1],
        "a 2D box must be x0 y0 x1 y1 with x1 > x0 and y1 > y0",
        got=Shown(value),
    )
    return box


def _mask(value: Any) -> str:
    problem = run_lengths(value) if isinstance(value, str) else "it is no text"
    require(not isinstance(problem, str), "not COCO's compressed run-length code of a mask", got=problem)
    return value


def _box(value: Any) -> dict[str, list[float]]:
    return box_value(box_of(value))


def _new_object(value: Any) -> dict[str, Any]:
    require(
        isinstance(value, dict) and not set(value) - {"label", "mask", "bbox", "box", "instance"},
        "a new object has a label and a mask, a 2D box or a 3D box",
        got=Shown(value),
    )
    found: dict[str, Any] = {"label": _name(value.get("label"))}
    for name, check in (("mask", _mask), ("bbox", _rectangle), ("box", _box)):
        if value.get(name) is not None:
            found[name] = check(value[name])
    require(len(found) > 1, "a new object needs a mask, a 2D box or a 3D box")
    if value.get("instance") is not None:
        number = value["instance"]
        known = isinstance(number, int) and not isinstance(number, bool) and 0 <= number < 2**31
        require(known, "an instance is a number of the scene's objects", got=Shown(number))
        found["instance"] = number
    return found


_SENTENCE = {
    "text": _sentence,
    "target": _name,
    "relation": _one_of("relation", PAIRWISE),
    "reference": _name,
    "target_object": _number,
    "reference_object": _number,
    "targets": _numbers,
    "acceptable": _numbers,
}


def _new_sentence(value: Any) -> dict[str, Any]:
    require(
        isinstance(value, dict) and value.keys() == _SENTENCE.keys(),
        "a new expression has what labels say of one",
        got=Shown(value),
        expected=", ".join(_SENTENCE),
    )
    return {name: check(value[name]) for name, check in _SENTENCE.items()}


FIELDS: dict[Kind, dict[str, Callable[[Any], Any]]] = {
    "object": {
        "label": _name,
        "status": _status,
        "mask": _mask,
        "bbox": _rectangle,
        "box": _box,
        "exists": _new_object,
    },
    "relation": {**dict.fromkeys(PAIRWISE, _state), **{f"{r}.status": _status for r in PAIRWISE}},
    "expression": {
        "text": _sentence,
        "targets": _numbers,
        "acceptable": _numbers,
        "ambiguous": _flag,
        "mark": _mark,
        "status": _status,
        "exists": _new_sentence,
    },
    "frame": {"status": _status, "note": _sentence},
    "review": {"said": _judgement, "settled": _judgement},
}
"""What checks a value, by kind of entity and field."""
_NULLABLE: dict[Kind, frozenset[str]] = {
    "object": frozenset({"status", "mask", "box", "exists"}),
    "relation": frozenset({*PAIRWISE, *(f"{r}.status" for r in PAIRWISE)}),
    "expression": frozenset({"mark", "status", "exists"}),
    "frame": frozenset({"status", "note"}),
    "review": frozenset({"said", "settled"}),
}
