"""Commands exporting labels and importing corrections, with their output for people."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.corrections.journal.field_refs import shown_value
from pipeline.corrections.journal.incoming.importing import (
    ImportConfig,
    ImportReport,
    import_corrections,
    import_record,
)
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal
from pipeline.corrections.journal.materialise import materialise
from pipeline.datasets import Dataset
from pipeline.labels.exports import export_labels
from pipeline.labels.exports.exporting import MARK, HubConfig
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.counted import counted
from pipeline.system.errors import require
from pipeline.system.remote import is_url
from pipeline.system.whole_files import check_target, scratch_folder
from spatialviz.cli_labels import ExportCommand, ImportCommand
from spatialviz.options import BAD, FINE, NO, DatasetOptions, JournalOptions, warn
from spatialviz.printing import rate_bar, say, say_lines


def run_export(command: ExportCommand) -> None:
    automatic = open_labels(command.labels)
    options = None
    if command.licence is not None:
        require(command.format == "parquet", "--licence is for the card of --format parquet")
        options = HubConfig(licence=command.licence)
    require(
        not (not command.corrected and command.journal != JournalOptions()),
        "--journal and --project go with --corrected",
    )
    dataset = None if command.dataset is None else DatasetOptions(dataset=command.dataset).open(automatic)
    with _labels(command, automatic, dataset) as labels, rate_bar("exporting", "frames") as advance:
        report = export_labels(
            labels,
            command.format,
            command.out,
            images=command.images,
            dataset=dataset,
            overwrite=command.overwrite,
            options=options,
            progress=advance,
        )
    warn(*report.notes)
    if command.format in ("coco", "vqa") and command.images == "none":
        warn("the files name images/ that are not there; --images copy writes them")
    rows = ", ".join(f"{count} {name}" for name, count in report.rows.items())
    say(f"{rows} -> {command.out}")


@contextmanager
def _labels(command: ExportCommand, automatic: Labels, dataset: Dataset | None) -> Iterator[Labels]:
    """Labels to export: unchanged, or with the journal applied, in a temporary folder."""
    if not command.corrected:
        yield automatic
        return
    require(
        automatic.manifest.corrections is None,
        "these labels are corrected already",
        cause="leave --corrected out",
        path=command.labels,
    )
    check_target(command.out, overwrite=command.overwrite, mark=MARK)
    with scratch_folder() as folder:
        where = Path(folder) / "corrected"
        with command.journal.open(automatic, must_exist=True) as journal:
            dataset = dataset or DatasetOptions().open(automatic)
            _, found = materialise(automatic, journal, where, dataset=dataset)
        if stale := found.counts["stale"]:
            warn(f"{stale} values are stale: they need the dataset (--dataset)")
        yield open_labels(where)


def run_import(command: ImportCommand) -> int:
    labels = open_labels(command.labels)
    config = ImportConfig(
        format=command.format,
        base=command.base,
        deleted=command.deleted,
        skip_conflicts=command.skip_conflicts,
        reason=command.reason,
        dry_run=command.dry_run,
    )
    with _journal(command, labels) as journal:
        report = import_corrections(
            labels, journal, command.file, command.author, config, open_dataset=lambda: command.source.open(labels)
        )
    command.write(import_record(report), print_import, report, command.show)
    if report.problems:
        count, first = len(report.problems), report.problems[0]
        more = f" (and {count - 1} more problems)" if count > 1 else ""
        warn(f"error: {first}{more}; nothing was saved")
        return BAD
    return NO if report.conflicts else FINE


@contextmanager
def _journal(command: ImportCommand, labels: Labels) -> Iterator[Journal | None]:
    """Journal of an import; a dry run creates none."""
    text = command.journal.journal
    missing = not (text is not None and is_url(text)) and not Path(text or labels.root / JOURNAL_FILE).exists()
    if command.dry_run and missing:
        yield None
        return
    with command.journal.open(labels) as journal:
        yield journal


def print_import(report: ImportReport, show: int) -> None:
    """Print the changes of a file, and objections to the changes."""
    edits = (f"{e.ref}: {shown_value(e.ref, e.before)} -> {shown_value(e.ref, e.after)}" for e in report.edits)
    say_lines(edits, most=show)
    for lines, style in ((report.conflicts, "yellow"), (report.problems, "red"), (report.notes, "dim")):
        say_lines(lines, style, show)
    changes = f"{counted(len(report.edits), 'change')}, {report.agreed} made here already"
    against = f"{counted(len(report.conflicts), 'conflict')}, {counted(len(report.problems), 'problem')}"
    say(f"{counted(report.compared, 'row')} compared, {changes}, {against}")
    saved = report.saved
    say("nothing was saved" if saved is None else f"saved: {counted(len(saved.events), 'change')}, group {saved.group}")
