"""Glossary of the screen, the shell and the documents, each word explained once: `glossary.json`."""

from __future__ import annotations

import json
from functools import cache
from itertools import groupby
from pathlib import Path

from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class GlossaryTerm:
    """An explained word."""

    name: str
    group: str
    short: str  # Meaning in a few words
    text: str  # Meaning in a sentence
    fault: str = ""  # What is wrong where a verdict names this module, in a few words

    @property
    def verdict(self) -> str:
        """Meaning as a verdict, in a few words."""
        return self.fault or self.short

    @property
    def meaning(self) -> str:
        """Meaning as a module and as a verdict."""
        return f"{self.text} As a verdict: {self.fault}." if self.fault else self.text

    @property
    def hint(self) -> str:
        """Hint for the word: all of the meaning."""
        return f"{self.short}. {self.meaning}"


@cache
def glossary() -> dict[str, GlossaryTerm]:
    """All terms by name, in groups."""
    groups = json.loads((Path(__file__).parent / "glossary.json").read_text("utf-8"))
    return {name: GlossaryTerm(name, group, *words) for group, terms in groups.items() for name, words in terms.items()}


def explained(name: str) -> GlossaryTerm | None:
    """Term of a name in any case; None if unknown."""
    return glossary().get(name) or next((t for t in glossary().values() if t.name.lower() == name.lower()), None)


def find_term(name: str) -> GlossaryTerm:
    """Term of a name in any case; InputError lists the known names.

    >>> from pipeline.language import find_term
    >>> find_term("lift").name
    'LIFT'
    """
    found = explained(name)
    if found is None:
        raise InputError(f"the glossary does not explain {name!r}", expected=", ".join(glossary()))
    return found


DOCUMENTED = {
    "The pipeline": "[the pipeline](concepts.md#the-pipeline)",
    "Numbers of an answer": "[scores and states](concepts.md#scores-and-states)",
    "Verdicts": "[each verdict with a picture](verdicts.md)",
    "What a run shows": "[debugging](debugging.md)",
    "Labels": "[what is kept](concepts.md#what-is-kept-on-disk)",
}
"""Groups of the document, each with where more is said; the others name what the page has."""


def glossary_markdown() -> str:
    """Glossary as a Markdown document."""
    lines = [
        "# Glossary",
        "",
        "Words that you meet in the page, in tables and in these documents. What a switch of the page does is said",
        "where the mouse rests on it; `spatialviz ask --glossary WORD` explains any word in the shell.",
    ]
    for group, terms in groupby(glossary().values(), lambda term: term.group):
        if group in DOCUMENTED:
            lines += ["", f"## {group}", "", f"More: {DOCUMENTED[group]}.", "", "| word | meaning |", "|---|---|"]
            lines += [f"| **{term.name}** | {term.hint} |" for term in terms]
    return "\n".join(lines) + "\n"
