"""Commands labelling, merging, checking, exporting and importing labels, with their output for people."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.text import Text

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
from pipeline.geometry.lifting import LiftConfig
from pipeline.labels.by_hand import begun_labels, with_frames
from pipeline.labels.check import check_labels, finding_record
from pipeline.labels.check.view import Finding
from pipeline.labels.exports import export_labels
from pipeline.labels.exports.exporting import MARK, HubConfig
from pipeline.labels.job import LabelReport, label_dataset
from pipeline.labels.merge import merge_labels
from pipeline.labels.plan import CAMERA, SENTENCE_KINDS, LabelConfig
from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import SENTENCES_FILE, Labels, open_labels
from pipeline.labels.report import NUMBERS, summary_lines, summary_tables, write_report
from pipeline.labels.schema import Manifest
from pipeline.labels.selection import SelectConfig
from pipeline.labels.statistics import label_statistics
from pipeline.language.counted import counted
from pipeline.system.errors import InputError, require
from pipeline.system.remote import is_url
from pipeline.system.whole_files import check_target, scratch_folder
from spatialviz.cli_labels import CheckCommand, ExportCommand, ImportCommand, LabelCommand, MergeCommand, Selection
from spatialviz.options import BAD, FINE, NO, DatasetOptions, JournalOptions, print_json, task_of, warn
from spatialviz.printing import print_rows, print_table, rate_bar, say, say_lines

COLORS = {"error": "red", "warning": "yellow"}


def run_label(command: LabelCommand) -> int:
    config = LabelConfig(
        profile=command.profile,
        vocabulary=command.vocabulary,
        lift=LiftConfig(box=command.box),
        style=command.style,
        seed=command.seed,
        second_opinion=command.second_opinion,
        sentences=SENTENCE_KINDS if command.sentences == () else command.sentences or (),
        sentences_a_kind=command.sentences_a_kind,
    )
    if command.empty:
        return _begin(command, config)
    part, spec, selection = task_of(command.shard), command.source.spec(command.dataset), _selection(command.selection)
    try:
        with rate_bar("labelling", "frames") as advance:
            report = label_dataset(
                spec,
                command.out,
                config,
                selection,
                engine=command.engine,
                workers=command.workers,
                part=part,
                resume=command.resume,
                limit=command.limit,
                frames_of=command.frames_of,
                gpus_a_detector=command.gpus_a_detector,
                progress=advance,
            )
    except KeyboardInterrupt:
        more = "run the same command again" + ("" if part else " with --resume")
        warn(f"finished shards are kept in {command.out}; to go on, {more}")
        raise
    manifest = report.manifest
    record = {
        "frames": report.frames,
        "reused": report.reused,
        "broken": report.broken,
        "frames_up_assumed": None if manifest is None else manifest.counts["frames_up_assumed"],
        "objects": report.objects,
        "pairs": report.pairs,
        "candidates": report.candidates,
        "seconds": round(report.seconds, 3),
        "expressions": None if manifest is None else manifest.counts["expressions"],
        "sentences": None if manifest is None else manifest.sentences,
        "hashes": None if manifest is None else {n: t.content_hash for n, t in manifest.tables.items()},
    }
    command.write(record, print_labelled, report, command.out)
    # A task of more than there are shards has nothing to do, and that is fine.
    return FINE if report.frames > report.broken or not report.frames else NO


def _begin(command: LabelCommand, config: LabelConfig) -> int:
    """Labels to be filled by hand."""
    spec = command.source.spec(command.dataset).absolute()
    camera = {name: spec.options.get(name) for name in CAMERA}
    dataset = spec.open(config).dataset
    new = begun_labels(dataset, command.out, camera, replace(config, vocabulary="all"))
    labels = with_frames(new, dataset, dataset.frame_ids[: command.limit] if command.limit else ())
    frames = labels.frames.num_rows
    command.write({"frames": frames}, lambda _: say(f"-> {command.out}: labels by hand, {counted(frames, 'frame')}"))
    return FINE


def run_merge(command: MergeCommand) -> None:
    manifest = merge_labels(command.labels, _selection(command.selection), command.to)
    command.write(json.loads(manifest.model_dump_json()), print_manifest, manifest, str(command.to or command.labels))


def run_check(command: CheckCommand) -> int:
    labels = open_labels(command.labels)
    if command.report is not None:
        check_target(command.report.expanduser(), overwrite=True, mark=NUMBERS)
    statistics = problem = None
    try:
        statistics = label_statistics(labels)
    except InputError as error:
        # A damaged table is first of all a finding.
        problem = error
    found = check_labels(labels, rules=command.rules or None)
    errors = 0
    for finding in found if command.json else ():
        errors += finding.severity == "error"
        print_json(finding_record(finding))
    if statistics is not None:
        record = {"statistics": statistics, "makers": makers_of(labels.manifest).record()}
        command.write(record, print_statistics, statistics, labels)
    if not command.json:
        errors = print_findings(found, command.show)
    if problem is not None and not errors:
        raise problem
    if command.report is not None and statistics is not None:
        page = write_report(labels, statistics, command.report)[0]
        if not command.json:
            say(f"-> {page}")
    return NO if errors else FINE


def print_statistics(statistics: dict[str, Any], labels: Labels) -> None:
    """Print the contents of labels."""
    say((str(labels.root), "bold"), (f"  rules {labels.manifest.profile.get('name')}", "dim"))
    say_lines(summary_lines(labels, statistics))
    for table in summary_tables(statistics):
        say()
        print_table(table)
    say()


def _selection(options: Selection) -> SelectConfig:
    telling = not options.keep_vague
    return SelectConfig(
        options.expressions, options.per_frame, options.balance or None, options.selection_seed, telling
    )


def print_labelled(report: LabelReport, out: str) -> None:
    """Print counts, speed, and the next step."""
    new = report.frames - report.reused
    rate = f", {new / report.seconds:.1f} frames/s" if new and report.seconds else ""
    reused = f" ({report.reused} were there already)" if report.reused else ""
    say(
        f"{counted(report.frames, 'frame')}{reused}: {counted(report.objects, 'object')}, "
        f"{counted(report.pairs, 'pair')}, "
        f"{report.candidates} candidate expressions in {report.seconds:.1f} s{rate}"
    )
    if report.broken:
        say(f"{counted(report.broken, 'frame')} could not be used; the manifest says why", style="yellow")
    if report.manifest is None:
        say(f"-> {out}; when all shards are there: spatialviz label --merge {out}")
    else:
        print_manifest(report.manifest, out)


def print_manifest(manifest: Manifest, out: str) -> None:
    """Print counts and hashes of merged labels."""
    say(
        f"{manifest.counts['expressions']} of {manifest.counts['candidates']} candidate expressions kept, "
        f"rules {manifest.profile['name']} {manifest.profile_hash[:12]}, settings {manifest.config_hash[:12]}"
    )
    if made := manifest.sentences:
        kinds = ", ".join(f"{count} {kind}" for kind, count in made.items())
        say(f"{counted(sum(made.values()), 'sentence')} in {SENTENCES_FILE}: {kinds}")
    rows = ((name, str(entry.rows), entry.content_hash[:16]) for name, entry in manifest.tables.items())
    print_rows(("table", ">rows", "hash of its rows"), rows)
    say_lines(manifest.warnings, "yellow", 5, ", in the manifest")
    say(f"-> {out}", style="dim")


def print_findings(findings: Iterable[Finding], show: int) -> int:
    """Count findings by rule, errors first, then show up to `show` of each; returns the number of errors.

    Findings may be many: those that are not shown are counted and let go.
    """
    counts: Counter[tuple[str, str]] = Counter()
    kept: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        kind = finding.severity, finding.rule
        counts[kind] += 1
        if counts[kind] <= show:
            kept.setdefault(kind, []).append(finding)
    rows = ((rule, Text(severity, COLORS[severity]), f"{n:,}") for (severity, rule), n in sorted(counts.items()))
    if counts:
        print_rows(("rule", "", ">findings"), rows)
    for kind, shown in sorted(kept.items()):
        say()
        for finding in shown:
            say(_line(finding))
        if more := counts[kind] - len(shown):
            say(f"and {more:,} more of {kind[1]}", style="dim")
    errors, warnings = (sum(n for (s, _), n in counts.items() if s == severity) for severity in COLORS)
    say()
    color = "red" if errors else "yellow" if warnings else "green"
    say(f"{counted(errors, 'error')}, {counted(warnings, 'warning')}", style=color)
    return errors


def _line(finding: Finding) -> Text:
    where = [] if finding.frame is None else [finding.frame]
    if finding.objects:
        where.append(("object " if len(finding.objects) == 1 else "objects ") + ", ".join(map(str, finding.objects)))
    figures = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in finding.figures.items())
    return Text.assemble(
        (finding.rule, COLORS[finding.severity]),
        "  ",
        (" ".join([*where, ""]), "dim"),
        finding.message,
        (f"  ({figures})" if figures else "", "dim"),
    )


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
