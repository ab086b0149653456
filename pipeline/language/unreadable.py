"""Limits of expressions, and the errors that explain them and suggest a correction."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Literal

from pipeline.language import lexicon
from pipeline.language.relation_names import PHRASE
from pipeline.language.tokens import EXAMPLE, Token
from pipeline.language.tree import Query
from pipeline.system.errors import InputError, UnknownClass, Unsupported, require

FORM = "TARGET RELATION REFERENCE"
NOT_EXACT = "how exactly it stands so is not judged"
"""Of `directly` before a relation, which itself is judged."""
Unread = Literal["WORDS", "GRAMMAR", "UNSUPPORTED"]
"""Why an expression was not read as meant: a name is not known, the sentence cannot be read, or it can and what it asks
for is not judged."""


def why_unread(problem: InputError) -> Unread:
    """Kind of an expression's error."""
    if isinstance(problem, UnknownClass):
        return "WORDS"
    return "UNSUPPORTED" if isinstance(problem, Unsupported) else "GRAMMAR"


def why_unused(query: Query) -> Unread | None:
    """Kind of error of words left out; None where all were used, or only `directly` was not."""
    unused = [span for span in query.unused if span.note != NOT_EXACT]
    if not unused:
        return None
    return "WORDS" if any(span.unknown for span in unused) else "UNSUPPORTED"


def check_judged(tokens: Sequence[Token], text: str) -> None:
    """Refuse, by InputError, a question for a number, and a relation without a rule: `far from`."""
    words = [t.plain or "" for t in tokens]
    require(
        " ".join(words[:2]) not in ("how many", "how much"),
        "a number is asked for, and only a thing can be",
        got=f"'{text}'",
        expected=FORM,
        error=Unsupported,
    )
    for phrase in lexicon.FAR:
        size = len(phrase.split())
        require(
            not any(" ".join(words[i : i + size]) == phrase for i in range(1, len(words))),
            f"'{phrase}' is not a relation that is judged",
            got=f"'{text}'",
            expected="'farthest from' or 'near'",
            cause="it says only that two things are not near",
            error=Unsupported,
        )


def other_view(what: str, text: str) -> InputError:
    """Error for an expression judged from an object's front, or from somebody's position."""
    return Unsupported(
        f"'{what}' asks for another view than the camera's",
        got=f"'{text}'",
        cause="no object's own front is known; left, right, front and behind are judged from the camera",
    )


def unreadable(word: str, text: str) -> InputError:
    """Error for a word that has no place in the grammar at its position."""
    return InputError(f"'{word}' cannot be read here", got=f"'{text}'", expected=FORM, cause=EXAMPLE)


def not_known(tokens: Sequence[Token], at: int, text: str) -> InputError:
    """Error for a word that relates two things in a way that is not judged, or close to such a word."""
    word = tokens[at].text
    near = _close_phrases(tokens, range(max(at - 1, 0), at + 1))
    meant = " or ".join(f"'{phrase}'" for phrase in near)
    hint = f"did you mean {meant}?" if near else "known relations: " + ", ".join(PHRASE.values())
    error = Unsupported if tokens[at].plain in lexicon.UNKNOWN_RELATIONS | lexicon.ACTIONS else InputError
    return error(f"'{word}' is not a known relation", got=f"'{text}'", cause=hint)


def _close_phrases(tokens: Sequence[Token], starts: range) -> list[str]:
    """Relation phrases with letters close to one to four words that start at the given tokens, best first."""
    scores: dict[str, float] = {}
    for start in starts:
        for end in range(start + 1, min(start + 5, len(tokens) + 1)):
            if any(t.plain is None for t in tokens[start:end]):
                break
            run = " ".join(t.text for t in tokens[start:end])
            known = [p for p in lexicon.phrase_table() if p[0] == run[0] and abs(len(p) - len(run)) < 4]
            for phrase in difflib.get_close_matches(run, known, n=3, cutoff=0.7):
                score = difflib.SequenceMatcher(None, phrase, run).ratio()
                scores[phrase] = max(score, scores.get(phrase, 0.0))
    return sorted(scores, key=lambda p: (-scores[p], len(p), p))[:3]
