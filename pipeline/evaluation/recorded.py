"""The verdict as a run has it: what it says, which version judged it, and what is doubtful of runs of earlier ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.answering.imported import file_of
from pipeline.diagnosis.verdict import RULES_VERSION, Diagnosis
from pipeline.evaluation.run_folder import Run
from pipeline.language.counted import counted
from pipeline.system.errors import InputError
from pipeline.system.version import __version__

AGAIN = "spatialviz eval --judge-again RUN --out NEW"


@dataclass(frozen=True)
class Recorded:
    """The verdict on an expression as its run has it.

    Attributes
    ----------
    said : str
        In words.
    """

    verdict: str
    detail: str | None
    lucky: bool
    said: str

    def is_that(self, judged: Diagnosis | str | None) -> bool:
        """Compare with a verdict of now."""
        return isinstance(judged, Diagnosis) and (self.verdict, self.detail, self.lucky) == (
            judged.verdict, judged.detail, judged.lucky,
        )  # fmt: skip


def recorded_verdict(row: Mapping[str, Any]) -> Recorded | None:
    """Verdict of a row of a run's records; None without a verdict."""
    if row.get("verdict") is None:
        return None
    return Recorded(row["verdict"], row.get("detail"), bool(row.get("lucky")), row.get("said") or "")


def judged_by(manifest: Mapping[str, Any]) -> str:
    """Version that judged a run, in words; empty for the rules of this version."""
    version, rules = manifest.get("version", "?"), manifest.get("verdict_rules", 1)
    if rules == RULES_VERSION:
        return ""
    return f"judged by spatialviz {version} with rules {rules} of verdicts (this is {__version__}, {RULES_VERSION})"


def doubts_of(run: Run) -> tuple[str, ...]:
    """Doubts about judgements of an earlier version, a sentence each; none of a run of this version."""
    by = judged_by(run.manifest)
    if not by:
        return ()
    found = [f"The run was {by}: {AGAIN} judges it again."]
    names = set(run.records.column_names)
    if {"verdict", "box"} <= names:
        right = np.array(run.records.column("verdict").to_pylist(), object) == "CORRECT"
        none = int((right & run.records.column("box").is_null().to_numpy(zero_copy_only=False)).sum())
        found += [f"{counted(none, 'expression')} of it are called CORRECT without an answer."] if none else []
    if run.spec.options.get("predictions") is not None:
        found += [words] if (words := _repeated(run)) else []
    return tuple(found)


def _repeated(run: Run) -> str:
    """Count lines of imported predictions with an id under several names, or several times under a name."""
    try:
        file = file_of(run.source)
    except InputError:
        return "Its predictions cannot be read any more, and may have been replaced where an id stands several times."
    lines = file.lines.values()
    ids = [[p.id for found in (line.proposals or {}).values() for p in found] for line in lines]
    count = sum(len(set(of_line)) < len(of_line) for of_line in ids)
    return (
        f"In {count} of its {len(ids)} lines an id stands several times: not all of their numbers were used."
        if count
        else ""
    )
