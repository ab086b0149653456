"""Language features: vectors of class names out of a file of word or sentence vectors."""

from __future__ import annotations

import gzip
import json
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.language.naming import normal_form
from pipeline.language.noun_phrase import readable
from pipeline.language.phrase_vectors import LanguageContract, VectorFile
from pipeline.system.errors import InputError, as_input_error, first_line, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import checked_texts, opened, opened_arrays

__all__ = ["LanguageContract", "VectorFile", "open_vectors"]

FORMATS = ".vec, .vec.gz, .npz"


def open_vectors(path: str | Path) -> VectorFile:
    """Open a file of text vectors, in the format of the file's ending.

    ========== ==================================================================================================
    .vec       FastText's text format, also gzipped (.vec.gz): read once for all the words asked for
    .npz       `words` (or `phrases`, or `names`) of unicode and `vectors` (N, D) of floats; a `kind`
    ========== ==================================================================================================

    Entries of kind "word" may be averaged over a phrase; whole phrases (CLIP, MiniLM) may not.

    Raises
    ------
    InputError
        There is no such file, the format is not known, or the file is damaged.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from pipeline.language import open_vectors
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "words.vec")
    ...     _ = path.write_text("2 2\\ncoffee 1 0\\ntable 0 1\\n")
    ...     print(open_vectors(path).phrases(["CoffeeTables"]))
    [[0.5 0.5]]
    """
    path = Path(path)
    require(path.is_file(), "there is no file of text vectors", expected=FORMATS, path=path)
    if path.name.lower().endswith((".vec", ".vec.gz")):
        return VecFile.open(path)
    if path.suffix.lower() == ".npz":
        return read_npz(path)
    models = (".bin", ".ftz")
    raise InputError(
        "the format of the text vectors is not known",
        got=repr(path.suffix),
        expected=FORMATS,
        cause="the .vec of the same vectors is published beside a model" if path.suffix in models else None,
        path=path,
    )


MAX_DIMENSION = 1 << 16
NAME_KEYS = {"words": "word", "phrases": "phrase", "names": "phrase"}
"""The array of names, and what its entries are where the file has no `kind`."""

_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class VectorTable(VectorFile):
    """Names and their vectors. The first of two entries with the same name counts."""

    path: Path
    kind: str
    names: tuple[str, ...]
    vectors: np.ndarray  # (N, D) float16, float32 or float64
    dimension: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "dimension", self.vectors.shape[1])

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {name: k for k, name in reversed([*enumerate(self.names)])}

    @cached_property
    def _normal(self) -> dict[str, int]:
        return {form: k for k, name in reversed([*enumerate(self.names)]) if (form := normal_form(name))}

    def fingerprint(self) -> str:
        """Hash of kind, names and vectors, however packed."""
        digest = xxhash.xxh3_128(json.dumps([self.kind, self.names, self.vectors.shape]).encode())
        for start in range(0, len(self.vectors), _BLOCK):
            digest.update(np.ascontiguousarray(self.vectors[start : start + _BLOCK], "<f4").data)
        return digest.hexdigest()

    def find(self, spellings: Iterable[str]) -> Mapping[str, np.ndarray]:
        rows = {s: self._vector(self._rows.get(s)) for s in spellings}
        return {s: v for s, v in rows.items() if v is not None}

    def whole(self, name: str) -> np.ndarray | None:
        """Vector of a name by its spelling, then by normal form, then by the first spelling without a qualifier.

        In a table of words only a name of several words is looked up so: `trash_can`, `trash can`.
        """
        normal = normal_form(name)
        if self.kind == "phrase":
            row = self._rows.get(name, self._normal.get(normal))
            return self._vector(self._normal.get(normal_form(readable(name))) if row is None else row)
        if " " not in normal:
            return None
        candidates = (normal, normal.replace(" ", "_"), name)
        return self._vector(next((self._rows[c] for c in candidates if c in self._rows), None))

    def _vector(self, row: int | None) -> np.ndarray | None:
        """Row as float32; zeros stand for a name without a vector."""
        vector = None if row is None else self.vectors[row].astype(np.float32)
        return vector if vector is not None and vector.any() else None


