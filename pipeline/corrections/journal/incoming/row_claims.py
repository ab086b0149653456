"""Corrections in JSON lines: rows as `export --format jsonl` writes them, with some of their keys or all.

A key that is absent says nothing; `base` is then that of the rows before. `frame`
must be there, and what names the row:
`object`; `a` and `b`; `id`. A row of objects whose `object` is absent or null is a
new one: `label`, and `mask`, `bbox`, or `center`, `R` and `size`.

Those of COCO are taken as such rows: see `coco_file`.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef, object_ref, relation_ref, same_value
from pipeline.corrections.journal.frame_rows import BOX_COLUMNS, Row
from pipeline.corrections.journal.incoming.states import Claims
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.exports.exporting import BLOCK
from pipeline.labels.exports.row_provenance import ExportedFrom
from pipeline.labels.schema import TABLES
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError, Shown, as_input_error, needed, require
from pipeline.system.safe_files import opened, parse_json

StateOf = Callable[[Any], ExportedFrom]
"""The state that a row's `base` names; InputError where it is not to be used."""
_TEXTS = ("text", "targets", "acceptable", "ambiguous", "status", "mark")
_CONTEXT = {"frame", "frame_index", "base", "made_by", "provenance"}


def read_lines(path: Path, claims: Claims, state_of: StateOf, *, reject_deleted: bool) -> None:
    """Read a file of rows of one table or several; InputError for an unreadable file or an unknown state."""
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
        with claims.reading(where):
            kind = table or _table(row)
            frame = _frame(row, claims)
            name = hash((kind, frame, *(str(row.get(key)) for key in ("object", "a", "b", "id"))))
            new = kind == "objects" and row.get("object") is None
            require(new or name not in twice, "the second row of the same")
            twice.add(name)
            if kind == "objects" and not new:
                seen.setdefault(frame, (set(), state))[0].add(_number(row, "object"))
            take_row(kind, where, row, frame, state, claims)
    if reject_deleted:
        for frame, (numbers, state) in seen.items():
            claims.say_deleted(f"{path.name}, frame {frame}", frame, numbers, state)


