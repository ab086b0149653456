"""The words of a class name, and the spellings under which a table of vectors may hold each."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pipeline.language.naming import HEAD_ENDS, normal_form, singular
from pipeline.language.noun_phrase import readable

_JOINED = re.compile(r"[-‐-―/&'’.]+")


@dataclass(frozen=True)
class Word:
    """One word of a class name.

    Attributes
    ----------
    text : str
        Lower case, the head noun in the singular: the word as it is reported, and the one whose subwords count.
    spellings : tuple of str
        In the order in which they are looked up; `text` first.
    parts : tuple of Word
        What stands for `t-shirt` or `dog's` in a table without it; empty for a plain word.
    """

    text: str
    spellings: tuple[str, ...]
    parts: tuple[Word, ...] = ()


def phrase_words(name: str) -> tuple[Word, ...]:
    """The words of a class name: `CoffeeTables` -> coffee, table; `boxes_of_tissues` -> box, of, tissues.

    The name is made readable first (`pipeline.language.noun_phrase.readable`: underscores, camel case, articles, the
    first of several spellings, no qualifier), and its head noun becomes singular, so that a class has one vector
    however a dataset spells it.

    Parameters
    ----------
    name : str
        As a dataset spells it.

    Returns
    -------
    tuple of Word
        Empty for a name without a letter or digit.
    """
    written = readable(name).split()
    head = len(HEAD_ENDS.split(" ".join(written).lower(), maxsplit=1)[0].split()) - 1
    words = [_word(w, _singular(written[: i + 1]) if i == head else None) for i, w in enumerate(written)]
    return tuple(w for w in words if any(c.isalnum() for c in w.text))


def utf8(word: str) -> bytes:
    """As files spell it; nothing for a word that no file can hold."""
    try:
        return word.encode("utf-8")
    except UnicodeEncodeError:
        return b""


def _singular(head: list[str]) -> str:
    """The last word of a head in the singular, in lower case."""
    last = _bare(head[-1]).lower()
    if _JOINED.search(last):
        return singular(last)
    # Wine glasses are glasses, eyeglasses are not: the whole head decides.
    return (normal_form(" ".join([*head[:-1], last])).split() or [last])[-1]


def _bare(word: str) -> str:
    return word.strip("()[]{}.,'’") or word


def _word(written: str, one: str | None) -> Word:
    plain = _bare(written)
    lower = plain.lower()
    text = one or lower
    spellings = dict.fromkeys((text, lower, plain, text.capitalize(), text.upper(), written))
    pieces = [p for p in _JOINED.split(re.sub(r"['’]s$", "", lower)) if p]
    parts = tuple(_word(p, None) for p in pieces) if pieces not in ([], [lower]) else ()
    return Word(text, tuple(spellings), parts)
