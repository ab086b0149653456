"""Class names while they are typed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.corrections import Vocabulary, completions
from pipeline.language import Synonyms, normal_form

TABLE = Synonyms(
    (frozenset({"trash can", "bin", "dustbin"}), frozenset({"sofa", "couch"}), frozenset({"kettle", "water boiler"}))
)
WORDS = Vocabulary.of(
    ["trashcan"] * 3 + ["sofa"] * 2 + ["book"] * 5 + ["bookshelf"] + ["notebook"] * 9 + ["comic book"] * 4,
    ["book stand", "sofa"],
    TABLE,
)


def names(typed: str, vocabulary: Vocabulary = WORDS) -> list[str]:
    return [c.name for c in completions(typed, vocabulary)]


def test_the_beginning_counts_more_than_a_word_and_that_more_than_a_part() -> None:
    assert names("boo") == ["book", "bookshelf", "book stand", "comic book", "notebook"]


@pytest.mark.parametrize("typed", ["trash can", "Trash  Can", "trash_can", "trashcan", "trash cans"])
def test_spellings_of_one_name_are_one_name(typed: str) -> None:
    first = completions(typed, WORDS)[0]
    assert (first.name, first.count, first.known) == ("trashcan", 3, True)


def test_another_name_of_a_class_leads_to_it_and_says_so() -> None:
    assert [(c.name, c.via, c.known) for c in completions("couch", WORDS)] == [("sofa", "couch", True)]
    assert [(c.name, c.via) for c in completions("dustb", WORDS)] == [("trashcan", "dustbin")]


def test_words_that_no_class_has_are_offered_last_and_are_not_known() -> None:
    assert [(c.name, c.known) for c in completions("water", WORDS)] == [("water boiler", False)]
    assert "water boiler" not in WORDS
    assert "trash can" not in WORDS
    assert "trashcan" in WORDS
    more = WORDS.with_names(["kettlebell"])
    assert names("kettle", more)[0] == "kettle"
    assert [c.known for c in completions("kettleb", more)] == [True]


def test_nothing_typed_means_the_most_frequent_classes() -> None:
    assert names("") == ["notebook", "book", "comic book", "trashcan", "sofa", "bookshelf", "book stand"]
    assert names("   ") == names("")


@given(st.text(max_size=12))
def test_whatever_is_typed_each_name_comes_once_and_holds_it(typed: str) -> None:
    found = completions(typed, WORDS, most=50)
    assert len({c.name for c in found}) == len(found)
    short = typed.lower().replace("_", " ").replace(" ", "")
    for c in found:
        spoken = (c.via or normal_form(c.name)).replace(" ", "")
        pieces = ("".join(short.split()), normal_form(typed).replace(" ", ""))
        assert any(p in spoken for p in pieces)


@given(st.sampled_from(sorted(WORDS.counts)))
def test_a_whole_name_comes_first(name: str) -> None:
    assert names(name)[0] == name
