"""Ways in which people say the same: openers, comparisons, what is not meant, misspelt words, order of the words."""

from __future__ import annotations

import pytest
from expression_checks import refused

from pipeline.language import parse


def unused(text: str) -> list[str]:
    return [text[s.start : s.end] for s in parse(text).unused]


@pytest.mark.parametrize(
    ("text", "description"),
    [
        # Openers
        ("wheres the jar thats on the shelf", "jar on shelf"),
        ("how about the jar beside the kettle", "jar near kettle"),
        ("whats standing next to the kettle", "thing near kettle"),
        ("which one of the jars is on the shelf", "jars on shelf"),
        ("plz can u find the jar behind the kettle", "jar behind kettle"),
        ("I can't find the jar, it was on the shelf", "jar on shelf"),
        ("look, the jar on the shelf", "jar on shelf"),
        ("what do you see left of the kettle", "thing left of kettle"),
        ("out of the three jars, the middle one", "jars [middle]"),
        ("hand sanitizer on the desk", "hand sanitizer on desk"),
        ("Might I bother you for the jar on the shelf?", "jar on shelf"),
        ("Would you be so very kind as to hand me the kettle", "kettle"),
        ("I should be glad to see the jar, please", "jar"),
        ("I seek jar on shelf", "jar on shelf"),
        ("may I trouble you for one of the jars on the shelf", "jars on shelf"),
        ("please be so kind as to hand me second jar from the left", "jar [second from the left]"),
        ("may I ask where the kettle is", "kettle"),
        ("if you would be so kind, the jar by the kettle", "jar near kettle"),
        ("tryin to locate the jar", "jar"),
        ("we require hand towels", "hand towels"),
        # As who learns English says it
        ("the jar at left from the kettle", "jar left of kettle"),
        ("the jar close of the kettle", "jar near kettle"),
        ("the jar under from the shelf", "jar below shelf"),
        ("the jar beside of the kettle", "jar near kettle"),
        ("shelf where there is a jar on it", "shelf supporting jar"),
        ("the shelf that has on top a jar", "shelf supporting jar"),
        ("the jar colour red", "red jar"),
        ("the jar on the right from the camera", "jar [on the right]"),
        ("the jar left from my view", "jar [left]"),
        # Without small words
        ("kettle right", "kettle [right]"),
        ("kettle left back", "kettle [left back]"),
        ("second jar in back row", "jar [second] [in back row]"),
        # Comparisons
        ("the farther jar", "jar [farther]"),
        ("the bigger one of the two jars", "jars [bigger]"),
        ("the closer jar to the kettle", "jar closest to kettle"),
        ("the jar further left than the kettle", "jar left of kettle"),
        ("the jar thats furthest away", "jar [furthest away]"),
        ("the left of the two jars", "jars [left]"),
        ("second-largest jar", "jar [largest]"),
        ("the next closest jar", "jar [closest]"),
        ("the second to last jar", "jar [second to last]"),
        ("jar no. 2 from the left", "jar [no. 2 from the left]"),
        ("show the jar second from left", "jar [second from left]"),
        ("the second jar on the top shelf", "jar [second] on (shelf [top])"),
        # What is not meant
        ("a jar that is neither green nor grey", "jar, not green jar, not grey jar"),
        ("the jar that is neither red, green nor blue", "jar, not red jar, not green jar, not blue jar"),
        ("the jar near neither the desk nor the shelf", "(jar not near desk) not near shelf"),
        ("not the red jar, the blue one", "blue jar, not red jar"),
        ("the non-red jar", "jar, not red jar"),
        ("not red jar", "jar, not red jar"),
        ("all jars except the two at the back", "jars, not jars [at the back]"),
        ("the jar that is not on the left", "jar, not jar [on the left]"),
        ("the jars minus the red one", "jars, not red jars"),
        ("any jar except the one in front and the red one", "jar, not jar [in front], not red jar"),
        ("the jar except the jars by the kettle", "jar not near kettle"),
        ("a jar on no shelf", "jar not on shelf"),
        ("the jar nowhere near the kettle", "jar not near kettle"),
        ("jar other than the red one", "jar, not red jar"),
        # Any class
        ("something yellow that is not in a jar", "yellow something not in jar"),
        ("anything that is not on the shelf", "anything not on shelf"),
        # Looks after the thing
        ("jar small and red", "small red jar"),
        ("the jar in dark blue", "dark blue jar"),
        ("the jar of red colour", "red jar"),
        # Order of the words
        ("next to the kettle is a jar", "jar near kettle"),
        ("in front of the shelf there is a jar", "jar in front of shelf"),
        ("do you see the shelf? Behind it there is a jar.", "jar behind shelf"),
        ("the shelf on which the jar stands", "shelf supporting jar"),
        ("the stool that the plant stands on", "stool supporting plant"),
        ("the two jars next to each other", "jars near jars"),
        ("the sofa below the picture", "sofa below picture"),
    ],
)
def test_it_is_read(text: str, description: str) -> None:
    read = parse(text).default.description
    assert read.replace("blue one, not red one", "blue jar, not red jar") == description
    assert unused(text) == []


