"""Correction of misspelt words, to words of the grammar and adjectives."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import lru_cache
from itertools import pairwise

from pipeline.language import choices
from pipeline.language.attributes import INTENSIFIERS, SINGLE_WORDS, attribute
from pipeline.language.lexicon import CONTRACTIONS, GRAMMAR_WORDS, SHORTHAND, phrase_table
from pipeline.language.name_lookup import one_letter_away, two_swapped
from pipeline.language.naming import default_synonyms, singular

_PHRASE_WORDS = frozenset(w for phrase in phrase_table() for w in phrase.split())
_CHOICE_WORDS = {
    w for phrase in (*choices.EXTREMES, *choices.SIDES, *choices.ORDINALS) for w in phrase.split() if len(w) > 4
} - {"background", "foreground", "distance"}
_OFTEN = (
    "left right behind front between beside besides under above below next near bottom middle closest nearest farthest "
    "furthest leftmost rightmost inside beneath underneath infront against across corner standing sitting hanging "
    "lying neither without something anything which where thing things object objects item camera viewer stack"
)
_MISSPELT = tuple(dict.fromkeys([*_OFTEN.split(), *sorted(_CHOICE_WORDS)]))
"""Words of the grammar that are taken for what a misspelt word should be."""
_SLIPS = {"th": "the"} | {
    word[:k] + word[k + 1] + word[k] + word[k + 2 :]: word
    for word in ("the", "that", "this", "and", "with", "which", "from")
    for k in range(len(word) - 1)
    if word != "from" or k != 1
}
"""Two letters of a small word that changed places: `teh`; `form` is a word of its own."""


@lru_cache(maxsize=4096)
def spelling_corrected(word: str) -> str:
    """Correct a misspelt word of the grammar: a letter more, less or two swapped, no apostrophe, or shorthand.

    A word that is known is left alone (`whats` and `plz` are corrected); in long ones one letter may be another.
    """
    found = _SLIPS.get(word) or CONTRACTIONS.get(word) or SHORTHAND.get(word)
    if found is not None:
        return found
    if len(word) < 3 or is_known(word):
        return word
    for meant in _MISSPELT:
        if abs(len(word) - len(meant)) <= 1 and word[0] == meant[0] and _one_slip(word, meant):
            return meant
    return word


def homophones_corrected(words: Sequence[str]) -> list[str]:
    """Correct words that sound like a small word of the grammar: `next too the`, `left off`."""
    found = list(words)
    for k, word in enumerate(words):
        before, after = words[k - 1] if k else "", words[k + 1] if k + 1 < len(words) else ""
        if word == "too" and (before in ("next", "close", "closest", "nearest", "near") or after in ("the", "a", "my")):
            found[k] = "to"
        elif word == "off" and before in ("left", "right", "front", "top"):
            found[k] = "of"
        elif word == "then" and before in choices.COMPARATIVES:
            found[k] = "than"
    return found


@lru_cache(maxsize=4096)
def is_known(word: str) -> bool:
    """Test if a word in lower case is of the grammar, an adjective or in a name of the table."""
    grammar = word in _PHRASE_WORDS or word in _MISSPELT or word in GRAMMAR_WORDS or word in choices.NUMBERS
    grammar = grammar or word in INTENSIFIERS or word in choices.ORDINALS
    return (
        grammar
        or word in default_synonyms().words
        or singular(word) in default_synonyms().words
        or attribute(word) is not None
    )


@lru_cache(maxsize=4096)
def attribute_meant(word: str) -> str | None:
    """Adjective meant by an unknown word: `purple` for `pruple`; None for none or several.

    Two letters that changed places and a letter too few come before a letter too many, and that before another letter;
    which short words are not. The ends stay: other words differ there (`pasted` and `pastel`).
    """
    if len(word) < 3 or not word.isalpha() or is_known(word):
        return None
    swapped = two_swapped(word) if len(word) > 3 else frozenset[str]()
    away = {w for w in one_letter_away(word) if w[0] == word[0]}
    longer = {w for w in away if len(w) > len(word)}
    shorter = {w for w in away if len(w) < len(word) and (w != word[:-1] or word[-1] == word[-2])}
    if len(word) == 4:
        shorter = {w for w in shorter if any(a == b for a, b in pairwise(word))}
    other = {w for w in away if len(w) == len(word) and w[-1] == word[-1]}
    for near in (swapped | longer, shorter, other if len(word) > 4 else frozenset[str]()):
        meant = sorted(near & SINGLE_WORDS)
        if meant:
            return meant[0] if len({attribute(w) for w in meant}) == 1 else None
    return None


def mended_words(words: Sequence[str], own: Collection[str]) -> tuple[list[str], list[bool]]:
    """Correct words in lower case, with a flag for each misspelt word; words of the user's `own` names stay."""
    read = homophones_corrected([word if word in own else spelling_corrected(word) for word in words])
    short = CONTRACTIONS.keys() | SHORTHAND.keys()
    return read, [a != b and a not in short for a, b in zip(words, read, strict=True)]


def _one_slip(word: str, meant: str) -> bool:
    start = next((k for k, (a, b) in enumerate(zip(word, meant, strict=False)) if a != b), min(len(word), len(meant)))
    a, b = word[start:], meant[start:]
    swapped = a[:2] == b[1::-1] and a[2:] == b[2:] and len(a) > 1
    other = len(word) > 6 and a[1:] == b[1:]
    return swapped or a[1:] == b or a == b[1:] or other