def read_npz(path: Path) -> VectorTable:
    """Read `words`, `phrases` or `names` (N,) of unicode, `vectors` (N, D) of floats and perhaps `kind`.

    InputError where the file is damaged, lacks an array, holds Python objects, or its arrays do not fit each other.
    """
    # Damaged bytes fail in zipfile, zlib, numpy or the tokenizer that it uses, each with its own class.
    with (
        as_input_error("the file of text vectors cannot be read", Exception, got=first_line, path=path),
        opened_arrays(path) as arrays,
    ):
        keys = getattr(arrays, "files", [])
        present = [k for k in NAME_KEYS if k in keys]
        require(
            len(present) == 1 and "vectors" in keys,
            "the file of text vectors lacks its arrays",
            got=", ".join(keys[:10]) or "nothing",
            expected=f"vectors, and one of {', '.join(NAME_KEYS)}",
            path=path,
        )
        kind = str(checked_texts(arrays["kind"]).item()) if "kind" in keys else NAME_KEYS[present[0]]
        names = _texts(arrays[present[0]], present[0], path)
        return _table(path, kind, names, arrays["vectors"])


def _texts(names: np.ndarray, key: str, path: Path) -> list[str]:
    require(
        names.ndim == 1 and names.dtype.kind in "US",
        f"the array {key!r} is no list of names",
        got=f"{names.dtype} of shape {names.shape}",
        expected="unicode of shape (N,)",
        path=path,
    )
    try:
        return [n.decode("utf-8") for n in names.tolist()] if names.dtype.kind == "S" else checked_texts(names).tolist()
    except ValueError as error:
        raise InputError(f"the array {key!r} is not UTF-8 or other text", got=error, path=path) from error


def _table(path: Path, kind: Any, names: Sequence[str], vectors: np.ndarray) -> VectorTable:
    if kind not in ("word", "phrase"):
        what = "text vectors are of words or of phrases"
        raise InputError(what, got=repr(kind), expected="word or phrase", path=path)
    require(
        not (
            vectors.ndim != 2
            or vectors.dtype.kind != "f"
            or not 1 <= vectors.shape[-1] <= MAX_DIMENSION
            or not len(names)
        ),
        "the array 'vectors' is no table of vectors",
        got=f"{vectors.dtype} of shape {vectors.shape}",
        expected=f"floats of shape (N, D), N above 0, D up to {MAX_DIMENSION}",
        path=path,
    )
    require(
        len(names) == len(vectors),
        "names and vectors differ in number",
        got=f"{len(names)} names, {len(vectors)} vectors",
        path=path,
    )
    largest = float(np.finfo(np.float32).max)
    for start in range(0, len(vectors), _BLOCK):
        block = vectors[start : start + _BLOCK].astype(np.float64)
        bad = np.flatnonzero(~(np.abs(block) <= largest).all(axis=1))
        if len(bad):
            raise InputError(
                "a text vector is not finite", got=f"that of {names[start + int(bad[0])][:60]!r}", path=path
            )
    return VectorTable(path, kind, tuple(names), vectors)


_HEADER = re.compile(rb"(?:\xef\xbb\xbf)?(\d{1,18})[ \t]+(\d{1,18})[ \t]*\r?\n?")
_BYTES_A_NUMBER, _BYTES_A_WORD = 32, 1 << 16


