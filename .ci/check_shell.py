"""The shell of the page: who gets in, what the address keeps, a server that is lost, keys alone, what is cut."""

import http.server
import json
import re
import shutil
import sys
import tempfile
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import parse_qs, quote, urlsplit

from browser import Server, Tab, Timed, chromium, new_tab
from looks import check_looks
from playwright.sync_api import Browser
from websockets import Origin, Subprotocol
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from pipeline.diagnosis.whatif.state import ViewState, decode, encode

ID = "0123456789abcdef" * 2
INJECTED = "<img src=x onerror=document.title='hit'>"
CROSS = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "image"}


# ---- who gets in


def status(address: str, **headers: str) -> int:
    request = urllib.request.Request(address, headers={k.replace("_", "-"): v for k, v in headers.items()})
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status
    except urllib.error.HTTPError as refused:
        return refused.code


def socket_status(address: str, path: str, origin: str = "", cookie: str = "") -> int:
    more = {"Cookie": cookie} if cookie else None
    # The page's socket knows no subprotocol, viser's has its own.
    protocols = [Subprotocol("viser-v1.1.1")] if path.startswith("/scene/") else None
    try:
        with connect(
            address.replace("http", "ws", 1) + path, origin=Origin(origin or address), subprotocols=protocols,
            additional_headers=more, open_timeout=10, max_size=None,
        ):  # fmt: skip
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


@contextmanager
def foreign_page(content: str) -> Iterator[str]:
    """The address of a page of another origin."""

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(content.encode())

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_port}"
        server.shutdown()


def check_foreign(browser: Browser, server: Server) -> None:
    """Foreign names, pages and frames are refused, on the page and on both sockets; each by its own check."""
    address, evil = server.address, "http://evil.example"
    sockets = (f"/app/socket?id={ID}", f"/scene/{ID}/")
    paths = ("/", "/app/core.mjs", f"/scene/{ID}/", "/app/image/x.jpg")
    assert {path: status(address + path, Host="evil.example") for path in paths} == dict.fromkeys(paths, 421)
    assert {path: status(address + path, Origin=evil) for path in paths} == dict.fromkeys(paths, 403)
    assert {path: status(address + path, **CROSS) for path in paths} == dict.fromkeys(paths, 403)
    assert {path: socket_status(address, path, evil) for path in sockets} == dict.fromkeys(sockets, 403)
    # A scene is shown to the page that is open alone.
    assert [socket_status(address, path) for path in sockets] == [101, 404]
    for path in ("/", f"/scene/{ID}/"):
        with urllib.request.urlopen(address + path) as answer:
            assert "frame-ancestors 'self'" in answer.headers["Content-Security-Policy"]
            assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    with foreign_page(f"<iframe src='{address}/'></iframe>") as foreign:
        tab = new_tab(browser)
        tab.page.goto(foreign)
        tab.page.wait_for_timeout(1500)
        framed = [frame for frame in tab.page.frames[1:] if frame.url.startswith(address)]
        assert not any(frame.locator("#bar").count() for frame in framed), "a foreign page frames ours"
        tab.page.close()


def check_tokens(browser: Browser) -> None:
    """Where other machines reach it, nothing is told without the token; the token does not stay in the address."""
    with Server("demo", "--host", "0.0.0.0") as server:
        address, paths = server.address, ("/", f"/scene/{ID}/", "/app/core.mjs", f"/app/image/{ID}.jpg")
        assert server.process.stdout is not None
        said = b"".join(server.process.stdout.readline() for _ in range(2)).decode()
        token = re.findall(r"token=([\w-]+)", said)[0]
        assert {path: status(address + path) for path in paths} == dict.fromkeys(paths, 401)
        sockets = (f"/app/socket?id={ID}", f"/scene/{ID}/")
        assert {p: socket_status(address, p) for p in sockets} == dict.fromkeys(sockets, 401)
        assert status(f"{address}/?token=wrong") == 401
        tab = new_tab(browser).open(f"{address}/?token={token}")
        assert token not in tab.page.url
        (cookie,) = tab.page.context.cookies()
        assert (cookie["value"], cookie["httpOnly"], cookie["sameSite"]) == (token, True, "Lax"), cookie
        tab.poll("location.search.includes('frame=')")
        assert token not in tab.page.content() + tab.page.url
        assert socket_status(address, sockets[0], cookie=f"spatialviz={token}") == 101
        other = new_tab(browser)
        answer = other.page.goto(tab.page.url)
        assert answer is not None
        assert answer.status == 401, "a copied address lets others in"
        assert not tab.problems, tab.problems
        tab.page.close()
        other.page.close()


