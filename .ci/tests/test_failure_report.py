"""The page of a failure: strings of the dataset stay strings, nothing is fetched, the numbers are the answer's."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from test_failure_case import TEXT, NamedDataset, keep, made
from whatif_scenes import ScoringDetector, context_of, row

from pipeline.answering.objects import PreparedFrame
from pipeline.diagnosis.asking import annotated_truth, answer
from pipeline.diagnosis.cases.saving import open_case
from pipeline.evaluation.leakage import PERFECT
from pipeline.proposals import AnnotationDetector
from pipeline.system.errors import InputError
from spatialviz.report.page import Subject, failure_page, write_page

HOSTILE = "<script>alert(1)</script> \"'&<img src=x onerror=alert(1)> mug"


class Tags(HTMLParser):
    """All tags with their attributes, and the text."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def parsed(page: str) -> Tags:
    parser = Tags()
    parser.feed(page)
    return parser


def page_of_case(folder: Path, scene: str | None = None) -> str:
    opened = open_case(folder)
    return failure_page(opened.answer(), opened.source, opened.context, Subject.of_case(opened), scene)


def test_a_page_holds_verdict_numbers_and_commands(tmp_path: Path) -> None:
    folder = keep(tmp_path / "a case", ScoringDetector())
    now = open_case(folder).answer()
    page = page_of_case(folder)
    text = " ".join(parsed(page).text)
    assert now.diagnosis is not None
    assert now.trace is not None
    assert now.trace.ranking is not None
    assert now.diagnosis.verdict in text
    best = now.trace.ranking.pairs[0]
    for number in (best.p_target, best.p_relation, best.probability):
        assert f"{number:.2f}" in text
    assert f"spatialviz replay '{folder}'" in text
    assert "sv1:" in text


def test_a_page_fetches_nothing(tmp_path: Path) -> None:
    page = page_of_case(keep(tmp_path / "case"), scene="<p>scene</p>")
    for tag, attributes in parsed(page).tags:
        assert tag not in ("script", "link", "object", "embed", "base")
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith("data:")
    assert not re.search(r"https?://|@import|url\(", page)


def test_hostile_strings_are_escaped_everywhere(tmp_path: Path) -> None:
    frame = row()
    annotations = tuple(replace(a, label=HOSTILE) if a.label == "mug" else a for a in frame.annotations)
    frame = replace(frame, id=f"{HOSTILE}/0", annotations=annotations)

    class Hostile(NamedDataset):
        class_names = (HOSTILE, "laptop", "book", "table")
        frame_ids = (frame.id,)

    used = replace(made(AnnotationDetector(Hostile.class_names)), dataset=Hostile())  # pyright: ignore
    context = PreparedFrame(frame)
    now = answer(used, context, TEXT, truth=annotated_truth(context, used))
    assert any(o.label == HOSTILE for o in now.objects)
    subject = Subject(HOSTILE, frame.id, (HOSTILE,), HOSTILE, ((HOSTILE, HOSTILE),))
    scene = f"<p title='{HOSTILE}'>\"quoted\"</p>"
    found = parsed(failure_page(now, used, context, subject, scene))
    assert not [t for t, _ in found.tags if t == "script"]
    assert all((a["src"] or "").startswith("data:image/jpeg") for t, a in found.tags if t == "img")
    assert not [a for _, a in found.tags for name in a if name.startswith("on")]
    (framed,) = [a for t, a in found.tags if t == "iframe"]
    assert framed["srcdoc"] == scene
    assert framed["sandbox"] == "allow-scripts"
    assert "<script>alert(1)</script>" in "".join(found.text)


def test_a_verdict_by_the_detectors_own_annotations_says_so() -> None:
    used = replace(made(AnnotationDetector(("mug", "laptop", "book", "table"))), dataset=NamedDataset())  # pyright: ignore
    context = context_of()
    now = answer(used, context, TEXT, truth=annotated_truth(context, used))
    subject = Subject.of_dataset("row", used, context, TEXT)
    said = PERFECT[:1].upper() + PERFECT[1:]
    assert said in failure_page(now, used, context, subject)
    # Another's masks, and a page without a verdict, have nothing of it.
    assert said not in failure_page(now, used, context, replace(subject, shares=()))
    assert said not in failure_page(answer(used, context, TEXT), used, context, subject)


def test_a_page_without_truth_or_without_an_answer() -> None:
    used, context = made(), context_of()
    subject = Subject("row", "scene/0", ())
    for text in (TEXT, "lamp left of the laptop", "mug abov the laptop"):
        page = failure_page(answer(used, context, text), used, context, subject)
        assert "NO VERDICT" in page
        assert page.rstrip().endswith("</html>")


def test_a_page_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_page("<p>\udc80</p>", tmp_path / "new" / "page.html")
    assert (tmp_path / "new" / "page.html").read_text() == "<p>?</p>"
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        write_page("x", tmp_path / "file" / "page.html")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "new"]
