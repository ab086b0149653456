"""Fixtures shared by the tests of the core."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real test input, kept beside the project and never inside it."""
    folder = Path(os.environ.get("SPATIALVIZ_SHARED", ROOT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"real test data are not at {folder}; set SPATIALVIZ_SHARED to the folder that holds data/")
    return folder
