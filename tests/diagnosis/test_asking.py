"""Answers with their verdicts, as `ask` gives them: by annotations, by labels, and where nothing is known."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.answering import Pipeline, open_pipeline
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis import Baseline, Edits, ask_and_judge, asking
from pipeline.diagnosis.asking import case_of, why_refused
from pipeline.diagnosis.whatif import rerun
from pipeline.geometry import Frame
from pipeline.labels import Labels, SourceSpec, label_dataset, open_labels
from pipeline.language import PHRASE
from pipeline.relations import T
from pipeline.system import InputError

TEXTS = ("mug left of the laptop", "laptop right of the mug", "desk holding a laptop")


@pytest.fixture(scope="module")
def demo() -> Pipeline:
    return open_pipeline("demo", srm="rule")


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Labels:
    out = tmp_path_factory.mktemp("asking") / "labels"
    label_dataset(SourceSpec("demo"), out, limit=2)
    return open_labels(out)


class Changed:
    """The demo with other pictures, or without annotations."""

    def __init__(self, inner: Any, **changes: Any) -> None:
        self._inner, self._changes = inner, changes

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def load(self, frame_id: str) -> Frame:
        frame = self._inner.load(frame_id)
        return replace(frame, **{name: change(frame) for name, change in self._changes.items()})


def changed(source: Pipeline, **changes: Any) -> Pipeline:
    return replace(source, dataset=Changed(source.dataset, **changes))  # pyright: ignore[reportArgumentType]


def test_an_annotated_frame_is_judged_by_one_truth(demo: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    truths = []

    def counted(*arguments: Any) -> Any:
        truths.append(arguments)
        return known(*arguments)

    known = asking.annotated_truth
    monkeypatch.setattr(asking, "annotated_truth", counted)
    found = [a.record() for a in ask_and_judge(demo, 0, TEXTS)]
    assert len(truths) == 1
    json.dumps(found, allow_nan=False)
    first, second, third = found
    assert (first["verdict"]["verdict"], second["verdict"]["verdict"]) == ("CORRECT", "CORRECT")
    winner = first["verdict"]["winner"]
    assert {k: winner[k] for k in ("target", "reference")} == {k: first["pairs"][0][k] for k in ("target", "reference")}
    assert first["verdict"]["truth"]["target"] == first["answer"]["target"]["id"]
    assert (third["verdict"]["verdict"], third["verdict"]["truth"]["reference"] is None) == ("CORRECT", False)


def test_a_wrong_answer_is_blamed_as_in_a_run(demo: Pipeline, labels: Labels) -> None:
    weak = open_pipeline("demo", srm="rule", detector="simulated")
    row = next(r for r in labels.expressions.to_pylist() if r["frame"] == demo.dataset.frame_ids[0])
    (answer,) = ask_and_judge(weak, row["frame"], [row["text"]], labels)
    record = answer.record()
    assert answer.diagnosis is not None
    assert answer.diagnosis.case.id == row["id"]
    assert record["verdict"]["truth"]["acceptable"] == row["acceptable"]
    assert record["verdict"]["said"] == answer.diagnosis.text


def test_without_annotations_nothing_is_said(demo: Pipeline) -> None:
    recorded = changed(demo, annotations=lambda frame: ())
    for answer in ask_and_judge(recorded, 0, TEXTS[:1]):
        assert not {"verdict", "verdict_reason"} & answer.record().keys()


def test_labels_of_another_picture_judge_nothing(demo: Pipeline, labels: Labels) -> None:
    other = changed(demo, rgb=lambda frame: frame.rgb[:, ::-1].copy())
    (record,) = [a.record() for a in ask_and_judge(other, 0, TEXTS[:1], labels)]
    assert record["answer"] is not None
    assert record["verdict"] is None
    assert "another picture" in record["verdict_reason"]
    (record,) = [a.record() for a in ask_and_judge(demo, 5, TEXTS[:1], labels)]
    assert record["verdict"] is None
    assert "say nothing of frame" in record["verdict_reason"]


def test_labels_without_sentences_judge_what_is_asked(demo: Pipeline, labels: Labels, tmp_path: Path) -> None:
    """As those of things that people outlined in the page."""
    bare = tmp_path / "bare"
    shutil.copytree(labels.root, bare)
    table = pq.read_table(bare / "expressions.parquet")
    pq.write_table(table.slice(0, 0), bare / "expressions.parquet")
    with_sentences, without = (
        [a.verdict for a in ask_and_judge(demo, 0, TEXTS, known)] for known in (labels, open_labels(bare))
    )
    assert without == with_sentences
    assert "CORRECT" in without


def test_a_frame_that_is_not_there_is_an_error(demo: Pipeline) -> None:
    with pytest.raises(InputError, match="no frame"):
        list(ask_and_judge(demo, 999, TEXTS[:1]))


def test_any_answer_that_is_true_beyond_doubt_is_right(demo: Pipeline) -> None:
    """A typed sentence means no one pair: whichever of several true ones wins, the verdict is not about the label."""
    seen = 0
    for frame_id in demo.dataset.frame_ids[:3]:
        context = next(asking.contexts(demo, frame_id))
        truth = asking.annotated_truth(context, demo)
        assert truth is not None
        for relation in ("left", "behind"):
            sure = np.argwhere(truth.states[relation] == T)
            names = {(truth.labels[a], truth.labels[b]) for a, b in sure if truth.labels[a] != truth.labels[b]}
            for target, reference in sorted(names)[:12]:
                trace = demo.ask(context, f"{target} {PHRASE[relation]} the {reference}")
                found = case_of(truth, trace, demo, context)
                assert not isinstance(found, str)
                case = found[1]
                assert case.target_object in case.strict
                assert truth.states[relation][case.target_object, case.reference_object] == T
                best = trace.ranking.pairs[0]  # pyright: ignore[reportOptionalMemberAccess]
                place = int(np.flatnonzero(truth.numbers == trace.objects[best.target].id)[0])
                if place in case.strict:
                    seen += len(case.strict) > 1
                    assert case.target_object == place
    assert seen > 3


def test_an_edit_that_hides_the_right_object_changes_the_verdict(demo: Pipeline) -> None:
    context = next(asking.contexts(demo, 0))
    baseline = Baseline(demo, context, TEXTS[0])
    before = baseline.outcome
    assert before.trace.ranking is not None
    right = before.keys[before.trace.ranking.pairs[0].target]
    after = rerun(baseline, Edits(hidden=frozenset({right})))
    truth = asking.truth_or_reason(demo, context, None)
    found = [asking.judged(o.trace, demo, context, truth, RankConfig()).verdict for o in (before, before, after)]
    assert found == ["CORRECT", "CORRECT", "OPM-TARGET"]
    bare = changed(demo, annotations=lambda frame: ())
    nothing = asking.truth_or_reason(bare, next(asking.contexts(bare, 0)), None)
    assert asking.judged(after.trace, bare, context, nothing, RankConfig()).verdict is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("mug left of left", "Read as “mug left of left”: the dataset does not know the class 'left'"),
        ("laptop, the one left", "'the' is not a known relation; “X RELATION Y” is understood"),
        ("mug facing the door", "'facing the' asks for another view than the camera's"),
    ],
)
def test_a_refusal_is_one_short_sentence(demo: Pipeline, text: str, why: str) -> None:
    with pytest.raises(InputError) as error:
        demo.ask(demo.prepare(0), text)
    assert why_refused(demo, text, error.value) == why
