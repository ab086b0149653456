"""Pipelines that are not ours, with planted faults: what is planted is the module's alone, and the verdict names it."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from benchmarks import normalised_scores, picture_relations
from benchmarks.centre_rule import CENTRES
from benchmarks.fault_figures import FAULTS, Line, Row, Tried, broken_lines, lines, random_fault, table, tally, verdicts
from benchmarks.foreign_pipelines import ForeignPipeline, Question, is_right, predicted, scenes

from pipeline.answering import open_pipeline, read_predictions, write_predictions
from pipeline.datasets import demo_labels
from pipeline.labels import open_labels

MOST = 0.95
"""As the benchmark has it of hundreds."""
CHANGED = {
    "OPM-TARGET": {"targets", "known", "dropped"},
    "OPM-REF": {"references", "known", "dropped"},
    "LIFT": {"targets", "references", "known"},
    "SRM": {"relations"},
    "OPM-CONF": {"targets", "references"},
    "PRM": {"scores", "answer"},
}
"""What a fault of a module may change; where things have other boxes, candidates have other ids."""
KINDS = picture_relations.KINDS


@pytest.mark.slow
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


def lines_of_frames(own: ForeignPipeline, tried: Tried, every: int, frames: int, whole: bool = False) -> list[Line]:
    dataset, labels = open_pipeline("demo", srm="rule").dataset, open_labels(demo_labels())
    return list(broken_lines(own, islice(scenes(own, dataset, labels), frames), 0, every, tried, whole))


def changed(line: Line) -> set[str]:
    def differs(name: str) -> bool:
        one, other = getattr(line.before, name), getattr(line.after, name)
        return one.keys() != other.keys() if name == "known" else one != other

    return {f.name for f in fields(Question) if differs(f.name)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "tried"),
    [
        (picture_relations.make("borda"), random_fault([f"{m} {k}" for m in FAULTS for k in KINDS[m]], 0.8)),
        (normalised_scores.make("standardised"), normalised_scores.any_fault),
    ],
    ids=["picture relations", "normalised scores"],
)
def test_a_fault_that_counts_is_wrong_in_one_module_and_makes_a_right_answer_wrong(
    own: ForeignPipeline, tried: Tried
) -> None:
    found = lines_of_frames(own, tried, every=4, frames=5)
    planted = [line for line in found if line.fault is not None]
    assert len({line.fault.split()[0] for line in planted if line.fault}) >= 4
    for line in planted:
        assert line.fault is not None
        module = line.fault.split()[0]
        assert line.right
        assert not is_right(own, line.line, line.before)
        assert changed(line) <= CHANGED[module], line.fault
        if module == "LIFT":
            # The same candidates in the picture, with the same scores.
            for side in ("targets", "references"):
                before, after = (
                    {q.known[i].box: s for i, s in getattr(q, side).items()} for q in (line.before, line.after)
                )
                assert before == after
    assert all(line.line == predicted(own, line.before) for line in found if line.fault is None)


@pytest.mark.slow
def test_a_rule_breaks_every_line_of_a_whole_file_and_a_thing_has_one_box_in_all_of_them(tmp_path: Path) -> None:
    own = normalised_scores.make("standardised")
    found = lines_of_frames(own, lambda *_: ["LIFT disparity"], every=5, frames=4, whole=True)
    assert all(changed(line) == set() for line in found)
    moved = [
        any(not np.array_equal(t.center, line.after.known[i].center) for i, t in line.before.known.items())
        for line in found
    ]
    assert all(moved)
    assert 0 < sum(line.fault is not None for line in found) < len(found)
    path = tmp_path / "p.jsonl"
    write_predictions(path, own.header, [line.line for line in found])
    assert len(read_predictions(path).lines) == len(found)


def test_the_table_counts_by_module_and_kind_with_wilsons_interval() -> None:
    own = picture_relations.make("borda")
    clean = lines_of_frames(own, lambda *_: [], every=40, frames=1)[0]
    near, usual = (replace(clean, fault=f"SRM {kind}") for kind in ("near", "usual"))
    rows = [Row(near, "SRM", None), Row(usual, "SRM", "CONSTANT"), Row(usual, "UNEXPLAINED", "NOT-SEPARABLE")]
    text = list(table("borda", [*rows, Row(clean, "CORRECT", None)], KINDS))
    assert text[0] == "borda: named 2 of 3, 66.7 [20.8, 93.9] %"
    srm = "intrinsic 0/0, usual 1/2, transposed 0/0, near 1/1"
    assert text[4] == f"  SRM        2/3 66.7 [20.8, 93.9] % ({srm}); else {{'UNEXPLAINED NOT-SEPARABLE': 1}}"
    assert text[-1] == "  clean      {'CORRECT': 1}"