def check_injected(tab: Tab) -> None:
    """Markup in a question and in a class name is text, and an address opens nothing that is not open already."""
    tab.ask(INJECTED)
    tab.see("#side", "cannot be read")
    tab.poll("text => document.getElementById('log').textContent.includes(text)", INJECTED)
    assert not tab.page.locator("[onerror]").count()
    before = tab.frame
    root = urlsplit(tab.page.url)._replace(query="").geturl()
    for query in (
        f"data={quote('/etc')}&frame=0",
        f"data={quote(INJECTED)}",
        "run=/etc&scorer=/etc/passwd",
        "mode=exec&stage=rm&item=1,x&camera=nan",
    ):
        tab.open(f"{root}?{query}")
        assert tab.frame == before, (query, tab.frame)
        assert "etc" not in tab.page.url
        assert not tab.page.locator("[onerror], #dialog-window").count()
    assert tab.page.title() != "hit"


def pasted(tab: Tab, view: ViewState) -> None:
    """Have the page open a view from its string."""
    tab.press("Shift+V")
    tab.see("#dialog-window textarea").fill(encode(view))
    tab.see("#dialog-window .go", "Open").click()


def check_opened(tab: Tab) -> None:
    """What a view string names is opened after a yes alone: no other dataset, no run, no network file."""
    tab.press("Shift+C")
    view = decode(tab.see("#dialog-window textarea").input_value())
    tab.page.keyboard.press("Escape")
    tab.poll("!document.getElementById('dialog-window')")
    before = tab.page.url
    pasted(tab, replace(view, dataset="/etc"))
    tab.see("#dialog-problem", "a dataset that is not open here")
    tab.page.keyboard.press("Escape")
    tab.poll("!document.getElementById('dialog-window')")
    assert tab.page.url == before
    pasted(tab, replace(view, run="/nowhere/other"))
    tab.poll("document.getElementById('log').textContent.includes('/nowhere/other, which is not open here')")
    network = "/nowhere/network.onnx"
    told = "name => ['log', 'toasts'].some(id => document.getElementById(id).textContent.includes(name))"
    for answer in ("Without it", "Load it"):
        pasted(tab, replace(view, edits=view.edits.with_scorer(network)))
        tab.see("#dialog-window pre", network)
        # Nobody has looked for the file yet: that there is none is not known.
        assert not tab.page.evaluate(told, network)
        tab.see("#dialog-window button", answer).click()
        tab.poll("answer => !document.getElementById('dialog-window') || answer === 'Load it'", answer)
    tab.poll(told, network)
    tab.page.keyboard.press("Escape")


