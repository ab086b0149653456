"""Claims of a file: values that are not those of the state of the labels that was exported.

JSON lines are rows as `export --format jsonl` writes them, in files of its names, with some of their keys or all. A key
that is absent says nothing; `base` is then that of the rows before. `frame` must be there, and what names the row:
`object`; `a` and `b`; `id`. A row of objects whose `object` is absent or null is a new one: `label`, and `mask`,
`bbox`, or `center`, `R` and `size`. COCO files are taken as such rows: see `coco_file`.
"""

from __future__ import annotations

import hashlib
import io
import json
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import (
    FIRST_NEW_OBJECT,
    FieldRef,
    checked,
    object_ref,
    relation_ref,
    same_value,
)
from pipeline.corrections.journal.frame_rows import BOX_COLUMNS, Row
from pipeline.datasets import Dataset
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.exports.base import ExportedFrom
from pipeline.labels.exports.exporting import BLOCK
from pipeline.labels.reading import Labels
from pipeline.labels.schema import TABLES, labels_version
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError, Shown, as_input_error, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import opened, parse_json

FRAMES_KEPT = 16
_OF_PIXELS = ("mask", "bbox", "box", "exists", "label")
MOST_PROBLEMS = 1_000
"""A file with more of them is not one of ours; reading goes no further."""


class States:
    """States of labels that a journal has been through.

    `events` are all of the journal in the order of their saving; `open_dataset` gives the dataset or None, when needed.
    """

    def __init__(
        self, labels: Labels, events: Sequence[Event], open_dataset: Callable[[], Dataset | None] | None = None
    ) -> None:
        self.labels = labels
        self.version = labels_version(labels.manifest)
        self._events = grouped(events, lambda e: e.ref.frame)
        self._id_of = {e.ulid: e.id for e in events}
        self._pixels = any(e.ref.kind == "object" and e.ref.field in _OF_PIXELS for e in events)
        self._bare = Corrector(labels)
        self.index = self._bare.index
        self._open = open_dataset
        self._frame_after = lru_cache(maxsize=FRAMES_KEPT)(self._computed)

    @property
    def now(self) -> ExportedFrom:
        """Newest state; with the dataset where needed."""
        return ExportedFrom(self.version, next(reversed(self._id_of), None), self._full is not None)

    def check(self, state: ExportedFrom) -> None:
        """Refuse a state of other labels or another journal, or for want of the dataset."""
        require(
            state.labels == self.version,
            "the file was exported from other automatic labels",
            got=state.labels,
            expected=self.version,
            cause="were the labels made again since?",
            path=self.labels.root,
        )
        require(
            state.event is None or state.event in self._id_of,
            "the file was exported with another journal",
            got=f"no event {state.event}",
            cause="is --journal right?",
        )
        require(
            not (state.relifted and self._pixels) or self._full is not None,
            "the dataset is needed",
            cause="what follows from corrected pixels is in the file",
            expected="--dataset says where it is",
        )

    def frame(self, frame: str, state: ExportedFrom) -> EffectiveFrame:
        """Frame in a checked state."""
        last = 0 if state.event is None else self._id_of[state.event]
        count = bisect_right(self._events.get(frame, []), last, key=lambda e: e.id)
        return self._frame_after(frame, count, state.relifted and self._pixels)

    def frame_now(self, frame: str, like: ExportedFrom) -> EffectiveFrame:
        """Frame with all corrections, computed as in that state."""
        return self.frame(frame, replace(self.now, relifted=like.relifted))

    def newest(self, ref: FieldRef) -> Event | None:
        """Newest event of a cell."""
        return next((e for e in reversed(self._events.get(ref.frame, ())) if e.ref == ref), None)

    def _computed(self, frame: str, count: int, full: bool) -> EffectiveFrame:
        return needed(self._full if full else self._bare, "unchecked").frame(frame, self._events.get(frame, [])[:count])

    @cached_property
    def _full(self) -> Corrector | None:
        """Corrector with the dataset; None where it is not needed or not to be had."""
        dataset = self._open() if self._pixels and self._open is not None else None
        return None if dataset is None else Corrector(self.labels, dataset)


class TooManyProblems(Exception):
    """Stop of a reading that tells nothing new."""


@dataclass(frozen=True)
class Claim:
    """Value that differs from the exported one; `where` is file and line or annotation, `base` the exported state."""

    where: str
    ref: FieldRef
    value: Any
    base: ExportedFrom


