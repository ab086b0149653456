"""What a person, or a program, reads of a run: rows of SQL, verdicts, slices and failures."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from rich.table import Table as RichTable
from rich.text import Text

from pipeline.counted import counted
from pipeline.diagnosis.run_database import Answer
from pipeline.diagnosis.slices import Slices, slice_table
from pipeline.diagnosis.summary import RunSummary, oracle_table, verdict_table
from pipeline.evaluation.shared_makers import Share, with_caveats
from spatialviz.options import print_json
from spatialviz.printing import make_console
from spatialviz.printing_eval import rich_table

if TYPE_CHECKING:
    import pyarrow as pa

SHOWN = ("id", "frame", "text", "target", "relation", "reference", "verdict", "detail", "lucky", "said", "repair",
         "margin", "p_target", "p_reference", "p_relation")  # fmt: skip
"""Columns of a failure in JSON."""


def print_answer(answer: Answer, most: int) -> int:
    """Rows as a table, at most so many; how many there were to show."""
    console = make_console()
    table = RichTable(box=None, pad_edge=False, header_style="dim")
    rows = list(islice(answer.rows, most + 1))
    for k, name in enumerate(answer.columns):
        numbers = all(isinstance(row[k], (int, float)) and not isinstance(row[k], bool) for row in rows)
        table.add_column(Text(name), justify="right" if rows and numbers else "left")
    for row in rows[:most]:
        # What stands in a run is text, not rich's markup.
        table.add_row(*(Text(_shown(value)) for value in row))
    console.print(table)
    if len(rows) > most:
        console.print(Text(f"only the first {most:,} rows are shown; --csv and --json print them all", "dim"))
    return len(rows)


def print_rows(answer: Answer) -> int:
    """Rows as JSON objects, a line each."""
    count = 0
    for row in answer.rows:
        print_json(dict(zip(answer.columns, map(plain, row), strict=True)))
        count += 1
    return count


def print_csv(answer: Answer) -> int:
    """Rows as CSV under their names."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(answer.columns)
    count = 0
    for row in answer.rows:
        writer.writerow(["" if value is None else value for value in row])
        count += 1
    return count


def plain(value: Any) -> Any:
    """A value of a database as JSON knows it; what is no number is null."""
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


@dataclass(frozen=True)
class FoundFailures:
    """What `failures` tells of a run.

    Attributes
    ----------
    name : str
        The run's system.
    shares : sequence of Share
        What it has in common with what made its labels.
    summary : RunSummary
    slices : sequence of Slices
    found : pyarrow.Table
        Records of the expressions that were found by `search`.
    limit : int
        Expressions told at most.
    search : str
    """

    name: str
    shares: Sequence[Share]
    summary: RunSummary
    slices: Sequence[Slices]
    found: pa.Table
    limit: int
    search: str

    def record(self) -> dict[str, Any]:
        """`failures --json`."""
        rows = self.found.slice(0, self.limit).select([c for c in SHOWN if c in self.found.column_names]).to_pylist()
        return {
            "system": self.name,
            "shares": [share.record() for share in self.shares],
            "search": self.search,
            "found": self.found.num_rows,
            "failures": [{key: plain(value) for key, value in row.items()} for row in rows],
            "summary": self.summary.record(),
            "slices": {s.dimension.name: s.record() for s in self.slices},
        }


def print_failures(told: FoundFailures) -> None:
    """Verdicts, deltas and slices of the run, then the expressions that were found."""
    console = make_console()
    summary, found, summaries = told.summary, told.found, {told.name: told.summary}
    cuts = [slice_table(s, intervals=False) for s in told.slices]
    for table in (verdict_table(summaries), oracle_table(summaries), *cuts):
        table = with_caveats(table, {told.name: told.shares})
        console.print(Text(table.title, "bold"))
        console.print(rich_table(table))
        if table.note:
            console.print(Text(table.note, "dim"))
        console.print()
    for share in told.shares:
        console.print(Text(share.sentence, "yellow"))
    said = f"{found.num_rows} of {counted(summary.expressions, 'expression')}"
    said += f": {told.search}" if told.search else " failed"
    console.print(Text(said, "bold"))
    for row in found.slice(0, told.limit).to_pylist():
        verdict = "CORRECT LUCKY" if row["lucky"] else " ".join(filter(None, (row["verdict"], row["detail"])))
        console.print(Text.assemble((row["frame"], "dim"), "  ", row["text"], (f"  {verdict}", "bold yellow")))
        console.print(Text(f"    {row['said'] or ''}  ({row['id']})", "dim"))
    if found.num_rows > told.limit:
        console.print(Text(f"and {found.num_rows - told.limit} more (--limit)", "dim"))
