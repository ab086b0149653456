"""Labels that are probably wrong: their review, the audit of labels and benchmarks, and what a person reads of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

from pipeline.audit.report import AuditReport, audit
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import setting_of
from pipeline.corrections.journal.journal import JOURNAL_FILE
from pipeline.corrections.review.doubts import DoubtConfig
from pipeline.corrections.review.items import Judgements, PairAgreement, pair_agreements
from pipeline.corrections.review.queue import (
    DISAGREE,
    automatic_version,
    read_relation_labels,
    review_queue,
    reviewed_labels,
    states_on_labels,
)
from pipeline.corrections.review.worklist import (
    NOTHING,
    Worklist,
    read_queue,
    refreshed_worklist,
    worklist,
    write_queue,
)
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.system.errors import MissingExtra, needed, require
from pipeline.system.whole_files import scratch_folder
from pipeline.training.train import need_torch
from spatialviz.cli_labels import AuditCommand, ReviewCommand
from spatialviz.options import FINE, NO, warn
from spatialviz.printing import figure, print_rows, print_table, progress_bars, rate_bar, say, say_lines


def run_review(command: ReviewCommand) -> int:
    require(command.limit >= 0, "--limit must not be negative", got=command.limit)
    require(command.author is None or not command.all, "--all and --author exclude each other")
    labels = open_labels(command.labels)
    with scratch_folder() as folder:
        effective, judgements = _reviewed(command, labels, Path(folder) / "labels")
        if command.agreement:
            pairs = pair_agreements(judgements, setting_of(labels).inverse)
            command.write((pair.record() for pair in pairs), print_agreement, pairs, command.limit)
            return FINE if pairs else NO
        work = _stored(command, labels) if command.queue is not None else _made(command, effective, judgements)
    if command.out is not None:
        write_queue(work.queue, command.out)
    shown = work if command.author is None else work.of_reviewer(judgements.states(command.author))
    places = shown.found(_label, command.find, command.kind, settled=command.all)
    rows = shown.rows(places[: command.limit])
    if command.author is not None:
        rows = [{**row, "reasons": [r for r in row["reasons"] if not r.startswith(DISAGREE)]} for row in rows]
    hidden = 0 if command.all else work.counts["items"] - len(shown.left())
    command.write(iter(rows), print_queue, work, rows, len(places), hidden, command.out)
    return FINE if places else NO


def _is_reviewed(command: ReviewCommand, labels: Labels) -> bool:
    return command.journal.journal is not None or (labels.root / JOURNAL_FILE).exists()


def _reviewed(command: ReviewCommand, labels: Labels, folder: Path) -> tuple[Labels, Judgements]:
    if not _is_reviewed(command, labels):
        return labels, Judgements()
    with command.journal.open(labels, must_exist=True) as journal:
        return reviewed_labels(labels, journal, folder, command.source.open(labels))


def _stored(command: ReviewCommand, labels: Labels) -> Worklist:
    work = worklist(read_queue(needed(command.queue, ""), automatic_version(labels.manifest)), {})
    if not _is_reviewed(command, labels):
        return work
    with command.journal.open(labels, must_exist=True) as journal:
        return refreshed_worklist(work, Corrector(labels, command.source.open(labels)), journal, NOTHING)[0]


def _made(command: ReviewCommand, labels: Labels, judgements: Judgements) -> Worklist:
    networks = command.networks
    if networks and (why := MissingExtra.missing(need_torch)):
        networks = False
        warn(f"the networks are left out, as with --no-networks: {why}")
    with progress_bars() as advance:
        queue = review_queue(
            labels,
            DoubtConfig() if networks else None,
            judgements=judgements,
            masks=command.source.masks(labels) if command.masks else None,
            progress=lambda done, of: advance("networks", done, of),
        )
    return worklist(queue, states_on_labels(judgements, read_relation_labels(labels)))


def print_queue(work: Worklist, first: list[dict[str, Any]], shown: int, hidden: int, out: Path | None) -> None:
    """Print the first items with reasons, and the counts; `hidden` are settled, or others'."""
    if first:
        print_rows(
            (">wrong", "frame", "label", "reasons"),
            ((f"{row['score']:.2f}", row["frame"], _label(row), "; ".join(row["reasons"])) for row in first),
        )
    metadata = {k.decode(): v.decode() for k, v in (work.queue.schema.metadata or {}).items()}
    told = f"{counted(shown, 'label')} to look at"
    if hidden:
        told += f" ({hidden} more are settled, or others': --all)"
    if "estimated_wrong" in metadata:
        told += f"; networks take {metadata['estimated_wrong']} relation labels to be wrong"
    say(told)
    if out is not None:
        say(f"-> {out}", style="dim")


