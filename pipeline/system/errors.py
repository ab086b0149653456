"""The errors the core raises on purpose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Value = TypeVar("Value")


class InputError(ValueError):
    """Something given from outside cannot be used.

    The message is one line: what was wrong, what was got, what was expected,
    the likely cause, and the file.

    Parameters
    ----------
    what : str
        What was wrong, in a short clause.
    got, expected : str, optional
        The value that came, and the value that would have been right.
    cause : str, optional
        The likely cause, phrased as help.
    path : str or Path, optional
        The file that holds the bad value.
    """

    def __init__(
        self,
        what: str,
        *,
        got: object = None,
        expected: object = None,
        cause: str | None = None,
        path: str | Path | None = None,
    ) -> None:
        parts = [what]
        if got is not None:
            parts.append(f"got {got}")
        if expected is not None:
            parts.append(f"expected {expected}")
        message = "; ".join(parts)
        if cause:
            message += f" ({cause})"
        if path is not None:
            message += f" [{path}]"
        super().__init__(" ".join(message.split()))
        self.what = what
        self.path = None if path is None else Path(path)


def require(
    sound: object,
    what: str,
    *,
    got: object = None,
    expected: object = None,
    cause: str | None = None,
    path: str | Path | None = None,
    error: type[InputError] = InputError,
) -> None:
    """Raise InputError (or another `error`) with these words where something does not hold.

    `got` and `expected` may be functions that give them, where they cost time or only exist then.
    """
    if not sound:
        got, expected = (words() if callable(words) else words for words in (got, expected))
        raise error(what, got=got, expected=expected, cause=cause, path=path)


def needed(
    value: Value | None,
    what: str,
    *,
    got: object = None,
    expected: object = None,
    cause: str | None = None,
    path: str | Path | None = None,
    error: type[InputError] = InputError,
) -> Value:
    """A value that must not be None; InputError (or another `error`) with these words where it is."""
    if value is None:
        raise error(what, got=got, expected=expected, cause=cause, path=path)
    return value


class UnknownFormat(InputError):
    """A folder that no reader recognises as a dataset."""


class FrameUnusable(InputError):
    """One frame cannot be used, and that says nothing about the others."""


class UnknownClass(InputError):
    """A class name that a detector or dataset of limited vocabulary does not know."""


class MissingExtra(ImportError):
    """A feature needs an optional dependency that is not installed."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(f"{feature} needs an optional dependency: pip install 'spatialviz[{extra}]'")
        self.feature = feature
        self.extra = extra

    @classmethod
    def missing(cls, need: Callable[[], None]) -> str:
        """Why what `need` checks has to be left out; empty where it is there."""
        try:
            need()
        except cls as error:
            return str(error)
        return ""

    def __reduce__(self) -> tuple[type[MissingExtra], tuple[str, str]]:
        # Worker processes send it to their parent.
        return type(self), (self.feature, self.extra)
