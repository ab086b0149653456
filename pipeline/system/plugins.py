"""Installed packages: their versions, and the readers, detectors, segmenters and exports that entry points add."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import suppress
from functools import lru_cache
from importlib import metadata
from importlib.metadata import EntryPoints, PackageNotFoundError, version
from typing import Any


def entry_points(group: str) -> EntryPoints:
    """The entry points of a group, as `importlib.metadata` finds them.

    That reads a file of every installed package, which takes longer than to open a small dataset. It is done once,
    and again where a folder of the search path has changed: whatever is installed or removed changes its folder.
    """
    return _entry_points(group, tuple((folder, _last_change(folder)) for folder in sys.path))


@lru_cache(maxsize=16)
def _entry_points(group: str, _folders: tuple[tuple[str, int], ...]) -> EntryPoints:
    return metadata.entry_points(group=group)


def _last_change(folder: str) -> int:
    """When anything was put into a folder, or taken out of it, nanoseconds; -1 where there is none."""
    try:
        return os.stat(folder or ".").st_mtime_ns
    except OSError:
        return -1


def load_plugins(group: str, what: str, kind: Any) -> tuple[tuple[str, Any], ...]:
    """The plugins of an entry point group. One that fails to load is warned of and left out.

    Parameters
    ----------
    group : str
        The entry point group, such as "spatialviz.datasets".
    what : str
        What the plugins add, for the warning: "dataset", "detector".
    kind : type
        What a plugin must be an instance of; `collections.abc.Callable` for functions.

    Returns
    -------
    tuple of (name of the entry point, loaded object)
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
    """The versions of those packages that are installed."""
    found = {}
    for package in packages:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
