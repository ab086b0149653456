"""Tables of figures with intervals, in Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.evaluation.intervals import Estimate

Cell = Estimate | float | int | str | None
"""What stands in a table. Estimates and floats are shares, and are written as percentages."""


@dataclass(frozen=True)
class Row:
    """A line of a table: its name, its cells, and where they come from.

    Attributes
    ----------
    name : str
    cells : tuple of Cell
    source : str
        "measured", or "reported" for figures of a publication.
    """

    name: str
    cells: tuple[Cell, ...]
    source: str = "measured"


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    key : str
        Its name in files.
    title : str
    columns : tuple of str
        Heads of the cells; the first column, the rows' names, has none.
    rows : tuple of Row
    note : str
        What a reader must know: what is counted, what the intervals are.
    """

    key: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    note: str = ""


def shown(cell: Cell) -> str:
    """A cell as text: percentages with one decimal, intervals in brackets."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "–"
    if isinstance(cell, Estimate):
        return cell.formatted()
    return f"{100 * cell:.1f}" if isinstance(cell, float) else str(cell)


def markdown(tables: Sequence[Table]) -> str:
    """All tables, each under its title."""
    parts = []
    for table in tables:
        lines = [f"## {table.title}", ""]
        lines.append("| " + " | ".join(["", *table.columns]) + " |")
        lines.append("|" + "|".join(["---", *["---:"] * len(table.columns)]) + "|")
        for row in table.rows:
            name = row.name if row.source == "measured" else f"{row.name} ({row.source})"
            lines.append("| " + " | ".join(_bars(x) for x in (name, *map(shown, row.cells))) + " |")
        parts.append("\n".join([*lines, *(["", table.note] if table.note else [])]))
    return "\n\n".join(parts) + "\n"


def _bars(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def as_csv(table: Table) -> str:
    """One line a row; an estimate fills three columns: value, low, high. Shares stay between 0 and 1."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    estimated = [
        any(isinstance(row.cells[k], Estimate) for row in table.rows) for k in range(len(table.columns))
    ]
    head = ["row", "source"]
    for name, wide in zip(table.columns, estimated, strict=True):
        head += [name, f"{name} low", f"{name} high"] if wide else [name]
    writer.writerow(head)
    for row in table.rows:
        line: list[object] = [row.name, row.source]
        for cell, wide in zip(row.cells, estimated, strict=True):
            if isinstance(cell, Estimate):
                line += [_number(cell.value), _number(cell.low), _number(cell.high)]
            else:
                line += [_number(cell) if isinstance(cell, float) else cell, *(["", ""] if wide else [])]
        writer.writerow(line)
    return out.getvalue()


def _number(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


_SPECIAL = {c: f"\\{c}" for c in "&%$#_{}"}
_SPECIAL |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"}


def latex(tables: Sequence[Table]) -> str:
    """All tables as `table` environments with booktabs rules; intervals in small type."""
    parts = ["% needs \\usepackage{booktabs}"]
    for table in tables:
        lines = [
            r"\begin{table}", r"\centering", rf"\caption{{{_tex(table.title)}}}", rf"\label{{tab:{table.key}}}",
            rf"\begin{{tabular}}{{l{'r' * len(table.columns)}}}", r"\toprule",
            " & ".join(["", *map(_tex, table.columns)]) + r" \\", r"\midrule",
        ]  # fmt: skip
        for row in table.rows:
            name = _tex(row.name) + ("" if row.source == "measured" else r"$^\dagger$")
            lines.append(" & ".join([name, *map(_tex_cell, row.cells)]) + r" \\")
        lines += [r"\bottomrule", r"\end{tabular}"]
        if any(row.source != "measured" for row in table.rows):
            lines.append(r"\\ \footnotesize $^\dagger$ as reported")
        parts.append("\n".join([*lines, r"\end{table}"]))
    return "\n\n".join(parts) + "\n"


def _tex(text: str) -> str:
    return "".join(_SPECIAL.get(c, c) for c in text)


def _tex_cell(cell: Cell) -> str:
    if not isinstance(cell, Estimate):
        return _tex(shown(cell)).replace("–", "--")
    value, _, interval = shown(cell).replace("–", "--").partition(" ")
    return value + (rf" {{\scriptsize {interval}}}" if interval else "")
