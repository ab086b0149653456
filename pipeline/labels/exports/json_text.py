"""Rows as JSON text: one line each, numbers in full, and long lists that are written item by item."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TextIO

from pipeline.errors import InputError

_LINE_ENDS = {ord(c): f"\\u{ord(c):04x}" for c in "\x85\u2028\u2029"}
"""JSON lets these stand, but many readers split lines at them."""


def json_line(content: Any) -> str:
    """One line of JSON that gives the same values back, floats included.

    Raises
    ------
    InputError
        A number that JSON has no word for.
    """
    try:
        text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(", ", ": "))
    except ValueError as error:
        raise InputError("the labels hold a number that JSON cannot carry", got=str(error)) from error
    return text.translate(_LINE_ENDS)


class JsonList:
    """A JSON list written item by item, one a line.

    Parameters
    ----------
    file : text file
        Open for writing; the list begins where it stands.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self.length = 0
        file.write("[")

    def add(self, item: Any) -> None:
        self._file.write((",\n" if self.length else "\n") + json_line(item))
        self.length += 1

    def close(self) -> None:
        self._file.write("\n]")


def load_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises
    ------
    InputError
        Missing or damaged.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError("a file of the export is missing", path=path) from error
    except (ValueError, RecursionError, OSError) as error:
        raise InputError("not a readable JSON file", got=str(error)[:120], path=path) from error
