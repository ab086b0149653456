"""Two runs on the same expressions: what was fixed, what was broken, what is right for another reason."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.grounding_tables import clusters_of, column
from pipeline.evaluation.records import ArrowTable
from pipeline.evaluation.summary import has_verdicts
from pipeline.metrics.intervals import Estimate, McNemar, mcnemar, mean_estimate
from pipeline.system.arrow import pq
from pipeline.system.errors import InputError, require

MEASURES = ("correct", "strict_correct", "set_correct", "reference_correct", "pair_correct")


@dataclass(frozen=True)
class Comparison:
    """What changed from one run to another.

    Attributes
    ----------
    shared : int
        Expressions that both answered.
    only_before, only_after : int
        Expressions that only one of them has.
    differences : dict of str to Estimate
        By measure: after less before, with its clustered interval.
    tests : dict of str to McNemar
        `b` counts what only the run after got right, `c` what only the run before did.
    fixed, broken, other_reason : tuple of dict
        Expressions (id, frame, text) that became right, became wrong, and are
        right both times with another target, reference, or one that is only now (or no longer) acceptable.
    measure : str
        The measure by which they are sorted into these.
    verdicts : dict of str to dict of str to int, or None
        How many expressions went from which verdict to which: [before][after], all of them, those that stayed too;
        None where a run has no verdicts.
    """

    shared: int
    only_before: int
    only_after: int
    differences: dict[str, Estimate]
    tests: dict[str, McNemar]
    fixed: tuple[dict[str, Any], ...]
    broken: tuple[dict[str, Any], ...]
    other_reason: tuple[dict[str, Any], ...]
    measure: str
    verdicts: dict[str, dict[str, int]] | None = None

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "measure": self.measure,
            "shared": self.shared,
            "only_before": self.only_before,
            "only_after": self.only_after,
            "differences": {k: v.record() for k, v in self.differences.items()},
            "mcnemar": {k: {"b": t.b, "c": t.c, "p_value": t.p_value} for k, t in self.tests.items()},
            "fixed": list(self.fixed),
            "broken": list(self.broken),
            "other_reason": list(self.other_reason),
            "verdicts": self.verdicts,
        }


def read_records(run: Path) -> ArrowTable:
    """The records of a run folder.

    Raises
    ------
    InputError
        There is no run, or it measured relations alone.
    """
    path = Path(run) / "records.parquet"
    try:
        return pq.read_table(path)
    except FileNotFoundError as error:
        if (Path(run) / "relation_records.parquet").is_file():
            raise InputError("this run has no expressions", cause="made with --tables relations", path=run) from error
        raise InputError("no evaluation run here", expected="a folder that `eval` wrote", path=run) from error
    except (ValueError, OSError) as error:
        raise InputError("the records of the run cannot be read", got=str(error).split("\n")[0], path=path) from error


def compare(before: ArrowTable, after: ArrowTable, measure: str = "set_correct") -> Comparison:
    """Compare two runs by the expressions that both have.

    Parameters
    ----------
    before, after : pyarrow.Table
        Records.
    measure : str
        One of MEASURES.

    Raises
    ------
    InputError
        They have no expression in common.
    """
    keys = [list(zip(t.column("frame").to_pylist(), t.column("id").to_pylist(), strict=True)) for t in (before, after)]
    index = {key: k for k, key in enumerate(keys[0])}
    shared = [(index[key], k) for k, key in enumerate(keys[1]) if key in index]
    require(shared, "the two runs have no expression in common", cause="were they made with other labels?")
    first, second = (rows.take([pair[k] for pair in shared]) for k, rows in enumerate((before, after)))
    clusters, _ = clusters_of(second)
    columns = {name: (column(first, name), column(second, name)) for name in MEASURES}
    differences = {name: mean_estimate(b, clusters, other=a) for name, (a, b) in columns.items()}
    tests = {name: mcnemar(b > 0, a > 0) for name, (a, b) in columns.items()}
    was, now = column(first, measure) > 0, column(second, measure) > 0
    same_target, same_reference = (
        # An object that is no labelled one has no place: two of them count as the same.
        np.nan_to_num(column(first, name), nan=-1) == np.nan_to_num(column(second, name), nan=-1)
        for name in ("matched_target", "matched_reference")
    )
    pair = (column(first, "pair_correct") > 0) == (column(second, "pair_correct") > 0)
    other = was & now & ~(same_target & same_reference & pair)
    return Comparison(
        len(shared),
        before.num_rows - len(shared),
        after.num_rows - len(shared),
        differences,
        tests,
        _named(second, ~was & now),
        _named(second, was & ~now),
        _named(second, other),
        measure,
        verdict_transitions(first, second),
    )


def verdict_transitions(before: ArrowTable, after: ArrowTable) -> dict[str, dict[str, int]] | None:
    """How many of the same expressions, row by row, went from which verdict to which; None without verdicts."""
    if not (has_verdicts(before) and has_verdicts(after)):
        return None
    pairs = zip(before.column("verdict").to_pylist(), after.column("verdict").to_pylist(), strict=True)
    counts = Counter((a, b) for a, b in pairs if a is not None and b is not None)
    found = {a: {b: counts[a, b] for b in VERDICTS if counts[a, b]} for a in VERDICTS}
    return {a: line for a, line in found.items() if line}


def _named(records: ArrowTable, chosen: np.ndarray) -> tuple[dict[str, Any], ...]:
    return tuple(records.select(["id", "frame", "text", "relation"]).take(np.flatnonzero(chosen)).to_pylist())
