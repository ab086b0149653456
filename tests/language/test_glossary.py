"""The glossary: whole, and the same in the document as in the program."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.diagnosis import MODULE_OF, ORACLES, VERDICTS
from pipeline.language import find_term, glossary_markdown
from pipeline.language.glossary import glossary
from pipeline.system import InputError


def test_the_document_is_the_glossary():
    document = Path(__file__).parents[2] / "docs" / "glossary.md"
    assert document.read_text("utf-8") == glossary_markdown()


@pytest.mark.parametrize("name", [*VERDICTS, *MODULE_OF.values(), *ORACLES, "T", "U", "F", "Shapley"])
def test_every_verdict_module_and_oracle_is_explained(name):
    assert glossary()[name].text.endswith(".")


def test_a_word_is_found_however_it_is_written():
    assert find_term("opm-conf").name == "OPM-CONF"
    assert find_term("IOU").hint.startswith(find_term("IoU").short)
    with pytest.raises(InputError, match=r"zzz.*posterior"):
        find_term("zzz")


def test_words_are_explained_once_and_end_as_sentences():
    terms = list(glossary().values())
    assert len({t.name for t in terms}) == len(terms)
    for term in terms:
        assert term.text.endswith((".", "?"))
        assert not term.short.endswith(".")
        assert "|" not in term.text


@pytest.mark.parametrize("name", MODULE_OF)
def test_what_a_verdict_says_of_a_module_is_told_with_it(name):
    term = glossary()[name]
    assert term.verdict == (term.fault or term.short)
    assert term.verdict in term.hint
    assert term.verdict in glossary_markdown()
