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


def anchors(document: Path) -> set[str]:
    """What the headings of a document are linked by, as GitHub makes it."""
    headings = re.findall(r"^#+ (.*)$", document.read_text(), re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def test_links_between_documents_lead_somewhere() -> None:
    links = [
        (d, link, anchor)
        for d in DOCUMENTS
        for link, anchor in re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", d.read_text())
        if "://" not in link
    ]
    assert len(links) > 5
    gone = [(d.name, link) for d, link, _ in links if not (d.parent / link).exists()]
    assert gone == []
    assert [(d.name, a) for d, link, a in links if a and a not in anchors(d.parent / link if link else d)] == []


def test_the_readme_lists_every_document() -> None:
    readme = (ROOT / "README.md").read_text()
    assert [d.name for d in DOCUMENTS if d.parent.name == "docs" and f"](docs/{d.name})" not in readme] == []
