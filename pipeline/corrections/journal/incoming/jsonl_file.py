"""Corrections in JSON lines: rows as `export --format jsonl` writes them, with some of their keys or all.

A key that is absent says nothing; `base` is then that of the rows before. `frame`
must be there, and what names the row:
`object`; `a` and `b`; `id`. A row of objects whose `object` is absent or null is a
new one: `label`, and `mask`, `bbox`, or `center`, `R` and `size`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.effective_objects import BOX_COLUMNS
from pipeline.corrections.journal.field_refs import FieldRef, object_cell, relation_cell, same_value
from pipeline.corrections.journal.incoming.claims import Claims
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.exports.jsonl import BLOCK
from pipeline.labels.exports.provenance import ExportedFrom
from pipeline.labels.schema import TABLES
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError

Row = dict[str, Any]
StateOf = Callable[[Any], ExportedFrom]
"""The state that a row's `base` names; InputError where it is not to be used."""
_TEXTS = ("text", "targets", "acceptable", "ambiguous", "status", "mark")
_BESIDE = {"frame", "frame_index", "base", "made_by", "provenance"}


def read_lines(path: Path, claims: Claims, state_of: StateOf, *, reject_deleted: bool) -> None:
    """Read one file of rows, of one table or of several.

    Raises
    ------
    InputError
        The file cannot be read, holds no text, or comes from a state of the labels that is not known here.
    """
    table = path.stem if path.stem in TABLES else None
    seen: dict[str, tuple[set[int], ExportedFrom]] = {}
    twice: set[int] = set()
    stated: Any = None
    for where, row in _rows(path, claims):
        stated = row.get("base") or stated
        try:
            # What cannot be compared at all is not told line by line.
            state = state_of(stated)
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        try:
            kind = table or _table(row)
            frame = _frame(row, claims)
            name = hash((kind, frame, *(str(row.get(key)) for key in ("object", "a", "b", "id"))))
            if name in twice and not (kind == "objects" and row.get("object") is None):
                raise InputError("the second row of the same")
            twice.add(name)
            claims.compared += 1
            if kind == "objects":
                numbers, _ = seen.setdefault(frame, (set(), state))
                _object(where, row, frame, state, claims, numbers)
            elif kind == "relations":
                _relation(where, row, frame, state, claims)
            elif kind == "expressions":
                _expression(where, row, frame, state, claims)
            else:
                for field in ("status", "note"):
                    if field in row:
                        claims.say(where, FieldRef("frame", frame, "", field), row[field], state)
        except InputError as error:
            claims.problem(where, error)
    if reject_deleted:
        for frame, (numbers, state) in seen.items():
            claims.say_deleted(f"{path.name}, frame {frame}", frame, numbers, state)


def _rows(path: Path, claims: Claims) -> Iterator[tuple[str, Row]]:
    try:
        with open(path, encoding="utf-8", newline="\n") as file:
            number = 0
            while line := file.readline(BLOCK):
                number += 1
                where = f"{path.name} line {number}"
                if len(line) == BLOCK:
                    raise InputError(f"line {number} is too long", expected=f"at most {BLOCK} characters", path=path)
                if not line.strip():
                    continue
                try:
                    row = json.loads(line, parse_constant=_no_number)
                except (ValueError, RecursionError) as error:
                    claims.problem(where, f"not JSON: {str(error)[:80]}")
                    continue
                if isinstance(row, dict):
                    yield where, row
                else:
                    claims.problem(where, f"a row is an object of JSON, got {type(row).__name__}")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("the file cannot be read", got=str(error)[:100], path=path) from error


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _table(row: Row) -> str:
    if "a" in row and "b" in row:
        return "relations"
    if "id" in row:
        return "expressions"
    return "objects" if "object" in row or "label" in row else "frames"


def _frame(row: Row, claims: Claims) -> str:
    frame = row.get("frame")
    if not isinstance(frame, str) or frame not in claims.states:
        raise InputError("the labels have no such frame", got=repr(frame)[:60])
    known = claims.states.index_of(frame)
    if row.get("frame_index", known) != known:
        raise InputError("frame_index is of another frame", got=repr(row["frame_index"])[:20], expected=known)
    return frame


