"""FastText's text format: a line `words dimension`, then a line a word, by falling frequency; plain or gzipped."""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterable, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.language.vectors.phrases import VectorFile, utf8
from pipeline.system.errors import InputError, require
from pipeline.system.file_memory import FileMemory, keep, memory_path, recall
from pipeline.system.safe_files import opened

MAX_DIMENSION = 1 << 16
_HEADER = re.compile(rb"(?:\xef\xbb\xbf)?(\d{1,18})[ \t]+(\d{1,18})[ \t]*\r?\n?")
_BYTES_A_NUMBER, _BYTES_A_WORD = 32, 1 << 16


@dataclass(frozen=True, eq=False)
class VecFile(VectorFile):
    """A .vec file. Words are as the file spells them; the first of two equal words counts, as in gensim.

    The file is read from its beginning to its end once for all the words of a call, whatever they are; what was
    found is kept in the cache folder, so that the same words cost nothing later. Memory holds one line and the
    vectors asked for. Only the lines of these words are parsed.
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

    def fingerprint(self) -> str:
        """Hash of the text, the same packed and unpacked."""
        return self._known(()).fingerprint or ""

    def find(self, spellings: Iterable[str]) -> Mapping[str, np.ndarray]:
        wanted = tuple(spellings)
        known = self._known(wanted).vectors
        return {w: known[w] for w in wanted if w in known}

    @cached_property
    def _location(self) -> Path:
        return memory_path(self.path)

    @cached_property
    def _memory(self) -> FileMemory:
        return recall(self._location, self.dimension)

    def _known(self, wanted: Iterable[str]) -> FileMemory:
        """Memory of the file, after a pass through the file where these words need it."""
        memory = self._memory
        new = {w for w in wanted if w not in memory.vectors and w not in memory.absent}
        if new or memory.fingerprint is None:
            found, memory.fingerprint = self._scan(new)
            memory.vectors.update(found)
            memory.absent |= new - found.keys()
            keep(self._location, memory, self.dimension)
        return memory

    def _scan(self, wanted: Iterable[str]) -> tuple[dict[str, np.ndarray], str]:
        """Scan the file once for vectors of the wanted words and the hash of the text.

        InputError where the file has more or fewer lines than its header says, ends within a line, or a wanted word's
        line is not D finite numbers.
        """
        # A token may hold spaces, so that its first piece only says which lines to look at.
        tokens: dict[bytes, str] = {utf8(w): w for w in wanted}
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
