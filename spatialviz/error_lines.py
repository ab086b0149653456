"""Errors in one line, for a person or an agent."""

from __future__ import annotations

import re
import traceback
from pathlib import Path

from pipeline.system.errors import InputError, MissingExtra

TOLD = (InputError, MissingExtra, OSError)
"""Errors that are the user's or the machine's; all others are the program's."""

_NO_MEMORY = re.compile(
    r"failed to map segment|cannot allocate memory|bad_alloc|bad allocation|out ?of ?memory error|insufficient memory"
    r"|can't start new thread|failed to allocate memory",
    re.IGNORECASE,
)
"""What the system and libraries say where memory is short: of loading a library too."""


LONGEST_LINE = 4000
"""Characters of an error's line: a file may hold a name as long as it likes."""


def error_line(error: Exception) -> str:
    """Single line of an error, for a person or an agent; of a long one the beginning and the end."""
    line = _line_of(error)
    half = LONGEST_LINE // 2
    return line if len(line) <= LONGEST_LINE else f"{line[:half]} ... {line[-half:]}"


def _line_of(error: Exception) -> str:
    if isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)):
        return "error: there is not enough memory (is it limited, as by ulimit -v, or does something else need it?)"
    if isinstance(error, OSError):  # A full disk, a folder that cannot be written.
        return f"error: {error.strerror or error}" + (f" [{error.filename}]" if error.filename else "")
    if isinstance(error, TOLD):
        return f"error: {error}"
    where = traceback.extract_tb(error.__traceback__)[-1]
    return (
        f"internal error: {type(error).__name__}: {error} at {Path(where.filename).name}:{where.lineno}"
        " (SPATIALVIZ_DEBUG=1 shows all of it; please report it)"
    )