def _number(row: Row, key: str) -> int:
    value = row.get(key)
    if type(value) is not int or not 0 <= value < 2**31:
        raise InputError(f"{key} must be the number of an object", got=repr(value)[:40])
    return value


def _object(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims, seen: set[int]) -> None:
    base = claims.base(frame, state)
    box = {key: row[key] for key in BOX_COLUMNS if key in row}
    if box and len(box) < len(BOX_COLUMNS):
        raise InputError("a 3D box is center, R and size", got=", ".join(box))
    if any(v is None for v in box.values()):
        if any(v is not None for v in box.values()):
            raise InputError("a 3D box is center, R and size", cause="some of them are null")
        box = None if box else {}
    if row.get("object") is None:
        seed = {key: row[key] for key in ("label", "mask", "bbox") if row.get(key) is not None}
        claims.say_new(where, frame, seed | ({"box": box} if box else {}), state)
        return
    number = _number(row, "object")
    was = base.objects.get(number) or base.left_out.get(number)
    if was is None:
        raise InputError(f"frame {frame} had no object {number}", cause="a new one has no number")
    seen.add(number)
    for field in ("label", "status"):
        if field in row:
            claims.say(where, object_cell(frame, number, field), row[field], state)
    if "mask" in row and not same_mask(row["mask"], was["mask"], (base.row["height"], base.row["width"])):
        claims.say(where, object_cell(frame, number, "mask"), row["mask"], state)
    if "bbox" in row:
        claims.say(where, object_cell(frame, number, "bbox"), row["bbox"], state)
    if box != {}:
        claims.say(where, object_cell(frame, number, "box"), box, state)
    _ignore(row, was, {"label", "mask", "bbox", *BOX_COLUMNS}, claims)


def same_mask(code: Any, was: str | None, size: tuple[int, int]) -> bool:
    """Whether two codes are of the same pixels; one that is none is of no others."""
    if code == was:
        return True
    if not isinstance(code, str) or was is None:
        return False
    try:
        return bool((decode_run_length(size, code) == decode_run_length(size, was)).all())
    except InputError:
        return False


def check_pair(base: EffectiveFrame, a: int, b: int) -> None:
    """Refuse a pair that the export cannot have had."""
    if a == b:
        raise InputError("an object has no relation to itself", got=a)
    for number in (a, b):
        if base.pairs.place(number) is None:
            raise InputError(f"frame {base.frame} had no object {number} that takes part in relations")


def _relation(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    a, b = _number(row, "a"), _number(row, "b")
    base = claims.base(frame, state)
    check_pair(base, a, b)
    relations = base.setting.relations
    for relation in PAIRWISE:
        if relation not in row:
            continue
        said = row[relation]
        if said == base.pairs.state(a, b, relation) and type(said) in (int, type(None)):
            continue
        if relation not in relations:
            raise InputError(f"the labels hold no relation {relation!r}")
        claims.say(where, relation_cell(frame, a, b, relation), said, state)
    if "statuses" in row:
        statuses = _statuses(row["statuses"], relations)
        for relation in relations:
            claims.say(where, relation_cell(frame, a, b, f"{relation}.status"), statuses.get(relation), state)


def _statuses(listed: Any, relations: tuple[str, ...]) -> dict[str, Any]:
    found = {}
    for entry in listed if isinstance(listed, list) else [None]:
        if not isinstance(entry, dict) or entry.get("relation") not in relations:
            raise InputError('statuses is a list of {"relation": ..., "status": ...}', got=repr(listed)[:60])
        found[entry["relation"]] = entry.get("status")
    return found


def _expression(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    name, base = row.get("id"), claims.base(frame, state)
    if not isinstance(name, str) or name not in base.auto.expressions:
        raise InputError(f"frame {frame} has no such expression", got=repr(name)[:60])
    for field in _TEXTS:
        if field in row:
            claims.say(where, FieldRef("expression", frame, name, field), row[field], state)
    _ignore(row, base.expressions.get(name, base.auto.expressions[name]), set(_TEXTS), claims)


def _ignore(row: Row, was: Row, corrected: set[str], claims: Claims) -> None:
    for column in (row.keys() & was.keys()) - corrected - _BESIDE:
        if not same_value(row[column], was[column]):
            claims.ignored[column] += 1
