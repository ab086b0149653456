"""A pipeline that is not ours, with planted faults: the verdict names the module (`benchmarks/other_pipeline.py`)."""

from __future__ import annotations

from benchmarks.other_pipeline import CENTRES, FAULTS, lines, tally, verdicts

from pipeline.answering.opening import open_pipeline
from pipeline.datasets.demo import demo_labels
from pipeline.labels.reading import open_labels

MOST = 0.95
"""As the benchmark has it of hundreds."""


def test_the_verdict_names_the_planted_module_of_another_pipeline() -> None:
    labels = open_labels(demo_labels())
    found = list(lines(CENTRES, open_pipeline("demo", srm="rule").dataset, labels, 4, every=10, share=0.7))
    counts = tally(verdicts(CENTRES, "demo", labels, found))
    planted = {fault: found for fault, found in counts.items() if fault in FAULTS}
    assert len(planted) >= 5
    assert sum(found[fault] for fault, found in planted.items()) >= MOST * sum(c.total() for c in planted.values())
    # What is not planted is right, or wrong of itself, and never beyond explanation.
    assert counts["clean"]["CORRECT"] + counts["clean"]["LABEL"] >= 0.8 * counts["clean"].total()
    assert not any("UNEXPLAINED" in verdict for found in counts.values() for verdict in found)
