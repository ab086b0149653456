"""What tests of the journal share."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.corrections.journal.field_refs import object_ref
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal, open_journal

NAME = object_ref("scene/0", 1, "label")


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    return open_journal(tmp_path / JOURNAL_FILE, labels="made-once")
