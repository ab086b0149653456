"""FastText's binary model, memory-mapped: words, and subwords for the words it does not hold.

The layout and the hashing are those of FastText's `Args::load`, `Dictionary::load`, `Dictionary::computeSubwords`
and `DenseMatrix::load` (file format version 12; https://github.com/facebookresearch/fastText, MIT).
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xxhash

from pipeline.language.vectors.phrases import VectorFile, utf8
from pipeline.system.errors import InputError
from pipeline.system.file_memory import remembered_fingerprint
from pipeline.system.safe_files import opened

MAGIC = 793712314
VERSIONS = (11, 12)
MAX_DIMENSION = 1 << 16
_ARGS = struct.Struct("<14id")
_COUNTS = struct.Struct("<3i2q")
_SHAPE = struct.Struct("<?2q")
_ENTRY = 9
"""Bytes after a word's own: its count and its type."""

_WORD, _LABEL = 0, 1
_SUPERVISED = 3
_LONGEST_INFERRED = 255
_BLOCK = 1 << 24
_END_OF_SENTENCE = b"</s>"


@dataclass(frozen=True)
class Subwords:
    """N-grams of a word with a vector: lengths in characters, and the number of hash buckets."""

    shortest: int
    longest: int
    buckets: int

    def of(self, word: bytes) -> list[int]:
        """Buckets of the n-grams of `<word>`, UTF-8.

        FNV-1a of 32 bits over signed bytes, as the published models were trained; the hash of an n-gram goes on from
        that of the next shorter one.
        """
        if not self.buckets:
            return []
        marked = b"<" + word + b">"
        starts = [i for i, b in enumerate(marked) if b & 0xC0 != 0x80]
        bounds = [*starts[1:], len(marked)]
        found = []
        for k, start in enumerate(starts):
            h, at = 2166136261, start
            for n, end in enumerate(bounds[k : k + self.longest], 1):
                for b in marked[at:end]:
                    h = ((h ^ (b if b < 128 else b | 0xFFFFFF00)) * 16777619) & 0xFFFFFFFF
                at = end
                if n >= self.shortest and not (n == 1 and (k == 0 or end == len(marked))):
                    found.append(h % self.buckets)
        return found


@dataclass(frozen=True, eq=False)
class FastTextBinary(VectorFile):
    """A .bin model of FastText. A word's vector is the mean of its own row and those of its subwords.

    Memory holds two numbers a word of the vocabulary; the matrix stays on disk, and only the rows that are asked for
    are read.
    """

    path: Path
    dimension: int
    words: int  # Size of the vocabulary
    subwords: Subwords
    end: int  # End of the matrix in the file; what follows is of no use here
    _map: mmap.mmap = field(repr=False)
    _matrix: np.ndarray = field(repr=False)
    _hashes: np.ndarray = field(repr=False)
    _order: np.ndarray = field(repr=False)
    _starts: np.ndarray = field(repr=False)

    kind = "word"

    @classmethod
    def open(cls, path: Path) -> FastTextBinary:
        """Map a model and read its dictionary; InputError for no model, a quantised or a damaged model."""
        try:
            with opened(path, "model") as file:
                data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except InputError:
            raise
        except (OSError, ValueError) as error:
            raise InputError("the FastText model cannot be read", got=error, path=path) from error
        return _parsed(path, data)

    def fingerprint(self) -> str:
        """Hash of the file up to the end of the matrix."""
        return remembered_fingerprint(self.path, self.dimension, self._digest)

    def _digest(self) -> str:
        digest = xxhash.xxh3_128()
        with opened(self.path, "model") as file:
            left = self.end
            while block := file.read(min(_BLOCK, left)):
                digest.update(block)
                left -= len(block)
        return digest.hexdigest()

    def find(self, spellings: Iterable[str]) -> Mapping[str, np.ndarray]:
        found = {}
        for word in spellings:
            row = self._row(utf8(word))
            vector = None if row is None else self._mean([row, *self._subword_rows(utf8(word))], word)
            if vector is not None:
                found[word] = vector
        return found

    def infer(self, word: str) -> np.ndarray | None:
        data = utf8(word)
        # FastText sets no limit; a word of a megabyte would gather gigabytes of rows.
        rows = self._subword_rows(data) if 0 < len(data) <= _LONGEST_INFERRED else []
        return self._mean(rows, word) if rows else None

    def _row(self, word: bytes) -> int | None:
        """Row of a word of the vocabulary."""
        if not word or b"\0" in word:
            return None
        wanted = hash(word)
        at = int(np.searchsorted(self._hashes, wanted))
        while at < len(self._hashes) and self._hashes[at] == wanted:
            row = int(self._order[at])
            start = int(self._starts[row])
            if self._map[start : start + len(word) + 1] == word + b"\0":
                return row
            at += 1
        return None

    def _subword_rows(self, word: bytes) -> list[int]:
        return [] if word == _END_OF_SENTENCE else [self.words + b for b in self.subwords.of(word)]

    def _mean(self, rows: list[int], word: str) -> np.ndarray | None:
        vector = self._matrix[rows].mean(axis=0, dtype=np.float64)
        if not np.isfinite(vector).all():
            raise InputError(
                "the FastText model is damaged", got=f"no finite numbers for {word[:60]!r}", path=self.path
            )
        narrow = vector.astype(np.float32)
        return narrow if narrow.any() else None


