"""Words for how things look: what each is taken for, whatever its spelling, its strength and the words before it."""

from __future__ import annotations

import pytest

from pipeline.language import Attribute, attribute
from pipeline.relations import SIZES
from pipeline.relations.attributes import _LIGHTNESS


@pytest.mark.parametrize(
    ("words", "kind", "value", "shade"),
    [
        ("red", "color", "red", None),
        ("Reddish", "color", "red", None),
        ("grey", "color", "gray", None),
        ("dark blue", "color", "blue", "dark"),
        ("light-grey", "color", "gray", "light"),
        ("lightblue", "color", "blue", "light"),
        ("navy blue", "color", "blue", "dark"),
        ("reddish brown", "color", "brown", None),
        ("cream-coloured", "color", "beige", None),
        ("blue-green", "color", "turquoise", None),
        ("very dark", "color", "dark", None),
        ("whitish", "color", "white", None),
        ("large", "size", "big", None),
        ("really tiny", "size", "small", None),
        ("oval shaped", "shape", "round", None),
        ("oblong", "shape", "rectangular", None),
        ("wooden", "material", "wooden", None),
        ("stainless steel", "material", "metal", None),
        ("see-through", "other", "transparent", None),
        ("empty", "other", "empty", None),
    ],
)
def test_a_word_is_taken_for_its_plain_form(words: str, kind: str, value: str, shade: str | None) -> None:
    found = attribute(words)
    assert found is not None
    assert (found.kind, found.value, found.shade) == (kind, value, shade)


@pytest.mark.parametrize("words", ["", "mug", "the", "left", "book", "dish", "red mug", "red brick", "candy", "fish"])
def test_other_words_are_none(words: str) -> None:
    assert attribute(words) is None


def test_everything_that_is_read_as_a_colour_or_a_size_can_be_judged() -> None:
    from pipeline.language import attributes

    for word, found in attributes._TABLE.items():
        assert attribute(word) == found, word
        if found.kind == "color":
            assert found.value in {*_LIGHTNESS, "light", "dark"}, word
        if found.kind == "size":
            assert found.value in SIZES, word
    assert attribute("red") == Attribute("color", "red")
