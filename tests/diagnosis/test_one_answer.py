"""Page, `ask --json` and a run's record say the same of one answer: names, scores, verdict."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.answering import LoadedFrame, Trace, all_objects, open_pipeline
from pipeline.datasets import demo_run
from pipeline.diagnosis import (
    AnswerView,
    Baseline,
    Edits,
    first_answered,
    frame_truth,
    shown_objects,
    suggest_questions,
    what_changed,
)
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import judged
from pipeline.diagnosis.whatif import rerun
from pipeline.evaluation import Run, open_run
from pipeline.proposals import AnnotationDetector
from pipeline.system import InputError

ROLES = ("target", "reference", "second_reference")


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(demo_run())


def looked_at(loaded: LoadedFrame, trace: Trace) -> AnswerView:
    """An answer as the page first shows it."""
    view = AnswerView(loaded=loaded, trace=trace, found=shown_objects(loaded, trace, trace.exact))
    pair = view.at(view.ranked[0]) if view.ranked else None
    return AnswerView(loaded=loaded, trace=trace, found=view.found, pair=pair)


def told(view: AnswerView) -> list[tuple[str, float, list[float]]]:
    """Label, score and box of the shown target and references."""
    objects = [view.shown.objects[place] for place in view.pair or ()]
    return [(o.label, round(o.score, 6), np.round(o.bbox.astype(np.float64), 2).tolist()) for o in objects]


def of_record(record: dict[str, Any]) -> list[tuple[str, float, list[float]]]:
    ends = [record["answer"][role] for role in ROLES if record["answer"].get(role) is not None]
    return [(end["label"], end["score"], end["bbox"]) for end in ends]


def check_frame(run: Run, frame: str, rows: list[dict[str, Any]]) -> int:
    """Compare all questions of a frame; how many had an answer."""
    source = run.source
    context = source.prepare(frame)
    loaded = LoadedFrame(context, all_objects(context, source.needed_detector()))
    numbers = {o.id: i for i, o in enumerate(loaded.objects) if o.id >= 0}
    answered = 0
    for row in rows:
        try:
            trace = source.ask(context, row["text"])
        except InputError:
            continue
        view, record = looked_at(loaded, trace), Answer(row["text"], trace).record()
        if record["answer"] is None:
            assert not told(view) or len(trace.tied) > 1, row["text"]
            continue
        answered += 1
        shown = told(view)
        if trace.asked is None:
            shown = shown[:1]
        assert shown == of_record(record), row["text"]
        for place, entry in ((p, view.shown.objects[p]) for p in view.pair or ()):
            assert view.shown.names[place] == f"{entry.label}·{numbers.get(entry.id, place)}"
        if row["parse_ok"] and row["box"] is not None:
            # The record says P(x | name), and its box.
            assert view.ranked[0].p_target == pytest.approx(row["p_target"], abs=1e-4)
            np.testing.assert_allclose(row["box"], shown[0][2], atol=0.1)
            np.testing.assert_allclose(row["reference_box"], shown[1][2], atol=0.1)
            assert [shown[0][0], shown[1][0]] == [row["target"], row["reference"]]
    return answered


def test_page_json_and_record_name_the_same_things(run: Run) -> None:
    rows = run.records.to_pylist()
    first = rows[0]["frame"]
    assert check_frame(run, first, [r for r in rows if r["frame"] == first]) > 100


@pytest.mark.slow
def test_page_json_and_record_name_the_same_things_in_all_frames(run: Run) -> None:
    rows = run.records.to_pylist()
    counts = {
        f: check_frame(run, f, [r for r in rows if r["frame"] == f]) for f in dict.fromkeys(r["frame"] for r in rows)
    }
    assert len(counts) == len(run.frame_counts)
    assert sum(counts.values()) > 0.9 * len(rows)


def test_a_pair_that_is_looked_at_gives_its_objects_their_names_in_it(run: Run) -> None:
    # A thing that was taken for a mug and for a laptop goes by the one in the pairs where it is the target, by the
    # other where it is the reference; its number stays.
    source = run.source
    swapped = 0
    for frame in source.dataset.frame_ids[:4]:
        context = source.prepare(frame)
        loaded = LoadedFrame(context, all_objects(context, source.needed_detector()))
        for question in dict.fromkeys(r["text"] for r in run.records.to_pylist() if r["frame"] == frame):
            try:
                trace = source.ask(context, question)
            except InputError:
                continue
            view = looked_at(loaded, trace)
            for pair in view.ranked[:8]:
                seen = AnswerView(loaded=loaded, trace=trace, found=view.found, pair=view.at(pair))
                assert trace.asked is not None
                ends = ((trace.root.label, pair.target), (trace.asked.nodes[0].label, pair.reference))
                for name, index in ((name, index) for name, index in ends if index is not None):
                    place = seen.found.place[index]
                    entry, before = seen.shown.objects[place], view.shown.objects[place]
                    at = trace.candidates[name].index.tolist().index(index)
                    assert entry.label == trace.candidates[name].labels[at]
                    assert entry.score == pytest.approx(trace.candidates[name].detector_scores[at])
                    assert seen.shown.names[place].rpartition("·")[2] == view.shown.names[place].rpartition("·")[2]
                    swapped += entry.label != before.label
            if swapped:
                return
    pytest.fail("no thing of these frames was found under both names")


def test_no_verdict_without_an_answer() -> None:
    source = open_pipeline("demo")
    context = source.prepare(0)
    found = judged(source.ask(context, "mug"), source, context, frame_truth(source, context))
    record = found.record()
    assert record["answer"] is None
    assert (found.holds, record["verdict"]) == (False, None)
    assert "no answer" in record["verdict_reason"]


@pytest.mark.parametrize("dropped", ["to the right of the unicorn", "facing the mug"])
def test_a_relation_that_was_dropped_is_not_held_to_be_true(dropped: str) -> None:
    source = open_pipeline("demo")
    context = source.prepare(0)
    try:
        trace = source.ask(context, f"laptop {dropped}")
    except InputError:
        return  # Refused: nothing is claimed.
    found = judged(trace, source, context, frame_truth(source, context))
    record = found.record()
    assert record["answer"]["holds"] is None
    assert record["answer"]["relation_probability"] is None
    assert record["verdict"] is None
    last = dropped.split()[-1]
    assert last in record["verdict_reason"]
    assert any(last in part["text"] for part in record["expression"]["unused"])
    assert "not all" in found.sentence
    changed = what_changed(*(rerun(Baseline(source, context, trace.query.text), e) for e in (Edits(), Edits(k=3))))
    assert changed["before"]["holds"] is None


def test_the_same_pair_by_other_letters_has_the_same_verdict(run: Run) -> None:
    source = open_pipeline("demo")
    context = source.prepare(0)
    truth = frame_truth(source, context)
    for text, misspelt in (
        ("mug left of the laptop", "mug left of the lamptop"),
        ("mug left of the laptop", "mug left of the laptpo"),
        ("red mug left of the laptop", "red mug left of the latop"),
    ):
        one, other = (judged(source.ask(context, t), source, context, truth) for t in (text, misspelt))
        assert one.diagnosis is not None
        assert other.diagnosis is not None, other.unjudged
        assert (one.verdict, one.diagnosis.lucky) == (other.verdict, other.diagnosis.lucky)


def test_what_is_offered_is_there_and_what_is_asked_first_has_an_answer(run: Run) -> None:
    source = run.source
    context = source.prepare(0)
    objects = all_objects(context, source.needed_detector())
    truth = frame_truth(source, context, run.labels)
    labelled = suggest_questions(source, context, objects, truth)
    there = {a.label for a in context.frame.annotations}
    assert labelled.by == "the labels"
    assert set(labelled.names) <= there
    texts = {r["text"] for r in run.records.to_pylist() if r["frame"] == context.frame.id}
    assert len(labelled.questions) == 3
    assert set(labelled.questions) <= texts
    annotated = suggest_questions(source, context, objects)
    assert set(annotated.names) == {o.label for o in all_objects(context, AnnotationDetector())}
    asked = first_answered(source, context, ("zebra left of the giraffe", "gibberish", *annotated.questions))
    assert asked in annotated.questions
    assert source.ask(context, asked).ranking is not None
    assert first_answered(source, context, ("zebra left of the giraffe",)) == ""
