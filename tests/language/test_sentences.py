"""Sentences as people say them: what is read, what is left out, and that no word is dropped in silence."""

from __future__ import annotations

from itertools import pairwise

import pytest
from expression_checks import refused
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.language import parse
from pipeline.language.chain import OWN_WORDS
from pipeline.language.expression import MOST_READINGS
from pipeline.system import InputError


def unused(text: str) -> list[str]:
    return [text[s.start : s.end] for s in parse(text).unused]


@pytest.mark.parametrize(
    ("text", "description"),
    [
        # Sides before a noun
        ("the bottom right drawer", "drawer [bottom right]"),
        ("lower left cushion", "cushion [lower left]"),
        ("the lower cushion", "cushion [lower]"),
        ("the very left jar", "jar [very left]"),
        # What is said of a thing
        ("the kettle is red", "red kettle"),
        ("the jar is round and stands on the shelf", "round jar on shelf"),
        ("the jar beside the kettle is blue and white", "blue white jar near kettle"),
        ("the jar on the shelf that is green", "jar on green shelf"),
        ("the thing on the stool is a small clock", "small clock on stool"),
        ("the watering can is on the stool", "watering can on stool"),
        ("the big orange", "big orange"),
        ("the grey paper is on the stool", "grey paper on stool"),
        # References joined
        ("the jar next to the kettle and toaster", "(jar near kettle) near toaster"),
        ("the stool between the shelf and the lamp", "stool between shelf and lamp"),
        (
            "the stool between the shelf on the left and the lamp on the right",
            "stool between (shelf [on the left]) and (lamp [on the right])",
        ),
        # It
        ("the stool by the wall has a jar on top of it", "(stool near wall) supporting jar"),
        ("the stool is by the door and does not have a jar on it", "(stool near door) not supporting jar"),
        ("the shelf without a lamp on it", "shelf not supporting lamp"),
        ("the lamp is on the desk. it's above the stool", "lamp on (desk above stool)"),
        ("the shelf that the green jars are standing on", "shelf supporting green jars"),
        ("the shelf the jar is on", "shelf supporting jar"),
        ("the box which the jar is not in", "box not containing jar"),
        ("what are the two jars standing on?", "thing supporting jars"),
        ("which shelf is the jar on", "shelf supporting jar"),
        ("the jar that is neither on the desk nor on the shelf", "(jar not on desk) not on shelf"),
        ("the jar the kettle is behind", "jar in front of kettle"),
        ("the one that is not on the shelf", "one not on shelf"),
        ("the jar except the one on the shelf", "jar not on shelf"),
        ("which of the jars is the closest to the kettle", "jars closest to kettle"),
        # Told by `that` without an article
        ("jar that is on the shelf", "jar on shelf"),
        ("lamp that stands between the jar and the kettle", "lamp between jar and kettle"),
        ("the jar what is on the shelf", "jar on shelf"),
        # Frames of speech
        ("excuse me, where would I find the jar on the shelf?", "jar on shelf"),
        ("I am needing the lamp near the door", "lamp near door"),
        ("do you know where is the jar behind the kettle", "jar behind kettle"),
        # Words of colour that name a thing
        ("the green wine bottle", "green wine bottle"),
        ("the peach jar", "peach jar"),
        ("the peach sofa", "peach sofa"),
        # Sides without a preposition, frames of politeness
        ("plant far left", "plant [far left]"),
        ("blue cushion, right side", "blue cushion [right side]"),
        ("would you be so kind as to pass me the jar on the shelf, would you?", "jar on shelf"),
        ("please could i have the green jar", "green jar"),
        ("teh jar w/ a lid on top", "jar supporting lid"),
        # What is not meant
        ("not the jar on the stool but the one on the shelf", "(jar on shelf) not on stool"),
        ("not the green jar but the white one", "white jar, not green jar"),
        ("any jar but the green one", "jar, not green jar"),
        ("a jar that is neither green nor white", "jar, not green jar, not white jar"),
        # Stacks, pictures, participles
        ("the plate at the bottom of the pile", "plate [at the bottom of the pile]"),
        ("the plate at the top of the stack on the shelf", "plate [at the top of the stack] on shelf"),
        ("standing on top of the shelf", "thing on shelf"),
        ("the jar hidden partly behind the kettle", "jar behind kettle"),
        ("the jar below three hanging towels", "jar below hanging towels"),
        ("the darkest of the jars", "darkest jars"),
        ("the jar beside what looks like a toaster", "jar near toaster"),
    ],
)
def test_sentences_are_read(text: str, description: str) -> None:
    assert parse(text).default.description == description
    assert unused(text) == []


