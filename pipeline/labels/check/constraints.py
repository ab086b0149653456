"""The pydantic models of the rows as checks of whole columns.

The models stay the one source: what they allow is read from their JSON Schema,
whole columns are compared with that, and only rows that fall out are validated
one by one, for the message.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from pipeline.labels.schema import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Constraint:
    """What a column may hold."""

    nullable: bool
    values: tuple[Any, ...] | None
    least: float | None
    most: float | None
    shortest: int | None
    longest: int | None


@dataclass(frozen=True)
class Violation:
    """A cell that breaks its column's constraint, or is not finite.

    `row` is its place in the table that was checked.
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
            kind.get("minimum"),
            kind.get("maximum"),
            kind.get("minItems"),
            kind.get("maxItems"),
        )
    return found


def violations(rows: pa.Table, table: str, skip: frozenset[str] = frozenset()) -> list[Violation]:
    """All cells that break the model of their table, in order of rows.

    Parameters
    ----------
    rows : pa.Table
        Of the table's Arrow schema.
    skip : frozenset of str
        Columns that the file lacks.
    """
    found: list[Violation] = []
    broken: dict[int, dict[str, Violation]] = {}
    for name, constraint in constraints(table).items():
        if name in skip:
            continue
        column = rows.column(name).combine_chunks()
        bad, wild = _broken(column, constraint)
        for row in np.flatnonzero(wild):
            found.append(Violation(int(row), "row/non-finite", name, f"{name} is not finite"))
        for row in np.flatnonzero(bad & ~wild):
            broken.setdefault(int(row), {})[name] = Violation(int(row), "row/model", name, f"{name} is not allowed")
    for row, cells in broken.items():
        messages = _messages(rows, table, row)
        found += [
            Violation(row, v.rule, name, f"{name}: {messages[name]}" if name in messages else v.message)
            for name, v in cells.items()
        ]
    return sorted(found, key=lambda v: v.row)


def _messages(rows: pa.Table, table: str, row: int) -> dict[str, str]:
    (record,) = rows.slice(row, 1).to_pylist()
    try:
        TABLES[table].model_validate(record)
    except ValidationError as error:
        return {
            str(e["loc"][0]): f"{e['msg']}, got {repr(e.get('input'))[:60]}"
            for e in reversed(error.errors())
            if e["loc"]
        }
    return {}


def _broken(column: Any, constraint: Constraint) -> tuple[np.ndarray, np.ndarray]:
    """Which cells are not allowed, and which are not finite, as two (N,) bool."""
    import pyarrow as pa

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
            if constraint.least is not None:
                bad |= ~null & (values < constraint.least)
            if constraint.most is not None:
                bad |= ~null & (values > constraint.most)
    return bad, wild


def _check_lists(column: Any, constraint: Constraint, null: np.ndarray, bad: np.ndarray, wild: np.ndarray) -> None:
    """Lengths and elements of a list column, into `bad` and `wild`."""
    import pyarrow as pa

    length = np.diff(column.offsets.to_numpy())
    if constraint.shortest is not None:
        bad |= ~null & (length < constraint.shortest)
    if constraint.longest is not None:
        bad |= ~null & (length > constraint.longest)
    inner = column.flatten()
    owner = np.repeat(np.flatnonzero(~null), length[~null])
    if inner.null_count:
        bad[owner[_bools(inner.is_null())]] = True
    if pa.types.is_floating(inner.type):
        values = inner.fill_null(0.0).to_numpy(zero_copy_only=False)
        wild[owner[~np.isfinite(values)]] = True


def _bools(array: Any) -> np.ndarray:
    return array.to_numpy(zero_copy_only=False).astype(np.bool_)
