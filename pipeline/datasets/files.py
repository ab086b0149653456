"""Text files and folder listings of a dataset."""

from __future__ import annotations

import io
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from pipeline.system import safe_files
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.limits import within

CUT_OFF = "was the copy or the download interrupted?"


@dataclass(frozen=True)
class Part:
    """Part of a file: a member of an archive, a cell of a table, a message of a stream."""

    file: Path
    inside: str  # What a message calls it, with its separator from the file
    read: Callable[[], bytes | np.ndarray]  # An encoded picture, or its pixels

    @property
    def name(self) -> str:
        return self.inside

    def __str__(self) -> str:
        return f"{self.file}{self.inside}"

    __fspath__ = __str__


Blob = Path | Part


def shortened(error: Exception) -> str:
    """Text of an error, up to 120 characters."""
    return str(error)[:120]


def read_bytes(path: Blob, limit: str = "bytes") -> bytes:
    """Read a whole file; `limit` names the size limit."""
    with (
        as_input_error("a file cannot be read", OSError, got=lambda error: error.strerror, path=path),
        as_input_error("a file is missing", FileNotFoundError, path=path),
    ):
        data = bytes(path.read()) if isinstance(path, Part) else safe_files.read_bytes(path, limit)
    require(data, "a file is empty", got="0 bytes", cause="was the copy interrupted?", path=path)
    return data


def read_json(path: Blob) -> dict[str, Any]:
    """Read a JSON file with an object at the top."""
    data = read_bytes(path, "text")
    try:
        table = safe_files.parse_json(data, path)
    except json.JSONDecodeError as error:
        raise InputError(
            f"malformed JSON in line {error.lineno}, column {error.colno}", got=error.msg, path=path
        ) from error
    except InputError:
        raise
    except ValueError as error:
        raise InputError("malformed JSON", got=f"{type(error).__name__}: {error}", path=path) from error
    require(isinstance(table, dict), "a JSON object was expected", got=type(table).__name__, path=path)
    return table


def numbered_lines(path: Blob) -> list[tuple[int, str]]:
    """Lines with content of a text file, each with the line number from 1."""
    with as_input_error("not a text file", UnicodeDecodeError, path=path):
        text = read_bytes(path, "text").decode("utf-8-sig")
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), start=1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def name_inside(name: str, source: Path, line: int) -> str:
    """File name from line `line` of a list, with "/" for the "\\" of Windows; must stay inside the list's folder.

    Of an absolute path of another machine the last parts count that are there.
    """
    inside = name if _PLAIN.match(name) or not leaves(name) else _below(name, source.parent)
    require(
        inside and inside.isprintable(),
        f"line {line} names a file outside the dataset",
        got=repr(name[:80]),
        expected="a path relative to the dataset's folder, without ..",
        path=source,
    )
    return str(inside).replace("\\", "/")


_PLAIN = re.compile(r"(?!.*\.\.)[^/\\:][^\\:]*\Z")
"""Most names, which need no closer look."""


MOST_PARTS = 32
"""So many last parts of an absolute path are looked for."""


def leaves(name: str) -> bool:
    """Test whether a name of a list is absolute or goes up, on any system."""
    windows = PureWindowsPath(name)
    return bool(PurePosixPath(name).is_absolute() or windows.drive or windows.root or ".." in windows.parts)


def goes_up(name: str) -> bool:
    """Test whether a relative name of a list has a "..", in Windows' way or not."""
    windows = PureWindowsPath(name)
    return ".." in windows.parts and not (windows.drive or windows.root)


def _below(name: str, folder: Path) -> str | None:
    """The most last parts of an absolute path that are a file of the folder."""
    parts = PureWindowsPath(name).parts[1:]
    tails = () if ".." in parts else ("/".join(parts[k:]) for k in range(max(0, len(parts) - MOST_PARTS), len(parts)))
    # `os.path` says False for what no system may be asked.
    return next((tail for tail in tails if os.path.isfile(folder / tail)), None)


def read_matrix(path: Blob, rows: int, columns: int) -> np.ndarray:
    """Matrix of a text file as float64; inf and NaN may occur."""
    words = " ".join(line for _, line in numbered_lines(path)).replace(",", " ").split()
    return as_floats(words, rows * columns, path).reshape(rows, columns)


_TIME = re.compile(r"[0-9]{9,}_[0-9]{3,9}")


def as_floats(values: Any, count: int, path: Blob, what: str = "numbers") -> np.ndarray:
    """`values` as (count,) float64, whatever their nesting. Of what Python alone reads, "1_0" and digits of other
    scripts, only a time as 1700000000_000000 counts."""
    words = [word for word in (values if isinstance(values, list) else [values]) if isinstance(word, str)]
    odd = next((w for w in words if not w.isascii() or ("_" in w and not _TIME.fullmatch(w))), None)
    require(odd is None, f"{what}: not numbers", got=str(odd)[:60], path=path)
    try:
        array = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what}: not numbers", got=str(values)[:60], path=path) from error
    require(array.size == count, f"{what}: a wrong count", got=array.size, expected=count, path=path)
    return array


def read_mat(path: Blob, *names: str) -> dict[str, Any]:
    """Named variables of a MATLAB file, where present."""
    data = read_bytes(path)
    from scipy.io import loadmat, whosmat

    # The package raises a dozen kinds of error for damaged files.
    with as_input_error("a MATLAB file that cannot be read", Exception, got=shortened, cause=CUT_OFF, path=path):
        for name, shape, _ in whosmat(io.BytesIO(data)):
            if name in names:
                within(math.prod(shape), "pixels", f"{name[:80]} of {shape}", path, safe_files.limits_of(path))
        return loadmat(io.BytesIO(data), variable_names=names)


def listing(folder: Path, links: bool = True) -> tuple[list[str], list[str]]:
    """Folder and file names in natural order, without hidden names. Without `links` a folder that is a link counts as a
    file."""
    memo = _LISTED.get()
    if memo is not None and (folder, links) in memo:
        return memo[folder, links]
    folders: list[str] = []
    files: list[str] = []
    unreadable = as_input_error("a folder cannot be listed", OSError, got=lambda e: e.strerror, path=folder)
    with unreadable, os.scandir(folder) as entries:
        for entry in entries:
            if not entry.name.startswith("."):
                (folders if entry.is_dir(follow_symlinks=links) else files).append(entry.name)
    within(len(folders) + len(files), "names", "a folder", folder, safe_files.limits_of(folder))
    found = sorted(folders, key=natural), sorted(files, key=natural)
    if memo is not None:
        memo[folder, links] = found
    return found


_LISTED: ContextVar[dict[tuple[Path, bool], tuple[list[str], list[str]]] | None] = ContextVar("listed", default=None)


@contextmanager
def listed_once() -> Iterator[None]:
    """Cache folder listings inside the block."""
    token = _LISTED.set({})
    try:
        yield
    finally:
        _LISTED.reset(token)


def readable(folder: Path, links: bool = True) -> tuple[list[str], list[str]]:
    """Folder listing; empty where unreadable."""
    try:
        return listing(folder, links)
    except InputError:
        return [], []


_NUMBER = re.compile("0*([0-9]+)")


def natural(name: str) -> str:
    """Natural sort key: frame2 before frame10.

    A number is written as what tells its length and its digits, so that characters are compared: a tuple of parts
    would be compared three times as slowly, and a folder may hold 300,000 names.
    """
    return _NUMBER.sub(_with_length, name) + "\0" + name


def _with_length(number: re.Match[str]) -> str:
    digits = number[1]
    return f"\1{chr(min(len(digits), sys.maxunicode))}{digits}"