@dataclass
class Claims:
    """Result of reading a file; `compared` counts rows and annotations."""

    states: States
    found: dict[FieldRef, Claim] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    ignored: Counter[str] = field(default_factory=Counter)  # differing values that cannot be corrected, by column
    notes: Counter[str] = field(default_factory=Counter)
    compared: int = 0

    def problem(self, where: str, what: object) -> None:
        """Note a fault of the file."""
        self.problems.append(f"{where}: {what}")
        if len(self.problems) >= MOST_PROBLEMS:
            raise TooManyProblems

    @contextmanager
    def reading(self, where: str) -> Iterator[None]:
        """Turn an InputError inside the block into a problem of the file."""
        try:
            yield
        except InputError as error:
            self.problem(where, error)

    def say(self, where: str, ref: FieldRef, value: Any, state: ExportedFrom) -> None:
        """Claim a cell's value unless exported so."""
        try:
            value = checked(ref, value)
        except InputError as error:
            return self.problem(where, f"{ref.field}: {error}")
        if not same_value(value, self.states.frame(ref.frame, state).value(ref)):
            self.put(Claim(where, ref, value, state))

    def say_fields(
        self, where: str, row: Mapping[str, Any], ref: FieldRef, fields: Iterable[str], state: ExportedFrom
    ) -> None:
        """Claim the fields of a row."""
        for name in fields:
            if name in row:
                self.say(where, replace(ref, field=name), row[name], state)

    def put(self, claim: Claim) -> None:
        """Keep a claim; a second claim on the cell must agree."""
        before = self.found.setdefault(claim.ref, claim)
        if before is not claim and not same_value(before.value, claim.value):
            self.problem(claim.where, f"says otherwise of {claim.ref} than {before.where}")

    def say_new(self, where: str, frame: str, seed: dict[str, Any], state: ExportedFrom) -> None:
        """Claim a new object; the number follows from the content, so a second import adds nothing."""
        seed = checked(object_ref(frame, FIRST_NEW_OBJECT, "exists"), seed)
        text = json.dumps([frame, seed], sort_keys=True, ensure_ascii=True)
        digest = int(hashlib.sha256(text.encode()).hexdigest()[:15], 16)
        number = FIRST_NEW_OBJECT + digest % (2**31 - FIRST_NEW_OBJECT)
        self.put(Claim(where, object_ref(frame, number, "exists"), seed, state))

    def say_deleted(self, where: str, frame: str, seen: set[int], state: ExportedFrom) -> None:
        """Reject the exported objects of a frame without an annotation."""
        for number in self.states.frame(frame, state).objects.keys() - seen:
            self.put(Claim(where, object_ref(frame, number, "status"), "rejected", state))


StateOf = Callable[[Any], ExportedFrom]
"""The state that a row's `base` names; InputError where it is not to be used."""
_TEXTS = ("text", "targets", "acceptable", "ambiguous", "status", "mark")
_CONTEXT = {"frame", "frame_index", "base", "made_by", "provenance"}


def read_lines(path: Path, claims: Claims, state_of: StateOf, *, reject_deleted: bool) -> None:
    """Read the rows of a table; InputError for an unreadable file, another name or an unknown state."""
    kind = path.stem
    expected = " | ".join(f"{table}.jsonl" for table in TABLES)
    require(kind in TABLES, "no table of an export by its name", got=path.name, expected=expected)
    seen: dict[str, tuple[set[int], ExportedFrom]] = {}
    twice: set[int] = set()
    stated: Any = None
    for where, row in _rows(path, claims):
        stated = row.get("base") or stated
        # What cannot be compared at all is not told line by line.
        state = state_of(stated)
        with claims.reading(where):
            frame = _frame(row, claims)
            name = hash((frame, *(str(row.get(key)) for key in ("object", "a", "b", "id"))))
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
    _COMPARE[kind](where, row, frame, state, claims)


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


def _relation(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    a, b = _number(row, "a"), _number(row, "b")
    base = claims.states.frame(frame, state)
    require(a != b, "an object has no relation to itself", got=a)
    for number in (a, b):
        known = base.pairs.index_of(number) is not None
        require(known, f"frame {frame} had no object {number} that takes part in relations")
    relations = base.setting.relations
    for relation in PAIRWISE:
        value = row.get(relation)
        # Nearly all of an export's cells are as they were: only one that is not gets a reference.
        if relation not in row or (value == base.pairs.state(a, b, relation) and type(value) in (int, type(None))):
            continue
        require(relation in relations, f"the labels hold no relation {relation!r}")
        claims.say(where, relation_ref(frame, a, b, relation), value, state)
    if "statuses" in row:
        statuses = _statuses(row["statuses"], relations)
        had = any(ref.kind == "relation" and ref.key == f"{a},{b}" for ref in base.statuses)
        for relation in relations if statuses or had else ():
            claims.say(where, relation_ref(frame, a, b, f"{relation}.status"), statuses.get(relation), state)


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


def _frame_row(where: str, row: Row, frame: str, state: ExportedFrom, claims: Claims) -> None:
    claims.say_fields(where, row, FieldRef("frame", frame, "", "status"), ("status", "note"), state)


_COMPARE = {"objects": _object, "relations": _relation, "expressions": _expression, "frames": _frame_row}


def _ignore(row: Row, was: Row, corrected: set[str], claims: Claims) -> None:
    for column in (row.keys() & was.keys()) - corrected - _CONTEXT:
        if not same_value(row[column], was[column]):
            claims.ignored[column] += 1