def _label(row: dict[str, Any]) -> str:
    if row["kind"] == "relation":
        return f"{row['a']} {PHRASE[row['relation']]} {row['b']}: {row['label']}"
    if row["kind"] == "object":
        return f"object {row['a']}: {row['label']}"
    return f"{row['expression']}: {row['label']!r}"


def print_agreement(pairs: Sequence[PairAgreement], limit: int) -> None:
    """Kappa of each two reviewers by kind, the table, and the first differing items."""
    if not pairs:
        say("no two reviewers have judged the same item")
    for pair in pairs:
        say(f"{pair.first} and {pair.second}: {counted(pair.all.items, 'item')} judged by both", style="bold")
        for kind, found in (("all", pair.all), *pair.kinds.items()):
            kappa = "-" if math.isnan(found.kappa) else f"{found.kappa:.2f}"
            say(f"  {kind}: kappa {kappa}, {figure(found.observed, '.1%')} of {found.items} judged alike")
        judgements = pair.all.judgements
        print_rows(
            (f"{pair.first} \\ {pair.second}", *(f">{judgement}" for judgement in judgements)),
            ((name, *map(str, row)) for name, row in zip(judgements, pair.all.table.tolist(), strict=True)),
        )
        for key, one, other in pair.differ[:limit]:
            item = f"{key.a} {PHRASE[key.what]} {key.b}" if key.kind == "relation" else f"{key.what or key.a}"
            say(f"  {key.frame}, {key.kind} {item}: {pair.first} says {one}, {pair.second} says {other}")
        if len(pair.differ) > limit:
            say(f"  and {len(pair.differ) - limit} more")


REASONS = 5
"""Reasons for which items cannot be judged that are printed."""


def run_audit(command: AuditCommand) -> None:
    require(command.limit >= 0, "--limit must not be negative", got=command.limit)
    with rate_bar("auditing", "items") as advance:
        report = audit(
            command.target,
            command.dataset,
            command.runs,
            options=command.source.arguments(),
            progress=advance,
        )
    if command.out is not None:
        report.write(command.out)
    command.write(chain([report.record()], islice(report.records(), command.limit)), print_audit, report, command)


def print_audit(report: AuditReport, command: AuditCommand) -> None:
    """Print the evidence against the items, the first items, and the path of all."""
    if report.systems is not None:
        print_table(report.systems)
        say()
    if report.kinds.rows:
        print_table(report.kinds)
        say()
    shown = report.suspicious[: command.limit]
    if shown:
        print_rows(
            (">wrong", "item", "frame", "sentence", "said correct", "seems correct", "evidence"),
            (
                (f"{i.score:.2f}", i.id, i.frame, i.text, i.truth, i.seems or "-", "; ".join(e.text for e in i.reasons))
                for i in shown
            ),
        )
    record = report.record()
    say(
        f"{counted(len(report.items), 'item')}; something speaks against {record['suspicious']}, {report.likely} are "
        f"probably wrong; {record['unjudged']} cannot be judged by geometry"
    )
    because = list(record["unjudged_because"].items())
    say_lines((f"  {count}: {why}" for why, count in because[:REASONS]), "dim")
    if len(because) > REASONS:
        say(f"  and {len(because) - REASONS} more reasons (--json)", style="dim")
    if command.out is not None:
        say(f"-> {command.out}", style="dim")
