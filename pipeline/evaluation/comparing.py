"""Two runs on the same expressions: what the second fixed, what it broke, and what is correct for another reason."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.grounding_tables import clusters_of, column
from pipeline.evaluation.records import read_records
from pipeline.evaluation.records_file import OtherColumn, RecordsFile, paired_rows, some_rows, texts_of
from pipeline.evaluation.summary import has_verdicts
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT
from pipeline.metrics.intervals import Estimate, McNemar, mcnemar, mean_estimate
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import parse_json, read_text

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

MEASURES = ("correct", "strict_correct", "set_correct", "reference_correct", "pair_correct")
CHANGES = {
    "fixed": "fixed",
    "broken": "broken",
    "other_reason": "correct for another reason",
    "verdict": "changed verdict",
    "same": "the same",
}
"""What became of an expression, in the words of the glossary: it is right only after, right only before, right both
times by another target, another reference or a pair that is acceptable only once, none of these but with another
verdict, or none of all this."""
CHANGE, SECOND = "change", "second_"
"""The column that says what became of an expression, and what stands before the names of the second run's columns."""
COMPARED = (*MEASURES, "matched_target", "matched_reference", "verdict", "right_with", "scene", "frame")
"""Columns that comparisons read, of those that a run has."""
SECOND_COLUMNS = ("verdict", "detail", "lucky", "said", "margin", "box", "reference_box")


@dataclass(frozen=True)
class Comparison:
    """What changed from one run to another."""

    shared: int  # expressions that both answered
    # only_before, only_after: expressions that only one of them has
    only_before: int
    only_after: int
    differences: dict[str, Estimate]  # by measure: after less before, with its clustered interval
    tests: dict[str, McNemar]  # `b` counts what only the run after got right, `c` what only the run before did
    # fixed, broken, other_reason: expressions (id, frame, text) that became right, became wrong, and are right both
    # times with another target, reference, or one that is only now (or no longer) acceptable
    fixed: tuple[dict[str, Any], ...]
    broken: tuple[dict[str, Any], ...]
    other_reason: tuple[dict[str, Any], ...]
    measure: str  # the measure by which they are sorted into these
    changes: dict[str, int]  # how many of each of CHANGES
    # verdicts: how many expressions went from which verdict to which: [before][after], all of them, those that stayed
    # too; None where a run has no verdicts
    verdicts: dict[str, dict[str, int]] | None = None

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
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
            "changes": self.changes,
            "verdicts": self.verdicts,
        }


def compare(
    before: Records, after: Records, measure: str = "set_correct", part: np.ndarray | None = None
) -> Comparison:
    """Compare two runs by their common expressions.

    `before`, `after`: records. `measure`: one of MEASURES. `part`: rows of `before` ((P,) int64) that count; what only
    the run after has is no part of them.

    Raises InputError: they have no expression in common.
    """
    own, other = shared_rows(before, after)
    if part is not None:
        kept = np.isin(own, part)
        own, other = own[kept], other[kept]
    require(len(own), "the two runs have no expression in common", cause="were they made with other labels?")
    first, second = (_compared(records, rows) for records, rows in ((before, own), (after, other)))
    clusters, _ = clusters_of(second)
    columns = {name: (column(first, name), column(second, name)) for name in MEASURES}
    differences = {name: mean_estimate(b, clusters, other=a) for name, (a, b) in columns.items()}
    tests = {name: mcnemar(b > 0, a > 0) for name, (a, b) in columns.items()}
    change = changes(first, second, measure)
    return Comparison(
        len(own),
        (before.num_rows if part is None else len(part)) - len(own),
        after.num_rows - len(own) if part is None else 0,
        differences,
        tests,
        _named(after, other[change == "fixed"]),
        _named(after, other[change == "broken"]),
        _named(after, other[change == "other_reason"]),
        measure,
        {name: int((change == name).sum()) for name in CHANGES},
        verdict_transitions(first, second),
    )


def shared_rows(before: Records, after: Records) -> tuple[np.ndarray, np.ndarray]:
    """(K,) int64 twice: the rows of the same expressions in two runs, in the order of the run after."""
    return paired_rows(before, after, ["frame", "id"])


def _compared(records: Records, rows: np.ndarray) -> pa.Table:
    return some_rows(records, rows, [name for name in COMPARED if name in records.column_names], coded=True)


def changes(first: pa.Table, second: pa.Table, measure: str = "set_correct") -> np.ndarray:
    """(K,) of CHANGES: fate of the same expressions, row by row."""
    was, now = column(first, measure) > 0, column(second, measure) > 0
    same = (column(first, "pair_correct") > 0) == (column(second, "pair_correct") > 0)
    for name in ("matched_target", "matched_reference"):
        # An object that is no labelled one has no index: two of them count as the same.
        same &= np.nan_to_num(column(first, name), nan=-1) == np.nan_to_num(column(second, name), nan=-1)
    judged = has_verdicts(first) and has_verdicts(second)
    other = texts_of(first, "verdict") != texts_of(second, "verdict") if judged else False
    return np.select(
        [~was & now, was & ~now, was & now & ~same, np.broadcast_to(other, was.shape)], list(CHANGES)[:4], "same"
    )


