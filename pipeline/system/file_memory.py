"""Cache of vectors read from a large file, in the user's cache folder."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xxhash

from pipeline.system.errors import InputError
from pipeline.system.paths import cache_folder
from pipeline.system.safe_files import opened
from pipeline.system.whole_files import keep_whole

_VERSION = "1"
_SAMPLE = 1 << 16


@dataclass
class FileMemory:
    """Known words of one file: `vectors` ((D,) float32 each) and `absent` ones, and the file's fingerprint."""

    fingerprint: str | None = None
    vectors: dict[str, np.ndarray] = field(default_factory=dict)
    absent: set[str] = field(default_factory=set)


def memory_path(path: Path) -> Path:
    """Path in the cache by a file's size, time and samples of content, not by name.

    To read all of several gigabytes would cost what the cache is to save.
    """
    try:
        state = path.stat()
        digest = xxhash.xxh3_128(f"{_VERSION} {state.st_size} {state.st_mtime_ns}".encode())
        with opened(path, "model") as file:
            for start in (0, state.st_size // 2, max(state.st_size - _SAMPLE, 0)):
                file.seek(start)
                digest.update(file.read(_SAMPLE))
    except OSError as error:
        raise InputError("the text vectors cannot be read", got=error, path=path) from error
    return cache_folder() / "text_vectors" / f"{digest.hexdigest()}.npz"


def recall(path: Path, dimension: int) -> FileMemory:
    """Kept memory of a file; empty if missing or damaged."""
    if not path.is_file():
        return FileMemory()
    try:
        with np.load(path, allow_pickle=False) as data:
            header = json.loads(bytes(data["said"]).decode())
            vectors = data["vectors"]
        words, absent, fingerprint = header["words"], header["absent"], header["fingerprint"]
        if vectors.dtype != np.float32 or vectors.shape != (len(words), dimension) or not np.isfinite(vectors).all():
            return FileMemory()
        if not all(isinstance(w, str) for w in (*words, *absent, fingerprint)):
            return FileMemory()
        return FileMemory(fingerprint, dict(zip(words, vectors, strict=True)), set(absent))
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        return FileMemory()


def keep(path: Path, memory: FileMemory, dimension: int) -> None:
    """Keep a memory whole, or nothing in a folder without write access."""
    words = list(memory.vectors)
    header = {"words": words, "absent": sorted(memory.absent), "fingerprint": memory.fingerprint}
    vectors = np.stack([memory.vectors[w] for w in words]) if words else np.zeros((0, dimension), np.float32)
    about = np.frombuffer(json.dumps(header).encode(), np.uint8)
    keep_whole(path, lambda file: np.savez(file, said=about, vectors=vectors))


def remembered_fingerprint(path: Path, dimension: int, compute: Callable[[], str]) -> str:
    """Fingerprint of a file, computed once."""
    location = memory_path(path)
    memory = recall(location, dimension)
    if memory.fingerprint is None:
        memory.fingerprint = compute()
        keep(location, memory, dimension)
    return memory.fingerprint