def check_hostile(browser: Browser) -> None:
    """Markup in the names of a dataset, of its folder and of a class is text wherever it stands."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / INJECTED
        shutil.copytree(
            Path(__file__).parents[1] / "assets" / "demo", root, ignore=shutil.ignore_patterns("00000[234]")
        )
        models = root / "models" / "models_info.json"
        models.write_text(models.read_text("utf-8").replace('"mug"', json.dumps(INJECTED)), "utf-8")
        (root / "spatialviz.toml").write_text(f'name = "{INJECTED}"\nworld_up = [0, 0, 1]\n', "utf-8")
        with Server(root) as server:
            tab = new_tab(browser).open(server.address).drawn()
            tab.see("#bar .dataset, #bar select", INJECTED)
            tab.see("#objects", INJECTED)
            tab.ask(f'"{INJECTED}" left of the laptop')
            tab.press("/")
            tab.page.keyboard.type("img")
            tab.page.wait_for_timeout(800)
            tab.page.keyboard.press("Escape")
            for name in ("Edit", "Log"):
                tab.drawer(name)
            assert not tab.page.locator("[onerror]").count()
            assert "hit" not in (tab.page.title(), *(frame.evaluate("document.title") for frame in tab.page.frames))
            assert not tab.problems, tab.problems
            tab.page.close()


# ---- the address


def looked_at(tab: Tab) -> dict[str, list[str]]:
    return parse_qs(urlsplit(tab.page.url).query)


def check_address(browser: Browser, tab: Tab) -> None:
    """Frame, question, mode, stage, filter and camera come back by reload, in a second tab, by Back and Forward."""
    tab.drawn()
    first = tab.frame
    tab.ask("laptop right of the mug")
    tab.see("#answer .names", "right of")
    tab.click("stage:SRM")
    tab.see("#head-srm[aria-expanded=true]")
    box = tab.see("#view").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.8
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.page.mouse.move(x + 60, y - 20, steps=6)
    tab.page.mouse.up()
    tab.poll("location.search.includes('stage=SRM') && location.search.includes('camera=')")
    tab.page.wait_for_timeout(1200)
    wanted = looked_at(tab)
    assert wanted["ask"] == ["laptop right of the mug"], wanted
    tab.page.reload()
    shows_the_same(tab, wanted)
    second = new_tab(browser).open(tab.page.url)
    shows_the_same(second, wanted)
    second.page.close()
    tab.press("n")
    tab.poll("first => document.querySelector('#where .frame-id').value !== first", first)
    tab.poll("first => !location.search.includes(first)", first)
    moved = tab.frame
    tab.click("task:evaluate")
    search = tab.see("#search input")
    search.fill("said:left")
    search.press("Enter")
    tab.poll("location.search.includes('find=said:left') && location.search.includes('mode=evaluate')")
    tab.page.reload()
    tab.words()
    assert tab.see("#search input").input_value() == "said:left"
    assert (looked_at(tab)["mode"], tab.frame) == (["evaluate"], moved)
    for _ in range(6):
        if tab.frame == first:
            break
        tab.page.go_back()
        tab.page.wait_for_timeout(1500)
    assert (tab.frame, tab.question) == (first, "laptop right of the mug"), (tab.frame, tab.question)
    tab.page.go_forward()
    tab.poll("moved => document.querySelector('#where .frame-id').value === moved", moved)


def check_item(browser: Browser, tab: Tab) -> None:
    """The labelled pair that is looked at is in the address, and comes back in a second tab."""
    tab.click("task:label")
    tab.see("#review-list .queue .q")
    tab.press("j")
    tab.see("#review-item .task-item")
    tab.poll("location.search.includes('item=') && location.search.includes('mode=label')")
    wanted = looked_at(tab)
    second = new_tab(browser).open(tab.page.url)
    second.poll("location.search.includes('item=') && location.search.includes('mode=label')")
    found = looked_at(second)
    assert {k: found[k] for k in ("frame", "item", "mode")} == {k: wanted[k] for k in ("frame", "item", "mode")}, found
    second.page.close()


def shows_the_same(tab: Tab, wanted: dict[str, list[str]]) -> None:
    tab.words().drawn()
    tab.see("#head-srm[aria-expanded=true]")
    tab.see("#answer .names", "right of")
    tab.page.wait_for_timeout(1200)
    found = looked_at(tab)
    cameras = [[float(n) for n in place.pop("camera")[0].split(",")] for place in (found, dict(wanted))]
    assert found == {k: v for k, v in wanted.items() if k != "camera"}, (found, wanted)
    assert max(abs(a - b) for a, b in zip(*cameras, strict=True)) < 0.02, cameras


# ---- a server that is lost


def check_lost(browser: Browser) -> None:
    """A server that ends is told of; one that comes back finds the page where it was."""
    first = Server("demo")
    first.served()
    tab = new_tab(browser).open(first.address)
    tab.press("n")
    tab.poll("location.search.includes('frame=000001/000001') || !location.search.includes('000000')")
    moved = tab.frame
    first.end()
    tab.see("#lost", "does not answer")
    with Server("demo", port=first.port) as second:
        tab.poll("!document.body.classList.contains('lost')")
        tab.see("#answer .panel")
        assert tab.frame == moved, (tab.frame, moved)
        tab.drawn()
        tab.press("p")
        tab.poll("moved => document.querySelector('#where .frame-id').value !== moved", moved)
        assert second.process.poll() is None
    tab.page.close()


# ---- keys alone


FOCUSED = """() => {
  const e = document.activeElement, s = getComputedStyle(e), b = e.getBoundingClientRect();
  return {tag: e.tagName, name: e.id || e.dataset.do || e.dataset.local || e.textContent.slice(0, 30),
    ring: parseFloat(s.outlineWidth) > 0 && s.outlineStyle !== 'none',
    area: e.closest('header, aside, #stage')?.id || '',
    seen: b.width > 0 && b.bottom > 0 && b.top < innerHeight};
}"""
REACHED = """() => [...document.querySelectorAll(
    'a[href], button, input, select, textarea, summary, [data-do], [data-local]')]
  .filter(e => e.checkVisibility({visibilityProperty: true}) && !e.disabled && e.tabIndex >= 0
    && e.getAttribute('role') !== 'option')
  .map(e => e.id || e.dataset.do || e.dataset.local || e.textContent.slice(0, 30))"""


def check_keys(tab: Tab) -> None:
    """Tab reaches every control: bar, side, stage, with a ring that is seen; Ask completes; Escape leaves."""
    tab.page.evaluate("document.activeElement.blur()")
    wanted, seen, areas = set(tab.page.evaluate(REACHED)), [], []
    for _ in range(len(wanted) + 200):
        tab.page.keyboard.press("Tab")
        now = tab.page.evaluate(FOCUSED)
        if now["tag"] == "BODY":
            break
        seen.append(now["name"])
        if now["tag"] == "IFRAME":
            continue
        assert now["ring"], f"no ring around {now}"
        assert now["seen"], f"not in view: {now}"
        areas += [now["area"]] if not areas or areas[-1] != now["area"] else []
        if wanted <= set(seen):
            break
    assert wanted <= set(seen), sorted(wanted - set(seen))
    assert areas[:3] == ["bar", "side", "stage"], areas
    tab.press("/")
    field = tab.page.locator("#ask-text")
    field.fill("")
    for text, offered in (("lap", "laptop"), ("rig", "right of"), ("the m", "mug")):
        tab.page.keyboard.type(text)
        tab.see("#suggested .offer", offered)
        tab.page.wait_for_timeout(500)
        for _ in range(10):
            tab.page.keyboard.press("ArrowDown")
            if tab.page.locator("#suggested [aria-selected=true] b").inner_text() == offered:
                break
        tab.page.keyboard.press("Enter")
        assert field.input_value().endswith(f"{offered} "), field.input_value()
    tab.page.keyboard.press("Enter")
    tab.see("#answer .names", "right of")
    tab.press("/")
    tab.page.keyboard.press("Escape")
    tab.poll("document.activeElement.tagName === 'BODY'")


def main() -> None:
    timed = Timed()
    with chromium() as browser:
        with Server() as server:
            timed(check_foreign, browser, server)
            tab = new_tab(browser).open(server.address)
            for check in (check_keys, check_injected, check_opened):
                timed(check, tab)
            tab.open(server.address)
            for check in (check_address, check_item):
                timed(check, browser, tab)
            assert not tab.problems, tab.problems
            tab.page.close()
            if "--looks" in sys.argv:
                timed(check_looks, browser, server.address)
        for check in (check_hostile, check_tokens, check_lost):
            timed(check, browser)
    print(timed)


if __name__ == "__main__":
    main()
