"""Tables of names and vectors that fit into memory: .npz and .json, of words or of whole phrases."""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.language.naming import normal_form
from pipeline.language.noun_phrase import readable
from pipeline.language.vectors.phrases import VectorFile
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.safe_files import open_archive, opened, parse_json, read_text

NAME_KEYS = {"words": "word", "phrases": "phrase", "names": "phrase"}
"""The array of names, and what its entries are where the file has no `kind`."""

MAX_DIMENSION = 1 << 16
_MOST_PACKED = 200
_FREE = 1 << 26
"""Bytes that any table may unpack to; a larger one must not be packed more than 200 times."""

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
    try:
        with opened(path, "model") as content, open_archive(content, path) as archive:
            keys = [m.filename.removesuffix(".npy") for m in archive.infolist()]
            present = [k for k in NAME_KEYS if k in keys]
            if len(present) != 1 or "vectors" not in keys:
                raise InputError(
                    "the file of text vectors lacks its arrays",
                    got=", ".join(keys[:10]) or "nothing",
                    expected=f"vectors, and one of {', '.join(NAME_KEYS)}",
                    path=path,
                )
            kind = str(_member(archive, "kind", path).item()) if "kind" in keys else NAME_KEYS[present[0]]
            names = _texts(_member(archive, present[0], path), present[0], path)
            vectors = _member(archive, "vectors", path)
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("the file of text vectors cannot be read", got=error, path=path) from error
    return _table(path, kind, names, vectors)


def _member(archive: zipfile.ZipFile, key: str, path: Path) -> np.ndarray:
    """Array of the archive, after a check of its declared size against the file."""
    info = archive.getinfo(f"{key}.npy")
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        require(version in ((1, 0), (2, 0)), f"the array {key!r} is of an unknown version", got=version, path=path)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
        require(
            not dtype.hasobject,
            f"the array {key!r} holds Python objects, which are never unpickled",
            expected="unicode or floats",
            cause="save names with np.array(names, dtype=np.str_)",
            path=path,
        )
        expected = math.prod(shape) * dtype.itemsize
        packed = max(info.compress_size, 1)
        bomb = packed > path.stat().st_size or info.file_size > max(_FREE, _MOST_PACKED * packed)
        require(
            not bomb and expected == info.file_size - file.tell(),
            f"the array {key!r} is damaged",
            got=f"{shape} of {dtype}, which is {expected} bytes, in {info.file_size} ({packed} packed)",
            path=path,
        )
    with archive.open(info) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _texts(names: np.ndarray, key: str, path: Path) -> list[str]:
    require(
        names.ndim == 1 and names.dtype.kind in "US",
        f"the array {key!r} is no list of names",
        got=f"{names.dtype} of shape {names.shape}",
        expected="unicode of shape (N,)",
        path=path,
    )
    try:
        return [n.decode("utf-8") for n in names.tolist()] if names.dtype.kind == "S" else names.tolist()
    except UnicodeDecodeError as error:
        raise InputError(f"the array {key!r} is not UTF-8", got=error, path=path) from error


def read_json(path: Path) -> VectorTable:
    """Read {"kind": "word" | "phrase", "vectors": {name: [D numbers]}}, by default of kind `phrase`."""
    with as_input_error("the file of text vectors cannot be read", OSError, ValueError, got=str, path=path):
        loaded = parse_json(read_text(path), path, object_pairs_hook=_no_repeats)
    entries = loaded.get("vectors") if isinstance(loaded, dict) else None
    if not isinstance(entries, dict) or not entries:
        raise InputError(
            "the file of text vectors has another shape", expected='{"vectors": {name: [numbers]}}', path=path
        )
    lengths = {len(v) if isinstance(v, list) else -1 for v in entries.values()}
    numbers = all(type(x) in (int, float) for v in entries.values() if isinstance(v, list) for x in v)
    if len(lengths) != 1 or min(lengths) < 1 or not numbers:
        raise InputError(
            "vectors must be lists of numbers, all of one length", got=f"lengths {sorted(lengths)[:5]}", path=path
        )
    try:
        vectors = np.array(list(entries.values()), np.float64)
    except OverflowError as error:
        raise InputError("the text vectors hold a number that is no float", got=error, path=path) from error
    return _table(path, loaded.get("kind", "phrase"), list(entries), vectors)


def _no_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """First of two equal keys, as in every other format."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        found.setdefault(key, value)
    return found


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
