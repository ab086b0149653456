"""What Ask offers while a question is typed: names of this frame's things, relations, and questions asked lately."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.language.relation_names import PHRASE
from spatialviz.app.state import State

OFFERED = 8


def offers(typed: str, state: State, suggestions: Sequence[str], asked: Sequence[str]) -> list[dict[str, str]]:
    """What may come next, the best first: {"text": the whole question, "kind": "name", "relation" or "asked"}."""
    text = typed.lower()
    whole = [{"text": t, "kind": kind} for kind, found in (("asked", asked), ("example", suggestions)) for t in found]
    if not text.strip():
        return _distinct(whole)
    found = [o for o in whole if o["text"].lower().startswith(text) and o["text"].lower() != text]
    names = sorted({o.label for o in state.shown.objects}, key=lambda n: (len(n), n))
    for kind, vocabulary in (("name", names), ("relation", list(dict.fromkeys(PHRASE.values())))):
        for word in vocabulary:
            begun = _begun(text, word.lower())
            if begun:
                found.append({"text": typed[: len(typed) - begun] + word + " ", "kind": kind})
            elif text.endswith(" ") and kind == _next(text, names):
                found.append({"text": typed + word + " ", "kind": kind})
    return _distinct(found)


def _begun(text: str, word: str) -> int:
    """How many characters at the end of a text, from the beginning of a word of it, begin this word; 0 for none."""
    for start in range(max(0, len(text) - len(word) + 1), len(text)):
        if (start == 0 or text[start - 1] == " ") and word.startswith(text[start:]):
            return len(text) - start
    return 0


def _next(text: str, names: Sequence[str]) -> str:
    """What follows a text that ends with a whole word: a relation after a name, else a name."""
    return "relation" if any(text.rstrip().endswith(name.lower()) for name in names) else "name"


def _distinct(found: list[dict[str, str]]) -> list[dict[str, str]]:
    return list({o["text"].strip().lower(): o for o in reversed(found)}.values())[::-1][:OFFERED]
