"""Installed packages: versions, and readers, detectors, segmenters and exports added by entry points."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


def entry_points(group: str) -> EntryPoints:
    """Find the entry points of a group, again only after a change in a folder of the search path.

    `importlib.metadata` reads a file of every installed package, slower than opening a small dataset.
    """
    return _entry_points(group, tuple((folder, _last_change(folder)) for folder in sys.path))


@lru_cache(maxsize=16)
def _entry_points(group: str, _folders: tuple[tuple[str, int], ...]) -> EntryPoints:
    from importlib.metadata import entry_points

    return entry_points(group=group)


def _last_change(folder: str) -> int:
    """Time of the last file put into or taken out of a folder, nanoseconds; -1 without the folder."""
    try:
        return os.stat(folder or ".").st_mtime_ns
    except OSError:
        return -1


def load_plugins(group: str, what: str, kind: Any) -> tuple[tuple[str, Any], ...]:
    """Load the plugins of an entry point group, such as "spatialviz.datasets", as (name, object).

    A plugin that fails, or is no instance of `kind` (`collections.abc.Callable` for functions), is left out with a
    warning; `what` names its purpose there: "dataset", "detector".
    """
    found: list[tuple[str, Any]] = []
    for point in entry_points(group=group):
        try:
            loaded = point.load()
        except Exception as error:  # A plugin may raise anything; what else there is must still work.
            warnings.warn(f"{what} plugin {point.value} cannot be loaded: {error}", stacklevel=3)
            continue
        if isinstance(loaded, kind):
            found.append((point.name, loaded))
        else:
            warnings.warn(f"{what} plugin {point.value} is no {kind.__name__}", stacklevel=3)
    return tuple(found)


def versions_of(*packages: str) -> dict[str, str]:
    """Versions of packages, if installed."""
    from importlib.metadata import PackageNotFoundError, version

    found = {}
    for package in packages:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
