"""Expressions as they are shown to be corrected, and their answers set one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_world import FRAME, an_expression, saved

from pipeline.corrections import Corrector, ExpressionCard, FieldRef, Journal, set_answer
from pipeline.corrections.journal import edits
from pipeline.corrections.object_card import answers_with, expression_card, expression_cards
from pipeline.system import InputError


def test_a_card_says_what_the_row_says_and_the_pair_comes_first(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = an_expression(frame)
    cards = expression_cards(frame, (row["reference_object"], row["target_object"]))
    assert {c.id for c in cards} == set(frame.expressions)
    ends = {row["target_object"], row["reference_object"]}
    of_pair = [c.is_of(ends) for c in cards]
    assert of_pair == sorted(of_pair, reverse=True)
    assert of_pair[0]
    card = next(c for c in cards if c.id == row["id"])
    assert (card.text, list(card.targets), list(card.acceptable)) == (row["text"], row["targets"], row["acceptable"])
    assert card.names[row["target_object"]] == frame.objects[row["target_object"]]["label"]
    assert {o.source for o in card.origins.values()} == {"auto"}
    assert {c.id for c in expression_cards(frame)} == set(frame.auto.expressions)


def test_answers_are_set_one_by_one_and_the_origin_is_told(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = an_expression(frame)
    other = next(n for n in frame.objects if n not in row["acceptable"])
    saved(journal, set_answer(frame, row["id"], other, "likely"))
    frame = bare_corrector.frame(FRAME, journal)
    card = expression_card(frame, row["id"])
    assert card.certainty(other) == "likely"
    assert card.ambiguous
    assert card.origins["acceptable"].author == "ann"
    with pytest.raises(InputError, match="already"):
        set_answer(frame, row["id"], other, "likely")
    saved(journal, set_answer(frame, row["id"], other, "sure"))
    frame = bare_corrector.frame(FRAME, journal)
    for number in (*row["acceptable"], other):
        assert expression_card(frame, row["id"]).certainty(number) != "no"
    for number in row["acceptable"]:
        saved(journal, set_answer(frame, row["id"], number, "no"))
        frame = bare_corrector.frame(FRAME, journal)
    assert expression_card(frame, row["id"]).acceptable == (other,)
    with pytest.raises(InputError, match="needs an answer"):
        set_answer(frame, row["id"], other, "no")
    with pytest.raises(InputError, match="no such expression"):
        set_answer(frame, "0" * 16, other, "no")


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 5), st.sampled_from(["sure", "likely", "no"])), max_size=12))
def test_targets_are_always_acceptable(steps: list[tuple[int, Any]]) -> None:
    card = ExpressionCard("f", "e", "t", "a", "left", "b", 0, 1, (0,), (0,), {}, False, None, None, {}, "", {})
    for number, doubt in steps:
        targets, acceptable = answers_with(card, number, doubt)
        assert set(targets) <= set(acceptable)
        card = replace(card, targets=targets, acceptable=acceptable)
        assert card.certainty(number) == doubt


def test_a_rejected_expression_keeps_its_text_and_can_be_brought_back(
    bare_corrector: Corrector, journal: Journal
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    name = an_expression(frame)["id"]
    saved(journal, edits.set_text(frame, name, "one"))
    status = FieldRef("expression", FRAME, name, "status")
    frame = bare_corrector.frame(FRAME, journal)
    saved(journal, edits.set_status(frame, status, "rejected"))
    frame = bare_corrector.frame(FRAME, journal)
    card = expression_cards(frame)[-1]
    assert (card.id, card.text, card.withdrawn, card.status) == (name, "one", "rejected", "rejected")
    saved(journal, edits.set_text(frame, name, "two"))
    saved(journal, edits.set_status(bare_corrector.frame(FRAME, journal), status, None))
    frame = bare_corrector.frame(FRAME, journal)
    assert frame.expressions[name]["text"] == "two"
    assert not frame.unapplied


def test_each_reviewer_has_a_word_of_their_own(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    name = next(iter(frame.expressions))
    cell = FieldRef("expression", FRAME, name, "status")
    for author, status in (("ann", "accepted"), ("ben", "unsure")):
        saved(journal, edits.set_status(bare_corrector.frame(FRAME, journal), cell, status, author=author), author)
    card = expression_card(bare_corrector.frame(FRAME, journal), name)
    assert card.statuses == {"ann": "accepted", "ben": "unsure"}
    assert card.status is None
