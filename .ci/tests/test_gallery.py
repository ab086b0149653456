"""The gallery of failures is what its script makes, and each of its cases opens in the page with one command."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from pipeline.diagnosis.cases.saving import OpenedCase
from pipeline.diagnosis.whatif.state import ViewState
from spatialviz import view_opening
from spatialviz.cli_ask import ViewCommand

ROOT = Path(__file__).resolve().parents[2]
CASES = sorted(path.parent for path in (ROOT / "docs" / "gallery").glob("*/spatialviz-case.json"))


def test_the_gallery_says_what_the_tool_says() -> None:
    spec = importlib.util.spec_from_file_location("gallery", ROOT / ".ci" / "site" / "gallery.py")
    assert spec is not None
    assert spec.loader is not None
    gallery = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(gallery)
    assert gallery.check() == []


@pytest.mark.parametrize("folder", CASES, ids=lambda folder: folder.name)
def test_a_case_opens_with_its_question_and_its_truth(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: dict[str, Any] = {}
    monkeypatch.setattr(view_opening, "serve", lambda sources, **given: opened.update(given, sources=sources))
    listening: Any = type("Listening", (), {"access": None})
    view_opening.open_view(ViewCommand(str(folder)), listening, None)
    case, view = opened["cases"][folder.name], opened["first_view"]
    assert isinstance(case, OpenedCase)
    assert isinstance(view, ViewState)
    assert (view.dataset, view.frame, view.expression) == (folder.name, case.manifest.frame.id, case.manifest.text)
    # Nothing is begun beside a case that is only looked at.
    assert opened["journals"] == {}
