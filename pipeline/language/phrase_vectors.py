"""Vectors of class names from vectors of words, and the contract of a relation network on them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from pipeline.language.naming import HEAD_ENDS, normal_form, singular
from pipeline.language.noun_phrase import readable
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

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

    def phrases(self, names: Sequence[str], *, normalised: bool = False) -> np.ndarray:
        """Vectors of class names as a dataset spells them (`trash_can`, `CoffeeTable`), (N, D) float32.

        A name that the file holds as one entry has that entry's vector. Any other has the mean of the vectors of its
        words, all alike, in a file of words; in a file of phrases it is not known. A word is looked up in lower case
        first, then as written, with a capital, in capitals; for `t-shirt`, its known parts stand in. Words that are
        not known do not count.

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

    text: str  # Lower case, the head noun in the singular: the word as it is reported
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


CONTRACT = "spatialviz-language-1"
"""Also the rules by which a name becomes words and words become a vector: a change of these must change it."""

PREFIX = "srm.language."
"""Every metadata key begins so."""


@dataclass(frozen=True)
class LanguageContract:
    """The language features of a relation network."""

    name: str  # The file of vectors, for people
    dimension: int
    normalised: bool  # Vectors were divided by their lengths before the mean was taken
    fingerprint: str  # Of the vectors

    @classmethod
    def of(cls, vectors: VectorFile, *, normalised: bool = False) -> LanguageContract:
        return cls(vectors.name, vectors.dimension, normalised, vectors.fingerprint())

    def to_metadata(self) -> dict[str, str]:
        """Contract as string properties of an ONNX file."""
        values = {
            "contract": CONTRACT,
            "name": self.name,
            "dimension": str(self.dimension),
            "normalised": "true" if self.normalised else "false",
            "fingerprint": self.fingerprint,
        }
        return {PREFIX + key: value for key, value in values.items()}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], path: Path | None = None) -> LanguageContract | None:
        """Contract from the properties of an ONNX file; None for a network without language.

        InputError where the properties speak of other language features than this program makes.
        """
        stored = {key.removeprefix(PREFIX): value for key, value in metadata.items() if key.startswith(PREFIX)}
        if not stored:
            return None
        if stored.get("contract") != CONTRACT:
            raise InputError(
                "the network's language features are not known",
                got=repr(stored.get("contract")),
                expected=repr(CONTRACT),
                path=path,
            )
        try:
            dimension = int(stored["dimension"])
            normalised = {"true": True, "false": False}[stored["normalised"]]
            contract = cls(stored["name"], dimension, normalised, stored["fingerprint"])
        except (KeyError, ValueError) as error:
            raise InputError(
                "the network's language features cannot be read", got=f"{type(error).__name__}: {error}", path=path
            ) from error
        require(
            dimension >= 1 and contract.fingerprint,
            "the network's language features cannot be read",
            got=contract,
            path=path,
        )
        return contract

    def check(self, vectors: VectorFile) -> None:
        """Raise InputError for other vectors than those of the network's training."""
        require(
            vectors.dimension == self.dimension,
            "the text vectors have another dimension than the network wants",
            got=f"{vectors.dimension} numbers of {vectors.name}",
            expected=f"{self.dimension} numbers of {self.name}",
        )
        found = vectors.fingerprint()
        require(
            found == self.fingerprint,
            "the text vectors are other ones than the network was trained with",
            got=f"{vectors.name}, fingerprint {found}",
            expected=f"{self.name}, fingerprint {self.fingerprint}",
        )
