"""Marks of tests that need what an extra brings, told without importing it: collection stays light."""

from __future__ import annotations

import os
from importlib.util import find_spec

import pytest

REQUIRED = os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1"
"""What is missing fails then, and is not skipped."""


def needs(*packages: str) -> pytest.MarkDecorator:
    """A mark that skips where a package is not installed.

    Parameters
    ----------
    packages
        Names as they are imported.
    """
    missing = [name for name in packages if find_spec(name.partition(".")[0]) is None]
    return pytest.mark.skipif(bool(missing) and not REQUIRED, reason=f"not installed: {', '.join(missing)}")
