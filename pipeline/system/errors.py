"""The errors the core raises on purpose."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

Thing = TypeVar("Thing")


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
        path: str | PathLike[str] | None = None,
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
    path: str | PathLike[str] | None = None,
    error: type[InputError] = InputError,
) -> None:
    """Raise InputError (or another `error`) with these words where something does not hold.

    `got` and `expected` may be functions that give them, where they cost time or only exist then.
    """
    if not sound:
        got, expected = (words() if callable(words) else words for words in (got, expected))
        raise error(what, got=got, expected=expected, cause=cause, path=path)


def needed(value: Thing | None, what: str, *, error: type[InputError] = InputError, **words: Any) -> Thing:
    """A value that must not be None; `error` with these words (those of `require`) where it is."""
    if value is None:
        raise error(what, **words)
    return value


@contextmanager
def as_input_error(what: str, *errors: type[Exception], got: object = None, **words: Any) -> Iterator[None]:
    """Errors of these kinds in the block, told as InputError with these words (those of `require`).

    `got` may be a function of the error. An InputError, which is a ValueError, goes through as it is.
    """
    try:
        yield
    except InputError:
        raise
    except errors as error:
        raise InputError(what, got=got(error) if callable(got) else got, **words) from error


def first_line(error: Exception) -> str:
    """What an error says in its first line."""
    return str(error).split("\n")[0]


def kind_and_text(error: Exception) -> str:
    """An error by its kind and what it says."""
    return f"{type(error).__name__}: {error}"


class Shown(NamedTuple):
    """A value as a message quotes it: its first characters, written out only where there is a message."""

    value: object
    longest: int = 60

    def __str__(self) -> str:
        return repr(self.value)[: self.longest]


def extra_module(module: str, feature: str, extra: str) -> Any:
    """The module; MissingExtra for the feature where it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtra(feature, extra) from error


class UnknownFormat(InputError):
    """A folder that no reader recognises as a dataset."""


class FrameUnusable(InputError):
    """One frame cannot be used, and that says nothing about the others."""


class UnknownClass(InputError):
    """A class name that a detector or dataset of limited vocabulary does not know."""


class Unsupported(InputError):
    """Words that were understood ask for what is not judged: `facing`, an action, `it`, a relation not on offer."""


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


def listed(names: Sequence[str], limit: int = 12) -> str:
    """ "a, b, c and 4 more"."""
    names = sorted(set(names))
    more = len(names) - limit
    return ", ".join(names[:limit]) + (f" and {more} more" if more > 0 else "")


class ServerError(InputError):
    """A server that gives no answer, after all tries.

    Attributes
    ----------
    status : int or None
        HTTP status; None where there was no reply.
    everywhere : bool
        Whether every other question would fail in the same way.
    """

    def __init__(self, what: str, *, status: int | None, everywhere: bool, **more: Any) -> None:
        super().__init__(what, **more)
        self.status, self.everywhere = status, everywhere