@pytest.mark.parametrize(
    ("text", "description", "left_out"),
    [
        ("red or blue jar", "red jar", ["or blue"]),
        ("the jar near the kettle or the cup", "jar near kettle", ["or the cup"]),
        ("the other jar", "jar", ["other"]),
        ("the third closest jar to the door", "jar closest to door", ["third"]),
        ("the jar near the not red kettle", "jar near kettle", ["not red"]),
        ("the jar flanked by two kettles", "jar near kettles", ["flanked"]),
        ("a stool to sit on near the door", "stool near door", ["to sit on"]),
        ("the chair whose seat is red near the door", "chair near door", ["whose seat is red"]),
        ("the jar closer to the door than the lamp", "jar closest to door", ["than the lamp"]),
        ("the jar of dirty red colour", "red jar", ["dirty"]),
    ],
)
def test_it_is_left_out_and_told(text: str, description: str, left_out: list[str]) -> None:
    assert parse(text).default.description == description
    assert unused(text) == left_out
    assert all(s.note for s in parse(text).unused)


@pytest.mark.parametrize(
    ("text", "label", "told"),
    [
        ("teh pruple jar", "purple jar", (("teh", "the"), ("pruple", "purple"))),
        ("the jar is pruple", "purple jar", (("pruple", "purple"),)),
        ("smal wodden jar", "small wooden jar", (("smal", "small"), ("wodden", "wooden"))),
        ("the tallset jar", "jar", (("tallset", "tallest"),)),
        ("jar next too the kettle", "jar", (("too", "to"),)),
        ("somthing on the shelf", "something", (("somthing", "something"),)),
        # Words that are no slips of a letter stay as they are
        ("the stray jar", "stray jar", ()),
        ("the twin jar", "twin jar", ()),
        ("a sort of brown jar", "sort of brown jar", ()),
    ],
)
def test_misspelt_words_are_mended_and_told(text: str, label: str, told: tuple[tuple[str, str], ...]) -> None:
    query = parse(text)
    assert query.target == label
    assert query.mended == told


def test_what_is_not_on_a_surface_is_judged_where_the_detector_knows_it() -> None:
    text = "the jar on the shelf without a kettle"
    assert parse(text, class_names=["jar", "shelf", "kettle"]).default.description == (
        "jar on (shelf not supporting kettle)"
    )
    assert "does not have" in refused("the shelf without a hinge", class_names=["shelf", "kettle"])


def test_a_shelf_of_books_is_a_thing_and_the_shelf_of_a_cupboard_a_part_of_it() -> None:
    assert parse("jar in the shelf of books").default.root.attachments[0].nodes[0].name == "shelf of books"
    assert unused("jar on the shelf of the cupboard") == ["the shelf of"]


def test_a_view_from_elsewhere_is_no_politeness() -> None:
    assert "another view" in refused("if you look at the shelf, the jar")


def test_a_word_of_the_users_names_is_not_misspelt() -> None:
    query = parse("the pruple jar", class_names=["pruple jar", "pruple"])
    assert query.target == "pruple jar"
    assert query.mended == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("not the jar", "only what is not meant"),
        ("the thing I can drink from", "what a thing is for"),
        ("a jar with no handle", "does not have"),
        ("the jar taller than the kettle", "'than'"),
    ],
)
def test_what_cannot_be_judged_alone_is_refused(text: str, says: str) -> None:
    assert says in refused(text)
