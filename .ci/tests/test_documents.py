"""Documents name files that are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [*(ROOT / "docs").glob("*.md"), ROOT / ".github" / "CONTRIBUTING.md", ROOT / "README.md"]


def test_files_that_documents_name_are_there() -> None:
    named = [(d.name, f) for d in DOCUMENTS for f in re.findall(r"`((?:\.?\w[\w.-]*/)+[\w-]+\.py)`", d.read_text())]
    assert len(named) > 30
    roots = (ROOT, ROOT / "pipeline")
    assert [(d, f) for d, f in named if not any((root / f).exists() for root in roots)] == []


def test_links_between_documents_lead_somewhere() -> None:
    links = [
        (d, link)
        for d in DOCUMENTS
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", d.read_text())
        if "://" not in link
    ]
    assert len(links) > 5
    assert [(d.name, link) for d, link in links if not (d.parent / link).exists()] == []
