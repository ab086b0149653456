"""Errors of the core."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

Thing = TypeVar("Thing")


class InputError(ValueError):
    """Unusable input from outside.

    The message is one line: `what` was wrong, what was `got`, what was `expected`, the likely `cause`, phrased as help,
    and the file at `path`.

    >>> from pipeline import open_labels
    >>> try:
    ...     open_labels("nowhere")
    ... except InputError as error:
    ...     print(error.what, "-", error.path)
    no labels here - nowhere
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
    """Raise InputError (or another `error`) with these words unless a condition holds.

    `got` and `expected` may be functions that give them, where they cost time or only exist then.
    """
    if not sound:
        got, expected = (words() if callable(words) else words for words in (got, expected))
        raise error(what, got=got, expected=expected, cause=cause, path=path)


def needed(value: Thing | None, what: str, *, error: type[InputError] = InputError, **words: Any) -> Thing:
    """Return a value; raise `error` with these words (as `require`) for None."""
    if value is None:
        raise error(what, **words)
    return value


@contextmanager
def as_input_error(what: str, *errors: type[Exception], got: object = None, **words: Any) -> Iterator[None]:
    """Turn errors of these kinds in the block into InputError with these words (as `require`).

    `got` may be a function of the error. An InputError, which is a ValueError, goes through as it is.
    """
    try:
        yield
    except InputError:
        raise
    except errors as error:
        raise InputError(what, got=got(error) if callable(got) else got, **words) from error


@contextmanager
def in_file(path: str | PathLike[str]) -> Iterator[None]:
    """Name a file in the InputErrors of the block without one."""
    try:
        yield
    except InputError as error:
        raise error if error.path is not None else InputError(str(error), path=path) from error


def first_line(error: Exception) -> str:
    """First line of an error."""
    return str(error).split("\n")[0]


def kind_and_text(error: Exception) -> str:
    """Kind and text of an error."""
    return f"{type(error).__name__}: {error}"


class Shown(NamedTuple):
    """Value as quoted in a message: its first characters, written out only for a message."""

    value: object
    longest: int = 60

    def __str__(self) -> str:
        return repr(self.value)[: self.longest]


def extra_module(module: str, feature: str, extra: str) -> Any:
    """Import a module of an extra; MissingExtra if not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtra(feature, extra) from error


class UnknownFormat(InputError):
    """Folder recognised by no reader as a dataset."""


class FrameUnusable(InputError):
    """One unusable frame, without a word on the others."""


class UnknownClass(InputError):
    """Class name outside a detector's or dataset's vocabulary."""


class Unsupported(InputError):
    """Understood words with a meaning beyond judging: `facing`, an action, `it`, a relation not on offer."""


class MissingExtra(ImportError):
    """Optional dependency missing for a feature."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(f"{feature} needs an optional dependency: pip install 'spatialviz[{extra}]'")
        self.feature = feature
        self.extra = extra

    @classmethod
    def missing(cls, need: Callable[[], None]) -> str:
        """Message of the MissingExtra raised by `need`; empty if none."""
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
    """Server without an answer after all tries.

    `status` is of HTTP, None without a reply; `everywhere` tells an error that every other question would meet.
    """

    def __init__(self, what: str, *, status: int | None, everywhere: bool, **more: Any) -> None:
        super().__init__(what, **more)
        self.status, self.everywhere = status, everywhere
