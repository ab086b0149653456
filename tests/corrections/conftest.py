"""What holds for every test of corrections."""

from __future__ import annotations

import pytest
from waiting import LONG_S

from pipeline.corrections import journal_location


@pytest.fixture(autouse=True)
def a_journal_has_time_to_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a journal that is long in opening, as on a machine under load, a person is told; a test waits for it."""
    monkeypatch.setattr(journal_location, "PATIENCE_S", LONG_S)
