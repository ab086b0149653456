"""The scene's frame: the page's ground while it loads, how much of it is there, and a browser that cannot draw it."""

import io

import numpy as np
from browser import OpenTab, Tab
from PIL import Image
from playwright.sync_api import Route
from servers import Server

NO_WEBGL = """const given = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith('webgl') ? null : given.call(this, kind, ...more);
};"""
LOSE = """() => {
  const all = [...document.getElementById('view').contentDocument.querySelectorAll('canvas')];
  all.find(c => c.dataset.engine).getContext('webgl2').getExtension('WEBGL_lose_context').loseContext();
}"""


def ground(tab: Tab) -> float:
    """How light most of the scene is, beside names and lines."""
    box = tab.see("#scene").bounding_box()
    assert box is not None
    clip = {"x": box["x"] + 40, "y": box["y"] + 80, "width": box["width"] - 80, "height": box["height"] / 3}
    return float(np.median(np.asarray(Image.open(io.BytesIO(tab.page.screenshot(clip=clip))))))  # pyright: ignore[reportArgumentType]


def test_the_ground_is_the_pages_from_the_first_byte(demo: Server, open_tab: OpenTab) -> None:
    """Before viser's client is there, and once its own page is; with words that say how much is."""
    tab = open_tab()
    held: list[Route] = []
    tab.page.route("**/scene/*/", lambda route: held.append(route))
    tab.open(demo.address)
    assert tab.see("#loading").inner_text().startswith("0 of ")
    while not held:
        tab.page.wait_for_timeout(40)
    assert ground(tab) < 40
    held[0].continue_()
    looks = []
    while tab.page.locator("#loading:visible").count():
        looks.append(ground(tab))
    assert max(looks) < 40, looks
    tab.drawn()
    frame = "getComputedStyle(document.getElementById('view').contentDocument.querySelector('canvas').parentElement)"
    assert tab.page.evaluate(f"{frame}.backgroundColor") == "rgba(0, 0, 0, 0)"


def test_without_webgl_the_picture_takes_the_place(demo: Server, open_tab: OpenTab) -> None:
    """One line says what to do, and all else works."""
    tab = open_tab()
    tab.page.add_init_script(NO_WEBGL)
    tab.open(demo.address)
    tab.see("#sceneless", "hardware acceleration")
    scene, picture = (tab.see(name).bounding_box() for name in ("#scene", "#picture"))
    assert scene is not None
    assert picture is not None
    assert scene["height"] < 80, scene
    assert picture["height"] > 400, picture
    tab.ask("laptop right of the mug")
    tab.see("#answer .names", "right of")


def test_a_scene_that_is_lost_is_drawn_again(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address).drawn()
    tab.page.evaluate(LOSE)
    tab.see("#sceneless", "has lost the 3D scene")
    tab.see("#sceneless button").click()
    tab.poll("document.getElementById('sceneless').hidden")
    tab.drawn()
    tab.poll("document.getElementById('loading').hidden")
