"""pyarrow and its modules, each imported at its first use."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.system.errors import as_input_error, require
from pipeline.system.frozen import dataclass


class LazyModule:
    """Module with its import at the first use of an attribute."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        found = self.__dict__[attribute] = getattr(import_module(self._name), attribute)
        return found


if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.json as pj
    import pyarrow.parquet as pq
else:
    pa, pc, pj, pq = (LazyModule(f"pyarrow{part}") for part in ("", ".compute", ".json", ".parquet"))


@dataclass(frozen=True)
class Repeated(Sequence[Any]):
    """A column of few different values."""

    values: Any  # A sequence or an Arrow array
    places: np.ndarray  # (N,) int: place of each row's value

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, row: Any) -> Any:
        value = self.values[int(self.places[row])]
        return value.as_py() if hasattr(value, "as_py") else value

    def array(self, kind: Any) -> Any:
        """Arrow array of a type."""
        values = self.values.cast(kind) if hasattr(self.values, "cast") else pa.array(self.values, kind)
        return values.take(pa.array(self.places))


def typed(rows: pa.Table, schema: pa.Schema, what: str, path: Any) -> pa.Table:
    """Cast columns of rows to the types of a schema; `what` names the table.

    Raises
    ------
    InputError
        A column of another type, or without values that the schema asks for.
    """
    for place, name in enumerate(rows.column_names):
        field, held = schema.field(name) if name in schema.names else None, rows.column(place)
        if field is None or (held.type == field.type and (field.nullable or not held.null_count)):
            continue
        words = {"got": held.type, "expected": field.type, "cause": "was the file written by something else?"}
        with as_input_error(f"{what}, column {name}: another type", pa.ArrowException, path=path, **words):
            rows = rows.set_column(place, field, held.cast(field.type))
        require(field.nullable or not held.null_count, f"{what}, column {name}: no value in a row", path=path)
    return rows


__all__ = ["LazyModule", "pa", "pc", "pj", "pq", "typed"]
