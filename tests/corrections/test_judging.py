"""Answers judged by what is known of their frames: labels before annotations, corrected ones before both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from journal_world import FRAME, an_expression

from pipeline.answering import Pipeline, open_pipeline
from pipeline.corrections import FieldRef, JournalLocation, Judge, LabelEditor, set_mark, set_status
from pipeline.datasets import demo_run
from pipeline.diagnosis import Baseline, Diagnosis, Edits, annotated_truth, judge_trace
from pipeline.diagnosis.whatif import rerun
from pipeline.evaluation import open_run
from pipeline.labels import Labels
from pipeline.relations.model import OnnxScorer


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline("demo", srm="rule")


def nobody(name: str, frame: str) -> None:
    """Nobody has corrected anything."""


def test_without_labels_the_annotations_say_what_is_true_and_are_worked_out_once(source: Pipeline) -> None:
    judge, context = Judge({}, {}, {}, nobody), source.prepare(FRAME)
    trace = source.ask(context, "mug left of the laptop")
    found, truth = judge.judge("demo", source, context, trace), annotated_truth(context, source)
    assert truth is not None
    expected = judge_trace(trace, source, context, truth)
    told = [d.verdict if isinstance(d, Diagnosis) else d for d in (found, expected)]
    assert told[0] == told[1]
    assert judge.truth("demo", source, context) is judge.truth("demo", source, context)
    assert judge.labels("demo") is None
    bare = source.prepare(replace(context.frame, annotations=()))
    assert judge.judge("demo", source, bare, trace) is not None, "the frame's truth is known already"
    assert Judge({}, {}, {}, nobody).judge("demo", source, bare, trace) is None


def test_an_edited_answer_is_judged_by_what_the_edit_leaves_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The verdict is the one without the evidence before; the network is asked about what is new only."""
    source = open_pipeline("demo")
    context, asked = source.prepare(FRAME), list[int]()
    network = OnnxScorer.probabilities

    def counted(scorer: OnnxScorer, rows: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        asked.append(len(rows) ** 2 if wanted is None else int(wanted.sum()))
        return network(scorer, rows, wanted)

    monkeypatch.setattr(OnnxScorer, "probabilities", counted)
    judge = Judge({}, {}, {}, nobody)
    baseline = Baseline(source, context, "book right of the mug")
    before = judge.judge("demo", source, context, baseline.outcome.trace)
    assert isinstance(before, Diagnosis)
    thing = baseline.outcome.trace.objects[0].lifted.box
    assert thing is not None
    key, moved = baseline.outcome.keys[0], replace(thing, center=thing.center + np.array([0.4, 0.0, 0.1]))
    less_sure = replace(Edits(), confidences={("book", baseline.keys["book"][0]): 0.2})
    for edits, share in ((less_sure, 0.0), (Edits().with_box(key, moved), 0.5)):
        trace = rerun(baseline, edits).trace
        asked.clear()
        whole = judge.judge("demo", source, context, trace)
        of_whole = sum(asked)
        asked.clear()
        found = judge.judge("demo", source, context, trace, before=before)
        assert sum(asked) <= share * of_whole
        assert of_whole
        assert isinstance(found, Diagnosis)
        assert isinstance(whole, Diagnosis)
        assert (found.verdict, found.repair, found.story) == (whole.verdict, whole.repair, whole.story)
        np.testing.assert_array_equal(found.margins, whole.margins)


def test_corrected_labels_come_first(source: Pipeline, demo_labels: Labels, tmp_path: Path) -> None:
    editor = LabelEditor(demo_labels, JournalLocation(demo_labels, tmp_path / "j.sqlite"), "ann", source.dataset)
    judge = Judge({}, {"demo": demo_labels}, {}, lambda name, frame: editor.corrected(frame))
    context, labelled = source.prepare(FRAME), an_expression(editor.frame(FRAME))
    trace, name = source.ask(context, labelled["text"]), labelled["id"]
    before, truth = judge.judge("demo", source, context, trace, name), judge.truth("demo", source, context)
    assert isinstance(before, Diagnosis)
    assert judge.known("demo", FRAME, truth, name)["case"].id == name
    editor.save(set_mark(editor.frame(FRAME), name, "BAD_LABEL"))
    assert judge.known("demo", FRAME, truth, name)["mark"] == "BAD_LABEL"
    rejected = FieldRef("expression", FRAME, name, "status")
    editor.save(set_status(editor.frame(FRAME), rejected, "rejected", author="ann"))
    assert judge.judge("demo", source, context, trace, name) == "the expression was rejected by ann"
    assert judge.truth("demo", source, context) is not truth


def test_a_second_run_answers_too_and_is_judged_by_the_same_truth(source: Pipeline) -> None:
    run = open_run(demo_run())
    judge, context = Judge({"demo": run}, {}, {"demo": run}, nobody), source.prepare(FRAME)
    assert judge.labels("demo") is run.labels
    text = "mug left of the laptop"
    other = judge.other("demo", context, text)
    assert other is not None
    assert other.trace is not None
    trace = run.source.ask(context, text)
    assert other.pairs == (trace.ranking.pairs if trace.ranking else ())
    assert judge.other("nothing", context, text) is None
    refused = judge.other("demo", context, "no such thing as this")
    assert refused is not None
    assert refused.problem
    assert (refused.trace, refused.pairs) == (None, ())


def test_each_of_two_runs_is_the_other_one_of_the_other(source: Pipeline, tmp_path: Path) -> None:
    """Beside an answer of the second run stands the first's, and what a person marked in a run is of that run."""
    first = open_run(demo_run())
    second = replace(first, spec=replace(first.spec, options={**first.spec.options, "srm": "rule"}, marks={}))
    second = replace(second, manifest={**first.manifest, "scorer": "rule"})
    judge, context = Judge({"demo": first}, {}, {"demo": second}, nobody), source.prepare(FRAME)
    assert judge.names == {"demo": ("relations by rel32", "relations by rule")}
    text = "mug left of the laptop"
    beside = [judge.other("demo", context, text, second=which) for which in (True, False)]
    assert [o.name for o in beside if o is not None] == ["relations by rule", "relations by rel32"]
    assert [o.needed_trace().scorer for o in beside if o is not None] == ["rule", "rel32"]
    (frame, expression), mark = next(iter(first.spec.marks.items()))
    truth = judge.truth("demo", source, source.prepare(frame))
    assert judge.known("demo", frame, truth, expression)["mark"] == mark
    assert judge.known("demo", frame, truth, expression, second.source)["mark"] is None