def _parsed(path: Path, data: mmap.mmap) -> FastTextBinary:
    size = len(data)

    def damaged(got: str, cause: str | None = None) -> InputError:
        return InputError("the FastText model is damaged", got=got, cause=cause, path=path)

    if size < _ARGS.size or struct.unpack_from("<i", data)[0] != MAGIC:
        raise InputError(
            "the file is no FastText model",
            got=f"{size} bytes that begin with {data[:4].hex(' ')}",
            expected=f"{_ARGS.size} bytes at least that begin with {struct.pack('<i', MAGIC).hex(' ')}",
            cause="word2vec's .bin and FastText's models of before 2017 are other formats",
            path=path,
        )
    _, version, dimension, _, _, _, _, _, _, model, buckets, shortest, longest, _, _ = _ARGS.unpack_from(data)
    if version not in VERSIONS:
        raise InputError("the FastText model is of another version", got=version, expected=VERSIONS[-1], path=path)
    if not 1 <= dimension <= MAX_DIMENSION or buckets < 0 or shortest < 0 or longest < 0:
        raise damaged(f"dimension {dimension}, {buckets} buckets, n-grams of {shortest} to {longest} characters")
    if version == VERSIONS[0] and model == _SUPERVISED:
        longest = 0  # Classifiers of that version had no subwords, whatever their arguments say.
    if size < _ARGS.size + _COUNTS.size:
        raise damaged(f"{size} bytes", "was the download cut short?")
    entries, words, labels, _, pruned = _COUNTS.unpack_from(data, _ARGS.size)
    at = _ARGS.size + _COUNTS.size
    if min(words, labels) < 0 or entries != words + labels or entries * (_ENTRY + 1) > size - at:
        raise damaged(f"{words} words and {labels} labels, {entries} together, in {size} bytes")
    if pruned >= 0:
        raise _quantised(path)
    starts, hashes, at = _dictionary(data, at, words, labels, damaged)
    if size < at + _SHAPE.size:
        raise damaged(f"{size} bytes, which end before the matrix", "was the download cut short?")
    quantised, rows, columns = _SHAPE.unpack_from(data, at)
    at += _SHAPE.size
    if quantised:
        raise _quantised(path)
    if rows != words + buckets or columns != dimension:
        raise damaged(f"a matrix of {rows} x {columns}, where {words} + {buckets} x {dimension} was announced")
    end = at + 4 * rows * columns
    if end > size:
        raise damaged(f"{size} bytes where the matrix alone ends at {end}", "was the download cut short?")
    matrix = np.ndarray((rows, columns), "<f4", data, at)
    order = np.argsort(hashes, kind="stable")
    ordered = hashes[order]
    for k in np.flatnonzero(ordered[1:] == ordered[:-1]):
        one, other = (_word_at(data, int(starts[i])) for i in order[k : k + 2])
        if one == other:
            raise damaged(f"the word {one.decode('utf-8', 'replace')[:60]!r} twice")
    subwords = Subwords(shortest, longest, buckets)
    return FastTextBinary(path, dimension, words, subwords, end, data, matrix, ordered, order, starts)


def _dictionary(
    data: mmap.mmap, at: int, words: int, labels: int, damaged: Callable[..., InputError]
) -> tuple[np.ndarray, np.ndarray, int]:
    """Starts of the words, their hashes in this process, and the end of the dictionary."""
    starts, hashes = np.empty(words, np.int64), np.empty(words, np.int64)
    size, find, entries = len(data), data.find, words + labels
    for k in range(entries):
        end = find(b"\0", at)
        after = end + 1 + _ENTRY
        if end < 0 or after > size:
            raise damaged(f"a dictionary that ends after {k} of {entries} entries", "was the download cut short?")
        if data[after - 1] != (_WORD if k < words else _LABEL):
            raise damaged(f"entry {k} of the dictionary of type {data[after - 1]}")
        if k < words:
            starts[k] = at
            hashes[k] = hash(data[at:end])
        at = after
    return starts, hashes, at


def _word_at(data: mmap.mmap, start: int) -> bytes:
    return data[start : data.find(b"\0", start)]


def _quantised(path: Path) -> InputError:
    return InputError(
        "quantised FastText models are not read",
        got="a model that `fasttext quantize` made",
        expected="the .bin or .vec it was made from",
        path=path,
    )