@dataclass(frozen=True, eq=False)
class VecFile(VectorFile):
    """A .vec file. Words are as the file spells them; the first of two equal words counts, as in gensim.

    The file is read from its beginning to its end once for all the words of a call. Memory holds one line and the
    vectors asked for; only the lines of these words are parsed.
    """

    path: Path
    words: int
    dimension: int

    kind = "word"

    @classmethod
    def open(cls, path: Path) -> VecFile:
        """Read the header; InputError without two sensible numbers at the beginning."""
        with _opened(path) as file:
            line = file.readline(64)
        found = _HEADER.fullmatch(line)
        if found is None:
            raise InputError(
                "the text vectors do not begin with their numbers of words and of dimensions",
                got=repr(line[:40])[1:],
                expected="a line such as '999994 300'",
                cause="GloVe's files lack this line; is it a .vec file of FastText?",
                path=path,
            )
        words, dimension = int(found[1]), int(found[2])
        require(
            1 <= dimension <= MAX_DIMENSION and words >= 1,
            "the header of the text vectors makes no sense",
            got=f"{words} words of {dimension} dimensions",
            expected=f"at least one word of 1 to {MAX_DIMENSION} dimensions",
            path=path,
        )
        return cls(path, words, dimension)

    @cached_property
    def _fingerprint(self) -> str:
        return self._scan(())[1]

    def fingerprint(self) -> str:
        """Hash of the text, the same packed and unpacked."""
        return self._fingerprint

    def find(self, spellings: Iterable[str]) -> Mapping[str, np.ndarray]:
        found, self.__dict__["_fingerprint"] = self._scan(spellings)
        return found

    def _scan(self, wanted: Iterable[str]) -> tuple[dict[str, np.ndarray], str]:
        """Scan the file once for vectors of the wanted words and the hash of the text.

        InputError where the file has more or fewer lines than its header says, ends within a line, or a wanted word's
        line is not D finite numbers.
        """
        # A token may hold spaces, so that its first piece only says which lines to look at.
        tokens = {w.encode("utf-8", "surrogatepass"): w for w in wanted}
        tokens.pop(b"", None)
        first_pieces = frozenset(t.split(b" ", 1)[0] for t in tokens)
        limit = _BYTES_A_NUMBER * self.dimension + _BYTES_A_WORD
        digest = xxhash.xxh3_128()
        found: dict[str, np.ndarray] = {}
        seen: set[bytes] = set()
        lines, last = 0, b""
        with _opened(self.path) as file:
            digest.update(file.readline(64))
            while line := file.readline(limit):
                digest.update(line)
                if len(line) >= limit and not line.endswith(b"\n"):
                    raise self._damaged(f"a line of over {limit} bytes after {lines} words")
                if lines == self.words:
                    if not line.isspace():
                        raise self._damaged(f"more than the {self.words} words its header says", "a wrong header?")
                    continue
                lines, last = lines + 1, line
                if line[: line.find(b" ")] in first_pieces:
                    token, numbers = self._split(line, lines)
                    if token in tokens and token not in seen:
                        seen.add(token)
                        vector = self._numbers(numbers, tokens[token], lines)
                        if vector.any():
                            found[tokens[token]] = vector
        if lines < self.words:
            raise self._damaged(f"{lines} words where its header says {self.words}", "was the download cut short?")
        self._numbers(self._split(last, lines)[1], "the last word", lines)
        return found, digest.hexdigest()

    def _split(self, line: bytes, number: int) -> tuple[bytes, list[bytes]]:
        """Split a line into a token and its numbers, which are counted from the right."""
        pieces = line.rstrip().rsplit(None, self.dimension)
        if len(pieces) != self.dimension + 1:
            raise self._damaged(
                f"{len(pieces) - 1} numbers in line {number + 1} where its header says {self.dimension}",
                "was the download cut short?",
            )
        return pieces[0], pieces[1:]

    def _numbers(self, pieces: list[bytes], word: str, number: int) -> np.ndarray:
        try:
            vector = np.array([float(p) for p in pieces], np.float64)
        except ValueError:
            raise self._damaged(f"no number in the vector of {word!r} in line {number + 1}") from None
        if not (np.abs(vector) <= np.finfo(np.float32).max).all():
            raise self._damaged(f"a number that is not finite in the vector of {word!r} in line {number + 1}")
        return vector.astype(np.float32)

    def _damaged(self, got: str, cause: str | None = None) -> InputError:
        return InputError("the text vectors are damaged", got=got, cause=cause, path=self.path)


@contextmanager
def _opened(path: Path) -> Any:
    try:
        packed = path.suffix.lower() == ".gz"
        with opened(path, "model") as file, gzip.open(file) if packed else nullcontext(file) as content:
            yield content
    except (OSError, EOFError, zlib.error) as error:
        raise InputError("the text vectors cannot be read", got=error, path=path) from error
