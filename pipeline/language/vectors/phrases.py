"""Vectors of phrases from vectors of words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.language.naming import HEAD_ENDS, normal_form, singular
from pipeline.language.noun_phrase import readable
from pipeline.system.errors import InputError

_NAMED = 8
"""At most so many names in an error."""


class VectorFile:
    """Vectors of class names from one file; a format says how they are found.

    A vector is (D,) float32, finite and not all zero, or the word is unknown.
    """

    path: Path
    dimension: int
    kind: str  # "word": a phrase may be the mean of its words; "phrase": only whole entries count

    @property
    def name(self) -> str:
        return self.path.name

    def fingerprint(self) -> str:
        """Hash of the contents, the same for the same vectors elsewhere."""
        raise NotImplementedError

    def find(self, spellings: Iterable[str]) -> Mapping[str, np.ndarray]:
        """Vectors of the spellings in the file, letter by letter."""
        raise NotImplementedError

    def whole(self, name: str) -> np.ndarray | None:
        """Vector of a name held as one entry."""
        return None

    def infer(self, word: str) -> np.ndarray | None:
        """Vector of a word outside the file, from the parts of its spelling."""
        return None

    def phrases(self, names: Sequence[str], *, normalised: bool = False) -> np.ndarray:
        """Vectors of class names as a dataset spells them (`trash_can`, `CoffeeTable`), (N, D) float32.

        A name that the file holds as one entry has that entry's vector. Any other has the mean of the vectors of its
        words, all alike, in a file of words; in a file of phrases it is not known. A word is looked up in lower case
        first, then as written, with a capital, in capitals; for `t-shirt`, its parts stand in where all of them are
        known; last, where the file has them, its subwords. Words that are not known do not count.

        With `normalised` every vector is divided by its length before the mean is taken, as FastText's
        getSentenceVector does. The mean itself is not normalised again.

        Raises
        ------
        InputError
            Names of which no word is known; a file that turns out to be damaged.
        """
        if isinstance(names, str):
            raise InputError("names of classes are a sequence", got=repr(names), expected="a list of names")
        whole = {name: self.whole(name) for name in dict.fromkeys(names)}
        words = {n: phrase_words(n) for n, vector in whole.items() if vector is None and self.kind == "word"}
        asked = (s for group in words.values() for w in group for one in (w, *w.parts) for s in one.spellings)
        found = self.find(dict.fromkeys(asked)) if words else {}
        rows: dict[str, np.ndarray] = {}
        for name, vector in whole.items():
            parts = self._of_words(words.get(name, ()), found) if vector is None else [vector]
            if parts:
                rows[name] = np.stack([_unit(p) if normalised else p for p in parts]).mean(axis=0, dtype=np.float64)
        unknown = [name for name in whole if name not in rows]
        if unknown:
            raise self._not_known(unknown)
        vectors = np.array([rows[name] for name in names], np.float32).reshape(len(names), self.dimension)
        vectors.flags.writeable = False
        return vectors

    def _of_words(self, words: Sequence[Word], found: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        vectors: list[np.ndarray] = []
        for word in words:
            direct = _first(word, found)
            pieces = [p for p in (_first(part, found) for part in word.parts) if p is not None]
            if direct is None and (not pieces or len(pieces) < len(word.parts)):
                direct = self.infer(word.text)
            vectors += pieces if direct is None else [direct]
        return vectors

    def _not_known(self, unknown: Sequence[str]) -> InputError:
        listed = ", ".join(repr(n[:60]) for n in unknown[:_NAMED])
        more = f" and {len(unknown) - _NAMED} more" if len(unknown) > _NAMED else ""
        if self.kind == "word":
            return InputError("no word of a name has a text vector", got=listed + more, path=self.name)
        return InputError(
            "names have no text vector",
            got=listed + more,
            expected="each name as an entry of the file",
            cause="it holds whole phrases, of which no mean is taken",
            path=self.name,
        )


def _first(word: Word, found: Mapping[str, np.ndarray]) -> np.ndarray | None:
    return next((found[s] for s in word.spellings if s in found), None)


def _unit(vector: np.ndarray) -> np.ndarray:
    """Normalise in float64, for the squares of tiny floats are zero."""
    wide = vector.astype(np.float64)
    return wide / np.linalg.norm(wide)


_JOINED = re.compile(r"[-‐-―/&'’.]+")


@dataclass(frozen=True)
class Word:
    """One word of a class name."""

    text: str  # Lower case, the head noun in the singular: the word as it is reported, and the one whose subwords count
    spellings: tuple[str, ...]  # In the order in which they are looked up; `text` first
    parts: tuple[Word, ...] = ()  # Stand-ins for `t-shirt` or `dog's` in a table without it; empty for a plain word


def phrase_words(name: str) -> tuple[Word, ...]:
    """Words of a class name: `CoffeeTables` -> coffee, table; `boxes_of_tissues` -> box, of, tissues.

    The name is made readable first (`pipeline.language.noun_phrase.readable`: underscores, camel case, articles, the
    first of several spellings, no qualifier), and its head noun becomes singular, so that a class has one vector
    however a dataset spells it. Empty for a name without a letter or digit.
    """
    written = readable(name).split()
    head = len(HEAD_ENDS.split(" ".join(written).lower(), maxsplit=1)[0].split()) - 1
    words = [_word(w, _singular(written[: i + 1]) if i == head else None) for i, w in enumerate(written)]
    return tuple(w for w in words if any(c.isalnum() for c in w.text))


def utf8(word: str) -> bytes:
    """Encode a word as in files; empty for a word that no file can hold."""
    try:
        return word.encode("utf-8")
    except UnicodeEncodeError:
        return b""


def _singular(head: list[str]) -> str:
    """Last word of a head in the singular, in lower case."""
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
