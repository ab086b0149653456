"""Limits of size for files of others: docs/limits.md prints the table, `--limits NAME=VALUE,...` changes it.

Limits stand in the environment, so that worker processes keep to those of their parent.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import field, fields, replace
from functools import lru_cache
from typing import Any

from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

LIMITS_VARIABLE = "SPATIALVIZ_LIMITS"
LIMITS_OPTION = "--limits"
FACTOR_OF_A_DATASET = 4
"""So many times a limit may be raised by the `[limits]` of a `spatialviz.toml`, which may come with the data."""
_UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}


def _limit(default: int, meaning: str, own: bool = False) -> Any:
    """Limit; with `own` a dataset may raise it for itself."""
    return field(default=default, metadata={"meaning": meaning, "own": own})


@dataclass(frozen=True)
class Limits:
    """Upper limits of everything read. Each field's `meaning` is its line in docs/limits.md."""

    pixels: int = _limit(64 * 10**6, "pixels of a picture, mask or depth map, by its header", True)
    bytes: int = _limit(256 * 10**6, "bytes of a file, archive member or message that is read whole", True)
    text: int = _limit(256 * 10**6, "bytes of a JSON, TOML, CSV or other text file", True)
    depth: int = _limit(100, "brackets inside brackets in JSON")
    names: int = _limit(2 * 10**6, "names in a folder", True)
    rows: int = _limit(200 * 10**6, "rows of a table", True)
    members: int = _limit(5 * 10**6, "members of an archive, or fields in the messages of a network's file", True)
    unpacked: int = _limit(256 * 10**9, "bytes of an archive, unpacked too, of a stream or a table", True)
    model: int = _limit(8 * 10**9, "bytes of a network's file, of a file of its weights, or of text vectors")
    tensor: int = _limit(2 * 10**9, "bytes of one tensor that a network's file declares")
    memory: int = _limit(8 * 10**9, "bytes that the networks of a process hold while they compute on the CPU")
    query: int = _limit(10**9, "bytes in memory of a database that counts or answers in SQL; 4 times as many on disk")
    seconds: int = _limit(300, "seconds of loading a network, and of one inference")
    query_seconds: int = _limit(60, "seconds of one query in SQL")
    links: int = _limit(0, "1 follows links that lead out of the folder that was opened")

    def changed(self, values: Mapping[str, Any], own: bool = False) -> Limits:
        """Change limits by name: numbers, or texts such as "500M".

        With `own` a dataset asks: it may raise some of them, and none by more than `FACTOR_OF_A_DATASET`.

        Raises
        ------
        InputError
            No such limit, no number, or more than a dataset may ask for.
        """
        table = {f.name: f for f in fields(self)}
        numbers: dict[str, int] = {}
        for name, value in values.items():
            require(name in table, f"there is no limit {name!r}", expected=f"one of {', '.join(table)}")
            numbers[name] = _number(name, value)
            most = getattr(self, name) * FACTOR_OF_A_DATASET if table[name].metadata["own"] else getattr(self, name)
            require(
                not own or numbers[name] <= most,
                f"a dataset may not raise the limit {name} so far",
                got=value,
                expected=f"at most {shown(most)}",
                cause=f"if you trust it: {LIMITS_OPTION} {name}={value}",
            )
        return replace(self, **numbers)


def _number(name: str, value: Any) -> int:
    found = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]{1,6})?)([kMGT]?)", str(value).strip())
    if found is None:
        raise InputError(f"the limit {name} is no number", got=repr(value), expected="such as 500M; k, M, G or T")
    return int(float(found[1]) * _UNITS[found[2]])


def shown(number: float) -> str:
    """Write a number as a limit: 500M."""
    unit = next((u for u in ("T", "G", "M", "k") if number >= _UNITS[u]), "")
    return f"{number / _UNITS[unit]:.4g}{unit}"


def current_limits() -> Limits:
    """Limits of this process: the table, changed by the environment; InputError for a malformed change."""
    return _parsed(os.environ.get(LIMITS_VARIABLE, ""))


@lru_cache(maxsize=16)
def _parsed(text: str) -> Limits:
    pairs = [part.partition("=") for part in text.split(",") if part.strip()]
    return Limits().changed({name.strip(): value for name, _, value in pairs})


def set_limits(text: str) -> None:
    """Change limits in this process and all children: "pixels=500M,bytes=2G"; InputError if malformed."""
    whole = ",".join(part for part in (os.environ.get(LIMITS_VARIABLE), text) if part)
    _parsed(whole)
    os.environ[LIMITS_VARIABLE] = whole


def within(number: float, name: str, what: str, path: Any, limits: Limits) -> None:
    """Raise InputError for a number above the limit of this name; `what` names the measured thing."""
    most = getattr(limits, name)
    if number > most:
        raise InputError(
            f"{what} is too large to be read" if name != "seconds" else what,
            got=f"{shown(number)} {'bytes' if name in _OF_BYTES else name}",
            expected=f"at most {shown(most)}",
            cause=f"meant to be so large? {LIMITS_OPTION} {name}={shown_above(number)}",
            path=path,
        )


def shown_above(number: float) -> str:
    """Limit above a number: two digits, rounded up."""
    unit = next((u for u in ("T", "G", "M", "k") if number >= _UNITS[u]), "")
    scaled = int(number / _UNITS[unit]) + 1
    step = 10 ** max(len(str(scaled)) - 2, 0)
    return f"{-(-scaled // step) * step}{unit}"


_OF_BYTES = ("bytes", "text", "unpacked", "model", "tensor", "memory", "query")
