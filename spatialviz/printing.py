"""What is printed for people on the terminal: lines, tables, progress."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Cell, with_heads
from pipeline.metrics.tables import Table as ResultTable

NAME_WIDTH = 32


class _PipeConsole(Console):
    """Leaves a closed pipe to the command line, which knows the right exit status."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


@lru_cache(maxsize=1)
def console() -> Console:
    """The console; it neither wraps in a pipe nor dies of a closed one."""
    made = _PipeConsole(highlight=False, soft_wrap=True)
    if not made.is_terminal:
        # In a pipe there is no edge to wrap at.
        made.width = 160
    return made


def say(*parts: str | Text | tuple[str, str], style: str = "") -> None:
    """A line of parts: text, not markup, or (text, style)."""
    console().print(Text.assemble(*parts, style=style))


def table(columns: Iterable[str], rows: Iterable[Iterable[str | Text]], **each: Any) -> Table:
    """Rows under their heads; a head that begins with ">" is of figures, which stand to the right.

    Cells are text, not markup. `each` is for every column, as `rich.table.Table.add_column` takes it.
    """
    found = Table(box=None, pad_edge=False, header_style="dim")
    for name in columns:
        found.add_column(Text(name.removeprefix(">")), justify="right" if name.startswith(">") else "left", **each)
    for row in rows:
        found.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    return found


def print_rows(columns: Iterable[str], rows: Iterable[Iterable[str | Text]], **each: Any) -> None:
    """Print a `table`."""
    console().print(table(columns, rows, **each))


def figure(value: float | None, form: str = ".4f", none: str = "-") -> str:
    """A number in its form; a dash where there is none."""
    return none if value is None else format(value, form)


@contextmanager
def progress_bars() -> Iterator[Callable[..., None]]:
    """Bars that appear when first told of, on a terminal; yields a function of (what, done, total, note="")."""
    if not sys.stderr.isatty():
        yield lambda what, done, total, note="": None
        return
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    shown = (TextColumn("{task.description}"), *columns)
    with Progress(*shown, console=Console(stderr=True), transient=True) as progress:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int, note: str = "") -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=total, note=note)
            progress.update(tasks[what], completed=done, total=total, note=note)

        yield tell


@contextmanager
def rate_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with rate and time left, as `progress_bars`; yields a function of (done, total)."""
    start = time.monotonic()
    with progress_bars() as tell:
        yield lambda done, of: tell(what, done, of, f"{done / max(time.monotonic() - start, 1e-9):.1f} {unit}/s")


def print_table(found: ResultTable, caveats: bool = True) -> None:
    """A table under its title, and what must be known of it."""
    say(found.title, style="bold")
    console().print(rich_table(found))
    if found.note:
        say(found.note, style="dim")
    for caveat in found.caveats if caveats else ():
        say(caveat, style="yellow")


def table_record(found: ResultTable) -> dict[str, Any]:
    """A table as JSON: by row and column; an estimate as {value, low, high, n, clusters, note}."""
    return {row.name: dict(zip(found.columns, map(_plain, row.cells), strict=True)) for row in found.rows}


def rows_record(tables: Iterable[ResultTable]) -> dict[str, Any]:
    """Where the rows of tables come from: by table and row, `source` and `shares` of `tables.Row`."""
    return {t.key: {row.name: {"source": row.source, "shares": row.shares} for row in t.rows} for t in tables}


def rich_table(found: ResultTable) -> Table:
    """A table of figures for the terminal; where it is too wide, intervals stand below their figures."""
    texts = [found.shown(row) for row in found.rows]
    names = [row.name if row.source == "measured" else f"{row.name} ({row.source})" for row in found.rows]
    longest = max(map(len, names), default=0)
    columns = zip(found.columns, *texts, strict=True)
    wide = longest + sum(2 + max(map(len, column)) for column in columns) > console().width
    made = table(("", *(f">{name}" for name in found.columns)), ())
    made.columns[0].min_width = min(longest, NAME_WIDTH)
    for (head, _), name, cells in zip(with_heads(found.rows), names, texts, strict=True):
        if head:
            made.add_row(Text(head, "italic"))
        made.add_row(Text(name), *(text.replace(" [", "\n[") if wide else text for text in cells))
    return made


def _plain(cell: Cell) -> Any:
    if isinstance(cell, Estimate):
        return cell.record()
    return None if isinstance(cell, float) and math.isnan(cell) else cell
