"""Mends of stories tried: each that is claimed makes its answer right, in a what-if."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest
from slow_cases import mostly_slow

from pipeline.datasets import demo_run
from pipeline.diagnosis import ask_and_judge
from pipeline.diagnosis.asking import judged
from pipeline.diagnosis.whatif import Baseline, edits_record, read_edits, rerun
from pipeline.diagnosis.whatif.changes import each_edit, without_edit
from pipeline.diagnosis.whatif.try_mend import mend_edits, try_mend
from pipeline.evaluation import open_run
from pipeline.labels import read_cases
from pipeline.system import InputError

RIGHT = ("right", "also right")


@pytest.mark.parametrize("frame", mostly_slow(range(12), fast=(4,)))
def test_every_change_that_a_story_names_makes_the_answer_right(frame: int) -> None:
    """Over all failures of the demo's run."""
    run, tried, untried = open_run(demo_run()), Counter[str](), Counter[str]()
    wrong = {(row["frame"], row["id"]) for row in run.failures().table.to_pylist()}
    (truth,) = read_cases(run.labels, frame, frame + 1)
    context, spec = run.source.prepare(truth.frame), run.spec
    for case in (c for c in truth.cases if (truth.frame, c.id) in wrong):
        known: Any = {"case": case, "confidence": spec.confidence, "mark": spec.marks.get((truth.frame, case.id))}
        try:
            baseline = Baseline(run.source, context, case.text)
        except InputError:
            continue
        before = judged(baseline.outcome.trace, run.source, context, truth, **known)
        if before.story.tone != "wrong" or before.verdict == "PARSE":
            continue
        change = before.story.change
        if change is None:
            untried[before.story.kind] += 1
            assert before.story.mend
            continue
        edits = mend_edits(baseline, change, truth)
        assert read_edits(edits_record(edits)) == edits
        after = judged(rerun(baseline, edits).trace, run.source, context, truth, **known)
        assert after.story.tone in RIGHT, (case.text, before.story, after.story)
        tried[change.field] += 1
    assert tried.keys() <= {"added", "boxes", "masks", "confidences", "relations"}
    assert sum(untried.values()) <= 0.1 * sum(tried.values()), (tried, untried)


def test_an_added_object_is_one_of_the_answer() -> None:
    """It is a candidate by its name and score, can be moved, hidden and taken back, and is lifted from its pixels."""
    (answered,) = ask_and_judge(open_run(demo_run()).source, 0, ["mug left of the laptop"])
    trace = answered.needed_trace()
    pipeline = open_run(demo_run()).source
    baseline = Baseline(pipeline, pipeline.prepare(0), "mug left of the laptop")
    mug = trace.objects[trace.candidates["laptop"].index[0]]
    edits = read_edits({}).with_added("mug", mug.mask, 0.83)
    after = rerun(baseline, edits)
    at = after.keys.index("+1")
    assert (after.trace.objects[at].label, after.trace.objects[at].score) == ("mug", 0.83)
    scores = dict(zip(after.trace.candidates["mug"].index.tolist(), after.trace.candidates["mug"].scores, strict=True))
    assert scores[at] == pytest.approx(0.83)
    assert rerun(baseline, edits.with_confidence("mug", "+1", 0.1)).trace.candidates["mug"].scores[-1] == 0.1
    box: Any = after.trace.objects[at].lifted.box
    moved = rerun(baseline, edits.with_box("+1", replace(box, center=box.center + 1.0)))
    assert moved.trace.objects[at].lifted.box.center == pytest.approx(box.center + 1.0)  # pyright: ignore
    assert edits.with_hidden("+1") == read_edits({})
    (edit,) = each_edit(edits)
    assert edit.text == "mug: added"
    assert not without_edit(edits, edit.id)
    assert "+1" not in rerun(baseline, read_edits({}).with_added("cup", mug.mask, 0.5)).keys
    assert edits.with_added("mug", mug.mask, 0.5).added.keys() == {"+1", "+2"}


def test_an_answer_is_tried_with_its_mend() -> None:
    failure = open_run(demo_run()).failures("verdict:OPM-TARGET")[0].answer
    tried = try_mend(failure)
    assert tried is not None
    assert tried.said == "✓ Now correct"
    assert tried.answer.verdict == "CORRECT"
    assert read_edits(tried.record()["edits"]) == tried.edits
    assert try_mend(tried.answer) is None


def test_a_box_that_is_off_is_mended_by_the_labelled_one() -> None:
    """Of both pairs the one box is named that alone makes the answer right, as a rerun with it does."""
    failures = open_run(demo_run()).failures("verdict:LIFT")
    changes = [f.answer.story.change for f in failures[:4] if f.answer.story.kind == "box"]
    assert {change.field for change in changes if change} == {"boxes"}
    tried = try_mend(failures[0].answer)
    assert tried is not None
    assert len(tried.edits.boxes) == 1
    assert tried.answer.story.tone in RIGHT


def test_a_misread_question_is_asked_as_it_was_meant() -> None:
    for failure in open_run(demo_run()).failures("verdict:PARSE")[:3]:
        tried, change = try_mend(failure.answer), failure.answer.story.change
        assert tried is not None
        assert change is not None
        assert failure.answer.story.sentence.endswith(f"meant was “{change.name}”.")
        assert not tried.edits
        assert tried.answer.verdict != "PARSE"


def test_a_change_of_another_answer_is_refused() -> None:
    run = open_run(demo_run())
    failure = run.failures("verdict:OPM-CONF")[0].answer
    assert failure.story.change is not None
    assert failure.diagnosis is not None
    baseline = Baseline(run.source, run.source.prepare(failure.needed_trace().frame.id), failure.text)
    with pytest.raises(InputError, match="another answer"):
        mend_edits(baseline, replace(failure.story.change, objects=(999,)), failure.diagnosis.truth)
