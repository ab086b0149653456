"""Answers are judged by labels as they were corrected: a failing case whose label was wrong is right once it is not."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from journal_world import FRAME, saved

from pipeline.answering import Pipeline, PreparedFrame, Trace, open_pipeline
from pipeline.corrections import Corrector, EffectiveFrame, FieldRef, Journal, effective_truth, undo
from pipeline.corrections.journal import edits
from pipeline.corrections.scene import answered_case, effective_mark, withdrawn_by
from pipeline.diagnosis import Diagnosis, judge_trace, labelled_truth
from pipeline.labels import Case, FrameCases, Labels
from pipeline.relations import F, T
from pipeline.system import InputError


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline("demo", srm="rule")


@pytest.fixture(scope="module")
def context(source: Pipeline) -> PreparedFrame:
    return PreparedFrame(source.dataset.load(FRAME), source.config.lift)


def same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, (Case, FrameCases)):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return bool(a == b) or (isinstance(a, float) and np.isnan(a) and np.isnan(b))


def test_uncorrected_labels_give_the_truth_that_is_read_from_the_files(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, source: Pipeline
) -> None:
    for name in source.dataset.frame_ids[:3]:
        read = labelled_truth(name, source, demo_labels)
        made = effective_truth(bare_corrector.frame(name, journal))
        assert read is not None
        for field in fields(FrameCases):
            assert same(getattr(made, field.name), getattr(read, field.name)), field.name


def test_a_rejected_frame_is_no_truth(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    saved(journal, edits.set_status(frame, FieldRef("frame", FRAME, "", "status"), "rejected"))
    with pytest.raises(InputError, match="rejected"):
        effective_truth(bare_corrector.frame(FRAME, journal))


def a_right_answer(frame: EffectiveFrame, source: Pipeline, context: PreparedFrame) -> tuple[dict[str, Any], Trace]:
    """An expression with one right answer that the pipeline finds, and another object of its frame that is not one."""
    truth = effective_truth(frame)
    for case in truth.cases:
        trace = source.ask(context, case.text)
        judged = judge_trace(trace, source, context, truth, case=case)
        if isinstance(judged, Diagnosis) and judged.correct and truth.acceptable_pairs(case).sum() == 1:
            return frame.expressions[case.id], trace
    raise AssertionError("the demo has none")


def judged(frame: EffectiveFrame, name: str, trace: Trace, source: Pipeline, context: PreparedFrame) -> str:
    truth = effective_truth(frame)
    case = next((c for c in truth.cases if c.id == name), None)
    case = None if case is None else answered_case(frame, truth, case, trace)
    found = judge_trace(trace, source, context, truth, case=case, mark=effective_mark(frame, name, None))
    return found.verdict if isinstance(found, Diagnosis) else found


def test_a_wrong_label_fails_a_right_answer_and_correcting_it_mends_that(
    bare_corrector: Corrector, journal: Journal, source: Pipeline, context: PreparedFrame
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row, trace = a_right_answer(frame, source, context)
    right = row["target_object"]
    wrong = next(n for n in frame.objects if n not in (right, row["reference_object"]))

    def verdict() -> str:
        return judged(bare_corrector.frame(FRAME, journal), row["id"], trace, source, context)

    assert verdict() == "CORRECT"
    saved(journal, edits.set_answers(frame, row["id"], [wrong]))
    assert verdict() != "CORRECT"
    saved(journal, edits.set_answers(bare_corrector.frame(FRAME, journal), row["id"], [wrong, right]))
    assert verdict() == "CORRECT", "all targets that a person names are meant"
    undo(journal, "ann")
    assert verdict() != "CORRECT"
    undo(journal, "ann")
    assert verdict() == "CORRECT"


def test_who_accepts_an_ambiguous_expression_means_all_its_answers(
    bare_corrector: Corrector, journal: Journal, source: Pipeline, context: PreparedFrame
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    truth = effective_truth(frame)
    for case in truth.cases:
        trace = source.ask(context, case.text)
        answer = trace.ranking.pairs[0].target if trace.ranking and trace.ranking.pairs else None
        others = [k for k in case.strict.tolist() if k != case.target_object]
        if answer is None or not others or trace.objects[answer].id not in truth.numbers[others]:
            continue
        assert judged(frame, case.id, trace, source, context) == "LABEL"
        status = FieldRef("expression", FRAME, case.id, "status")
        saved(journal, edits.set_status(frame, status, "accepted"))
        assert judged(bare_corrector.frame(FRAME, journal), case.id, trace, source, context) == "CORRECT"
        return
    raise AssertionError("no answer of the demo is another right one")


def test_a_flipped_relation_changes_the_verdict_and_flipping_it_back_mends_it(
    bare_corrector: Corrector, journal: Journal, source: Pipeline, context: PreparedFrame
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row, trace = a_right_answer(frame, source, context)
    a, b, relation = row["target_object"], row["reference_object"], row["relation"]
    saved(journal, edits.set_relation(frame, a, b, relation, F))
    frame = bare_corrector.frame(FRAME, journal)
    assert row["id"] in {w.id for w in frame.withdrawn}
    assert judged(frame, row["id"], trace, source, context) != "CORRECT"
    saved(journal, edits.set_relation(frame, a, b, relation, T), "bob")
    frame = bare_corrector.frame(FRAME, journal)
    assert judged(frame, row["id"], trace, source, context) == "CORRECT"


def test_a_mark_holds_until_what_it_was_said_of_is_corrected(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row, other = list(frame.expressions.values())[:2]
    name = row["id"]
    assert effective_mark(frame, name, "BAD_LABEL") == "BAD_LABEL"
    assert effective_mark(frame, name, None) is None
    saved(journal, edits.set_text(frame, name, "another one"))
    frame = bare_corrector.frame(FRAME, journal)
    assert effective_mark(frame, name, "BAD_LABEL") is None
    assert effective_mark(frame, name, "BAD_BOX") == "BAD_BOX", "its box is as bad as before"
    assert effective_mark(frame, other["id"], "BAD_LABEL") == "BAD_LABEL"
    saved(journal, edits.set_mark(frame, name, "BAD_BOX"))
    assert effective_mark(bare_corrector.frame(FRAME, journal), name, None) == "BAD_BOX"
    saved(journal, edits.set_mark(bare_corrector.frame(FRAME, journal), name, None))
    assert effective_mark(bare_corrector.frame(FRAME, journal), name, "BAD_BOX") is None
    frame = bare_corrector.frame(FRAME, journal)
    saved(journal, edits.set_bbox(frame, other["target_object"], [5, 5, 50, 50]))
    frame = bare_corrector.frame(FRAME, journal)
    assert effective_mark(frame, other["id"], "BAD_BOX") is None
    assert effective_mark(frame, other["id"], "BAD_LABEL") == "BAD_LABEL"
    status = FieldRef("expression", FRAME, other["id"], "status")
    saved(journal, edits.set_status(frame, status, "accepted"))
    assert effective_mark(bare_corrector.frame(FRAME, journal), other["id"], "BAD_LABEL") is None


def test_a_rejected_expression_is_not_judged_by(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    name = next(iter(frame.expressions))
    assert withdrawn_by(frame, name) is None
    saved(journal, edits.set_status(frame, FieldRef("expression", FRAME, name, "status"), "rejected"))
    assert withdrawn_by(bare_corrector.frame(FRAME, journal), name) == "the expression was rejected by ann"
