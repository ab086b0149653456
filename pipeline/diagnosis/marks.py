"""Marks of people on labelled expressions: a wrong label, or a wrong box."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.system.errors import as_input_error, require
from pipeline.system.safe_files import read_json

_KEYS = (
    "frame",  # Id of the frame
    "id",  # Of the expression in the labels
    "mark",  # What is wrong
)
MARKS = ("BAD_LABEL", "BAD_BOX")


def read_marks(path: Path) -> dict[tuple[str, str], str]:
    """Read marks by (frame, expression id) from JSON: a list of {"frame", "id", "mark"} with any other keys.

    Raises
    ------
    InputError
        The file cannot be read, a mark is not one of MARKS, or an expression is marked twice.
    """
    with as_input_error("the marks cannot be read", OSError, ValueError, got=str, path=path):
        entries: Any = read_json(Path(path))
    require(isinstance(entries, list), "marks must be a list", got=type(entries).__name__, path=path)
    found: dict[tuple[str, str], str] = {}
    for n, entry in enumerate(entries):
        require(
            isinstance(entry, dict) and all(isinstance(entry.get(key), str) for key in _KEYS),
            f"mark {n} must have the texts {', '.join(_KEYS)}",
            got=repr(entry)[:80],
            path=path,
        )
        frame, expression, mark = (entry[key] for key in _KEYS)
        require(mark in MARKS, f"mark {n} is not known", got=mark, expected=" or ".join(MARKS), path=path)
        require(
            (frame, expression) not in found, "an expression is marked twice", got=f"{frame} {expression}", path=path
        )
        found[frame, expression] = mark
    return found
