"""The scene's frame: the page's ground while it loads, how much of it is there, and a browser that cannot draw it."""

import io
import json
from typing import Any
from urllib.parse import urlencode

import numpy as np
from browser import OpenTab, Tab
from PIL import Image
from playwright.sync_api import Route
from servers import Server

from pipeline import open_run
from pipeline.answering import LoadedFrame, open_pipeline
from pipeline.datasets.demo import demo_run
from pipeline.geometry import decode_run_length

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
    tab.see("#answer", "mug")


LIT = """(() => {
  const nodes = document.getElementById('view').contentWindow?.__viserMutable?.nodeRefFromName ?? {}, lit = {};
  for (const [name, node] of Object.entries(nodes)) {
    const points = name.startsWith('/cloud/') && node?.getObjectByProperty('isPoints', true);
    if (!points) continue;
    const {position, isLit} = points.geometry.attributes, dimming = points.material.uniforms.dimming?.value;
    lit.count = (lit.count ?? 0) + (isLit?.array.reduce((sum, one) => sum + one, 0) ?? NaN);
    lit.of = (lit.of ?? 0) + position.count;
    lit.dims = (lit.dims ?? true) && dimming?.[0] < 1;
  }
  return document.getElementById('loading').hidden && lit;
})()"""


def test_the_answers_points_keep_their_colors(demo: Server, open_tab: OpenTab) -> None:
    """All other points are dimmed, in the browser: exactly those that the server means, in each frame."""
    tab, calls = open_tab(), list[dict[str, Any]]()

    def heard(text: str | bytes) -> None:
        message = json.loads(text) if isinstance(text, str) else {}
        if message.get("name") == "lit":
            calls.append(message["data"])

    tab.page.on("websocket", lambda socket: socket.on("framereceived", heard) if "/app/" in socket.url else None)
    tab.open(demo.address).drawn()
    source, asked = open_pipeline("demo"), None
    for number in (0, 1):
        if number:
            asked = len(calls)
            tab.send(f"frame:{number}")
            tab.ask("a book left of a chair")
            tab.poll("document.querySelectorAll('.pair-card.of-answer .thing').length")
        context = source.prepare(number)
        cloud = LoadedFrame(context, ()).cloud
        seen = tab.still(LIT, 2)
        assert asked is None or len(calls) > asked
        mask = decode_run_length(calls[-1]["size"], calls[-1]["counts"])
        assert seen == {"count": int(mask[cloud.v, cloud.u].sum()), "of": len(cloud.u), "dims": True}
        assert seen["count"] > 500
    tab.ask("the unicorn left of the mug")
    tab.poll(f"(lit => lit && !lit.dims)({LIT})")
    tab.ask("a book left of a chair")
    tab.poll(f"(lit => lit.count === {seen['count']} && lit.dims)({LIT})")


def test_a_scene_that_is_lost_is_drawn_again(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address).drawn()
    before = tab.still(LIT, 1)
    tab.page.evaluate(LOSE)
    tab.see("#sceneless", "has lost the 3D scene")
    tab.see("#sceneless button").click()
    tab.poll("document.getElementById('sceneless').hidden")
    tab.drawn()
    tab.poll("document.getElementById('loading').hidden")
    assert tab.still(LIT, 1) == before


TAGS = """(async () => {
  const {shownTags} = await import('/app/tags.mjs');
  const gap = ([a, b, c, d], [x, y, X, Y]) => Math.hypot(Math.max(x - c, a - X, 0), Math.max(y - d, b - Y, 0));
  const {clientWidth: W, clientHeight: H} = document.getElementById('scene');
  return shownTags().map(({text, detail, strong, rect, box, apart}) => ({text, detail, strong, gap: gap(rect, box), box,
    apart, inside: rect[0] >= 0 && rect[1] >= 0 && rect[2] <= W && rect[3] <= H}));
})()"""


