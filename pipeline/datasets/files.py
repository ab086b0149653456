"""Reading the small text files of a dataset, and listing its folders."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Protocol

import numpy as np

from pipeline.system.errors import InputError, require

CUT_OFF = "was the copy or the download interrupted?"


class Blob(Protocol):
    """A file where it stands: a path, or a member of an archive, a table or a stream.

    One that holds an array and no encoded picture also has `pixels()`. `os.fspath` says what a message calls it.
    """

    @property
    def name(self) -> str: ...

    def read_bytes(self) -> bytes: ...

    def __fspath__(self) -> str: ...


def read_bytes(path: Blob) -> bytes:
    """The whole file, wherever it stands.

    Raises
    ------
    InputError
        Missing, unreadable, or empty.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError("a file is missing", path=path) from error
    except OSError as error:
        raise InputError("a file cannot be read", got=error.strerror, path=path) from error
    require(data, "a file is empty", got="0 bytes", cause="was the copy interrupted?", path=path)
    return data


def read_json(path: Blob) -> dict[str, Any]:
    """A JSON file whose top level is an object.

    Raises
    ------
    InputError
        Missing, empty, malformed (with the line), or of another shape.
    """
    data = read_bytes(path)
    try:
        table = json.loads(data.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise InputError(
            f"malformed JSON in line {error.lineno}, column {error.colno}", got=error.msg, path=path
        ) from error
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise InputError("malformed JSON", got=f"{type(error).__name__}: {error}", path=path) from error
    require(isinstance(table, dict), "a JSON object was expected", got=type(table).__name__, path=path)
    return table


def numbered_lines(path: Blob) -> list[tuple[int, str]]:
    """The lines of a text file that say something, each with its number in the file, from 1.

    Raises
    ------
    InputError
        Missing, empty, unreadable, or no text.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("not a text file", path=path) from error
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), start=1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def path_inside(root: Path, name: str, source: Path, line: int) -> Path:
    """The file that line `line` of the list `source` names, which must lie inside `root`.

    Raises
    ------
    InputError
        An absolute path, one with "..", or one with control characters.
    """
    windows = PureWindowsPath(name)
    outside = PurePosixPath(name).is_absolute() or windows.drive or windows.root or ".." in windows.parts
    require(
        name and not outside and name.isprintable(),
        f"line {line} names a file outside the dataset",
        got=repr(name[:80]),
        expected="a path relative to the dataset's folder, without ..",
        path=source,
    )
    return root / name


def read_matrix(path: Blob, rows: int, columns: int) -> np.ndarray:
    """A text file of rows x columns numbers, as float64. inf and NaN may be among them."""
    words = " ".join(line for _, line in numbered_lines(path)).replace(",", " ").split()
    return as_floats(words, rows * columns, path).reshape(rows, columns)


def as_floats(values: Any, count: int, path: Blob, what: str = "numbers") -> np.ndarray:
    """`values` as (count,) float64, whatever their nesting.

    Raises
    ------
    InputError
        Not numbers, or another count.
    """
    try:
        array = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what}: not numbers", got=str(values)[:60], path=path) from error
    require(array.size == count, f"{what}: a wrong count", got=array.size, expected=count, path=path)
    return array


def read_mat(path: Blob, *names: str) -> dict[str, Any]:
    """The named variables of a MATLAB file, as far as it has them.

    Raises
    ------
    InputError
        Missing, cut off, or no MATLAB file.
    """
    data = read_bytes(path)
    from scipy.io import loadmat

    try:
        return loadmat(io.BytesIO(data), variable_names=names)
    except Exception as error:  # The package raises a dozen kinds of error for damaged files.
        raise InputError("a MATLAB file that cannot be read", got=str(error)[:120], cause=CUT_OFF, path=path) from error


def listing(folder: Path, links: bool = True) -> tuple[list[str], list[str]]:
    """Names of the folders and of the files in a folder, each in natural order, without hidden ones.

    Without `links` a folder that is a link counts as a file.
    """
    memo = _LISTED.get()
    if memo is not None and (folder, links) in memo:
        return memo[folder, links]
    folders: list[str] = []
    files: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if not entry.name.startswith("."):
                    (folders if entry.is_dir(follow_symlinks=links) else files).append(entry.name)
    except OSError as error:
        raise InputError("a folder cannot be listed", got=error.strerror, path=folder) from error
    found = in_order(folders), in_order(files)
    if memo is not None:
        memo[folder, links] = found
    return found


_LISTED: ContextVar[dict[tuple[Path, bool], tuple[list[str], list[str]]] | None] = ContextVar("listed", default=None)


@contextmanager
def listed_once() -> Iterator[None]:
    """In the block each folder is listed once: every format looks at a dataset before one opens it."""
    token = _LISTED.set({})
    try:
        yield
    finally:
        _LISTED.reset(token)


_DIGITS = str.maketrans("123456789", "0" * 9)


def in_order(names: list[str]) -> list[str]:
    """Names in natural order."""
    # Where all digits stand in the same columns, the order of characters is the natural one, and soon found.
    alike = len({name.translate(_DIGITS) for name in names}) <= 1
    return sorted(names) if alike else sorted(names, key=natural)


def readable(folder: Path, links: bool = True) -> tuple[list[str], list[str]]:
    """`listing`, and nothing where the folder cannot be read: what may not be looked at is no data."""
    try:
        return listing(folder, links)
    except InputError:
        return [], []


def natural(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """Sort key under which frame2 comes before frame10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(p), "") if p[0] in "0123456789" else (1, 0, p) for p in parts], name
