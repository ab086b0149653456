"""Findings counted by rule, for printing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from pipeline.labels.check.findings import RULES, Finding


@dataclass(frozen=True)
class RuleCount:
    """How often a rule was broken.

    Attributes
    ----------
    rule, about : str
    errors, warnings : int
    frames : int
        Frames in which it was.
    """

    rule: str
    about: str
    errors: int
    warnings: int
    frames: int


@dataclass
class Summary:
    """Counts that grow as findings come; frames are counted, not kept, for findings come frame by frame.

    Attributes
    ----------
    errors, warnings : int
    """

    errors: int = 0
    warnings: int = 0
    _counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    _frames: Counter[str] = field(default_factory=Counter)
    _last: dict[str, str] = field(default_factory=dict)

    def add(self, finding: Finding) -> None:
        """Count a finding."""
        if finding.severity == "error":
            self.errors += 1
        else:
            self.warnings += 1
        self._counts[finding.rule, finding.severity] += 1
        if finding.frame is not None and self._last.get(finding.rule) != finding.frame:
            self._last[finding.rule] = finding.frame
            self._frames[finding.rule] += 1

    def counted(self, findings: Iterable[Finding]) -> Iterator[Finding]:
        """The findings as they come, counted on the way."""
        for finding in findings:
            self.add(finding)
            yield finding

    @property
    def rules(self) -> tuple[RuleCount, ...]:
        """Rules that were broken: those with errors first, then by how often."""
        names = {rule for rule, _ in self._counts}
        counts = [
            RuleCount(
                name,
                RULES[name].about,
                self._counts[name, "error"],
                self._counts[name, "warning"],
                self._frames[name],
            )
            for name in RULES
            if name in names
        ]
        return tuple(sorted(counts, key=lambda c: (-c.errors, -c.warnings)))


def summarise(findings: Iterable[Finding]) -> Summary:
    """All findings counted."""
    summary = Summary()
    for finding in findings:
        summary.add(finding)
    return summary
