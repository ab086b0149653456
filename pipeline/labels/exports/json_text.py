"""Rows as JSON text: one line each, numbers in full, and long lists that are written item by item."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

_LINE_ENDS = {ord(c): f"\\u{ord(c):04x}" for c in "\x85\u2028\u2029"}
"""JSON lets these stand, but many readers split lines at them."""


def json_line(content: Any) -> str:
    """One line of JSON that gives the same values back, floats included.

    Raises
    ------
    InputError
        A number that JSON has no word for.
    """
    try:
        text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(", ", ": "))
    except ValueError as error:
        raise InputError("the labels hold a number that JSON cannot carry", got=str(error)) from error
    return text.translate(_LINE_ENDS)


def json_lines(table: pa.Table) -> Iterator[str]:
    """A table's rows as lines of JSON, each with its line end; raises as `json_line`.

    Tables without lists are put together by Arrow, column by column: the pairs
    of a large set are many.
    """
    import pyarrow as pa

    if any(pa.types.is_nested(field.type) for field in table.schema) or not table.num_rows:
        return (json_line(row) + "\n" for row in table.to_pylist())
    return _flat_lines(table)


def _flat_lines(table: pa.Table) -> Iterator[str]:
    import pyarrow as pa
    import pyarrow.compute as pc

    parts: list[Any] = []
    for name in table.column_names:
        parts += [f"{', ' if parts else '{'}{json_line(name)}: ", _texts(table.column(name).combine_chunks())]
    join = pc.binary_join_element_wise  # pyright: ignore[reportAttributeAccessIssue]
    lines = join(*(pa.scalar(p) if isinstance(p, str) else p for p in (*parts, "}\n")), "")
    return iter(lines.to_pylist())


def _texts(column: Any) -> Any:
    """Each value as JSON text; floats as the shortest decimal of the same double."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_string(column.type):
        coded = column.dictionary_encode()
        texts = pa.array([json_line(text) for text in coded.dictionary.to_pylist()], pa.string()).take(coded.indices)
    elif pa.types.is_floating(column.type):
        if not pc.all(pc.is_finite(column)).as_py() and column.null_count < len(column):  # pyright: ignore[reportAttributeAccessIssue]
            raise InputError("the labels hold a number that JSON cannot carry", got="an infinity or NaN")
        texts = column.cast(pa.float64()).cast(pa.string())
    else:
        texts = column.cast(pa.string())
    return texts.fill_null("null")


class JsonList:
    """A JSON list written item by item, one a line.

    Parameters
    ----------
    file : text file
        Open for writing; the list begins where it stands.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self.length = 0
        file.write("[")

    def add(self, item: Any) -> None:
        self._file.write((",\n" if self.length else "\n") + json_line(item))
        self.length += 1

    def close(self) -> None:
        self._file.write("\n]")


def load_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises
    ------
    InputError
        Missing or damaged.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError("a file of the export is missing", path=path) from error
    except (ValueError, RecursionError, OSError) as error:
        raise InputError("not a readable JSON file", got=str(error)[:120], path=path) from error
