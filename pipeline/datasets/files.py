"""Reading the small text files of a dataset: JSON and tables of numbers."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from pipeline.system.errors import InputError


def read_bytes(path: Path) -> bytes:
    """The whole file.

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
    if not data:
        raise InputError("a file is empty", got="0 bytes", cause="was the copy interrupted?", path=path)
    return data


def read_json(path: Path) -> dict[str, Any]:
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
    if not isinstance(table, dict):
        raise InputError("a JSON object was expected", got=type(table).__name__, path=path)
    return table


def read_lines(path: Path) -> list[str]:
    """The lines of a text file that say something: no blanks, no # comments."""
    return [line for _, line in numbered_lines(path)]


def numbered_lines(path: Path) -> list[tuple[int, str]]:
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
    if not name or outside or not name.isprintable():
        raise InputError(
            f"line {line} names a file outside the dataset",
            got=repr(name[:80]),
            expected="a path relative to the dataset's folder, without ..",
            path=source,
        )
    return root / name


def read_matrix(path: Path, rows: int, columns: int) -> np.ndarray:
    """A text file of rows x columns numbers, as float64. inf and NaN may be among them."""
    words = " ".join(read_lines(path)).replace(",", " ").split()
    return as_floats(words, rows * columns, path).reshape(rows, columns)


def as_floats(values: Any, count: int, path: Path, what: str = "numbers") -> np.ndarray:
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
    if array.size != count:
        raise InputError(f"{what}: a wrong count", got=array.size, expected=count, path=path)
    return array


def listing(folder: Path) -> tuple[list[str], list[str]]:
    """Names of the folders and of the files in a folder, each in natural order, without hidden ones."""
    folders: list[str] = []
    files: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if not entry.name.startswith("."):
                    (folders if entry.is_dir() else files).append(entry.name)
    except OSError as error:
        raise InputError("a folder cannot be listed", got=error.strerror, path=folder) from error
    return sorted(folders, key=natural), sorted(files, key=natural)


def natural(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """Sort key under which frame2 comes before frame10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(p), "") if p[0] in "0123456789" else (1, 0, p) for p in parts], name
