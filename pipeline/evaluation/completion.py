"""What can be typed in a search: fields, the values that occur, and how a word that is begun may end."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.evaluation.search import SORT, Field, fields_of, records_of
from pipeline.evaluation.search_words import quote

if TYPE_CHECKING:
    import pyarrow as pa

_WORD = re.compile(r'(?:[^\s"]|"(?:[^"\\]|\\.)*(?:"|$))+')
"""A quote that is open or closed belongs to its word, blanks included."""

def completions(source: str | Path | pa.Table, most: int = 200) -> tuple[Field, ...]:
    """All fields of a run with the values that occur, for a field that completes what is typed."""
    import pyarrow.compute as pc

    records = records_of(source)
    found = []
    for field in fields_of(records.schema).values():
        column = records.column(field.column)
        values: tuple[str, ...] = ()
        if field.kind == "text":
            # Ids are not chosen from a list.
            if field.column != "id":
                counts = column.drop_null().value_counts()
                by_count = sorted(counts.to_pylist(), key=lambda c: (-c["counts"], c["values"]))
                values = tuple(quote(c["values"]) for c in by_count[:most])
        elif field.kind == "flag":
            values = ("yes", "no")
        elif field.kind == "names":
            flat = column.drop_null().combine_chunks().flatten()
            values = tuple(sorted(str(v) for v in flat.unique().to_pylist() if v is not None))
        elif field.kind == "number" and column.null_count < len(column):
            ends = pc.min_max(column).as_py()  # pyright: ignore[reportAttributeAccessIssue]
            values = (f"{ends['min']:.6g}", f"{ends['max']:.6g}")
        found.append(Field(field.name, field.column, field.kind, values))
    return tuple(found)


def complete(typed: str, fields: Sequence[Field], most: int = 20) -> list[str]:
    """What the last word of a search may become, each as the whole word.

    Parameters
    ----------
    typed : str
    fields : sequence of Field
        From `completions`.
    most : int
    """
    words = list(_WORD.finditer(typed))
    word = words[-1][0] if words and words[-1].end() == len(typed) else ""
    minus, bare = ("-", word[1:]) if word.startswith("-") else ("", word)
    name, colon, value = bare.partition(":")
    if not colon:
        ends = {"flag": "", "number": "<"}
        offered = [f"{minus}{f.name}{ends.get(f.kind, ':')}" for f in fields if f.name.startswith(bare.lower())]
        return [*offered, *([f"{SORT}:"] if SORT.startswith(bare.lower()) else [])][:most]
    if name.lower() == SORT:
        down = "-" if value.startswith("-") else ""
        return [f"{SORT}:{down}{f.name}" for f in fields if f.name.startswith(value.removeprefix("-").lower())][:most]
    before, comma, last = value.rpartition(",")
    start = last.lstrip('"').lower()
    chosen = [f for f in fields if f.name == name.lower() and f.kind not in ("number", "words")]
    return [
        f"{minus}{name}:{before}{comma}{v}" for f in chosen for v in f.values if v.lstrip('"').lower().startswith(start)
    ][:most]
