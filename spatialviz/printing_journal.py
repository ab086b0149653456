"""What a person reads of corrections on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.table import Table
from rich.text import Text

from pipeline.correcting.wording import said_event
from pipeline.counted import counted
from pipeline.errors import InputError
from pipeline.journal.cells import shown_value
from pipeline.journal.effective import Corrector, EffectiveLabels
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Conflict, Event, Saved
from pipeline.journal.examining import Examined
from pipeline.journal.incoming.importing import ImportReport
from pipeline.journal.journal import Journal
from spatialviz.printing import make_console

FrameOf = Callable[[str], EffectiveFrame | None]


def print_events(events: Sequence[Event]) -> None:
    """One line an event."""
    console = make_console()
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("time (UTC)", "who", "what", "of", "before", "after", "why"):
        table.add_column(column, overflow="fold")
    for e in events:
        name = e.cell.entity
        did = e.cell.field if e.action == "edit" else f"{e.action}: {e.cell.field}"
        values = (shown_value(e.cell, e.before), shown_value(e.cell, e.after))
        when = e.time.strftime("%Y-%m-%d %H:%M:%S")
        table.add_row(*(Text(x) for x in (when, e.author, did, f"{name} in {e.cell.frame}", *values, e.reason)))
    if events:
        console.print(table)
    console.print(counted(len(events), "event") if events else "nothing was corrected")


def print_outcome(done: Saved | Conflict | None, verb: str, frame_of: FrameOf) -> None:
    """What was saved, or who had been there."""
    console = make_console()
    if done is None:
        console.print("there is nothing of this person's left to take back or bring back")
    elif isinstance(done, Saved):
        for event in done.events:
            console.print(Text(_said(event, frame_of)))
        console.print(Text(f"{verb}: {counted(len(done.events), 'change')}, group {done.group}"))
    else:
        console.print(Text("nothing was saved: somebody else has been there", "yellow"))
        for rival in done.rivals:
            console.print(Text(str(rival)))


def print_effective(found: EffectiveLabels, out: Path, show: int) -> None:
    """Whose the values are, and what no longer applies."""
    console = make_console()
    counts = found.counts
    console.print(
        f"{counted(found.events, 'event')}: {counted(counts['human'], 'value')} by people, {counts['recomputed']} "
        f"recomputed, {counts['stale']} stale; {counted(counts['withdrawn'], 'expression')} withdrawn, "
        f"{counts['marks']} marked as wrong"
    )
    if counts["stale"]:
        console.print(Text("stale values follow from masks or boxes: they need the dataset (--dataset)", "yellow"))
    frame_of = frames_of(Corrector(found.labels), ())
    for entry in found.unapplied[:show]:
        line = f"does not apply: {_said(entry.event, frame_of)} by {entry.event.author}: {entry.reason}"
        console.print(Text(line, "yellow"))
    if len(found.unapplied) > show:
        console.print(Text(f"and {len(found.unapplied) - show} more, in unapplied.json", "yellow"))
    console.print(Text(f"-> {out}", "dim"))


def print_import(report: ImportReport, show: int) -> None:
    """What a file changes, and what stands against it."""
    console = make_console()
    for edit in report.edits[:show]:
        values = (shown_value(edit.cell, value) for value in (edit.before, edit.after))
        console.print(Text(f"{edit.cell}: {' -> '.join(values)}"))
    for lines, style in ((report.conflicts, "yellow"), (report.problems, "red"), (report.notes, "dim")):
        for line in lines[:show]:
            console.print(Text(line, style))
        if len(lines) > show:
            console.print(Text(f"and {len(lines) - show} more", style))
    if len(report.edits) > show:
        console.print(f"and {counted(len(report.edits) - show, 'more change')}")
    changes = f"{counted(len(report.edits), 'change')}, {report.agreed} made here already"
    against = f"{counted(len(report.conflicts), 'conflict')}, {counted(len(report.problems), 'problem')}"
    console.print(f"{counted(report.compared, 'row')} compared, {changes}, {against}")
    if report.saved is not None:
        console.print(Text(f"saved: {counted(len(report.saved.events), 'change')}, group {report.saved.group}"))
    else:
        console.print("nothing was saved")


def print_examined(found: Examined) -> None:
    """Whether a journal is as it was saved, and what is intact of one that is not."""
    console = make_console()
    for line in found.damage:
        console.print(Text(f"damaged: {line}", "red"))
    if found.damage:
        console.print(Text(found.said))
        console.print(Text(found.help or "", "yellow"))
    else:
        chained = "" if found.chained else "; not chained yet: the next opening does it, and keeps this one beside"
        console.print(Text(f"{counted(len(found.intact), 'event')}, all as they were saved{chained}"))
    console.print(Text(found.place, "dim"))


def print_written(found: Examined, made: Examined) -> None:
    """What is in a copy, or in a new journal."""
    console = make_console()
    intact = len(made.intact)
    said = counted(intact, "event") if found.events is None else f"{intact:,} of {counted(found.events, 'event')}"
    console.print(Text(f"{said} written and checked"))
    left = len(found.intact) - len(made.intact)
    if found.damage and left:
        console.print(Text(f"{left:,} intact ones are left out: they take back what is not intact", "yellow"))
    if found.damage:
        console.print(Text(f"to go on: --journal {made.place}, or put it in the place of the damaged one, without the "
                           "-wal and -shm files of that"))  # fmt: skip
    console.print(Text(f"-> {made.place}", "dim"))


def frames_of(corrector: Corrector, journal: Journal | Sequence[Event]) -> FrameOf:
    """Frames by name, for the classes of objects in what is said; None for one that the labels do not have."""

    def frame_of(frame: str) -> EffectiveFrame | None:
        try:
            return corrector.frame(frame, journal)
        except InputError:
            return None

    return frame_of


def _said(event: Event, frame_of: FrameOf) -> str:
    """An event in words, with its frame."""
    return f"{event.cell.frame}: {said_event(event, frame_of(event.cell.frame))}"
