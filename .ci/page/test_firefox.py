"""The page in Firefox: scene, keys and labels as in Chromium; all but the scene where there is no WebGL."""

import base64
import json
import os
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from firefox import FIREFOX, SCREEN, Tab, firefox
from servers import Server

REQUIRED = os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (FIREFOX and SCREEN) and not REQUIRED,
        reason="no firefox-esr or no Xvfb here: `bash .ci/check firefox` installs both",
    ),
]
POINTS = """(() => {
  const nodes = document.getElementById('view').contentWindow?.__viserMutable?.nodeRefFromName;
  return !!nodes && Object.keys(nodes).some(name => name.startsWith('/cloud/') && nodes[name])
    && document.getElementById('loading').hidden;
})()"""
QUESTION = "document.getElementById('ask-text').value"
ANSWER = "document.getElementById('answer').innerText"
BOX = "(b => [b.x, b.y, b.right, b.bottom])(document.querySelector('%s').getBoundingClientRect())"


@pytest.fixture(scope="module")
def tab(reviewed: Server) -> Iterator[Tab]:
    """The first page of the demo in Firefox. At the end nothing may have gone wrong in it."""
    with firefox() as found:
        found.open(reviewed.address).poll(ANSWER)
        yield found
        assert not found.problems, found.problems


def shades(tab: Tab, selector: str) -> int:
    """How many colours an element of the page shows, of 512."""
    data = np.frombuffer(base64.b64decode(tab.picture()), np.uint8)
    x0, y0, x1, y1 = (int(v) for v in tab.evaluate(BOX % selector))
    image = cv2.imdecode(data, cv2.IMREAD_COLOR)[y0:y1, x0:x1]
    return len(np.unique(image.reshape(-1, 3) // 32, axis=0))


def ask(tab: Tab, question: str) -> None:
    tab.evaluate("document.getElementById('ask-text').select()")
    tab.press(*question, "Enter")
    tab.poll(f"{QUESTION} === {json.dumps(question)} && document.activeElement.id !== 'ask-text'")


def test_the_scene_is_drawn(tab: Tab) -> None:
    tab.poll(POINTS)
    assert shades(tab, "#scene") > 40


def test_it_is_asked_and_answered(tab: Tab) -> None:
    was = tab.evaluate(ANSWER)
    ask(tab, "laptop right of the mug")
    assert "laptop" in tab.poll(f"{ANSWER} !== {json.dumps(was)} && {ANSWER}")


def test_keys_lead_to_the_next_failure(tab: Tab) -> None:
    for _ in range(2):
        was = tab.evaluate(QUESTION)
        tab.press(".")
        tab.poll(f"{QUESTION} !== {json.dumps(was)}")
    tab.press("h")
    tab.poll("!!document.getElementById('dialog-window')")
    tab.press("Escape")
    tab.poll("!document.getElementById('dialog-window')")


def test_a_label_is_decided(tab: Tab) -> None:
    tab.click("[data-do='task:label']")
    tab.poll("!!document.querySelector('#review-list .queue .q')", 120)
    tab.press("j")
    item = "document.getElementById('review-item').innerText"
    was = tab.poll(item)
    tab.press("u")
    tab.poll(f"{item} !== {json.dumps(was)}")


def test_without_webgl_the_picture_takes_the_place_of_the_scene(demo: Server) -> None:
    with firefox(webgl_disabled=True) as tab:
        tab.open(demo.address).poll(ANSWER)
        said = tab.poll(
            "document.getElementById('sceneless').checkVisibility() && document.getElementById('sceneless').innerText"
        )
        assert "WebGL" in said
        assert "hardware acceleration" in said
        (x0, y0, x1, y1), (left, top, right, bottom) = (tab.evaluate(BOX % e) for e in ("#image", "#stage"))
        assert (x1 - x0) * (y1 - y0) > 0.5 * (right - left) * (bottom - top)
        tab.poll("[...document.querySelectorAll('#image img')].every(i => i.complete)")
        assert shades(tab, "#image") > 40
        ask(tab, "laptop right of the mug")
        assert not tab.problems, tab.problems
