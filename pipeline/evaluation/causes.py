"""Causes that keep a run from answering, before its figures: unknown names, frames without labels or not opened."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.evaluation.grounding_tables import problem_warnings
from pipeline.labels.reading import Labels
from pipeline.language.counted import counted
from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Table
from pipeline.proposals.base import Detector
from pipeline.proposals.class_names import is_cut, known_names, knows
from pipeline.proposals.recorded import RecordedDetector
from pipeline.system.arrow import pa

NAMED = 8
"""Names that are listed."""


def causes_of(records: pa.Table, source: Pipeline, labels: Labels, detector: Detector | None) -> tuple[str, ...]:
    """Reasons for which expressions have no answer or are not asked, each a line, the gravest first.

    Parameters
    ----------
    records : Table
        Of the run's expressions.
    detector : Detector or None
        Which finds things by their names; None where the system has none.
    """
    unknown = [] if detector is None or detector.exact else unknown_names(records, detector, source)
    asked = [records.column(name).to_pylist() for name in ("target", "reference")]
    touched = np.array([a in unknown or b in unknown for a, b in zip(*asked, strict=True)], bool)
    found = []
    if unknown and detector is not None:
        names = len({name for column in asked for name in column if name})
        counts = Counter(name for pair in zip(*asked, strict=True) for name in {*pair} if name in unknown)
        listed = ", ".join(f"{name} ({n})" for name, n in counts.most_common(NAMED))
        more = f" and {len(unknown) - NAMED} more" if len(unknown) > NAMED else ""
        found.append(
            f"{detector.name} does not know {len(unknown)} of {names} names that are asked for: {listed}{more}. "
            f"{int(touched.sum())} of {records.num_rows} expressions ask for one of them. Another name for one: "
            '--synonyms FILE with {"groups": [[NAME, KNOWN]]}'
        )
    found += problem_warnings(records.filter(pa.array(~touched)) if touched.any() else records)
    return (*found, *_of_recording(detector), *_unlabelled(source, labels))


def unknown_names(records: pa.Table, detector: Detector, source: Pipeline) -> list[str]:
    """Names of the expressions that a detector cannot find, in order."""
    known = known_names(detector)
    asked = dict.fromkeys(name for c in ("target", "reference") for name in records.column(c).to_pylist() if name)
    if not known:
        # Of a detector of any words, and of answers without proposals.
        return []
    return [n for n in asked if not knows(known, n, source.synonyms) and not any(is_cut(piece, n) for piece in known)]


def _of_recording(detector: Detector | None) -> list[str]:
    """Assumptions about recorded detections: scores that are missing, and names that were cut."""
    found: object = detector
    # What wraps a detector (a cache, a segmenter) has it as this attribute.
    while found is not None and not isinstance(found, RecordedDetector):
        found = getattr(found, "detector", None)
    return [] if found is None else found.assumed()


def _unlabelled(source: Pipeline, labels: Labels) -> list[str]:
    """Frames of the dataset that the labels do not hold, or could not open."""
    rows = labels.frames.select(["frame", "ok", "problem"]).to_pylist()
    bad, told = [row for row in rows if not row["ok"]], []
    if bad:
        of = f"{len(bad)} of {counted(len(rows), 'frame')}"
        first = f"{bad[0]['frame']}: {bad[0]['problem']}"
        told.append(f"{of} could not be used when they were labelled, and nothing is asked of them; the first, {first}")
    missing = [frame for frame in source.dataset.frame_ids if frame not in {row["frame"] for row in rows}]
    if missing:
        of = f"{len(missing)} of {counted(len(source.dataset.frame_ids), 'frame')} of the dataset"
        told.append(f"{of} are not in the labels, and nothing is asked of them; the first: {missing[0]}")
    return told


def with_figures(tables: Sequence[Table]) -> tuple[list[Table], list[Table]]:
    """Tables of which any figure is other than 0, and those without rows or figures."""
    telling = [t for t in tables if any(_tells(cell) for row in t.rows for cell in row.cells)]
    return telling, [t for t in tables if t not in telling]


def _tells(cell: object) -> bool:
    value = cell.value if isinstance(cell, Estimate) else cell
    return isinstance(value, float) and value == value and value != 0
