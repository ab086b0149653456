"""Console of rich, and tables drawn by it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from rich.console import Console
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from pipeline.metrics.tables import Table as ResultTable
from pipeline.metrics.tables import with_heads
from spatialviz.plain_text import PIPE_WIDTH, one_line, plain, unfiltered

NAME_WIDTH = 32


class PipeConsole(Console):
    """Console with plain output, leaving a closed pipe to the command line with its exit status."""

    @property
    def file(self) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        return unfiltered(super().file)

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        return super()._render_buffer(s if s.control else Segment(plain(s.text), s.style) for s in buffer)

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


@lru_cache(maxsize=1)
def console() -> Console:
    """Console without wrapping in a pipe, robust to a closed pipe."""
    made = PipeConsole(highlight=False, soft_wrap=True)
    if not made.is_terminal:
        made.width = PIPE_WIDTH
    return made


def table(columns: Iterable[str], rows: Iterable[Iterable[str | Text]], **each: Any) -> Table:
    """Table of rows under heads; a head beginning with ">" is right-aligned.

    Cells are text, not markup. `each` is for every column, as `rich.table.Table.add_column` takes it.
    """
    found = Table(box=None, pad_edge=False, header_style="dim")
    for name in columns:
        found.add_column(Text(name.removeprefix(">")), justify="right" if name.startswith(">") else "left", **each)
    for row in rows:
        found.add_row(*(Text(one_line(cell)) if isinstance(cell, str) else cell for cell in row))
    return found


def rich_table(found: ResultTable) -> Table:
    """Table of figures for the terminal; a too wide table has intervals below the figures."""
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
