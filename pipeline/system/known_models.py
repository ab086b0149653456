"""Public model files that the adapters read: where they are, how large, under which licence, with which hash."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

TABLE = Path(__file__).with_name("models.json")


@dataclass(frozen=True)
class KnownFile:
    """A file.

    Attributes
    ----------
    file : str
        Path in the repository, or its whole address.
    sha256 : str or None
        None where no public text states it.
    megabytes : float or None
        As stated, in 10**6 bytes or in 2**20; None where it is not.
    bytes : int or None
        The exact size.
    """

    file: str
    sha256: str | None = None
    megabytes: float | None = None
    bytes: int | None = None


@dataclass(frozen=True)
class KnownModel:
    """A model that is known to be read.

    Attributes
    ----------
    option : str
        "--detector grounding-dino".
    name : str
    repo : str or None
        On the Hugging Face hub; None for files that are elsewhere, and are downloaded by hand.
    revision : str or None
        The commit that the hashes are of.
    licence : str
        Of the weights.
    files : tuple of KnownFile
        The first is what the repository's id alone means.
    note : str
    """

    option: str
    name: str
    repo: str | None
    revision: str | None
    licence: str
    files: tuple[KnownFile, ...]
    note: str


@lru_cache(maxsize=1)
def known_models() -> tuple[KnownModel, ...]:
    """All of the table."""
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    return tuple(
        KnownModel(
            m["option"], m["name"], m["repo"], m["revision"], m["licence"],
            tuple(KnownFile(f["file"], f["sha256"], f["megabytes"]) for f in m["files"]), m["note"],
        )
        for m in table["models"]
    )  # fmt: skip
