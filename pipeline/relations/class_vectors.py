"""Phrase vectors of class names, kept with a language network, and look-up of other names.

A trained network comes with `NAME.vectors.npz` beside `NAME.onnx`: the vectors of
all classes it was trained on. Its metadata holds their hash, so that neither
goes with another's. A class that is not among them needs the file of text
vectors that the network was trained with.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import xxhash

from pipeline.language.naming import normal_form
from pipeline.language.vectors import LanguageContract, open_vectors, read_npz
from pipeline.system.errors import InputError, require

_NAMED = 8


@dataclass(frozen=True, eq=False)
class ClassVectors:
    """Class names and their phrase vectors."""

    names: tuple[str, ...]  # As the labels spell them, each once
    vectors: np.ndarray  # (C, D) float32

    @property
    def hash(self) -> str:
        """Hash (xxh3-128) of names and vectors."""
        digest = xxhash.xxh3_128("\0".join(self.names).encode("utf-8", "surrogatepass"))
        digest.update(np.ascontiguousarray(self.vectors, "<f4").tobytes())
        return digest.hexdigest()

    def content(self) -> bytes:
        """Content of an .npz file, readable by `pipeline.language.vectors.open_vectors` too."""
        file = io.BytesIO()
        np.savez(
            file, names=np.array(self.names, np.str_), vectors=self.vectors.astype(np.float32), kind=np.str_("phrase")
        )
        return file.getvalue()

    @classmethod
    def read(cls, path: Path) -> ClassVectors:
        """Read an .npz file of class vectors; InputError for another file."""
        table = read_npz(path)
        return cls(table.names, table.vectors.astype(np.float32))


def vectors_path(network: Path) -> Path:
    """Path of the class vectors of an ONNX file."""
    return network.with_suffix(".vectors.npz")


class ClassLookup:
    """Vectors of class names for a network.

    `language`: text vectors by the network's contract; `expected`: hash of the class vectors; `vectors`: file of text
    vectors, for classes outside the training.
    """

    def __init__(self, network: Path, language: LanguageContract, expected: str, vectors: Path | None = None) -> None:
        self.language = language
        self._file = None if vectors is None else open_vectors(vectors)
        path = vectors_path(network)
        if path.is_file():
            known = ClassVectors.read(path)
            require(
                known.hash == expected and known.vectors.shape[1] == language.dimension,
                "these class vectors belong to another network",
                got=known.hash,
                expected=expected,
                path=path,
            )
        elif self._file is None:
            raise InputError(
                "the network's class vectors are missing",
                expected=f"{path.name} beside the network, or --vectors {language.name}",
                path=path,
            )
        else:
            known = ClassVectors((), np.zeros((0, language.dimension), np.float32))
        self._known = known

    @cached_property
    def _by_name(self) -> dict[str, np.ndarray]:
        """Known vectors by exact spelling, and by normal form wherever all spellings share one vector."""
        found: dict[str, np.ndarray] = {}
        clashing: set[str] = set()
        for name, vector in zip(self._known.names, self._known.vectors, strict=True):
            key = normal_form(name)
            if key in found and not np.array_equal(found[key], vector):
                clashing.add(key)
            found.setdefault(key, vector)
        for key in clashing:
            del found[key]
        return {**found, **dict(zip(self._known.names, self._known.vectors, strict=True))}

    def rows(self, labels: Sequence[str]) -> np.ndarray:
        """(N, D) float64 vectors of the class names."""
        known = self._by_name
        unknown = list(dict.fromkeys(n for n in labels if n not in known and normal_form(n) not in known))
        if unknown and self._file is None:
            more = f" and {len(unknown) - _NAMED} more" if len(unknown) > _NAMED else ""
            raise InputError(
                "the network was not trained on these classes",
                got=", ".join(repr(n) for n in unknown[:_NAMED]) + more,
                expected=f"--vectors with the file {self.language.name}",
            )
        if unknown and self._file is not None:
            found = self._file.phrases(unknown, normalised=self.language.normalised)
            # Its pass through the file has worked out the fingerprint, too.
            self.language.check(self._file)
            known.update(zip(unknown, found, strict=True))
        rows = [known[n] if n in known else known[normal_form(n)] for n in labels]
        return np.array(rows, np.float64).reshape(len(rows), self.language.dimension)
