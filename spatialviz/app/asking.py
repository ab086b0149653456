"""What Ask offers while a question is typed: names of this frame's things, relations, and questions asked lately."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.language.relation_names import PHRASE
from spatialviz.app.state import State

OFFERED = 8


def offers(typed: str, state: State, suggestions: Sequence[str], asked: Sequence[str]) -> list[dict[str, str]]:
    """What may come next, the best first.

    {"text", "kind", "detail"}: a "question" stands for all that is typed, a "name" or a "relation" ends it.
    """
    text = typed.lower()
    sources = (("asked before", asked), ("example", suggestions))
    whole = [{"text": t, "kind": "question", "detail": detail} for detail, found in sources for t in found]
    if not text.strip():
        return _distinct(whole)
    found = [o for o in whole if o["text"].lower().startswith(text) and o["text"].lower() != text]
    names = sorted({o.label for o in state.shown.objects}, key=lambda n: (len(n), n))
    for kind, vocabulary in (("name", names), ("relation", list(dict.fromkeys(PHRASE.values())))):
        for word in vocabulary:
            if _begins(text, word.lower()) or (text.endswith(" ") and kind == _next(text, names)):
                found.append({"text": word, "kind": kind, "detail": "in this frame" if kind == "name" else kind})
    return _distinct(found)


def _begins(text: str, word: str) -> bool:
    """Whether the end of a text, from the beginning of a word of it, begins this word."""
    starts = (k for k in range(max(0, len(text) - len(word) + 1), len(text)) if k == 0 or text[k - 1] == " ")
    return any(word.startswith(text[k:]) for k in starts)


def _next(text: str, names: Sequence[str]) -> str:
    """What follows a text that ends with a whole word: a relation after a name, else a name."""
    return "relation" if any(text.rstrip().endswith(name.lower()) for name in names) else "name"


def _distinct(found: list[dict[str, str]]) -> list[dict[str, str]]:
    return list({o["text"].strip().lower(): o for o in reversed(found)}.values())[::-1][:OFFERED]
