"""Tables of labels read frame by frame, whatever was done to the files.

A table in order of frames is read in batches, and no more than one batch and
one frame are held. One that is out of order is reported and sorted in memory.

The pydantic models of the rows stay the one source of what a cell may hold: it is read from their JSON Schema, whole
columns are compared with that, and only rows that fall out are validated one by one, for the message.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from pipeline.labels.reading import arrow_schema, check_version
from pipeline.labels.schema import ADDED_COLUMNS, TABLES
from pipeline.relations.pair_measures import NOT_JUDGED
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, Shown, require
from pipeline.system.reading import asked
from pipeline.system.safe_files import open_parquet

BATCH_ROWS = 8_192


@dataclass(frozen=True)
class Rows:
    """Rows of one frame."""

    columns: dict[str, np.ndarray]
    """Numbers and bools as they are, vectors as (N, k), the rest as objects."""
    violations: tuple[Violation, ...]
    """Their `row` counts from the frame's first."""
    count: int

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __len__(self) -> int:
        return self.count


class TableStream:
    """A table of labels, read in order of frames.

    `checked`: whether its rows tell their violations. `problem`: why it cannot be read at all; it then has no rows.
    `lacking`: columns that are not there or hold something else entirely. `other_types`: columns of another width than
    the schema's, in words. `extra`: columns that the schema does not know. `ordered`: whether frames come in order.
    `opened`: whether it could be read at first.
    """

    def __init__(self, path: Path, table: str, checked: bool = True) -> None:
        self.table, self.path, self._checked = table, path, checked
        self.problem: str | None = None
        self.lacking: frozenset[str] = frozenset()
        self.other_types: tuple[str, ...] = ()
        self.extra: tuple[str, ...] = ()
        self.ordered = True
        self.opened = False
        # Columns that the schema got after the file was written: null throughout.
        self._added: set[str] = set()
        self._blocks: Iterator[pa.Table] = iter(())
        self._block: dict[str, np.ndarray] = {}
        self._violations: list[Violation] = []
        self._index, self._at = np.zeros(0, np.int64), 0
        try:
            # Read ahead, a file would stay in memory until it is closed.
            file = open_parquet(path, pre_buffer=False)
            check_version(file.schema_arrow.metadata or {}, table, path)
            self._compare(file.schema_arrow)
            require("frame_index" not in self.lacking, "it has no column frame_index")
            self.ordered = _is_ordered(file)
            self._blocks = self._read(file)
            self._advance()
            self.opened = self.problem is None
        except FileNotFoundError:
            self.problem = "the file is missing"
        except InputError as error:
            self.problem = error.what
        except (pa.ArrowInvalid, pa.ArrowTypeError, OSError) as error:
            self.problem = str(error).split("\n")[0]

    def peek(self) -> int | None:
        """The next frame's index; None at the end."""
        return int(self._index[self._at]) if self._at < len(self._index) else None

    def take(self, index: int) -> Rows:
        """Rows of a frame, if next; else none."""
        if self.peek() != index:
            return no_rows(self.table)
        start, stop = self._at, int(np.searchsorted(self._index, index, "right"))
        first, last = (bisect_left(self._violations, at, key=lambda v: v.row) for at in (start, stop))
        found = Rows(
            {name: values[start:stop] for name, values in self._block.items()},
            tuple(replace(v, row=v.row - start) for v in self._violations[first:last]),
            stop - start,
        )
        self._at = stop
        if stop == len(self._index):
            self._advance()
        return found

    def _advance(self) -> None:
        try:
            block = next(self._blocks, None)
        except (pa.ArrowInvalid, OSError) as error:
            self.problem, block = str(error).split("\n")[0], None
        if block is None:
            self._block, self._violations, self._index, self._at = {}, [], np.zeros(0, np.int64), 0
            return
        self._violations = violations(block, self.table, self.lacking) if self._checked else []
        self._block = _arrays(block, self.table)
        self._index, self._at = self._block["frame_index"], 0

    def _compare(self, found: pa.Schema) -> None:
        lacking, other = set(), []
        for field in arrow_schema(self.table):
            if field.name not in found.names:
                (self._added if field.name in ADDED_COLUMNS else lacking).add(field.name)
            elif not _alike(found.field(field.name).type, field.type):
                other.append(f"{field.name} is {found.field(field.name).type} and not {field.type}")
                if not _castable(found.field(field.name).type, field.type):
                    lacking.add(field.name)
        self.lacking, self.other_types = frozenset(lacking), tuple(other)
        self.extra = tuple(n for n in found.names if n not in arrow_schema(self.table).names)

    def _read(self, file: Any) -> Iterator[pa.Table]:
        """Blocks of whole frames, in order, of the schema's types."""
        wanted = [n for n in arrow_schema(self.table).names if n not in self.lacking | self._added]
        if not self.ordered:
            whole = self._typed(file.read(columns=wanted))
            yield whole.take(pa.array(np.argsort(whole.column("frame_index").fill_null(-1).to_numpy(), kind="stable")))
            return
        tail: pa.Table | None = None
        left = file.metadata.num_rows
        for batch in file.iter_batches(BATCH_ROWS, columns=wanted):
            left -= batch.num_rows
            rows = self._typed(pa.Table.from_batches([batch]))
            rows = rows if tail is None else pa.concat_tables([tail, rows])
            index = rows.column("frame_index").to_numpy()
            # The rows of the last frame may go on in the next batch; where there is none, they are whole.
            cut = int(np.searchsorted(index, index[-1], "left")) if len(index) and left else len(index)
            if cut:
                yield rows.slice(0, cut)
            tail = rows.slice(cut)
        if tail is not None and tail.num_rows:
            yield tail

    def _typed(self, rows: pa.Table) -> pa.Table:
        absent, schema = self.lacking | self._added, arrow_schema(self.table)
        arrays = [
            pa.chunked_array([pa.nulls(rows.num_rows, field.type)])
            if field.name in absent
            else rows.column(field.name).cast(field.type, safe=False)
            for field in schema
        ]
        return pa.Table.from_arrays(arrays, names=schema.names)


