"""Rows of a query, as a table or as JSON lines."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from typing import Any

from pipeline.system.sql import QueryRows
from spatialviz.options import print_json
from spatialviz.printing import print_rows, say

MOST_SHOWN = 1000
"""Rows on the terminal."""


def print_answer(answer: QueryRows) -> int:
    """Print the first rows as a table; returns their number."""
    rows = list(islice(answer.rows, MOST_SHOWN + 1))

    kinds = [{type(value) for value in column} for column in zip(*rows, strict=True)] or [set()] * len(answer.columns)
    columns = (f">{n}" if kind and kind <= {int, float} else n for n, kind in zip(answer.columns, kinds, strict=True))
    print_rows(columns, (map(_shown, row) for row in rows[:MOST_SHOWN]))
    if len(rows) > MOST_SHOWN:
        say(f"only the first {MOST_SHOWN:,} rows are shown; --json prints them all", style="dim")
    return len(rows)


def print_json_rows(answer: QueryRows) -> int:
    """Rows as JSON objects, a line each; how many."""
    count = 0
    for row in row_records(answer):
        print_json(row)
        count += 1
    return count


def row_records(answer: QueryRows) -> Iterator[dict[str, Any]]:
    """Rows as records of `query --json`, streamed."""
    return (dict(zip(answer.columns, map(plain, row), strict=True)) for row in answer.rows)


def plain(value: Any) -> Any:
    """Convert a value of a database to JSON; NaN and infinity become null."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return str(value)


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
