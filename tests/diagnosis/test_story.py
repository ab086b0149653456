"""What is said of every answer: a head and a sentence for each verdict and kind, short, plain, and true of the run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_worlds import world

from pipeline.answering import ScoredPair
from pipeline.datasets import demo_run
from pipeline.diagnosis import Diagnosis, Missed, diagnose
from pipeline.diagnosis.story import change_words, judged_story, unjudged_story
from pipeline.diagnosis.story_words import LONGEST, STORIES, WORDS, Story, story, values_of
from pipeline.evaluation import open_run
from pipeline.evaluation.run import Evaluator
from pipeline.labels import read_cases

FORBIDDEN = re.compile(
    r"\b(its|Verdict|false positives?|confidences?|product|margin|posterior|None|PARSE|OPM|LIFT|SRM|PRM|CONF|LABEL|"
    r"ATTRIBUTE|COMPOUND)\b|[{}]"
)
LONGEST_HEAD = 6
SAMPLE = dict.fromkeys((v for _, _, s in STORIES.values() for t in s for v in values_of(t)), "mug") | {
    "really": "something without a label",
    "beside": "something without a label",
    "ending": "the answer is something without a label",
    "faults": "a 3D box is off and the detector was 5 times surer of a wrong mug",
    "reason": "no such frame",
    "Wrong": "Not answered",
    "Number": "three",
    "by": "",
}


def plain(told: Story) -> None:
    """Assert that a story is short, and without words that a stranger does not know."""
    assert told.head
    assert len(told.head.split()) <= LONGEST_HEAD, told
    assert told.sentence.endswith(".")
    assert len(told.sentence.split()) <= LONGEST, told
    assert told.tone == STORIES[told.kind][0]
    for words in (told.head, told.sentence, told.mend):
        # What people wrote is quoted as they wrote it.
        assert not FORBIDDEN.search(re.sub("“[^”]*”", "", words)), told
        assert not re.search(r"  | [,;.]|\(\)|nan", words), told


@pytest.mark.parametrize("kind", STORIES)
def test_every_kind_is_said_shortly_and_plainly(kind: str) -> None:
    plain(story(kind, **SAMPLE))
    for sentence in STORIES[kind][2]:
        plain(replace(story(kind, **SAMPLE), sentence=sentence.format(**SAMPLE)))


def test_other_words_are_plain_too() -> None:
    for group in ("really", "ending", "faults", "mends", "factors", "truths", "done", "changes"):
        for kind, words in WORDS[group].items():
            assert kind == "margin" or not FORBIDDEN.search(re.sub(r"\{\w+\}", "", words)), words


CASES = [world(seed) for seed in range(40)]
DETAILS: dict[str, tuple[str | None, ...]] = {
    "CORRECT": (None,),
    "LABEL": ("AMBIGUOUS", "SUSPECT", "BAD_LABEL", "BAD_BOX"),
    "PARSE": ("WORDS", "GRAMMAR", "UNSUPPORTED"),
    "OPM-TARGET": ("RANK", "THRESHOLD", "LOCALISATION", "ABSENT"),
    "OPM-REF": ("RANK", "THRESHOLD", "LOCALISATION", "ABSENT"),
    "LIFT": (None,),
    "ATTRIBUTE": (None,),
    "SRM": (None, "CHOICE", "CONSTANT"),
    "OPM-CONF": (None,),
    "PRM": (None, "DEGENERATE", "SCORE"),
    "COMPOUND": ("LIFT+SRM", "SRM+CONF", "LIFT+SRM+CONF", "RECALL", "RECALL+CONF", "LIFT+ATTRIBUTE"),
    "UNEXPLAINED": ("ANSWER", "PROPOSALS", "BOXES", "NOT-SEPARABLE"),
}


def variants(verdict: str, detail: str | None) -> Iterator[Diagnosis]:
    """Diagnoses of a verdict with and without pairs, lucky or not, with false objects or not."""
    evidence, case = next((e, c) for e, c in CASES if e.detections > 3)
    near, far = ScoredPair(0, 1, 0.6, 0.5, 0.9, -1.0, 0.1, 0.5), ScoredPair(2, 3, 0.1, 0.4, 0.2, -2.0, 0.01, 0.1)
    repair = tuple((detail or "").split("+")) if verdict == "COMPOUND" else ()
    base = Diagnosis(verdict, detail, False, repair, 0, np.full(16, np.nan), near, far, case=case, evidence=evidence)
    missed = verdict.startswith("OPM-") and detail is not None
    if missed:
        base = replace(base, missed=Missed(detail, 0.3, 0.2, 7), missed_name="mug")  # pyright: ignore
    pairs = ((near, far), (far, near), (near, near), (None, far), (None, None))
    for winner, right in pairs:
        for false in ((False, False), (True, False), (False, True), (True, True)):
            yield replace(base, winner=winner, right=right, false_target=false[0], false_reference=false[1])
    yield replace(base, lucky=True, false_reference=True)
    yield replace(base, lucky=True)
    yield replace(base, lucky=True, winner=None)
    if missed:
        yield replace(base, missed=Missed("RANK", 0.9, 0.4, 1, suppressed=True))


@pytest.mark.parametrize(("verdict", "detail"), [(v, d) for v, ds in DETAILS.items() for d in ds])
def test_every_verdict_and_kind_of_it_has_a_story(verdict: str, detail: str | None) -> None:
    for d in variants(verdict, detail):
        told = judged_story(d)
        plain(told)
        assert told.tone == {"CORRECT": "right", "LABEL": "also right"}.get(verdict, "wrong")
        assert (told.head == "Wrong, reason unknown") == (verdict == "UNEXPLAINED")


def test_worlds_are_told() -> None:
    for evidence, case in CASES:
        for mark in (None, "BAD_BOX", "BAD_LABEL"):
            plain(diagnose(evidence, case, parse_ok=True, mark=mark).story)


def test_an_answer_without_a_verdict_has_a_story() -> None:
    assert unjudged_story(None, "no frame 99", None) == Story("refused", "none", "Could not be asked", "No frame 99.")
    assert STORIES["unjudged"][1] == "No label to judge by"


def test_all_answers_of_the_demos_run_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each as its record has it."""
    run, told = open_run(demo_run()), []

    def kept(d: Diagnosis, *more: object) -> Story:
        told.append(judged_story(d, *more))  # pyright: ignore[reportArgumentType]
        return told[-1]

    monkeypatch.setattr("pipeline.diagnosis.decision.judged_story", kept)
    evaluator = Evaluator(run.spec)
    for truth in read_cases(evaluator.labels, 0, len(evaluator.source.dataset.frame_ids)):
        evaluator.frame(truth)
    assert [s.sentence for s in told] == run.records.column("said").to_pylist()
    assert len(told) == 1800
    for one in told:
        plain(one)
    mended = {s.kind for s in told if s.mend}
    assert mended.isdisjoint(s.kind for s in told if not s.mend)
    assert all(STORIES[kind][0] == "wrong" for kind in mended)


@pytest.mark.parametrize(
    ("changed", "before", "after", "words"),
    [
        (False, "right", "lucky.alone", "Answer unchanged"),
        (True, "false", "right", "✓ Now correct"),
        (True, "false", "label.another", "✓ Now correct"),
        (True, "false", "label.text", "Another answer"),
        (True, "right", "false", "✕ Now wrong"),
        (True, "right", "lucky.alone", "✓ Another answer, also correct"),
        (True, "false", "ranked", "✕ Another answer, still wrong"),
        (True, "unjudged", "unjudged", "Another answer"),
    ],
)
def test_what_edits_did_is_said_in_a_few_words(changed: bool, before: str, after: str, words: str) -> None:
    assert change_words(changed, story(before, **SAMPLE), story(after, **SAMPLE)) == words