@pytest.mark.parametrize(
    ("text", "description", "left_out"),
    [
        ("the jar in the middle of the shelf", "jar on shelf", ["the middle of"]),
        ("the jar at the edge of the shelf", "jar near shelf", ["the edge of"]),
        (
            "the jar in the corner of the desk and to the left of the cup",
            "(jar on desk) left of cup",
            ["the corner of"],
        ),
        ("the jar right behind the kettle", "jar behind kettle", ["right"]),
        ("the jar is directly under the lamp", "jar below lamp", ["directly"]),
        ("the jar just left of the kettle", "jar left of kettle", ["just"]),
        ("the jar on the lowest shelf of the bookcase", "jar on bookcase", ["the lowest shelf of"]),
        ("the jar near the leg of the table", "jar near table", ["the leg of"]),
        ("the jar over there on the shelf", "jar on shelf", ["over there"]),
        ("the stool by the shelf that nobody sits on", "stool near shelf", ["nobody sits on"]),
        ("the jar leaning against the wall on the shelf", "jar on shelf", ["against the wall"]),
    ],
)
def test_what_cannot_be_judged_is_left_out_and_told(text: str, description: str, left_out: list[str]) -> None:
    query = parse(text)
    assert query.default.description == description
    assert unused(text) == left_out
    assert all(s.note for s in query.unused)


def test_a_misspelt_word_of_the_grammar_is_told() -> None:
    query = parse("teh mug abov the nex shelf")
    assert query.expression is not None
    assert query.expression.relation == "above"
    assert query.mended == (("teh", "the"), ("abov", "above"))
    assert parse("the mug above the shelf").mended == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("that one over there", "point to a place"),
        ("how many jars are on the shelf", "asks for a number"),
        ("the stool that faces the shelf", "another view"),
        ("the lamp pointing at the shelf", "another view"),
        ("the cushion somebody is leaning on", "what somebody does"),
        ("the jar without a lid", "does not have"),
    ],
)
def test_what_cannot_be_grounded_is_refused_with_the_reason(text: str, says: str) -> None:
    assert says in refused(text)


def test_a_side_of_a_thing_may_be_a_place_on_it() -> None:
    for text in ("the jar sitting on the left side of the table", "the jar on the right hand side of the counter"):
        beside, on = parse(text).readings
        assert beside.root.attachments[0].relation in ("left", "right")
        assert not beside.root.choices
        assert on.root.attachments[0].relation == "on"
        assert [c.order for c in on.root.choices] == [beside.root.attachments[0].relation]
    assert len(parse("the jar sitting on the left side of the kettle").readings) == 1
    assert len(parse("the jar to the left of the table").readings) == 1


def test_a_corner_of_the_picture_is_a_choice_even_where_pictures_are_things() -> None:
    root = parse("the jar in the top left corner of the picture", class_names=["picture", "jar"]).default.root
    assert not root.attachments
    assert [c.order for c in root.choices] == ["top", "left"]


CONTENT = ["jar", "kettle", "zorb", "green", "big", "glass", "wooden", "frobbing", "shelf", "table", "picture"]
GRAMMAR = sorted(OWN_WORDS)
MORE = ["of", "on", "the", "and", "is", "not", "left", "corner", "side", "second", "leftmost", "over", ",", "."]


@given(st.lists(st.sampled_from(CONTENT + GRAMMAR + MORE), min_size=1, max_size=18))
@settings(max_examples=100)
def test_no_word_is_dropped_in_silence(words: list[str]) -> None:
    text = " ".join(words)
    try:
        query = parse(text)
    except InputError:
        return
    assert all(a.end <= b.start for a, b in pairwise(query.spans))
    assert len(query.readings) <= MOST_READINGS
    start = 0
    for word in words:
        start = text.index(word, start)
        inside = any(s.start <= start and start + len(word) <= s.end for s in query.spans)
        assert inside or word in OWN_WORDS or not word.isalpha(), (word, query.spans)
        start += len(word)
