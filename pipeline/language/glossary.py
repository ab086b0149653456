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
    fault : str
        What is wrong where a verdict names this module, in a few words.
    """

    name: str
    group: str
    short: str
    text: str
    fault: str = ""

    @property
    def verdict(self) -> str:
        """What it says as a verdict, in a few words."""
        return self.fault or self.short

    @property
    def meaning(self) -> str:
        """What it means, as a module and as a verdict."""
        return f"{self.text} As a verdict: {self.fault}." if self.fault else self.text

    @property
    def hint(self) -> str:
        """All of it, for those who hover over the word."""
        return f"{self.short}. {self.meaning}"


@cache
def glossary() -> dict[str, Term]:
    """All terms by their names, in groups."""
    groups = json.loads((Path(__file__).parent / "glossary.json").read_text("utf-8"))
    return {name: Term(name, group, *words) for group, terms in groups.items() for name, words in terms.items()}


def explained(name: str) -> Term | None:
    """The term of a name, however it is capitalised; None where there is none."""
    return glossary().get(name) or next((t for t in glossary().values() if t.name.lower() == name.lower()), None)


def find_term(name: str) -> Term:
    """The term of a name, however it is capitalised; InputError names those that there are."""
    found = explained(name)
    if found is None:
        raise InputError(f"the glossary does not explain {name!r}", expected=", ".join(glossary()))
    return found


def glossary_markdown() -> str:
    """The glossary as a document."""
    lines = [
        "# Glossary",
        "",
        "What the page says where the mouse rests on a word or Tab reaches it, and `spatialviz ask --glossary`.",
    ]
    for group, terms in groupby(glossary().values(), lambda term: term.group):
        lines += ["", f"## {group}", "", "| word | is | |", "|---|---|---|"]
        lines += [f"| **{term.name}** | {term.short} | {term.meaning} |" for term in terms]
    return "\n".join(lines) + "\n"
