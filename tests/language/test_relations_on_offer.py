"""Relations that are not on offer, and sentences that cannot be read."""

from __future__ import annotations

import pytest
from expression_checks import expression_of, refused, triple

from pipeline.language import RELATIONS, parse
from pipeline.language.tree import Expression
from pipeline.system import InputError

# ---- vocabularies of relations -----------------------------------------------------------------------------------

AVD = ("left", "right", "above", "below", "front", "behind")
SEMANTIC_ABSTRACTION = ("behind", "left", "right", "front", "on", "in")


def test_on_is_read_as_above_where_there_is_no_on() -> None:
    expression = expression_of("mug on top of the table", relations=AVD)
    assert (expression.relation, expression.mapped_from) == ("above", "on")
    assert expression.note is not None
    assert "on top of" in expression.note
    held = expression_of("table holding a mug", relations=AVD)
    assert (held.relation, held.inverse, held.mapped_from) == ("below", False, "on")
    under = expression_of("mug under the table", relations=AVD)
    assert (under.relation, under.mapped_from) == ("below", "under")


def test_nothing_is_mapped_without_need() -> None:
    for relations in (None, RELATIONS, SEMANTIC_ABSTRACTION):
        expression = expression_of("mug on the table", relations=relations)
        assert (expression.relation, expression.mapped_from, expression.note) == ("on", None, None)
    for phrase in ("below", "lower than"):
        assert expression_of(f"mug {phrase} table", relations=AVD).mapped_from is None
    assert expression_of("mug under the table").mapped_from is None


@pytest.mark.parametrize(
    ("text", "relations"),
    [
        ("mug in the box", AVD),
        ("mug above the box", SEMANTIC_ABSTRACTION),
        ("mug near the box", AVD),
        ("mug on the box", ["left"]),
        ("mug on the box", []),
    ],
)
def test_a_relation_that_is_not_on_offer_is_refused(text: str, relations: list[str]) -> None:
    message = refused(text, relations=relations)
    assert "not in this vocabulary" in message
    assert all(wording in message for wording in relations)


# ---- errors ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        (" \t\n", "empty"),
        ("the mug against the wall", "known relations: left of"),
        ("left of the laptop", "target is missing"),
        ("find the mug left of", "reference is missing"),
        ("mug left of the", "reference is missing"),
        ("left of", "target is missing"),
        ("the chair between the table", "two references"),
        ("the chair between the table and", "reference is missing"),
        ("mug left of it", "names no object"),
        ("the mug and the cup left of the laptop", "second target"),
        ("put the mug on the table", "asks to do something"),
        ("x" * 301 + " on y", "too long"),
        ("the cat is touching the dog", "'touching'"),
        ("the mug that has a handle", "parts"),
        ("mug\x00left of laptop", "control character"),
        ("mug left of \x1b[31mlaptop", "control character"),
        ("mug left of <b>laptop</b>", "cannot be read"),
        ("mug \u202eleft of laptop", "control character"),
        ("mug left of laptop \ud800", "control character"),
        ("mug on its top table", "cannot be read"),
        ("mug 😀 left of laptop", "cannot be read"),
    ],
)
def test_errors_say_what_is_wrong(text: str, says: str) -> None:
    message = refused(text)
    assert says in message
    message.encode("utf-8")


@pytest.mark.parametrize(
    "text",
    [
        "facing the couch, the lamp on the left of it",
        "the left side of the car's front",
        "the lamp to the couch's left",
        "from the sofa's point of view, the lamp left of the table",
        "the mug facing the laptop",
        "from the perspective of the sofa, the lamp left of the table",
        "looking at the front of the couch, the lamp behind it",
        "facing the couch from the side you sit on it, choose the lamp to the left of this couch",
        "as seen from the door, the chair left of the table",
        "if you sit on the sofa, the lamp is right of the tv",
        "from the point of view of the sofa, the lamp left of the table",
        "when facing the tv, the lamp left of the tv",
        "with your back to the door, the chair left of the table",
    ],
)
def test_an_objects_own_view_is_refused_with_the_reason(text: str) -> None:
    assert "no object's own front is known" in refused(text)


def test_known_names_are_not_taken_for_a_view() -> None:
    assert (
        triple("front facing camera left of the mug", class_names=["front facing camera"])[0] == "front facing camera"
    )


@pytest.mark.parametrize("bad", [None, 3, b"mug on table", ["mug"]])
def test_only_text_is_an_expression(bad: object) -> None:
    with pytest.raises(InputError, match="must be text"):
        parse(bad)  # type: ignore[arg-type]


def test_a_name_is_no_list_of_names() -> None:
    assert "class_names" in refused("mug on table", class_names="mug")
    assert "relations" in refused("mug on table", relations="on")
    assert "class name" in refused("mug on table", class_names=[3])


def test_an_expression_is_told_in_words() -> None:
    assert str(Expression("mug", "left", "laptop", "")) == "mug left of laptop"
    assert str(Expression("mug", "between", "laptop", "", "lamp")) == "mug between laptop and lamp"