def _is_ordered(file: Any) -> bool:
    last = -1
    for batch in file.iter_batches(BATCH_ROWS, columns=["frame_index"]):
        index = np.append(last, batch.column(0).fill_null(-2).to_numpy(zero_copy_only=False))
        if (np.diff(index) < 0).any():
            return False
        last = index[-1]
    return True


def _alike(found: Any, wanted: Any) -> bool:
    if pa.types.is_dictionary(found):
        found = found.value_type
    if pa.types.is_large_string(found):
        found = pa.string()
    if pa.types.is_large_list(found) or pa.types.is_fixed_size_list(found) or pa.types.is_list(found):
        return pa.types.is_list(wanted) and _alike(found.value_type, wanted.value_type)
    return found == wanted


def _castable(found: Any, wanted: Any) -> bool:

    def kind(of: Any) -> str:
        if pa.types.is_integer(of) or pa.types.is_floating(of):
            return "number"
        nested = pa.types.is_list(of) or pa.types.is_large_list(of) or pa.types.is_fixed_size_list(of)
        return f"list of {kind(of.value_type)}" if nested else str(of)

    return kind(found) == kind(wanted)


def _arrays(block: pa.Table, table: str) -> dict[str, np.ndarray]:
    found = {}
    for name, constraint in constraints(table).items():
        column = block.column(name).combine_chunks()
        kind = column.type
        if pa.types.is_list(kind):
            if pa.types.is_string(kind.value_type):
                found[name] = np.fromiter((tuple(words or ()) for words in column.to_pylist()), object, len(column))
                continue
            fixed = constraint.shortest == constraint.longest
            found[name] = _vectors(column, constraint.shortest) if fixed else _lists(column)
        elif pa.types.is_string(kind):
            words = column.dictionary_encode()
            known = np.array([*words.dictionary.to_pylist(), None], object)
            found[name] = known[words.indices.fill_null(len(known) - 1).to_numpy(zero_copy_only=False)]
        else:
            nulls = ((pa.types.is_int8, NOT_JUDGED), (pa.types.is_floating, float("nan")), (pa.types.is_boolean, False))
            null: Any = next((value for of_type, value in nulls if of_type(kind)), -1)
            values = column.fill_null(null).to_numpy(zero_copy_only=False)
            found[name] = values.astype(np.int64) if pa.types.is_int32(kind) else values
    return found


def _vectors(column: Any, k: int) -> np.ndarray:
    """(N, k) float64; NaN where a list is null or of another length."""
    found = np.full((len(column), k), np.nan)
    offsets = column.offsets.to_numpy()
    good = (np.diff(offsets) == k) & ~column.is_null().to_numpy(zero_copy_only=False).astype(np.bool_)
    values = column.values.fill_null(float("nan")).to_numpy(zero_copy_only=False)
    found[good] = values[offsets[:-1][good, None] + np.arange(k)]
    return found


def _lists(column: Any) -> np.ndarray:
    """(N,) objects: an int64 array for each list."""
    offsets, values = column.offsets.to_numpy(), column.values.fill_null(-1).to_numpy(zero_copy_only=False)
    found = np.empty(len(column), object)
    for row in range(len(found)):
        found[row] = values[offsets[row] : offsets[row + 1]].astype(np.int64)
    return found


@lru_cache
def no_rows(table: str) -> Rows:
    """None of a table's rows, with all of its columns."""
    return Rows(_arrays(arrow_schema(table).empty_table(), table), (), 0)


