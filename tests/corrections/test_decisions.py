"""Questions of a review: what each label claims, what three answers make of it, and two people who differ."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from journal_world import FRAME, an_expression, saved
from state_checks import frame, left, some_pairs  # noqa: F401

from pipeline.corrections import ItemKey, Journal
from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.review.decisions import (
    Answer,
    ReviewQuestion,
    edits_of_answer,
    question_of,
    state_edits,
    words_of,
)
from pipeline.corrections.review.items import NOBODY, State
from pipeline.corrections.review.worklist import frame_states
from pipeline.relations import F, T, U

Frame = Callable[[], EffectiveFrame]


def asked(frame: EffectiveFrame, item: ItemKey, journal: Journal | None = None) -> ReviewQuestion:
    words = () if journal is None else words_of(frame, journal.events(frame=FRAME), item)
    question = question_of(frame, item, "mug", words)
    assert question is not None
    return question


def state_of(frame: Any, journal: Journal, item: ItemKey) -> State:
    return frame_states(frame(), journal.events(frame=FRAME)).get(item, "unreviewed")


@pytest.mark.parametrize(
    ("state", "words", "right", "wrong"), [(T, " is ", T, F), (F, " is not ", F, T), (U, "Is ", T, F)]
)
def test_a_relation_claims_what_its_label_says(
    frame: Frame, journal: Journal, state: int, words: str, right: int, wrong: int
) -> None:
    (a, b), *_ = some_pairs(frame(), 1)
    if frame().pairs.state(a, b, "left") != state:
        saved(journal, actions.set_relation(frame(), a, b, "left", state))
    question = asked(frame(), left(a, b))
    assert words in question.claim
    assert {name: choice.state for name, choice in question.choices.items()} == {
        "right": right,
        "wrong": wrong,
        "unsure": U,
    }
    answers: tuple[tuple[Answer, int], ...] = (("wrong", wrong), ("unsure", U))
    for answer, wanted in answers:
        saved(journal, edits_of_answer(frame(), question, answer, "ann"))
        assert frame().pairs.state(a, b, "left") == wanted


def test_the_same_three_answers_are_for_objects_and_sentences(frame: Any, journal: Journal) -> None:
    number, spoken = frame().pairs.numbers.tolist()[0], an_expression(frame())["id"]
    states: dict[Answer, State] = {"unsure": "unsure", "right": "accepted", "wrong": "rejected"}
    for item in (ItemKey(FRAME, "object", number, None, ""), ItemKey(FRAME, "expression", NOBODY, None, spoken)):
        for answer, state in states.items():
            saved(journal, edits_of_answer(frame(), asked(frame(), item), answer, "ann"))
            assert state_of(frame, journal, item) == state
        assert asked(frame(), item).choices["wrong"].does == "leave it out"
    assert number not in frame().objects
    assert spoken not in frame().expressions


def test_one_answer_settles_what_two_people_differ_on(frame: Any, journal: Journal) -> None:
    (a, b), *_ = some_pairs(frame(), 1)
    item, now = left(a, b), frame().pairs.state(a, b, "left")
    saved(journal, actions.set_relation(frame(), a, b, "left", F if now == T else T))
    item = left(a, b)
    changed = frame().pairs.state(a, b, "left")
    journal.append(state_edits(frame(), item, now, "bob"), "bob")
    question = asked(frame(), item, journal)
    assert [word.author for word in question.words] == ["ann", "bob"]
    assert (question.choices["right"].state, question.choices["wrong"].state) == (changed, now)
    assert question.choices["wrong"].does.startswith("bob: ")
    saved(journal, edits_of_answer(frame(), question, "wrong", "ann"))
    assert frame().pairs.state(a, b, "left") == now
    assert state_of(frame, journal, item) == "corrected"
    assert not words_of(frame(), journal.events(frame=FRAME), item)


def test_two_people_differ_on_an_object(frame: Any, journal: Journal) -> None:
    number = frame().pairs.numbers.tolist()[0]
    item = ItemKey(FRAME, "object", number, None, "")
    for author, answer in (("ann", "right"), ("bob", "wrong")):
        journal.append(edits_of_answer(frame(), asked(frame(), item), answer, author), author)  # pyright: ignore
    question = asked(frame(), item, journal)
    assert [choice.does for choice in question.choices.values()] == ["ann: correct", "bob: wrong", "ask another"]
    saved(journal, edits_of_answer(frame(), question, "right", "ann"))
    assert state_of(frame, journal, item) == "accepted"
    assert number in frame().objects


def test_what_is_gone_or_unnamed(frame: Frame) -> None:
    assert question_of(frame(), ItemKey(FRAME, "object", 99_999, None, "")) is None
    missing = asked(frame(), ItemKey(FRAME, "object", NOBODY, None, "1,2,3,4"))
    assert missing.claim == "No mug is labelled here"
    assert [c.does for c in missing.choices.values()] == ["none is missing", "one is missing", "ask another"]
