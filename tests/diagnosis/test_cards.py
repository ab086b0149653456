"""Cards of answers: what was answered beside what is right."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline import open_run
from pipeline.datasets.demo import demo_run
from pipeline.diagnosis.cards import Card, cards_of
from pipeline.evaluation.run_folder import Run


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(demo_run())


def cards(run: Run, search: str) -> tuple[Card, ...]:
    answer = run.failures(search)[0].answer
    trace = answer.trace
    pair = answer.pairs[0] if answer.pairs else None
    found = cards_of(trace, answer.diagnosis, pair, trace.name if trace is not None else str)
    for card in found:
        assert card.title
        assert card.objects[0].role == "target"
        for thing in card.objects:
            assert thing.name
            assert np.isfinite(thing.bbox).all()
    return found


def test_a_right_answer_stands_alone(run: Run) -> None:
    (card,) = cards(run, "verdict:CORRECT lucky:false")
    assert card.kind == "answer"
    assert all(thing.note.startswith("scored ") for thing in card.objects)


def test_what_a_wrong_box_really_is_stands_under_its_name(run: Run) -> None:
    answer, right = cards(run, "verdict:OPM-CONF")
    assert any(thing.note.startswith("really ") for thing in answer.objects)
    assert all(thing.index is not None for thing in right.objects)


@pytest.mark.parametrize(
    ("search", "role", "note"),
    [
        ("verdict:OPM-TARGET detail:ABSENT", 0, "not seen"),
        ("verdict:OPM-TARGET detail:THRESHOLD", 0, "dropped"),
        ("verdict:OPM-REF detail:ABSENT", 1, "not seen"),
        ("verdict:OPM-TARGET detail:LOCALISATION", 0, "badly boxed"),
    ],
)
def test_a_missed_thing_says_why_it_is_not_there(run: Run, search: str, role: int, note: str) -> None:
    missed = cards(run, search)[-1].objects[role]
    assert missed.index is None
    assert note in missed.note


def test_beside_a_right_answer_the_label_is_not_called_what_should_be(run: Run) -> None:
    assert [card.kind for card in cards(run, "verdict:LABEL detail:AMBIGUOUS")] == ["answer", "label"]


def test_luck_names_the_right_reference(run: Run) -> None:
    answer, right = cards(run, "verdict:CORRECT lucky:true")
    assert answer.objects[0].index == right.objects[0].index
    assert answer.objects[1].index != right.objects[1].index


def test_a_refused_question_has_only_what_should_be(run: Run) -> None:
    (card,) = cards(run, "verdict:PARSE detail:UNSUPPORTED")[-1:]
    assert card.kind == "right"
