"""Installed packages: their versions, and the readers, detectors, segmenters and exports that entry points add."""

from __future__ import annotations

import warnings
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, entry_points, version
from typing import Any


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
