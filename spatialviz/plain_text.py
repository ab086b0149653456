r"""Plain output: control codes in names of strangers (classes, files, tensors, keys) are escaped in the shell and the
log.

Such a code stands as its escape, which in JSON means the same: `\u202e`. The colours of the terminal are rich's own.
"""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from pipeline.system.execution import VERBOSE_VARIABLE

_CODES = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""C0 without tabs and ends of lines, DEL, C1, marks of direction, separators of lines, half characters."""

PIPE_WIDTH = 160
"""Columns of a table in a pipe, which has no edge to wrap at."""
_ERRORS = 2
"""The descriptor of standard error, which libraries write to."""


def plain(text: str) -> str:
    """Text with control codes escaped; ends of lines stay."""
    return _CODES.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def one_line(text: str) -> str:
    """Text on a single line, with ends of lines escaped too."""
    return plain(text).replace("\n", "\\u000a")


class PlainStream:
    """Text stream with plain output; everything else is the stream's own.

    `rich_proxied_file`: the stream itself, under the name by which rich finds it.
    """

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        self.rich_proxied_file.write(plain(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


def unfiltered(stream: Any) -> Any:
    """Stream below, for code with a filter already."""
    while (below := getattr(stream, "rich_proxied_file", None)) is not None:
        stream = below
    return stream


@contextmanager
def plain_streams() -> Iterator[None]:
    """Make output plain meanwhile; a missing character of a terminal is a question mark, and output to a closed stream
    is dropped."""
    before = sys.stdout, sys.stderr
    with _libraries_silent():
        _make_plain()
        try:
            yield
        finally:
            sys.stdout, sys.stderr = before


def _make_plain() -> None:
    for name in ("stdout", "stderr"):
        stream: Any = getattr(sys, name)
        if stream is None:
            stream = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (open to the end)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
        setattr(sys, name, PlainStream(stream))


@contextmanager
def _libraries_silent() -> Iterator[None]:
    """Silence native libraries' messages about a damaged picture: ours replaces them.

    Where the program is looked into, or ONNX Runtime's own messages are asked for, all of it is shown.
    """
    shown = (
        any(os.environ.get(name) for name in ("SPATIALVIZ_DEBUG", VERBOSE_VARIABLE, "PYTHONFAULTHANDLER"))
        or "--verbose" in sys.argv
    )
    if shown or not isinstance(sys.stderr, io.TextIOWrapper) or _descriptor(sys.stderr) != _ERRORS:
        yield
        return
    own, nowhere = os.dup(_ERRORS), os.open(os.devnull, os.O_WRONLY)
    sys.stderr.flush()
    os.dup2(nowhere, _ERRORS)
    os.close(nowhere)
    stream = open(own, "w", buffering=1, encoding=sys.stderr.encoding, errors="replace")  # noqa: SIM115 (closed below)
    sys.stderr = stream
    try:
        yield
    finally:
        os.dup2(own, _ERRORS)
        with suppress(OSError):
            stream.close()


def _descriptor(stream: Any) -> int | None:
    with suppress(OSError, ValueError):
        return stream.fileno()
    return None
