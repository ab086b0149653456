"""What an expression may not say, and the errors that tell why and what is near."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from pipeline.language import lexicon
from pipeline.language.relation_names import PHRASE
from pipeline.language.tokens import EXAMPLE, Token
from pipeline.system.errors import InputError, require

FORM = "TARGET RELATION REFERENCE"
_NO_THINGS = lexicon.PRONOUNS | lexicon.LINKING | lexicon.AND | lexicon.WITH


def check_noun(tokens: Sequence[Token], role: str, text: str) -> None:
    """Refuse a noun that names no object or that holds words of a relation which nobody could read.

    Parameters
    ----------
    tokens : sequence of Token
        The noun without its articles, at least one token.
    role : str
        "target" or "reference", for the message.
    text : str
        The whole expression, for the message.

    Raises
    ------
    InputError
    """
    words = [t.plain for t in tokens]
    negation = next((w for w in words if w in lexicon.NEGATIONS), None)
    require(
        not negation, f"negation cannot be grounded: '{negation}'", got=f"'{text}'", expected="a relation that holds"
    )
    whole = " ".join(t.text for t in tokens)
    if None not in words and lexicon.SIDE_ONLY.fullmatch(whole):
        raise InputError(
            f"'{whole}' is a side and names no object", got=f"'{text}'", expected=FORM, cause="of what? " + EXAMPLE
        )
    require(
        not all(w in _NO_THINGS for w in words),
        f"the {role} names no object: '{whole}'",
        got=f"'{text}'",
        expected="the name of a thing",
    )
    for i, word in enumerate(words):
        before = words[i - 1] if i else None
        if i and word in lexicon.ARTICLES and before not in lexicon.ARTICLE_BEARING:
            require(
                before not in lexicon.AND,
                f"'{before} {word}' names a second {role}",
                got=f"'{text}'",
                expected=f"one {role} a relation",
            )
            raise _unknown_relation(tokens, i - 1, text)
        if word in lexicon.UNKNOWN_RELATIONS:
            raise _unknown_relation(tokens, i, text)
        if i and word in lexicon.VERBS:
            raise unreadable(str(word), text)


def check_judged(tokens: Sequence[Token], text: str) -> None:
    """Refuse a relation that has words and no rule: `far from`.

    Raises
    ------
    InputError
    """
    words = [t.plain or "" for t in tokens]
    for phrase in lexicon.FAR:
        size = len(phrase.split())
        require(
            not any(" ".join(words[i : i + size]) == phrase for i in range(1, len(words))),
            f"'{phrase}' is not a relation that is judged",
            got=f"'{text}'",
            expected="'farthest from' or 'near'",
            cause="it says only that two things are not near",
        )


def other_view(what: str, text: str) -> InputError:
    """The error for an expression judged from an object's front, or from where somebody stands."""
    return InputError(
        f"'{what}' asks for another view than the camera's",
        got=f"'{text}'",
        cause="no object's own front is known; left, right, front and behind are judged from the camera",
    )


def unreadable(word: str, text: str) -> InputError:
    """The error for a word that has no place in the grammar where it stands."""
    return InputError(f"'{word}' cannot be read here", got=f"'{text}'", expected=FORM, cause=EXAMPLE)


def _unknown_relation(tokens: Sequence[Token], at: int, text: str) -> InputError:
    word = tokens[at].text
    near = _close_phrases(tokens, range(max(at - 1, 0), at + 1))
    hint = _did_you_mean(near) if near else "known relations: " + ", ".join(PHRASE.values())
    return InputError(f"'{word}' is not a known relation", got=f"'{text}'", cause=hint)


def no_relation(tokens: Sequence[Token], text: str) -> InputError:
    """The error for an expression without a relation, with the phrases that a misspelt one is close to."""
    words = [t.plain for t in tokens]
    if any(w in lexicon.NEGATIONS for w in words):
        return InputError("no relation found, and negation cannot be grounded", got=f"'{text}'", expected=FORM)
    near = _close_phrases(tokens, range(1, len(tokens)))
    if near:
        return InputError("no relation found", got=f"'{text}'", expected=FORM, cause=_did_you_mean(near))
    unknown = next((i for i, w in enumerate(words) if i and w in lexicon.UNKNOWN_RELATIONS), None)
    if unknown is not None:
        return _unknown_relation(tokens, unknown, text)
    return InputError("no relation found", got=f"'{text}'", expected=FORM, cause=EXAMPLE)


def _close_phrases(tokens: Sequence[Token], starts: range) -> list[str]:
    """Relation phrases whose letters are close to one to four words that start at the given tokens, best first."""
    scores: dict[str, float] = {}
    known = list(lexicon.phrase_table())
    for start in starts:
        for end in range(start + 1, min(start + 5, len(tokens) + 1)):
            if any(t.plain is None for t in tokens[start:end]):
                break
            run = " ".join(t.text for t in tokens[start:end])
            for phrase in difflib.get_close_matches(run, known, n=3, cutoff=0.7):
                score = difflib.SequenceMatcher(None, phrase, run).ratio()
                scores[phrase] = max(score, scores.get(phrase, 0.0))
    return sorted(scores, key=lambda p: (-scores[p], len(p), p))[:3]


def _did_you_mean(phrases: Sequence[str]) -> str:
    return "did you mean " + " or ".join(f"'{p}'" for p in phrases) + "?"
