"""Command checking labels, with its output for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from rich.text import Text

from pipeline.labels.check import check_labels, finding_record
from pipeline.labels.check.view import Finding
from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import Labels, open_labels
from pipeline.labels.report import NUMBERS, summary_lines, summary_tables, write_report
from pipeline.labels.statistics import label_statistics
from pipeline.language.counted import counted
from pipeline.system.errors import InputError
from pipeline.system.whole_files import check_target
from spatialviz.cli_labels import CheckCommand
from spatialviz.options import FINE, NO, print_json
from spatialviz.printing import print_rows, print_table, say, say_lines

COLORS = {"error": "red", "warning": "yellow"}


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
    compared = command.masks or "object/other-masks" in command.rules
    masks = command.source.masks(labels) if compared else None
    found = check_labels(labels, rules=command.rules or None, masks=masks)
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