def frames_of(streams: dict[str, TableStream]) -> Iterator[tuple[int, dict[str, Rows]]]:
    """Rows of all tables, frame by frame; none of a table without rows of the frame."""
    while True:
        following = [p for p in (s.peek() for s in streams.values()) if p is not None]
        if not following:
            return
        index = min(following)
        yield index, {name: stream.take(index) for name, stream in streams.items()}


@dataclass(frozen=True)
class Constraint:
    """What a column may hold."""

    nullable: bool
    values: tuple[Any, ...] | None
    least: float
    most: float
    shortest: int
    longest: float


@dataclass(frozen=True)
class Violation:
    """A cell that breaks its column's constraint, or is not finite.

    `row` is its index in the table that was checked.
    """

    row: int
    rule: str
    column: str
    message: str


@lru_cache
def constraints(table: str) -> dict[str, Constraint]:
    """The constraints of a table's columns, by name."""
    properties = TABLES[table].model_json_schema(by_alias=True)["properties"]
    found = {}
    for name, schema in properties.items():
        options = schema.get("anyOf", [schema])
        kinds = [o for o in options if o.get("type") != "null"]
        kind = kinds[0]
        values = kind.get("enum", [kind["const"]] if "const" in kind else None)
        found[name] = Constraint(
            len(kinds) < len(options),
            None if values is None else tuple(values),
            kind.get("minimum", -inf),
            kind.get("maximum", inf),
            kind.get("minItems", 0),
            kind.get("maxItems", inf),
        )
    return found


def violations(rows: pa.Table, table: str, skip: frozenset[str] = frozenset()) -> list[Violation]:
    """All cells that break the model of their table, in order of rows.

    `rows`: of the table's Arrow schema. `skip`: columns that the file lacks.
    """
    found: list[Violation] = []
    broken: dict[int, list[str]] = {}
    for name, constraint in constraints(table).items():
        if name in skip:
            continue
        bad, wild = _broken(rows.column(name).combine_chunks(), constraint)
        wild_rows = np.flatnonzero(wild).tolist()
        found += [Violation(row, "row/non-finite", name, f"{name} is not finite") for row in wild_rows]
        for row in np.flatnonzero(bad & ~wild):
            broken.setdefault(int(row), []).append(name)
    for row, names in broken.items():
        messages = _messages(rows, table, row)
        found += [
            Violation(row, "row/model", n, f"{n}: {messages[n]}" if n in messages else f"{n} is not allowed")
            for n in names
        ]
    return sorted(found, key=lambda v: v.row)


def _messages(rows: pa.Table, table: str, row: int) -> dict[str, str]:
    (record,) = rows.slice(row, 1).to_pylist()
    try:
        TABLES[table].model_validate(record)
    except ValidationError as error:
        return {
            str(e["loc"][0]): f"got {Shown(e['input'])}; expected {asked(e)}"
            for e in reversed(error.errors())
            if e["loc"]
        }
    return {}


def _broken(column: Any, constraint: Constraint) -> tuple[np.ndarray, np.ndarray]:
    """Disallowed cells, and cells without a finite value, as two (N,) bool."""
    n = len(column)
    null = _bools(column.is_null())
    bad = np.zeros(n, np.bool_) if constraint.nullable else null.copy()
    wild = np.zeros(n, np.bool_)
    if pa.types.is_list(column.type):
        _check_lists(column, constraint, null, bad, wild)
    elif pa.types.is_string(column.type):
        if constraint.values is not None:
            words = column.dictionary_encode()
            allowed = np.array([w in constraint.values for w in words.dictionary.to_pylist()] or [True], np.bool_)
            codes = words.indices.fill_null(0).to_numpy(zero_copy_only=False)
            bad |= ~null & ~allowed[codes]
    elif not pa.types.is_boolean(column.type):
        values = column.fill_null(0).to_numpy(zero_copy_only=False)
        if pa.types.is_floating(column.type):
            wild = ~null & ~np.isfinite(values)
        if constraint.values is not None:
            bad |= ~null & ~np.isin(values, constraint.values)
        with np.errstate(invalid="ignore"):
            bad |= ~null & ((values < constraint.least) | (values > constraint.most))
    return bad, wild


def _check_lists(column: Any, constraint: Constraint, null: np.ndarray, bad: np.ndarray, wild: np.ndarray) -> None:
    """Lengths and elements of a list column, into `bad` and `wild`."""
    length = np.diff(column.offsets.to_numpy())
    bad |= ~null & ((length < constraint.shortest) | (length > constraint.longest))
    inner = column.flatten()
    owner = np.repeat(np.flatnonzero(~null), length[~null])
    if inner.null_count:
        bad[owner[_bools(inner.is_null())]] = True
    if pa.types.is_floating(inner.type):
        values = inner.fill_null(0.0).to_numpy(zero_copy_only=False)
        wild[owner[~np.isfinite(values)]] = True


def _bools(array: Any) -> np.ndarray:
    return array.to_numpy(zero_copy_only=False).astype(np.bool_)
