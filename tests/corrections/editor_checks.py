"""What tests of the label editor share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pipeline.corrections import JournalLocation, LabelEditor
from pipeline.labels import Labels

Open = Callable[..., LabelEditor]


@pytest.fixture
def place(demo_labels: Labels, tmp_path: Path) -> Iterator[JournalLocation]:
    found = JournalLocation(demo_labels, tmp_path / "j.sqlite")
    yield found
    found.close()


@pytest.fixture
def desk(demo_labels: Labels, place: JournalLocation) -> Open:
    """Opens desks of one journal."""
    return lambda author="ann": LabelEditor(demo_labels, place, author)
