"""Documents name files that are there."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from pipeline.bench.claims import read_bench
from pipeline.bench.table import renewed
from pipeline.relations.pair_measures import Profile

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [*(ROOT / "docs").glob("*.md"), *(ROOT / ".github").glob("*.md"), ROOT / "README.md"]


def test_files_that_documents_name_are_there() -> None:
    named = [(d.name, f) for d in DOCUMENTS for f in re.findall(r"`((?:\.?\w[\w.-]*/)+[\w-]+\.py)`", d.read_text())]
    architecture = (ROOT / "docs" / "architecture.md").read_text()
    named += [("architecture.md", f) for f in re.findall(r"`((?:\w+/)+\w+\.json)`", architecture)]
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
        if "://" not in link and not link.startswith("reference/")  # made when the site is built, and checked there
    ]
    assert len(links) > 5
    gone = [(d.name, link) for d, link, _ in links if not (d.parent / link).exists()]
    assert gone == []
    assert [(d.name, a) for d, link, a in links if a and a not in anchors(d.parent / link if link else d)] == []


def test_the_readme_is_short_and_shows_one_picture() -> None:
    readme = (ROOT / "README.md").read_text()
    assert len(readme.encode()) < 7000
    assert readme.count("![") == 1


def test_what_was_measured_has_its_data_its_date_and_who_made_it() -> None:
    section = (ROOT / "docs" / "measured.md").read_text().partition("\n## At a glance\n")[2].partition("\n## ")[0]
    rows = [[c.strip() for c in line.strip("|").split("|")] for line in section.splitlines() if line.startswith("| ")]
    head, *claims = rows
    assert head == ["what", "figure", "data", "measured", "knew the judge"]
    assert len(claims) > 5
    figures = [row for row in claims if re.search(r"\d", row[1])]
    assert [r[0] for r in figures if not (r[2] and re.fullmatch(r"20\d\d-\d\d-\d\d", r[3]) and r[4])] == []
    assert [r[0] for r in claims if r not in figures and "](" not in r[0] + r[1]] == []


def test_the_thresholds_of_relations_are_those_of_the_rule() -> None:
    text, p = (ROOT / "docs" / "relations.md").read_text(), Profile()
    degrees = (p.cone, p.doubtful_cone, p.elevation, p.elevation_doubtful)
    lengths = (p.dead_zone, p.dead_zone_depth, p.sink, p.clear_height, p.on_gap, p.on_gap_doubtful, p.in_inflation)
    shares = (p.dead_zone_depth_relative, p.on_gap_relative)
    told = [f"{v:g}°" for v in degrees] + [f"{100 * v:g} cm" for v in lengths] + [f"{100 * v:g} %" for v in shares]
    assert [words for words in told if words not in text] == []


def test_accuracy_is_claimed_with_a_date_or_with_what_was_measured() -> None:
    claims = re.compile(r"\b(F1|AUC|ECE|IoU)\b[^|\n]{0,40}[ |]\.\d\d")
    dated = re.compile(r"\b20\d\d-\d\d-\d\d\b|#what-was-measured")
    texts = {d.name: d.read_text() for d in DOCUMENTS}
    assert [name for name, text in texts.items() if claims.search(text) and not dated.search(text)] == []


def test_figures_of_speed_are_those_of_the_bench() -> None:
    """`python -m pipeline.bench.table docs/bench.json README.md docs/*.md` renews them."""
    run = replace(read_bench(ROOT / "docs" / "bench.json"), before=None)
    assert "<!-- bench: table -->" in (ROOT / "docs" / "speed.md").read_text()
    assert [d.name for d in DOCUMENTS if renewed(d.read_text(), run) != d.read_text()] == []
