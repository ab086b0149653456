"""What a check of labels found, on the terminal: by rule, then one by one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from pipeline.counted import counted
from spatialviz.printing import make_console

if TYPE_CHECKING:
    from pipeline.labels.check.findings import Finding

COLORS = {"error": "red", "warning": "yellow"}


def print_findings(findings: Iterable[Finding], show: int) -> int:
    """How much was found by each rule, then up to `show` findings of each, errors first; returns how many are errors.

    Findings may be many: those that are not shown are counted and let go.
    """
    counts: Counter[tuple[str, str]] = Counter()
    kept: dict[str, dict[str, list[Finding]]] = {}
    for finding in findings:
        counts[finding.rule, finding.severity] += 1
        of_rule = kept.setdefault(finding.rule, {"error": [], "warning": []})
        if len(of_rule[finding.severity]) < show:
            of_rule[finding.severity].append(finding)
    console = make_console()
    rules = sorted(kept, key=lambda r: (not counts[r, "error"], r))
    if rules:
        table = Table(box=None, pad_edge=False, header_style="dim")
        table.add_column("rule")
        for title in ("errors", "warnings"):
            table.add_column(title, justify="right")
        for rule in rules:
            said = (_number(counts[rule, severity], COLORS[severity]) for severity in ("error", "warning"))
            table.add_row(Text(rule), *said)
        console.print(table)
    for rule in rules if show > 0 else ():
        console.print()
        shown = [*kept[rule]["error"], *kept[rule]["warning"]][:show]
        for finding in shown:
            console.print(_line(finding))
        more = counts[rule, "error"] + counts[rule, "warning"] - len(shown)
        if more:
            console.print(Text(f"and {more:,} more of {rule}", "dim"))
    errors, warnings = (sum(n for (_, s), n in counts.items() if s == severity) for severity in ("error", "warning"))
    if rules:
        console.print()
    color = "red" if errors else "yellow" if warnings else "green"
    console.print(Text(f"{counted(errors, 'error')}, {counted(warnings, 'warning')}", color))
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


def _number(count: int, color: str) -> Text:
    return Text(f"{count:,}", color) if count else Text("0", "dim")

