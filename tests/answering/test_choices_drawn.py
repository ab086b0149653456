"""Every kind of choice in a scene drawn in `drawn_scenes.py`, and the page of documentation made from the same."""

from __future__ import annotations

from pathlib import Path

import pytest
from drawn_scenes import SCENES, Asked, Scene, page

from pipeline.answering import best_pair, why_no_answer
from pipeline.answering.ask import ask
from pipeline.geometry import Frame
from pipeline.proposals import AnnotationDetector

PAGE = Path(__file__).parents[2] / "docs" / "choices.md"
TURNED = {"right": ("left", True), "small": ("big", True), "top": ("high", False)}
CASES = [pytest.param(s, a, id=a.text) for s in SCENES for a in s.asked]


@pytest.fixture(scope="module")
def frames() -> dict[str, Frame]:
    return {scene.title: scene.frame() for scene in SCENES}


@pytest.mark.parametrize(("scene", "asked"), CASES)
def test_the_sentence_means_the_thing_in_the_drawing(frames: dict[str, Frame], scene: Scene, asked: Asked) -> None:
    names = tuple(dict.fromkeys(t.name for t in scene.things.values()))
    trace = ask(frames[scene.title], asked.text, AnnotationDetector(names))
    best = best_pair(trace)
    assert best is not None, why_no_answer(trace)
    assert list(scene.things)[trace.objects[best.target].id] == asked.means
    assert best.holds
    assert not trace.query.unused


@pytest.mark.parametrize(("scene", "asked"), [c for c in CASES if c.values[1].otherwise])  # type: ignore[union-attr]
def test_the_other_way_to_judge_it_means_another_thing(frames: dict[str, Frame], scene: Scene, asked: Asked) -> None:
    """The drawing tells the two apart: the order by the other measure has the other thing at the same place."""
    names = tuple(dict.fromkeys(t.name for t in scene.things.values()))
    query = ask(frames[scene.title], asked.text, AnnotationDetector(names)).query.default.root
    order, rank = query.choices[0].order, query.choices[0].rank or 1
    key, turned = TURNED.get(order, (order, False))
    for judged in ("3D", "picture"):
        kind = scene.things[asked.means].name
        letters = [k for k in scene.order(key, judged) if scene.things[k].name == kind]
        letters = letters[::-1] if turned else letters
        assert letters[rank - 1] == (asked.means if judged == asked.judged else asked.otherwise)


def test_the_page_is_made_from_the_same_scenes() -> None:
    assert PAGE.read_text(encoding="utf-8") == page()