def with_second(records: Records, second: Records, measure: str = "set_correct") -> Records:
    """Add `change` and the second run's columns (`second_verdict`, …) to a run's records; null without a counterpart.

    Raises InputError: they have no expression in common.
    """
    own, other = shared_rows(records, second)
    require(len(own), "the two runs have no expression in common", cause="were they made with other labels?")
    change = np.full(records.num_rows, None, object)
    change[own] = changes(_compared(records, own), _compared(second, other), measure)
    at = np.full(records.num_rows, -1, np.int64)
    at[own] = other
    index = pa.array(at, mask=at < 0)
    found = records.append_column(CHANGE, pa.array(change.tolist(), pa.string()))
    for name in SECOND_COLUMNS:
        if name in second.column_names:
            beside = OtherColumn(second, name, index)
            whole = beside if isinstance(records, RecordsFile) else beside.take(pa.array(np.arange(records.num_rows)))
            found = found.append_column(f"{SECOND}{name}", whole)
    return found


def verdict_transitions(before: pa.Table, after: pa.Table) -> dict[str, dict[str, int]] | None:
    """Count expressions by verdict before and after, row by row; None without verdicts."""
    if not (has_verdicts(before) and has_verdicts(after)):
        return None
    pairs = zip(texts_of(before, "verdict").tolist(), texts_of(after, "verdict").tolist(), strict=True)
    counts = Counter((a, b) for a, b in pairs if a is not None and b is not None)
    found = {a: {b: counts[a, b] for b in VERDICTS if counts[a, b]} for a in VERDICTS}
    return {a: line for a, line in found.items() if line}


def _named(records: Records, rows: np.ndarray) -> tuple[dict[str, Any], ...]:
    return tuple(some_rows(records, rows, ["id", "frame", "text", "relation"]).to_pylist())


Boxes = tuple[list[float] | None, list[float] | None]
"""2D boxes of an answer's target and reference, x0, y0, x1, y1 in pixels; None without one."""


def answer_differences(first: Path, second: Path) -> dict[str, Any]:
    """Compare two sets of answers by frame and text, without labels or verdicts.

    `first`, `second`: a run folder, or a file of `ask --json`.

    Returns JSON: shared, same, only_first, only_second (counts of expressions); answers: of each one that differs
    its frame, text, what differs ("target" or "reference": the boxes overlap by less than HIT) and both answers.

    Raises InputError: neither a run nor answers; no expression in common.
    """
    one, other = answered_boxes(first), answered_boxes(second)
    shared = [key for key in one if key in other]
    require(shared, "the two have no expression in common", cause="are they of other frames or texts?", path=second)
    ends = {key: [_overlap(*pair) for pair in zip(one[key], other[key], strict=True)] for key in shared}
    different = [key for key in shared if min(ends[key]) < HIT]

    def shown(boxes: Boxes) -> dict[str, Any]:
        return dict(zip(("box", "reference_box"), boxes, strict=True))

    return {
        "shared": len(shared),
        "same": len(shared) - len(different),
        "only_first": len(one) - len(shared),
        "only_second": len(other) - len(shared),
        "answers": [
            {
                "frame": key[0],
                "text": key[1],
                "differs": "target" if ends[key][0] < HIT else "reference",
                "first": shown(one[key]),
                "second": shown(other[key]),
            }
            for key in different
        ],
    }


def answered_boxes(path: Path) -> dict[tuple[str, str], Boxes]:
    """Boxes of each answer by frame and text, of a run folder or of a file of `ask --json`."""
    if path.is_dir():
        rows = read_records(path, ["frame", "text", "box", "reference_box"]).to_pylist()
        return {(row["frame"], row["text"]): (_rounded(row["box"]), _rounded(row["reference_box"])) for row in rows}
    found: dict[tuple[str, str], Boxes] = {}
    for line in filter(str.strip, read_text(path).splitlines()):
        try:
            record = parse_json(line, path)
            answer = record["answer"] or {}
            ends = ((answer.get(end) or {}).get("bbox") for end in ("target", "reference"))
            target, reference = map(_rounded, ends)
            found[record["frame"], record["expression"]["text"]] = target, reference
        except (AttributeError, KeyError, TypeError, ValueError):
            expected = "a run folder, or lines of `ask --json`"
            raise InputError("this is no answer", got=line[:60], expected=expected, path=path) from None
    return found


def _rounded(box: Any) -> list[float] | None:
    return None if box is None else np.round(np.asarray(box, np.float64).reshape(4), 2).tolist()


def _overlap(a: list[float] | None, b: list[float] | None) -> float:
    """IoU of two boxes; 1 if both are missing."""
    return float(a is b) if a is None or b is None else float(iou_2d(np.array([a]), np.array([b]))[0, 0])
