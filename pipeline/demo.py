"""The built-in demo dataset."""

from __future__ import annotations

from pathlib import Path

from pipeline.assets import asset_path

DEMO_NAME = "demo"
DEMO_EXPRESSION = "mug left of the laptop"


def demo_path() -> Path:
    """The folder of the built-in demo dataset.

    Raises
    ------
    InputError
        Where the installation lacks it.
    """
    return asset_path(DEMO_NAME)