def take_row(kind: str, where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    """Compare a row of a table with the exported state; InputError where impossible."""
    claims.compared += 1
    if kind == "objects":
        _object(where, row, frame, state, claims)
    elif kind == "relations":
        _relation(where, row, frame, state, claims)
    elif kind == "expressions":
        _expression(where, row, frame, state, claims)
    else:
        claims.say_fields(where, row, FieldRef("frame", frame, "", "status"), ("status", "note"), state)


def _rows(path: Path, claims: Claims) -> Iterator[tuple[str, Row]]:
    with (
        as_input_error("the file cannot be read", OSError, UnicodeDecodeError, got=lambda e: str(e)[:100], path=path),
        opened(path, "unpacked") as content,
        io.TextIOWrapper(content, encoding="utf-8", newline="\n") as file,
    ):
        number = 0
        while line := file.readline(BLOCK):
            number += 1
            where = f"{path.name} line {number}"
            require(len(line) != BLOCK, f"line {number} is too long", expected=f"at most {BLOCK} characters", path=path)
            try:
                row = parse_json(line, path, parse_constant=no_number) if line.strip() else None
            except ValueError as error:
                claims.problem(where, f"not JSON: {str(error)[:80]}")
                continue
            if isinstance(row, dict):
                yield where, row
            elif line.strip():
                claims.problem(where, f"a row is an object of JSON, got {type(row).__name__}")


def no_number(word: str) -> float:
    """Refuse NaN and infinity in JSON."""
    raise ValueError(f"{word} is no number")


def _table(row: Row) -> str:
    if "a" in row and "b" in row:
        return "relations"
    return "expressions" if "id" in row else "objects" if "object" in row or "label" in row else "frames"


def _frame(row: Row, claims: Claims) -> str:
    frame: Any = row.get("frame")
    require(
        isinstance(frame, str) and frame in claims.states.index.of_frame,
        "the labels have no such frame",
        got=Shown(frame),
    )
    known = claims.states.index.of_frame[frame]
    stated = row.get("frame_index", known)
    require(stated == known, "frame_index is of another frame", got=repr(stated)[:20], expected=known)
    return frame


def _number(row: Row, key: str) -> int:
    value: Any = row.get(key)
    require(type(value) is int and 0 <= value < 2**31, f"{key} must be the number of an object", got=Shown(value, 40))
    return value


def _object(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    base = claims.states.frame(frame, state)
    box = {key: row[key] for key in BOX_COLUMNS if key in row}
    require(len(box) in (0, len(BOX_COLUMNS)), "a 3D box is center, R and size", got=", ".join(box))
    if None in box.values():
        require(all(v is None for v in box.values()), "a 3D box is center, R and size", cause="some of them are null")
        box = None
    if row.get("object") is None:
        seed = {key: row[key] for key in ("label", "mask", "bbox") if row.get(key) is not None}
        claims.say_new(where, frame, seed | ({"box": box} if box else {}), state)
        return
    number = _number(row, "object")
    was = needed(base.object(number), f"frame {frame} had no object {number}", cause="a new one has no number")
    claims.say_fields(where, row, object_ref(frame, number, "label"), ("label", "status"), state)
    if "mask" in row and not same_mask(row["mask"], was["mask"], base.size):
        claims.say(where, object_ref(frame, number, "mask"), row["mask"], state)
    claims.say_fields(where, row, object_ref(frame, number, "bbox"), ("bbox",), state)
    if box != {}:
        claims.say(where, object_ref(frame, number, "box"), box, state)
    _ignore(row, was, {"label", "mask", "bbox", *BOX_COLUMNS}, claims)


def same_mask(code: Any, was: str | None, size: tuple[int, int]) -> bool:
    """Compare the pixels of two codes; an invalid code equals no other."""
    if code == was or not isinstance(code, str) or was is None:
        return code == was
    with suppress(InputError):
        return bool((decode_run_length(size, code) == decode_run_length(size, was)).all())
    return False


def check_pair(base: EffectiveFrame, a: int, b: int) -> None:
    """Refuse a pair that the export cannot have had."""
    require(a != b, "an object has no relation to itself", got=a)
    for number in (a, b):
        require(
            base.pairs.index_of(number) is not None,
            f"frame {base.frame} had no object {number} that takes part in relations",
        )


def _relation(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    a, b = _number(row, "a"), _number(row, "b")
    base = claims.states.frame(frame, state)
    check_pair(base, a, b)
    relations = base.setting.relations
    for relation in PAIRWISE:
        if relation in row:
            _state(where, base, (a, b, relation), row[relation], state, claims)
    if "statuses" in row:
        statuses = _statuses(row["statuses"], relations)
        had = any(ref.kind == "relation" and ref.key == f"{a},{b}" for ref in base.statuses)
        for relation in relations if statuses or had else ():
            claims.say(where, relation_ref(frame, a, b, f"{relation}.status"), statuses.get(relation), state)


def _state(
    where: str, base: EffectiveFrame, cell: tuple[int, int, str], value: Any, state: ExportedFrom, claims: Claims
) -> None:
    """Claim a changed state of a relation; unchanged states of unlabelled relations pass."""
    # Nearly all of an export's cells are as they were: only one that is not gets a reference.
    if value == base.pairs.state(*cell) and type(value) in (int, type(None)):
        return
    require(cell[2] in base.setting.relations, f"the labels hold no relation {cell[2]!r}")
    claims.say(where, relation_ref(base.frame, *cell), value, state)


def _statuses(listed: Any, relations: tuple[str, ...]) -> dict[str, Any]:
    found = {}
    entries: list[Any] = listed if isinstance(listed, list) else [None]
    for entry in entries:
        require(
            isinstance(entry, dict) and entry.get("relation") in relations,
            'statuses is a list of {"relation": ..., "status": ...}',
            got=Shown(listed),
        )
        found[entry["relation"]] = entry.get("status")
    return found


def _expression(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    name: Any = row.get("id")
    base = claims.states.frame(frame, state)
    require(
        isinstance(name, str) and name in base.auto.expressions,
        f"frame {frame} has no such expression",
        got=Shown(name),
    )
    claims.say_fields(where, row, FieldRef("expression", frame, name, "text"), _TEXTS, state)
    _ignore(row, base.expressions.get(name, base.auto.expressions[name]), set(_TEXTS), claims)


def _ignore(row: Row, was: Row, corrected: set[str], claims: Claims) -> None:
    for column in (row.keys() & was.keys()) - corrected - _CONTEXT:
        if not same_value(row[column], was[column]):
            claims.ignored[column] += 1
