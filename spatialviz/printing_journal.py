"""What a person reads of corrections on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table
from rich.text import Text

from pipeline.corrections.journal.effective import EffectiveLabels
from pipeline.corrections.journal.events import Conflict, Event, Saved
from pipeline.corrections.journal.examining import Examined
from pipeline.corrections.journal.field_refs import shown_value
from pipeline.corrections.journal.incoming.importing import ImportReport
from pipeline.corrections.wording import event_text
from spatialviz.printing import make_console


def print_events(events: Sequence[Event]) -> None:
    """One line an event."""
    console = make_console()
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("time (UTC)", "who", "what", "of", "before", "after", "why"):
        table.add_column(column, overflow="fold")
    for e in events:
        name = e.ref.entity
        did = e.ref.field if e.action == "edit" else f"{e.action}: {e.ref.field}"
        values = (shown_value(e.ref, e.before), shown_value(e.ref, e.after))
        when = e.time.strftime("%Y-%m-%d %H:%M:%S")
        table.add_row(*(Text(x) for x in (when, e.author, did, f"{name} in {e.ref.frame}", *values, e.reason)))
    if events:
        console.print(table)
    console.print(f"{len(events)} events" if events else "nothing was corrected")


def print_outcome(done: Saved | Conflict | None, verb: str) -> None:
    """What was saved, or who had been there."""
    console = make_console()
    if done is None:
        console.print("there is nothing of this person's left to take back or bring back")
    elif isinstance(done, Saved):
        for event in done.events:
            console.print(Text(_said(event)))
        console.print(Text(f"{verb}: {len(done.events)} changes, group {done.group}"))
    else:
        console.print(Text("nothing was saved: somebody else has been there", "yellow"))
        for rival in done.rivals:
            console.print(Text(str(rival)))


def print_effective(found: EffectiveLabels, out: Path, show: int) -> None:
    """Whose the values are, and what no longer applies."""
    console = make_console()
    counts = found.counts
    console.print(
        f"{found.events} events: {counts['human']} values by people, {counts['recomputed']} recomputed, "
        f"{counts['stale']} stale; {counts['withdrawn']} expressions withdrawn, {counts['marks']} marked as wrong"
    )
    if counts["stale"]:
        console.print(Text("stale values follow from masks or boxes: they need the dataset (--dataset)", "yellow"))
    for entry in found.unapplied[:show]:
        line = f"does not apply: {_said(entry.event)} by {entry.event.author}: {entry.reason}"
        console.print(Text(line, "yellow"))
    if len(found.unapplied) > show:
        console.print(Text(f"and {len(found.unapplied) - show} more, in unapplied.json", "yellow"))
    console.print(Text(f"-> {out}", "dim"))


def print_import(report: ImportReport, show: int) -> None:
    """What a file changes, and what stands against it."""
    console = make_console()
    for edit in report.edits[:show]:
        values = (shown_value(edit.ref, value) for value in (edit.before, edit.after))
        console.print(Text(f"{edit.ref}: {' -> '.join(values)}"))
    for lines, style in ((report.conflicts, "yellow"), (report.problems, "red"), (report.notes, "dim")):
        for line in lines[:show]:
            console.print(Text(line, style))
        if len(lines) > show:
            console.print(Text(f"and {len(lines) - show} more", style))
    if len(report.edits) > show:
        console.print(f"{len(report.edits) - show} changes are not shown")
    counted = f"{report.compared} rows compared, {len(report.edits)} changes, {report.agreed} made here already"
    console.print(f"{counted}, {len(report.conflicts)} conflicts, {len(report.problems)} problems")
    if report.saved is not None:
        console.print(Text(f"saved: {len(report.saved.events)} changes, group {report.saved.group}"))
    else:
        console.print("nothing was saved")


def print_examined(found: Examined) -> None:
    """Whether a journal is as it was saved, and what is intact of one that is not."""
    console = make_console()
    for line in found.damage:
        console.print(Text(f"damaged: {line}", "red"))
    if found.damage:
        console.print(Text(found.summary))
        console.print(Text(found.help or "", "yellow"))
    else:
        chained = "" if found.chained else "; not chained yet: the next opening does it, and keeps this one beside"
        console.print(Text(f"{len(found.intact):,} events, all as they were saved{chained}"))
    console.print(Text(found.location, "dim"))


def print_written(found: Examined, made: Examined) -> None:
    """What is in a copy, or in a new journal."""
    console = make_console()
    of = "" if found.events is None else f" of {found.events:,}"
    console.print(Text(f"{len(made.intact):,}{of} events written and checked"))
    left = len(found.intact) - len(made.intact)
    if found.damage and left:
        console.print(Text(f"{left:,} intact ones are left out: they take back what is not intact", "yellow"))
    if found.damage:
        console.print(Text(f"to go on: --journal {made.location}, or put it in the place of the damaged one, without "
                           "the -wal and -shm files of that"))  # fmt: skip
    console.print(Text(f"-> {made.location}", "dim"))


def _said(event: Event) -> str:
    """An event in words, with its frame; the classes of the objects are not at hand."""
    return f"{event.ref.frame}: {event_text(event, None)}"
