"""Terminal output for people: lines, tables, progress, and counts of datasets."""

from __future__ import annotations

import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pipeline.language.counted import counted, listed, share_text
from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Cell
from pipeline.metrics.tables import Table as ResultTable
from spatialviz.plain_text import PIPE_WIDTH, one_line, plain

if TYPE_CHECKING:
    from rich.text import Text


def say(*parts: str | Text | tuple[str, str], style: str = "") -> None:
    """Print a line of parts: text, not markup, or (text, style)."""
    texts = [p if isinstance(p, str) else p[0] if isinstance(p, tuple) else p.plain for p in parts]
    if not colored() and "\t" not in (line := one_line("".join(texts))):
        # A line to a file or a pipe is its text: rich takes 30 ms to load, and as long for 400 lines.
        print(line, flush=True)
        return
    from rich.text import Text

    from spatialviz.terminal import console

    console().print(Text.assemble(*map(_on_one_line, parts), style=style))


def colored() -> bool:
    """Whether lines may be more than their text: on a terminal, and where the environment asks for colours."""
    return sys.stdout.isatty() or any(map(os.environ.get, ("TTY_COMPATIBLE", "FORCE_COLOR")))


def say_lines(lines: Iterable[str], style: str = "", most: int | None = None, where: str = "") -> None:
    """Print lines but for empty ones, at most so many, then the number of the rest, with `where` they are."""
    told = [line for line in lines if line]
    for line in told[:most]:
        say(line, style=style)
    if most is not None and len(told) > most:
        say(f"and {len(told) - most} more{where}", style=style)


def _on_one_line(part: str | Text | tuple[str, str]) -> str | Text | tuple[str, str]:
    if isinstance(part, str):
        return one_line(part)
    return (one_line(part[0]), part[1]) if isinstance(part, tuple) else part


def print_rows(columns: Iterable[str], rows: Iterable[Iterable[str | Text]], **each: Any) -> None:
    """Print a table of `terminal.table`."""
    heads, cells = [*columns], [[*row] for row in rows]
    if not each and not colored() and (lines := _plain_lines(heads, cells)):
        print("\n".join(lines), flush=True)
        return
    from spatialviz.terminal import console, table

    console().print(table(heads, cells, **each))


_LATIN = re.compile("|[ -~\u00a1-\u02ff]*[!-~\u00a1-\u02ff]")
"""Characters of one column each, without a blank at the end; all else is for rich to measure."""


def _plain_lines(heads: list[str], rows: list[list[str | Text]]) -> list[str]:
    """Lines of a table as rich draws them without colours, which takes it 40 ms to load; none where it may differ."""
    if any(len(row) != len(heads) for row in rows):
        return []
    names = [head.removeprefix(">") for head in heads]
    texts = [names, *([cell if isinstance(cell, str) else cell.plain for cell in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    fits = all(widths) and sum(widths) + 2 * (len(widths) - 1) <= PIPE_WIDTH
    if not fits or not all(_LATIN.fullmatch(t) for row in texts for t in row):
        return []
    sides = [str.rjust if head.startswith(">") else str.ljust for head in heads]
    return ["  ".join(side(t, w) for side, t, w in zip(sides, row, widths, strict=True)) for row in texts]


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

    from spatialviz.terminal import PipeConsole

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    shown = (TextColumn("{task.description}"), *columns)
    with Progress(*shown, console=PipeConsole(stderr=True), transient=True) as progress:
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
    from spatialviz.terminal import console, rich_table

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
