"""What a person reads on the terminal."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from pipeline.answering.ask import Trace
from pipeline.answering.json_records import why_no_answer
from pipeline.answering.missed_names import MissedNames
from pipeline.answering.objects import SceneObject
from pipeline.answering.opening import FrameRelations
from pipeline.answering.told_answer import probability, told
from pipeline.datasets import Dataset, FrameReport
from pipeline.datasets.up_text import ASSUMED, DECLARE
from pipeline.diagnosis.asking import JudgedAnswer
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.counted import counted
from pipeline.language.lexicon import wording
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import letter

SHOWN_PAIRS = 5


class _PipeConsole(Console):
    """Leaves a closed pipe to the command line, which knows the right exit status."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def make_console() -> Console:
    """A console that neither wraps in a pipe nor dies of a closed one."""
    console = _PipeConsole(highlight=False, soft_wrap=True)
    if not console.is_terminal:
        # In a pipe there is no edge to wrap at.
        console.width = 160
    return console


def _name(entry: SceneObject, place: int, exact: bool) -> str:
    return f"{entry.label}·{entry.id if exact else place}"


def print_trace(trace: Trace) -> None:
    """The answer, the ranked pairs with their factors, the doubts, and what each stage cost."""
    console = make_console()
    phrase = wording(trace.asked.relation, inverse=trace.asked.inverse)
    console.print(Text.assemble(("frame ", "dim"), trace.frame.id, ("  ", ""), (trace.query.text, "bold")))
    no_answer = why_no_answer(trace)
    if no_answer is not None:
        console.print(Text(no_answer, "yellow"))
    if trace.ranking is not None and no_answer is None:
        pairs = trace.ranking.pairs
        best = pairs[0]
        assert best.reference is not None
        second = "" if best.second_reference is None else f" and {_at(trace, best.second_reference)}"
        answer = told(trace, lambda place: _at(trace, place))
        console.print(
            Text.assemble(
                (answer.lead, "yellow"),
                (_at(trace, best.target), "bold dark_orange"),
                f" {phrase} ",
                (_at(trace, best.reference) + second, "bold dodger_blue2"),
                (f"   {answer.numbers}", "bold" if answer.holds else "yellow"),
            )
        )
        for failing in answer.fails:
            console.print(Text(f"does not hold: {failing}", "yellow"))
        console.print(Text(answer.below, "dim"))
        if len(trace.query.readings) > 1:
            console.print(Text(f"read as: {trace.ranking.reading.description}", "dim"))
        table = Table(box=None, pad_edge=False, header_style="dim")
        for column in ("#", "target", "reference"):
            table.add_column(column)
        for column in ("P(target)", "P(reference)", f"P({phrase})", "product", "posterior"):
            table.add_column(column, justify="right")
        for place, pair in enumerate(pairs[:SHOWN_PAIRS], start=1):
            assert pair.reference is not None
            other = "" if pair.second_reference is None else f", {_at(trace, pair.second_reference)}"
            table.add_row(
                str(place),
                _at(trace, pair.target),
                _at(trace, pair.reference) + other,
                f"{pair.p_target:.2f}",
                f"{pair.p_reference:.2f}",
                f"{pair.p_relation:.2f}",
                probability(pair.product),
                f"{pair.probability:.3f}",
            )
        console.print(table)
        if len(pairs) > SHOWN_PAIRS:
            console.print(Text(f"and {len(pairs) - SHOWN_PAIRS} more pairs", "dim"))
        for role, place in (("target", best.target), ("reference", best.reference)):
            for concern in trace.objects[place].lifted.quality.concerns:
                console.print(Text(f"{role} {_at(trace, place)}: {concern}", "yellow"))
    _warn_assumed(console, trace.viewer)
    stages = " · ".join(f"{k} {v * 1000:.1f} ms" for k, v in trace.timings.items())
    console.print(
        Text(f"{stages} · detector {trace.detector} · relations by {trace.scorer} · up {trace.viewer.up_source}", "dim")
    )


def _warn_assumed(console: Console, viewer: ViewerAxes) -> None:
    if viewer.up_source == "assumed":
        console.print(Text(f"{ASSUMED}; {DECLARE}", "yellow"))


def print_verdict(answer: JudgedAnswer) -> None:
    """What the frame's truth says of the answer: a line, or nothing where no truth is known."""
    if answer.diagnosis is not None:
        found = answer.diagnosis
        name = " ".join(word for word in (found.verdict, found.detail, "LUCKY" if found.lucky else None) if word)
        style = "bold green" if found.correct else "bold yellow"
        make_console().print(Text.assemble(("verdict ", "dim"), (name, style), f"  {answer.diagnosis.text}"))
    elif answer.unjudged is not None:
        make_console().print(Text(f"no verdict: {answer.unjudged}", "dim"))


