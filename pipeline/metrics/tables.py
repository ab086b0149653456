"""Tables of figures with intervals, in Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from pipeline.metrics.intervals import Estimate
from pipeline.system.frozen import dataclass

Cell = Estimate | float | int | str | None
"""What stands in a table. Estimates and floats are shares, and are written as percentages."""
NOTHING_SHARED: Mapping[str, Any] = MappingProxyType({})
"""No system has anything in common with what made the truth."""


@dataclass(frozen=True)
class Row:
    """A line of a table: name, cells, and their source.

    >>> from pipeline.metrics import Row, Table, markdown
    >>> print(markdown([Table("srm", "Relations", ("F1", "pairs"), (Row("rules", (0.913, 1200)),))]))
    ## Relations
    <BLANKLINE>
    |  | F1 | pairs |
    |---|---:|---:|
    | rules | 91.3 | 1200 |
    <BLANKLINE>
    """

    name: str
    cells: tuple[Cell, ...]
    source: str = "measured"  # "measured", or "reported" for figures of a publication
    # Where its figures are agreement with what made the truth, and not accuracy: that, in a few words. Such rows stand
    # in blocks of their own below the others, see `in_blocks`
    shares: str = ""


@dataclass(frozen=True)
class Table:
    """A table."""

    key: str  # Its name in files
    title: str
    columns: tuple[str, ...]  # Heads of the cells; the first column, the rows' names, has none
    rows: tuple[Row, ...]
    note: str = ""  # What a reader must know: what is counted, what the intervals are
    # What the figures cannot show, since what is measured and what made the truth have something in common
    caveats: tuple[str, ...] = ()
    decimals: int = 1  # Of percentages without an interval
    # Columns whose shares are written as they are, between 0 and 1, and not as percentages
    fractions: tuple[str, ...] = ()

    def shown(self, row: Row) -> tuple[str, ...]:
        """Cells of a row as text."""
        return tuple(
            shown(cell, self.decimals, name in self.fractions)
            for name, cell in zip(self.columns, row.cells, strict=True)
        )


def in_blocks(rows: Iterable[Row], kinds: Iterable[str] = ()) -> tuple[Row, ...]:
    """Order rows: rows that share nothing first, then by kind, in the order of `kinds`; else in their own order."""
    rows = tuple(rows)
    order = list(dict.fromkeys(["", *kinds, *(row.shares for row in rows)]))
    return tuple(sorted(rows, key=lambda row: order.index(row.shares)))


def with_heads(rows: Sequence[Row]) -> Iterator[tuple[str, Row]]:
    """Yield each row with the title of the block that begins; empty within a block, and where all rows are alike."""
    before = rows[0].shares if rows and len({row.shares for row in rows}) == 1 else ""
    for row in rows:
        yield ("" if row.shares == before else row.shares), row
        before = row.shares


def shown(cell: Cell, decimals: int = 1, fraction: bool = False) -> str:
    """Format a cell: percentages with one decimal (fractions with two), intervals in brackets."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "–"
    if isinstance(cell, Estimate):
        return cell.formatted(1.0, 2) if fraction else cell.formatted()
    if not isinstance(cell, float):
        return str(cell)
    return f"{cell:.2f}" if fraction else f"{100 * cell:.{decimals}f}"


def markdown(tables: Sequence[Table]) -> str:
    """Format tables as Markdown, each under its title."""
    parts = []
    for table in tables:
        lines = [f"## {table.title}", ""]
        lines.append("| " + " | ".join(["", *table.columns]) + " |")
        lines.append("|" + "|".join(["---", *["---:"] * len(table.columns)]) + "|")
        for head, row in with_heads(table.rows):
            if head:
                lines.append("| " + " | ".join([f"*{_bars(head)}*", *[""] * len(table.columns)]) + " |")
            name = row.name if row.source == "measured" else f"{row.name} ({row.source})"
            lines.append("| " + " | ".join(_bars(x) for x in (name, *table.shown(row))) + " |")
        caveats = "\n".join(f"- {caveat}" for caveat in table.caveats)
        parts.append("\n\n".join(part for part in ("\n".join(lines), table.note, caveats) if part))
    return "\n\n".join(parts) + "\n"


def _bars(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def as_csv(table: Table) -> str:
    """Format a table as CSV: an estimate fills three columns: value, low, high. Shares stay between 0 and 1.

    The last column is `Row.shares`.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    estimated = [any(isinstance(row.cells[k], Estimate) for row in table.rows) for k in range(len(table.columns))]
    head = ["row", "source"]
    for name, wide in zip(table.columns, estimated, strict=True):
        head += [name, f"{name} low", f"{name} high"] if wide else [name]
    writer.writerow([*head, "shares"])
    for row in table.rows:
        line: list[object] = [row.name, row.source]
        for cell, wide in zip(row.cells, estimated, strict=True):
            if isinstance(cell, Estimate):
                line += [_number(cell.value), _number(cell.low), _number(cell.high)]
            else:
                line += [_number(cell) if isinstance(cell, float) else cell, *(["", ""] if wide else [])]
        writer.writerow([*line, row.shares])
    return out.getvalue()


def _number(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


_SPECIAL = {c: f"\\{c}" for c in "&%$#_{}"}
_SPECIAL |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"}


def latex(tables: Sequence[Table]) -> str:
    """Format tables as `table` environments with booktabs rules; intervals in small type."""
    parts = ["% needs \\usepackage{booktabs}"]
    for table in tables:
        lines = [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{_tex(table.title)}}}",
            rf"\label{{tab:{table.key}}}",
            rf"\begin{{tabular}}{{l{'r' * len(table.columns)}}}",
            r"\toprule",
            " & ".join(["", *map(_tex, table.columns)]) + r" \\",
            r"\midrule",
        ]
        for head, row in with_heads(table.rows):
            if head:
                lines.append(rf"\midrule \multicolumn{{{1 + len(table.columns)}}}{{l}}{{\emph{{{_tex(head)}}}}} \\")
            name = _tex(row.name) + ("" if row.source == "measured" else r"$^\dagger$")
            lines.append(" & ".join([name, *map(_tex_cell, table.shown(row))]) + r" \\")
        lines += [r"\bottomrule", r"\end{tabular}"]
        if any(row.source != "measured" for row in table.rows):
            lines.append(r"\\ \footnotesize $^\dagger$ as reported")
        lines += [rf"\\ \footnotesize {_tex(caveat)}" for caveat in table.caveats]
        parts.append("\n".join([*lines, r"\end{table}"]))
    return "\n\n".join(parts) + "\n"


def _tex(text: str) -> str:
    return "".join(_SPECIAL.get(c, c) for c in text)


def _tex_cell(text: str) -> str:
    value, _, interval = _tex(text).replace("–", "--").partition(" [")
    return value + (rf" {{\scriptsize [{interval}}}" if interval else "")
