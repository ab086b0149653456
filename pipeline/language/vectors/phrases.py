"""Vectors of phrases from vectors of words, with a list of unknown words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipeline.language.naming import HEAD_ENDS, normal_form, singular
from pipeline.language.noun_phrase import readable
from pipeline.system.errors import InputError

_NAMED = 8
"""At most so many names in an error."""


class VectorSource(Protocol):
    """Interface of a format. A vector is (D,) float32, finite and not all zero, or unknown."""

    @property
    def name(self) -> str:
        """Name of the file."""
        ...

    @property
    def dimension(self) -> int: ...

    @property
    def kind(self) -> str:
        """Kind of entries. `word`: a phrase may be the mean of its words; `phrase`: only whole entries count."""
        ...

    def fingerprint(self) -> str:
        """Hash of the contents, the same for the same vectors elsewhere."""
        ...

    def find(self, spellings: Iterable[str]) -> Mapping[str, np.ndarray]:
        """Vectors of the spellings in the file, letter by letter."""
        ...

    def whole(self, name: str) -> np.ndarray | None:
        """Vector of a name held as one entry."""
        ...

    def infer(self, word: str) -> np.ndarray | None:
        """Vector of a word outside the file, from the parts of its spelling."""
        ...


@dataclass(frozen=True, eq=False)
class PhraseVector:
    """The vector of one name."""

    vector: np.ndarray  # (D,) float32
    missing: tuple[str, ...] = ()  # Words without a vector, which do not count in the mean
    inferred: tuple[str, ...] = ()  # Words outside the vocabulary, with vectors from their subwords


@dataclass(frozen=True, eq=False)
class PhraseTable:
    """The vectors of several names."""

    names: tuple[str, ...]  # In the order of the call
    vectors: np.ndarray  # (N, D) float32
    missing: dict[str, tuple[str, ...]]  # The words without a vector, of each name that has such
    inferred: dict[str, tuple[str, ...]]  # The words whose vectors come from subwords, of each name that has such
    # The names of which no word is known; their rows are zeros, and they stand in `missing` too
    unknown: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class VectorFile:
    """Vectors of class names, from one file."""

    source: VectorSource

    @property
    def name(self) -> str:
        return self.source.name

    @property
    def dimension(self) -> int:
        return self.source.dimension

    @property
    def kind(self) -> str:
        return self.source.kind

    def fingerprint(self) -> str:
        """Hash of the contents, the same for the same vectors elsewhere."""
        return self.source.fingerprint()

    def vector(self, phrase: str, *, normalised: bool = False, allow_missing: bool = False) -> PhraseVector:
        """Vector of a name, as in `phrases`. Of a .vec file, ask for all names at once instead."""
        table = self.phrases([phrase], normalised=normalised, allow_missing=allow_missing)
        return PhraseVector(table.vectors[0], table.missing.get(phrase, ()), table.inferred.get(phrase, ()))

    def phrases(self, names: Sequence[str], *, normalised: bool = False, allow_missing: bool = False) -> PhraseTable:
        """Vectors of names.

        A name that the file holds as one entry has that entry's vector. Any other has the mean of the vectors of its
        words, all alike, in a file of words; in a file of phrases it is not known. A word is looked up in lower case
        first, then as written, with a capital, in capitals; for `t-shirt`, its parts stand in where all of them are
        known; last, where the file has them, its subwords.

        Parameters
        ----------
        names : sequence of str
            Class names as a dataset spells them: `trash_can`, `CoffeeTable`.
        normalised : bool
            Divide every vector by its length before the mean is taken, as FastText's getSentenceVector
            does. The mean itself is not normalised again.
        allow_missing : bool
            Give a name of which no word is known a row of zeros, and a place in `unknown`, instead of an error.

        Raises
        ------
        InputError
            Names of which no word is known, unless they are allowed; a file that turns out to be damaged.
        """
        if isinstance(names, str):
            raise InputError("names of classes are a sequence", got=repr(names), expected="a list of names")
        distinct = dict.fromkeys(names)
        whole = {name: self.source.whole(name) for name in distinct}
        words = {n: phrase_words(n) for n in distinct if whole[n] is None and self.kind == "word"}
        asked = (s for group in words.values() for w in group for one in (w, *w.parts) for s in one.spellings)
        found = self.source.find(dict.fromkeys(asked)) if words else {}
        rows: dict[str, np.ndarray] = {}
        missing: dict[str, tuple[str, ...]] = {}
        inferred: dict[str, tuple[str, ...]] = {}
        for name, vector in whole.items():
            if vector is not None:
                rows[name] = _unit(vector) if normalised else vector
                continue
            parts, lost, guessed = self._known(words.get(name, ()), found)
            if parts:
                rows[name] = np.stack([_unit(p) if normalised else p for p in parts]).mean(axis=0, dtype=np.float64)
            if lost or not parts:
                missing[name] = tuple(lost) or (readable(name) or name,)
            if guessed:
                inferred[name] = tuple(guessed)
        unknown = tuple(name for name in distinct if name not in rows)
        if unknown and not allow_missing:
            raise self._not_known(unknown)
        vectors = np.zeros((len(names), self.dimension), np.float32)
        for k, name in enumerate(names):
            if name in rows:
                vectors[k] = rows[name]
        vectors.flags.writeable = False
        return PhraseTable(tuple(names), vectors, missing, inferred, unknown)

    def _known(
        self, words: Sequence[Word], found: Mapping[str, np.ndarray]
    ) -> tuple[list[np.ndarray], list[str], list[str]]:
        """Vectors of the mean, unknown words, and words known by their subwords."""
        vectors: list[np.ndarray] = []
        missing: list[str] = []
        inferred: list[str] = []
        for word in words:
            direct = _first(word, found)
            pieces = [_first(p, found) for p in word.parts]
            known = [p for p in pieces if p is not None]
            if direct is not None:
                vectors.append(direct)
            elif known and len(known) == len(pieces):
                vectors += known
            elif (guess := self.source.infer(word.text)) is not None:
                vectors.append(guess)
                inferred.append(word.text)
            elif known:
                vectors += known
                missing += [w.text for w, p in zip(word.parts, pieces, strict=True) if p is None]
            else:
                missing.append(word.text)
        return vectors, missing, inferred

    def _not_known(self, unknown: Sequence[str]) -> InputError:
        listed = ", ".join(repr(n[:60]) for n in unknown[:_NAMED])
        more = f" and {len(unknown) - _NAMED} more" if len(unknown) > _NAMED else ""
        if self.kind == "word":
            return InputError("no word of a name has a text vector", got=listed + more, path=self.name)
        return InputError(
            "names have no text vector", got=listed + more, expected="each name as an entry of the file",
            cause="it holds whole phrases, of which no mean is taken", path=self.name,
        )  # fmt: skip


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