def test_names_stand_beside_their_boxes(demo: Server, open_tab: OpenTab) -> None:
    """With the glyph of a role and no score; of those without a role at most eight."""
    tab = open_tab(demo.address).drawn()
    tab.poll("document.querySelectorAll('#tags .tag:not(.hovering)').length > 2")
    picture, host = (tab.see(name).bounding_box() for name in ("#picture", "#scene"))
    assert picture is not None
    assert host is not None
    right, low = picture["x"] - host["x"], picture["y"] + picture["height"] - host["y"]
    named = tab.still(TAGS)
    assert not [tag for tag in named if tag["box"][2] > right + 4 and tag["box"][1] < low - 4], "under the picture"
    tab.send("flag:labels")
    tab.poll("document.querySelectorAll('#tags .weak:not(.hovering)').length > 8")
    tags = tab.still(TAGS)
    strong, weak = ([tag for tag in tags if tag["strong"] is kind] for kind in (True, False))
    assert {"T", "R"} <= set(tab.page.locator("#tags .tag b").all_inner_texts())
    assert len(strong) >= 2
    assert 0 < len(weak) <= 8
    assert not [tag for tag in tags if tag["gap"] > 48 or tag["apart"] > 48 or not tag["inside"]]
    assert not [tag for tag in tags if "·" in tag["text"] or "0." in tag["text"]]


def test_two_boxes_of_one_thing_have_one_name(demo: Server, open_tab: OpenTab) -> None:
    """The found box, which is to blame, and the labelled one."""
    row = open_run(demo_run()).failures("verdict:LIFT")[0].row
    query = urlencode({"data": "demo", "frame": row["frame"], "ask": row["text"]})
    tab = open_tab(f"{demo.address}/?{query}").drawn()
    tab.poll("[...document.querySelectorAll('#tags .tag i')].some(i => i.textContent === 'as found')")
    named = {(tag["text"], tag["detail"]) for tag in tab.still(TAGS)}
    twice = {text for text, detail in named if detail == "as found"}
    assert twice == {text for text, detail in named if detail == "as labelled"}


def marked(tab: Tab, number: int) -> None:
    """An object is marked everywhere."""
    tab.poll("n => import('/app/hover.mjs').then(m => m.markedObjects().join() === String(n))", number)
    tab.poll("document.querySelector('.hovered path')?.getAttribute('d') && document.querySelector('#marked rect')")
    assert tab.page.evaluate(
        "n => [...document.querySelectorAll(`[data-hover='hover:${n}']`)]"
        ".every(e => getComputedStyle(e).outlineStyle === 'solid')",
        number,
    )


def test_one_thing_is_marked_in_row_picture_and_scene(demo: Server, open_tab: OpenTab) -> None:
    """Whichever of them the pointer is over; and by the focus of a row."""
    tab = open_tab(demo.address).drawn()
    tab.poll("document.querySelector('#tags .tag')")
    row = tab.see("#stages [data-hover]")
    number = int(row.get_attribute("data-hover").split(":")[1])  # pyright: ignore[reportOptionalMemberAccess]
    row.hover()
    marked(tab, number)
    tab.page.mouse.move(2, 2)
    tab.poll("!document.querySelector('.hovered path')")
    # Its middle in the picture may show something in front of it: what is marked there is asked of the page.
    picture = tab.see("#image .pic").bounding_box()
    assert picture is not None
    find = "import('/app/hover.mjs').then(m => m.inPicture(0.5, 0.55).concat([-1])[0] + 1)"
    seen = tab.poll(find) - 1
    tab.page.mouse.move(picture["x"] + picture["width"] * 0.5, picture["y"] + picture["height"] * 0.55)
    marked(tab, seen)
    host = tab.see("#scene").bounding_box()
    assert host is not None
    target = next(tag for tag in tab.still(TAGS) if tag["strong"])
    x, y = (target["box"][k] / 2 + target["box"][k + 2] / 2 for k in (0, 1))
    tab.page.mouse.move(host["x"] + x, host["y"] + y)
    inside = tab.poll("at => import('/app/hover.mjs').then(m => m.inScene(...at).concat([-1])[0] + 1)", [x, y]) - 1
    marked(tab, inside)
    tab.page.mouse.move(2, 2)
    row.focus()
    marked(tab, number)
