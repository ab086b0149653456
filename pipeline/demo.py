"""Where the built-in demo dataset lies: beside the package in a checkout, inside it when installed."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import InputError

DEMO_NAME = "demo"
DEMO_EXPRESSION = "mug left of the laptop"


def demo_path() -> Path:
    """The folder of the built-in demo dataset.

    Raises
    ------
    InputError
        Where the installation lacks it.
    """
    here = Path(__file__).resolve().parent
    for candidate in (here / "assets" / DEMO_NAME, here.parent / "assets" / DEMO_NAME):
        if candidate.is_dir():
            return candidate
    raise InputError("the built-in demo is not part of this installation", cause="reinstall spatialviz")
