"""What people and other programs write, checked: where it is wrong, one line says so."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from pipeline.system.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

Checked = TypeVar("Checked")


def parse_toml(text: str) -> dict[str, Any]:
    """A table of TOML; ValueError where it is none."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("brackets inside brackets too deep") from error


def checked(
    check: Callable[[Any], Checked],
    content: Any,
    wrong: str,
    path: Path,
    *,
    inside: Iterable[str] = (),
    keys: Iterable[str] = (),
) -> Checked:
    """What `check` (a validating method of pydantic) makes of a file's content.

    Parameters
    ----------
    wrong : str
        What to say where it is wrong, with the location for {}.
    inside : iterable of str
        The location of the content in the file.
    keys : iterable of str
        The keys there are, to be told where another one is given.

    Raises
    ------
    InputError
        The first fault, and where it stands.
    """
    try:
        return check(content)
    except ValidationError as error:
        first = error.errors()[0]
        location = ".".join(str(p) for p in (*inside, *first["loc"])) or "the top"
        known = ", ".join(keys) if first["type"] in ("extra_forbidden", "unexpected_keyword_argument") else ""
        raise InputError(
            wrong.replace("{}", location), got=first["msg"], expected=f"one of {known}" if known else None, path=path
        ) from error