def print_overlooked(found: MissedNames) -> None:
    """What the detector sees of names that were not found, and what else: a line each."""
    console = make_console()
    for name, score in found.below.items():
        least = math.floor(score * 100) / 100
        if least:
            console.print(Text(f"the best {name!r} has {score:.3f}: --min-score {least:.2f} keeps it", "yellow"))
    if found.seen:
        console.print(Text("the detector finds " + ", ".join(f"{name} {n}" for name, n in found.seen.items()), "dim"))


def _at(trace: Trace, place: int) -> str:
    return _name(trace.objects[place], place, trace.exact)


def print_relations(found: FrameRelations, relations: Sequence[str]) -> None:
    """The relations of a frame that hold (T) or are in doubt (U), a line for each pair."""
    console = make_console()
    up = "" if found.viewer is None else f"  up {found.viewer.up_source}"
    objects = counted(len(found.objects), "object")
    console.print(Text.assemble(("frame ", "dim"), found.frame_id, (f"  {objects}{up}", "dim")))
    if found.viewer is not None:
        _warn_assumed(console, found.viewer)
    for i, a in enumerate(found.objects):
        for j, b in enumerate(found.objects):
            if i == j:
                continue
            said = []
            for r in relations:
                n = found.scores.relations.index(r)
                state = letter(found.scores.states[i, j, n])
                if state != "F":
                    doubt = "?" if state == "U" else ""
                    said.append(f"{PHRASE[r]} {found.scores.probabilities[i, j, n]:.2f}{doubt}")
            if said:
                first, second = _name(a, i, found.exact), _name(b, j, found.exact)
                console.print(Text.assemble(first, (" — ", "dim"), ", ".join(said), (" — ", "dim"), second))


def print_frames(dataset: Dataset, reports: Iterable[FrameReport]) -> int:
    """A line or two for each frame, then their notes, each once; returns how many can be used."""
    console = make_console()
    frames = counted(len(dataset.frame_ids), "frame")
    console.print(Text.assemble((str(dataset.root), "bold"), f"  {dataset.format}, {frames}"))
    usable = 0
    notes: dict[str, list[str]] = {}
    for report in reports:
        usable += report.ok
        if report.ok:
            depth = f"{report.depth_valid or 0:.0%} depth, median {report.median_depth or 0:.2f} m"
            pose = "pose" if report.has_pose else "no pose"
            line = (
                f"{report.index:>5}  {report.id}  {report.width}x{report.height}  {depth}  {pose}"
                f"  up {report.up_source}, {_off_image_up(report.up)} off image-up  "
                f"{counted(report.annotations, 'object')}"
            )
            console.print(Text(line))
            if report.labels:
                console.print(Text("       " + ", ".join(report.labels), "dim"))
        else:
            console.print(Text(f"{report.index:>5}  {report.id}  broken: {report.problem}", "red"))
        for note in report.notes:
            notes.setdefault(note, []).append(report.id)
    for note, frames in notes.items():
        where = frames[0] if len(frames) == 1 else counted(len(frames), "frame")
        console.print(Text(f"note on {where}: {note}", "yellow"))
    return usable


def _off_image_up(up: Sequence[float] | None) -> str:
    return "?" if up is None else f"{math.degrees(math.acos(max(-1.0, min(1.0, -up[1])))):.0f}°"


def print_bench(record: dict[str, Any]) -> None:
    """Milliseconds by stage and the ratios between them."""
    console = make_console()
    sizes = ", ".join(counted(record[f"{what}s"], what) for what in ("frame", "object"))
    console.print(f"{sizes}, {record['width']}x{record['height']}")
    for stage, ms in record["ms_per_frame"].items():
        console.print(f"  {stage:<22} {ms:8.2f} ms")
    for name, ratio in record["ratios"].items():
        console.print(f"  {name:<22} {ratio:8.2f}x")


@contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int], None]]:
    """Bars that appear when first told of, on a terminal; yields a function of (what, done, total)."""
    if not sys.stderr.isatty():
        yield lambda what, done, total: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        tasks: dict[str, Any] = {}

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=total)
            progress.update(tasks[what], completed=done)

        yield tell


@contextmanager
def progress_bar(what: str, total: int) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal, nothing elsewhere; yields a function of (done, total)."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=total)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextmanager
def rate_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar with rate and time left on a terminal, nothing elsewhere; yields a function of (done, total)."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=None, rate="")

        def tell(done: int, total: int) -> None:
            elapsed = progress.tasks[0].elapsed or 0.0
            rate = f"{done / elapsed:.1f} {unit}/s" if elapsed > 0 else ""
            progress.update(task, completed=done, total=total, rate=rate)

        yield tell
