"""Terminal output for people: lines, tables, progress, and counts of datasets."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from rich.console import Console
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from pipeline.language.counted import counted, listed, share_text
from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Cell, with_heads
from pipeline.metrics.tables import Table as ResultTable
from spatialviz.plain_text import one_line, plain, unfiltered

NAME_WIDTH = 32


class _PipeConsole(Console):
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
    made = _PipeConsole(highlight=False, soft_wrap=True)
    if not made.is_terminal:
        # In a pipe there is no edge to wrap at.
        made.width = 160
    return made


def say(*parts: str | Text | tuple[str, str], style: str = "") -> None:
    """Print a line of parts: text, not markup, or (text, style)."""
    console().print(Text.assemble(*map(_on_one_line, parts), style=style))


def say_lines(lines: Iterable[str], style: str = "", most: int | None = None, where: str = "") -> None:
    """Print lines but for empty ones, at most so many, then the number of the rest, with `where` they are."""
    told = [line for line in lines if line]
    for line in told[:most]:
        say(line, style=style)
    if most is not None and len(told) > most:
        say(f"and {len(told) - most} more{where}", style=style)


def _on_one_line(part: str | Text | tuple[str, str]) -> str | Text | tuple[str, str]:
    if isinstance(part, Text):
        return part
    return one_line(part) if isinstance(part, str) else (one_line(part[0]), part[1])


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


def print_rows(columns: Iterable[str], rows: Iterable[Iterable[str | Text]], **each: Any) -> None:
    """Print a `table`."""
    console().print(table(columns, rows, **each))


def figure(value: float | None, form: str = ".4f", none: str = "-") -> str:
    """Number in a format; a dash for none."""
    return none if value is None else format(value, form)


@contextmanager
def progress_bars() -> Iterator[Callable[..., None]]:
    """Progress bars on a terminal, shown on first use; else a line every 10 s on stderr. Yields a function of
    (what, done, total, note="")."""
    if not sys.stderr.isatty():
        with _progress_lines() as tell:
            yield tell
        return
    # A hundredth of a second of imports, which most commands need not.
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    shown = (TextColumn("{task.description}"), *columns)
    with Progress(*shown, console=_PipeConsole(stderr=True), transient=True) as progress:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int, note: str = "") -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=total, note=note)
            progress.update(tasks[what], completed=done, total=total, note=note)

        yield tell


LINE_SECONDS = 10.0
"""Where no terminal is, progress is told as often."""


@contextmanager
def _progress_lines() -> Iterator[Callable[..., None]]:
    """Lines on stderr of what was told last, from a thread: also of a step that takes long."""
    last: list[tuple[str, int, int, str]] = []
    over, start = threading.Event(), time.monotonic()

    def lines() -> None:
        while not over.wait(LINE_SECONDS):
            what, done, total, note = last[-1] if last else ("working", 0, 0, "")
            counts = f" {done:,} of {total:,}" if total else ""
            told = f"{what}{counts and f':{counts}'}{f', {note}' if note else ''}, {time.monotonic() - start:.0f} s"
            print(f"spatialviz: {plain(told)}", file=sys.stderr, flush=True)

    thread = threading.Thread(target=lines, daemon=True)
    thread.start()
    try:
        yield lambda what, done, total, note="": last.__setitem__(slice(None), [(what, done, total, note)])
    finally:
        over.set()
        thread.join()


@contextmanager
def rate_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Progress bar with rate and time left, as `progress_bars`; yields a function of (done, total)."""
    start = time.monotonic()
    with progress_bars() as tell:
        yield lambda done, of: tell(what, done, of, f"{done / max(time.monotonic() - start, 1e-9):.1f} {unit}/s")


def print_table(found: ResultTable, caveats: bool = True) -> None:
    """Print a table with title and caveats."""
    say(found.title, style="bold")
    console().print(rich_table(found))
    say_lines([found.note], "dim")
    say_lines(found.caveats if caveats else (), "yellow")


def table_record(found: ResultTable) -> dict[str, Any]:
    """JSON record of a table: by row and column; an estimate as {value, low, high, n, clusters, note}."""
    return {row.name: dict(zip(found.columns, map(_plain, row.cells), strict=True)) for row in found.rows}


def rows_record(tables: Iterable[ResultTable]) -> dict[str, Any]:
    """Sources of table rows: by table and row, `source` and `shares` of `tables.Row`."""
    return {t.key: {row.name: {"source": row.source, "shares": row.shares} for row in t.rows} for t in tables}


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


def _plain(cell: Cell) -> Any:
    if isinstance(cell, Estimate):
        return cell.record()
    return None if isinstance(cell, float) and math.isnan(cell) else cell


SUMMARY_CLASSES = 20


NOT_DECODED = "their depth, annotations and up, and whether their pictures are whole, were not looked at"


def print_summary(summary: dict[str, Any]) -> None:
    """Print counts over the frames of a dataset."""
    frames, usable = summary["frames"], summary["frames_usable"]
    say(f"{usable:,} of {counted(frames, 'frame')} can be used")
    say_lines((f"  note: {note}" for note in summary["notes"]), "yellow")
    remedies = {reason: f"; {text}" for reason, text in summary["remedies"].items()}
    broken = ((count, reason + remedies.get(reason, "")) for reason, count in summary["problems"].items())
    say_lines((f"  {count:,} broken: {why}" for count, why in broken), "red", 5, " reasons")
    if not usable:
        return
    left = usable - summary["frames_decoded"]
    if left:
        say(f"  {left:,} were not decoded (--decode): {NOT_DECODED}", style="yellow")
    say(f"  {listed(summary['sizes'])}; up {listed(summary['up_source'])}", style="dim")
    lacking = {
        "with little depth": summary["frames_with_little_depth"],
        "without pose": summary["frames_without_pose"],
        "without objects": summary["frames_without_objects"],
        "with notes": summary["frames_with_notes"],
    }
    frames_lacking = ", ".join(f"{count:,} {what}" for what, count in lacking.items() if count)
    depth = f"{share_text(summary['depth_valid'])} of the pixels have depth"
    say(f"  {depth}" + (f"; frames: {frames_lacking}" if frames_lacking else ""), style="dim")
    if classes := summary["classes"]:
        objects = f"{counted(summary['objects'], 'object')} of {counted(len(classes), 'class')}"
        names = listed(classes, SUMMARY_CLASSES)
        say(f"{objects}, {summary['objects_per_frame']:.1f} a frame: ", (names, "dim"))
