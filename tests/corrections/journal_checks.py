"""What tests of the journal share."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.corrections import JOURNAL_FILE, Journal, object_ref, open_journal

NAME = object_ref("scene/0", 1, "label")


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    return open_journal(tmp_path / JOURNAL_FILE, labels="made-once")
