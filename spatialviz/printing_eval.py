"""What a person reads of an evaluation on the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from rich.table import Table as RichTable
from rich.text import Text

from pipeline.counted import counted
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.compare import Comparison
from pipeline.evaluation.intervals import Estimate
from pipeline.evaluation.job import RunReport
from pipeline.evaluation.tables import Cell, Table, with_heads
from spatialviz.printing import make_console

NAME_WIDTH = 32


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


def rows_record(tables: Iterable[Table]) -> dict[str, Any]:
    """Where the rows of tables come from: by table and row, `source` and `shares` of `tables.Row`."""
    return {t.key: {row.name: {"source": row.source, "shares": row.shares} for row in t.rows} for t in tables}


def rich_table(table: Table) -> RichTable:
    """A table of figures for the terminal; where it is too wide, intervals stand below their figures."""
    found = RichTable(box=None, pad_edge=False, header_style="dim")
    texts = [table.shown(row) for row in table.rows]
    names = [row.name if row.source == "measured" else f"{row.name} ({row.source})" for row in table.rows]
    found.add_column("", min_width=min(max(map(len, names), default=0), NAME_WIDTH))
    for name in table.columns:
        found.add_column(name, justify="right")
    columns = zip(table.columns, *texts, strict=True)
    width = max(map(len, names), default=0) + sum(2 + max(map(len, column)) for column in columns)
    wide = width > make_console().width
    for (head, _), name, cells in zip(with_heads(table.rows), names, texts, strict=True):
        if head:
            found.add_row(Text(head, "italic"), *[""] * len(table.columns))
        found.add_row(name, *(text.replace(" [", "\n[") if wide else text for text in cells))
    return found


def print_comparison(found: Comparison, show: int) -> None:
    """Differences with intervals and tests, and the first expressions of each kind."""
    console = make_console()
    console.print(Text(f"compared on {counted(found.shared, 'expression')}", "bold"))
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
        "rows": rows_record(report.tables),
        "comparison": None if report.comparison is None else report.comparison.record(),
    }


def _plain(cell: Cell) -> Any:
    if isinstance(cell, Estimate):
        return cell.record()
    return None if isinstance(cell, float) and math.isnan(cell) else cell
