"""Command auditing a benchmark or labels, with its output for people."""

from __future__ import annotations

from itertools import chain, islice

from pipeline.audit.report import AuditReport, audit
from pipeline.language.counted import counted
from pipeline.system.errors import require
from spatialviz.cli_labels import AuditCommand
from spatialviz.printing import print_rows, print_table, rate_bar, say


def run_audit(command: AuditCommand) -> None:
    require(command.limit >= 0, "--limit must not be negative", got=command.limit)
    with rate_bar("auditing", "items") as advance:
        report = audit(
            command.target,
            command.dataset,
            command.runs,
            options=command.source.arguments(),
            networks=command.networks,
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
            (">wrong", "item", "frame", "sentence", "said right", "seems right", "evidence"),
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
    if command.out is not None:
        say(f"-> {command.out}", style="dim")
