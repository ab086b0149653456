"""Ways to harm a journal's files, for the tests and for the runner of faults."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

from pipeline.corrections import JOURNAL_FILE

Parts = dict[str, bytearray]
"""The files of a journal by the ends of their names: "", "-wal", "-shm"."""
PAGE = 4096


def parts_of(path: Path) -> Parts:
    found = {end: Path(f"{path}{end}") for end in ("", "-wal", "-shm")}
    return {end: bytearray(file.read_bytes()) for end, file in found.items() if file.exists()}


def placed(parts: Parts, folder: Path) -> Path:
    path = folder / JOURNAL_FILE
    for end, data in parts.items():
        Path(f"{path}{end}").write_bytes(data)
    return path


def flipped(data: bytearray, rng: random.Random, first: int = 0, stop: int | None = None) -> None:
    data[rng.randrange(first, stop or len(data))] ^= 1 << rng.randrange(8)


def zeroed(data: bytearray, rng: random.Random) -> None:
    at = PAGE * rng.randrange(len(data) // PAGE)
    data[at : at + PAGE] = bytes(PAGE)


def cut(data: bytearray, rng: random.Random) -> None:
    del data[rng.randrange(1, len(data)) :]


HARM: dict[str, tuple[str, Callable[[Parts, random.Random], None]]] = {
    "a bit": ("closed", lambda parts, rng: flipped(parts[""], rng, PAGE)),
    "a bit under a log": ("open", lambda parts, rng: flipped(parts[""], rng)),
    "a bit of the header": ("closed", lambda parts, rng: flipped(parts[""], rng, 0, 100)),
    "a bit of the schema": ("closed", lambda parts, rng: flipped(parts[""], rng, 100, PAGE)),
    "a page": ("closed", lambda parts, rng: zeroed(parts[""], rng)),
    "the end": ("closed", lambda parts, rng: cut(parts[""], rng)),
    "a bit of the log": ("open", lambda parts, rng: flipped(parts["-wal"], rng)),
    "a page of the log": ("open", lambda parts, rng: zeroed(parts["-wal"], rng)),
    "the end of the log": ("open", lambda parts, rng: cut(parts["-wal"], rng)),
    "a bit of the log's index": ("open", lambda parts, rng: flipped(parts["-shm"], rng, 0, 200)),
}
