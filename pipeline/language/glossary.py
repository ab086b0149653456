"""Words of the screen, the shell and the documents that are not everybody's, each explained once: `glossary.json`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path

from pipeline.system.errors import InputError


@dataclass(frozen=True)
class Term:
    """A word that is explained.

    Attributes
    ----------
    name, group : str
    short : str
        What it is in a few words.
    text : str
        What it means, in a sentence.
    """

    name: str
    group: str
    short: str
    text: str

    @property
    def hint(self) -> str:
        """Both, for those who hover over the word."""
        return f"{self.short}. {self.text}"


@cache
def glossary() -> dict[str, Term]:
    """All terms by their names, in groups."""
    groups = json.loads((Path(__file__).parent / "glossary.json").read_text("utf-8"))
    return {name: Term(name, group, *words) for group, terms in groups.items() for name, words in terms.items()}


def find_term(name: str) -> Term:
    """The term of a name, however it is capitalised; InputError names those that there are."""
    found = next((t for t in glossary().values() if t.name == name), None)
    found = found or next((t for t in glossary().values() if t.name.lower() == name.lower()), None)
    if found is None:
        raise InputError(f"the glossary does not explain {name!r}", expected=", ".join(glossary()))
    return found


def glossary_markdown() -> str:
    """The glossary as a document."""
    lines = [
        "# Glossary",
        "",
        "What the page says where the mouse rests on a word, and `spatialviz glossary` in the shell.",
    ]
    for group, terms in groupby(glossary().values(), lambda term: term.group):
        lines += ["", f"## {group}", "", "| word | is | |", "|---|---|---|"]
        lines += [f"| **{term.name}** | {term.short} | {term.text} |" for term in terms]
    return "\n".join(lines) + "\n"
