"""This pair is correct: objects, relation and sentence in one action, by which the answer is judged."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import pytest

from pipeline.answering import Pipeline, Trace, all_objects, open_pipeline
from pipeline.corrections import (
    JournalLocation,
    LabelEditor,
    Saved,
    effective_truth,
    right_pair,
    why_not_kept,
)
from pipeline.datasets import demo_path
from pipeline.diagnosis import Diagnosis, judge_trace
from pipeline.labels import begun_labels
from pipeline.language import parse
from pipeline.relations import T
from pipeline.system import InputError


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline(demo_path(), detector="simulated", srm="rule")


def asked(source: Pipeline) -> tuple[str, str]:
    """A frame and a plain question that has several ranked pairs."""
    for name in source.dataset.frame_ids[:6]:
        context = source.prepare(name)
        labels = sorted({o.label for o in all_objects(context, source.needed_detector())})
        for one in labels:
            for other in labels:
                trace = source.ask(context, f"{one} left of the {other}") if one != other else None
                if trace is not None and trace.ranking is not None and len(trace.ranking.pairs) > 1:
                    return name, trace.query.text
    raise AssertionError("no such question")


def of_two_relations(source: Pipeline) -> Trace:
    """A question with two relations that the detector's objects answer with three things."""
    for name in source.dataset.frame_ids[:6]:
        context = source.prepare(name)
        labels = sorted({o.label for o in all_objects(context, source.needed_detector())})
        for one, other, third in permutations(labels, 3):
            trace = source.ask(context, f"{one} near the {other} and right of the {third}")
            if trace.ranking is not None and not trace.ranking.degenerate:
                pair = trace.ranking.pairs[0]
                if len({pair.target, *(link.b for link in pair.links)}) == 3:
                    return trace
    raise AssertionError("no such question")


def test_a_pair_of_several_relations_that_is_right_is_judged_by_them(source: Pipeline, tmp_path: Path) -> None:
    trace = of_two_relations(source)
    name, context = trace.frame.id, source.prepare(trace.frame.id)
    assert trace.ranking is not None
    best = trace.ranking.pairs[0]
    location = JournalLocation(begun_labels(source.dataset, tmp_path / "mine"))
    ann = LabelEditor(location.labels, location, "ann", source.dataset)
    ann.take_in(name)
    assert isinstance(ann.save(right_pair(ann, trace, best)), Saved)
    frame = ann.frame(name)
    assert len(frame.objects) == 3
    # The truth of such a sentence follows from the labels: no sentence is kept.
    assert not frame.expressions
    numbers = {row["label"]: n for n, row in frame.objects.items()}
    target = trace.root.name
    for a in trace.root.attachments:
        assert frame.pairs.state(numbers[target], numbers[a.nodes[0].name], a.relation) == T
    verdict = judge_trace(trace, source, context, effective_truth(frame))
    assert isinstance(verdict, Diagnosis), verdict
    assert verdict.verdict == "CORRECT"
    with pytest.raises(InputError, match="say so already"):
        right_pair(ann, trace, best)
    ann.undo()
    # Nothing is labelled any more.
    assert "true of nothing" in str(judge_trace(trace, source, context, effective_truth(ann.frame(name))))
    location.close()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{0} between the {1} and the {2}", "judged by geometry"),
        ("{0} closest to the {1}", "judged by geometry"),
        ("leftmost {0} near the {1}", "that are labelled"),
        ("{0} near the {1}, not the {2}", "that are labelled"),
        ("{0} that is not on the {1}", "that are labelled"),
        ("{0} closest to me", "that are labelled"),
        ("{0} near the red {1}", "the pixels"),
        ("the {0}", "no relation"),
        ("{0} near the {1} on the {2}", ""),
        ("{1} holding a {0}", ""),
        ("{0} left of the {1}", ""),
    ],
)
def test_what_cannot_be_kept_says_why(text: str, why: str) -> None:
    found = why_not_kept(parse(text.format("mug", "table", "lamp")).default.root)
    assert why in found
    assert bool(why) == bool(found)


def test_a_pair_that_is_right_is_judged_by_itself(source: Pipeline, tmp_path: Path) -> None:
    name, text = asked(source)
    location = JournalLocation(begun_labels(source.dataset, tmp_path / "mine"))
    ann = LabelEditor(location.labels, location, "ann", source.dataset)
    ann.take_in(name)
    context = source.prepare(name)
    trace = source.ask(context, text)
    assert trace.ranking is not None
    best, second = trace.ranking.pairs[:2]
    done = ann.save(right_pair(ann, trace, best))
    assert isinstance(done, Saved)
    frame = ann.frame(name)
    assert len(frame.objects) == 2
    (row,) = frame.expressions.values()
    assert frame.pairs.state(row["target_object"], row["reference_object"], "left") == T
    verdict = judge_trace(trace, source, context, effective_truth(frame))
    assert isinstance(verdict, Diagnosis)
    assert verdict.verdict == "CORRECT"
    with pytest.raises(InputError, match="say so already"):
        right_pair(ann, trace, best)
    # Another pair is right after all: the answer is wrong then, and one undo brings the first back.
    assert isinstance(ann.save(right_pair(ann, trace, second)), Saved)
    other = judge_trace(trace, source, context, effective_truth(ann.frame(name)))
    assert isinstance(other, Diagnosis)
    targets = [trace.objects[p.target].id for p in (best, second)]
    assert (other.verdict == "CORRECT") == (targets[0] == targets[1])
    ann.undo()
    assert ann.frame(name).expressions == frame.expressions
    location.close()
