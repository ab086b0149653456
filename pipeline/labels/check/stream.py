"""Rows of a table as arrays, frame by frame, with the cells that break the row's model.

The pydantic models of the rows stay the one source of what a cell may hold: whole columns are compared with the limits
of their JSON Schema, and only rows that fall out are validated one by one.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from math import inf
from typing import Any

import numpy as np
from pydantic import ValidationError

from pipeline.labels.frame_stream import frame_blocks, frame_spans
from pipeline.labels.reading import Labels, arrow_schema
from pipeline.labels.schema import TABLES
from pipeline.relations.pair_measures import NOT_JUDGED
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import Shown
from pipeline.system.frozen import dataclass
from pipeline.system.reading import asked


@dataclass(frozen=True)
class Violation:
    """A cell that breaks its row's model, or is not finite; `row` counts from the first of the table or frame."""

    row: int
    rule: str
    column: str
    message: str


@dataclass(frozen=True)
class Rows:
    """Rows of one frame."""

    columns: dict[str, np.ndarray]
    """Numbers and bools as they are, vectors as (N, k), the rest as objects."""
    count: int
    violations: tuple[Violation, ...] = ()

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __len__(self) -> int:
        return self.count


@lru_cache
def no_rows(table: str) -> Rows:
    """None of a table's rows, with all of its columns."""
    return Rows(column_arrays(arrow_schema(table).empty_table(), table), 0)


def frame_rows(labels: Labels, table: str, *, checked: bool) -> Iterator[tuple[int, str, Rows]]:
    """Rows of each frame: (frame, table's name, rows), with their violations if `checked`.

    Raises InputError: as `frame_blocks`.
    """
    for block in frame_blocks(labels, table):
        columns = column_arrays(block, table)
        broken = violations(block, columns, table) if checked else []
        for frame, start, stop in frame_spans(columns["frame_index"]):
            of_frame = {name: values[start:stop] for name, values in columns.items()}
            here = (Violation(v.row - start, v.rule, v.column, v.message) for v in broken if start <= v.row < stop)
            yield frame, table, Rows(of_frame, stop - start, tuple(here))


def column_arrays(block: pa.Table, table: str) -> dict[str, np.ndarray]:
    """Columns of rows of the table's schema, as `Rows` has them; NaN, -1, False or NOT_JUDGED in place of null."""
    found = {}
    nulls = ((pa.types.is_int8, NOT_JUDGED), (pa.types.is_floating, float("nan")), (pa.types.is_boolean, False))
    for name, limits in _limits(table).items():
        column = block.column(name).combine_chunks()
        kind = column.type
        if pa.types.is_list(kind) and "minItems" in limits:
            found[name] = _vectors(column, limits["minItems"])
        elif pa.types.is_list(kind) or pa.types.is_string(kind):
            found[name] = np.fromiter(column.to_pylist(), object, len(column))
        else:
            null: Any = next((value for of_type, value in nulls if of_type(kind)), -1)
            values = column.fill_null(null).to_numpy(zero_copy_only=False)
            found[name] = values.astype(np.int64) if pa.types.is_int32(kind) else values
    return found


def _vectors(column: Any, k: int) -> np.ndarray:
    """(N, k) float64; NaN where a list is null or of another length."""
    found = np.full((len(column), k), np.nan)
    offsets = column.offsets.to_numpy()
    good = (np.diff(offsets) == k) & ~column.is_null().to_numpy(zero_copy_only=False)
    values = column.values.fill_null(float("nan")).to_numpy(zero_copy_only=False)
    found[good] = values[offsets[:-1][good, None] + np.arange(k)]
    return found


@lru_cache
def _limits(table: str) -> dict[str, dict[str, Any]]:
    """JSON Schema of each column's values other than null."""
    properties = TABLES[table].model_json_schema(by_alias=True)["properties"]
    options = {name: schema.get("anyOf", [schema]) for name, schema in properties.items()}
    return {name: next(s for s in schemas if s.get("type") != "null") for name, schemas in options.items()}


def violations(block: pa.Table, columns: dict[str, np.ndarray], table: str) -> list[Violation]:
    """All cells that break the model of their table, in order of rows; `columns` are the block's `column_arrays`."""
    odd = np.zeros(block.num_rows, np.bool_)
    for name, limits in _limits(table).items():
        column = block.column(name).combine_chunks()
        odd |= _odd(column, columns[name], limits) & column.is_valid().to_numpy(zero_copy_only=False)
    found = []
    for row in np.flatnonzero(odd).tolist():
        (record,) = block.slice(row, 1).to_pylist()
        try:
            TABLES[table].model_validate(record)
        except ValidationError as error:
            faults = {str(e["loc"][0]): e for e in reversed(error.errors())}
            found += [_violation(row, name, fault) for name, fault in faults.items()]
    return found


def _odd(column: Any, values: np.ndarray, limits: dict[str, Any]) -> np.ndarray:
    """(N,) bool: cells that may break the model; of null any."""
    allowed = limits.get("enum", [limits["const"]] if "const" in limits else None)
    if allowed is not None:
        known = pc.is_in(column, value_set=pa.array(allowed, column.type))  # pyright: ignore[reportAttributeAccessIssue]
        return ~known.to_numpy(zero_copy_only=False)
    if values.dtype == object:
        inner = column.flatten() if pa.types.is_list(column.type) else None
        items = limits.get("items", {}).get("enum")
        strange = inner is not None and items is not None and not set(inner.unique().to_pylist()) <= set(items)
        return np.full(len(values), strange or (inner is not None and inner.null_count > 0))
    if values.ndim == 2:
        return np.asarray(~np.isfinite(values).all(axis=1))
    return ~(np.isfinite(values) & (values >= limits.get("minimum", -inf)) & (values <= limits.get("maximum", inf)))


def _violation(row: int, name: str, fault: Any) -> Violation:
    if fault["type"] == "finite_number":
        return Violation(row, "row/non-finite", name, f"{name} is not finite")
    return Violation(row, "row/model", name, f"{name}: got {Shown(fault['input'])}; expected {asked(fault)}")
