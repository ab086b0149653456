"""Corrections in JSON lines: rows as `export --format jsonl` writes them, with some of their keys or all.

A key that is absent says nothing; `base` is then that of the rows before. `frame`
must be there, and what names the row:
`object`; `a` and `b`; `id`. A row of objects whose `object` is absent or null is a
new one: `label`, and `mask`, `bbox`, or `center`, `R` and `size`.

The two other files of a COCO export, `refs.json` and `relations.json`, are read
here, too. Both name annotations: `instances.json` of the same export must stand
beside them, and say of which object each is.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.effective_frame import BOX_COLUMNS, EffectiveFrame, Row
from pipeline.corrections.journal.field_refs import FieldRef, object_ref, relation_ref, same_value
from pipeline.corrections.journal.incoming.coco_file import (
    base_of,
    entries,
    images_of,
    listed,
    no_number,
    number_of,
)
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
Annotations = dict[int, tuple[str, int]]
"""Frame and object of annotations, by id."""


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
        with claims.reading(where):
            kind = table or _table(row)
            frame = _frame(row, claims)
            name = hash((kind, frame, *(str(row.get(key)) for key in ("object", "a", "b", "id"))))
            new = kind == "objects" and row.get("object") is None
            require(new or name not in twice, "the second row of the same")
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
                claims.say_fields(where, row, FieldRef("frame", frame, "", "status"), ("status", "note"), state)
    if reject_deleted:
        for frame, (numbers, state) in seen.items():
            claims.say_deleted(f"{path.name}, frame {frame}", frame, numbers, state)


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


def _object(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims, seen: set[int]) -> None:
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
    seen.add(number)
    claims.say_fields(where, row, object_ref(frame, number, "label"), ("label", "status"), state)
    if "mask" in row and not same_mask(row["mask"], was["mask"], base.size):
        claims.say(where, object_ref(frame, number, "mask"), row["mask"], state)
    claims.say_fields(where, row, object_ref(frame, number, "bbox"), ("bbox",), state)
    if box != {}:
        claims.say(where, object_ref(frame, number, "box"), box, state)
    _ignore(row, was, {"label", "mask", "bbox", *BOX_COLUMNS}, claims)


def same_mask(code: Any, was: str | None, size: tuple[int, int]) -> bool:
    """Whether two codes are of the same pixels; one that is none is of no others."""
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
    """The state of a relation; one that the labels do not hold may be there as it was exported."""
    # Nearly all of an export's cells are as they were: only one that is not gets a reference.
    if value == base.pairs.state(*cell) and type(value) in (int, type(None)):
        return
    require(cell[2] in base.setting.relations, f"the labels hold no relation {cell[2]!r}")
    claims.say(where, relation_ref(base.frame, *cell), value, state)


def _entries(listed: Any) -> list[Any]:
    return listed if isinstance(listed, list) else [None]


def _statuses(listed: Any, relations: tuple[str, ...]) -> dict[str, Any]:
    found = {}
    for entry in _entries(listed):
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


def annotated(instances: Any, name: str, claims: Claims) -> tuple[dict[int, str], Annotations, Any]:
    """Frames by image, objects by annotation, and the state that `info` names.

    Raises
    ------
    InputError
        No COCO, or annotations that do not say which object they are of.
    """
    frames = images_of(listed(instances, "images", name), name, claims)
    found: Annotations = {}
    for row in listed(instances, "annotations", name):
        number = number_of(row) if isinstance(row, dict) else None
        whole = isinstance(row, dict) and all(type(row.get(key)) is int for key in ("id", "image_id"))
        if number is not None and whole and row["image_id"] in frames:
            found[row["id"]] = frames[row["image_id"]], number
    return frames, found, base_of(instances)


def read_refs(
    refs: Any, name: str, frames: dict[int, str], annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    """Read `refs.json`: sentences, answers, marks and statuses."""
    require(isinstance(refs, list), f"{name} is a list", got=type(refs).__name__)
    seen: set[tuple[str, str]] = set()
    for where, ref in entries(refs, f"{name} ref", "ref_id"):
        with claims.reading(where):
            require(
                isinstance(ref, dict) and type(ref.get("image_id")) is int and ref["image_id"] in frames,
                "it is of no image that instances.json lists",
            )
            frame = frames[ref["image_id"]]
            own: Any = ref.get("id")
            require(
                isinstance(own, str) and own in claims.states.frame(frame, state).auto.expressions,
                f"frame {frame} has no such expression",
                got=Shown(own),
            )
            require((frame, own) not in seen, "the second one of its expression")
            seen.add((frame, own))
            claims.compared += 1
            if "sentences" in ref:
                claims.say(where, FieldRef("expression", frame, own, "text"), _raw(ref["sentences"]), state)
            for key, field in (("target_ann_ids", "targets"), ("acceptable_ann_ids", "acceptable")):
                if key in ref:
                    claims.say(
                        where,
                        FieldRef("expression", frame, own, field),
                        _objects(ref[key], frame, annotations, key),
                        state,
                    )
            claims.say_fields(
                where, ref, FieldRef("expression", frame, own, "mark"), ("ambiguous", "mark", "status"), state
            )


def _raw(sentences: Any) -> Any:
    first: Any = sentences[0] if isinstance(sentences, list) and sentences else None
    require(isinstance(first, dict), "sentences is a list of sentences", got=Shown(sentences, 40))
    return first.get("raw")


def _objects(ids: Any, frame: str, annotations: Annotations, what: str) -> list[int]:
    require(
        isinstance(ids, list) and all(type(n) is int for n in ids),
        f"{what} is a list of annotations",
        got=Shown(ids, 40),
    )
    for n in ids:
        require(
            annotations.get(n, ("", 0))[0] == frame,
            f"{what} names annotation {n}, which instances.json does not give an object of this image",
        )
    return [annotations[n][1] for n in ids]


def read_relations(
    content: Any, name: str, frames: dict[int, str], annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    """Read `relations.json`: the columns of states."""
    seen: set[int] = set()
    for where, image in entries(listed(content, "images", name), f"{name} image", "image_id"):
        with claims.reading(where):
            require(isinstance(image, dict) and type(image.get("image_id")) is int, "it has no image_id")
            require(
                image["image_id"] in frames and image["image_id"] not in seen,
                "it is of no image that instances.json lists, or of one a second time",
            )
            seen.add(image["image_id"])
            _columns(image, where, frames[image["image_id"]], annotations, state, claims)


def _columns(
    image: dict[str, Any], where: str, frame: str, annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    a, b = (_objects(image.get(end), frame, annotations, end) for end in ("a", "b"))
    base = claims.states.frame(frame, state)
    relations = [r for r in PAIRWISE if r in image]
    for relation in relations:
        sound = isinstance(image[relation], list) and len(image[relation]) == len(a)
        require(sound, f"the column {relation!r} has not one state a pair")
    sound = len(a) == len(b) and len(set(zip(a, b, strict=True))) == len(a)
    require(sound, "the columns a and b do not give each pair once")
    claims.compared += len(a)
    for m, n in zip(a, b, strict=True):
        check_pair(base, m, n)
    for relation in relations:
        for m, n, value in zip(a, b, image[relation], strict=True):
            _state(f"{where}, pair {m},{n}", base, (m, n, relation), value, state, claims)
    if "statuses" in image:
        _pair_statuses(image["statuses"], where, frame, annotations, state, claims)


def _pair_statuses(
    statuses: Any, where: str, frame: str, annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    base = claims.states.frame(frame, state)
    found: dict[Any, Any] = {}
    for entry in _entries(statuses):
        require(
            isinstance(entry, dict) and entry.get("relation") in base.setting.relations,
            "statuses is a list of {a, b, relation, status}",
            got=Shown(entry),
        )
        m, n = _objects([entry.get("a"), entry.get("b")], frame, annotations, "statuses")
        found[relation_ref(frame, m, n, f"{entry['relation']}.status")] = entry.get("status")
    # One that was exported and is not listed any more was taken off.
    gone = [c for c in base.statuses if c.kind == "relation" and c not in found]
    for ref, status in (*found.items(), *((c, None) for c in gone)):
        claims.say(where, ref, status, state)
