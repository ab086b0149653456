"""What a person reads of an evaluation on the terminal."""

from __future__ import annotations

import math
from typing import Any

from rich.table import Table as RichTable
from rich.text import Text

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.compare import Comparison
from pipeline.evaluation.intervals import Estimate
from pipeline.evaluation.job import RunReport
from pipeline.evaluation.tables import Cell, Table, shown, with_heads
from spatialviz.printing import make_console


def print_run(report: RunReport, show: int) -> None:
    """The tables, the comparison, and where everything lies."""
    console = make_console()
    for table in report.tables:
        print_table(table, caveats=False)
        console.print()
    for caveat in dict.fromkeys(caveat for table in report.tables for caveat in table.caveats):
        console.print(Text(caveat, "yellow"))
    if report.comparison is not None:
        print_comparison(report.comparison, show)
    done = [f"{n} {what}" for n, what in ((report.expressions, "expressions"), (report.pairs, "pairs")) if n]
    rate = (report.expressions or report.pairs) / report.seconds if report.seconds else 0.0
    console.print(f"{' and '.join(done)} in {report.seconds:.1f} s, {rate:.0f} a second")
    console.print(Text(f"-> {report.folder}", "dim"))


def print_table(table: Table, caveats: bool = True) -> None:
    """A table under its title, and what must be known of it."""
    console = make_console()
    console.print(Text(table.title, "bold"))
    console.print(rich_table(table))
    if table.note:
        console.print(Text(table.note, "dim"))
    for caveat in table.caveats if caveats else ():
        console.print(Text(caveat, "yellow"))


def table_record(table: Table) -> dict[str, Any]:
    """A table as JSON: by row and column; an estimate as {value, low, high, n, clusters, note}."""
    return {row.name: dict(zip(table.columns, map(_plain, row.cells), strict=True)) for row in table.rows}


def rich_table(table: Table) -> RichTable:
    """A table of figures for the terminal."""
    found = RichTable(box=None, pad_edge=False, header_style="dim")
    found.add_column("")
    for name in table.columns:
        found.add_column(name, justify="right")
    for head, row in with_heads(table.rows):
        if head:
            found.add_row(Text(head, "italic"), *[""] * len(table.columns))
        name = row.name if row.source == "measured" else f"{row.name} ({row.source})"
        found.add_row(name, *map(shown, row.cells))
    return found


def print_comparison(found: Comparison, show: int) -> None:
    """Differences with intervals and tests, and the first expressions of each kind."""
    console = make_console()
    console.print(Text(f"compared on {found.shared} expressions", "bold"))
    table = RichTable(box=None, pad_edge=False, header_style="dim")
    for name in ("measure", "difference", "only now right", "only before right", "McNemar p"):
        table.add_column(name, justify="left" if name == "measure" else "right")
    for name, estimate in found.differences.items():
        test = found.tests[name]
        table.add_row(name, estimate.formatted(signed=True), str(test.b), str(test.c), f"{test.p_value:.2g}")
    console.print(table)
    if found.verdicts is not None:
        console.print(Text("verdicts: before in rows, after in columns", "bold"))
        console.print(_transitions(found.verdicts))
    for title, entries in (
        ("fixed", found.fixed),
        ("broken", found.broken),
        ("right for another reason", found.other_reason),
    ):
        console.print(f"{title}: {len(entries)}")
        for entry in entries[:show]:
            console.print(Text(f"  {entry['frame']}  {entry['text']}  ({entry['id']})", "dim"))
    console.print()


def _transitions(verdicts: dict[str, dict[str, int]]) -> RichTable:
    after = [v for v in VERDICTS if any(v in line for line in verdicts.values())]
    table = RichTable(box=None, pad_edge=False, header_style="dim")
    table.add_column("")
    for name in after:
        table.add_column(name, justify="right")
    for name, line in verdicts.items():
        table.add_row(name, *(Text(str(line.get(b, "·")), "dim" if b == name else "") for b in after))
    return table


def run_record(report: RunReport) -> dict[str, Any]:
    """`eval --json`."""
    return {
        "run": str(report.folder),
        "expressions": report.expressions,
        "pairs": report.pairs,
        "warnings": list(report.warnings),
        "shares": [share.record() for share in report.shares],
        "seconds": round(report.seconds, 2),
        "caveats": {t.key: list(t.caveats) for t in report.tables},
        "tables": {t.key: table_record(t) for t in report.tables},
        "comparison": None if report.comparison is None else report.comparison.record(),
    }


def _plain(cell: Cell) -> Any:
    if isinstance(cell, Estimate):
        return cell.record()
    return None if isinstance(cell, float) and math.isnan(cell) else cell
