"""Fixtures shared by the tests of the core."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pipeline.labels.reading import Labels

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real test input, kept beside the project and never inside it."""
    folder = Path(os.environ.get("SPATIALVIZ_SHARED", ROOT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"real test data are not at {folder}; set SPATIALVIZ_SHARED to the folder that holds data/")
    return folder


@pytest.fixture(scope="session")
def label_sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Labels]:
    """Labels of the demo, ones with everything odd, and empty ones; not to be changed."""
    from label_sets import hostile_labels, label_demo, write_labels

    folder = tmp_path_factory.mktemp("labels")
    return {
        "demo": label_demo(folder / "demo"),
        "hostile": hostile_labels(folder / "hostile"),
        "empty": write_labels(folder / "empty", {}),
    }
