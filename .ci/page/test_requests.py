"""Who gets in: foreign names, pages and frames are refused, and without the token nothing is told."""

import http.server
import re
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager

from accessibility import axe
from browser import OpenTab
from servers import Server
from websockets import Origin, Subprotocol
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

ID = "0123456789abcdef" * 2
CROSS = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "image"}


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
            address.replace("http", "ws", 1) + path,
            origin=Origin(origin or address),
            subprotocols=protocols,
            additional_headers=more,
            open_timeout=10,
            max_size=None,
        ):
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


def test_foreign_names_and_pages(demo: Server) -> None:
    """Refused on the page and on both sockets, each by its own check."""
    address, evil = demo.address, "http://evil.example"
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


def test_a_foreign_page_cannot_frame_it(demo: Server, open_tab: OpenTab) -> None:
    with foreign_page(f"<iframe src='{demo.address}/'></iframe>") as foreign:
        tab = open_tab()
        tab.page.goto(foreign)
        tab.page.wait_for_timeout(1500)  # long enough for the page to appear where it is not refused
        framed = [frame for frame in tab.page.frames[1:] if frame.url.startswith(demo.address)]
        assert not any(frame.locator("#bar").count() for frame in framed), "a foreign page frames ours"
        # That it is refused is what the browser complains about.
        tab.problems.clear()


def test_without_the_token_nothing_is_told(guarded: Server, open_tab: OpenTab) -> None:
    """Where other machines reach it; the token does not stay in the address."""
    address, paths = guarded.address, ("/", f"/scene/{ID}/", "/app/core.mjs", f"/app/image/{ID}.jpg")
    assert guarded.process.stdout is not None
    said = b"".join(guarded.process.stdout.readline() for _ in range(2)).decode()
    token = re.findall(r"token=([\w-]+)", said)[0]
    assert {path: status(address + path) for path in paths} == dict.fromkeys(paths, 401)
    sockets = (f"/app/socket?id={ID}", f"/scene/{ID}/")
    assert {p: socket_status(address, p) for p in sockets} == dict.fromkeys(sockets, 401)
    assert status(f"{address}/?token=wrong") == 401
    tab = open_tab(f"{address}/?token={token}")
    assert token not in tab.page.url
    (cookie,) = tab.page.context.cookies()
    assert (cookie["value"], cookie["httpOnly"], cookie["sameSite"]) == (token, True, "Lax"), cookie
    tab.poll("location.search.includes('frame=')")
    assert token not in tab.page.content() + tab.page.url
    assert socket_status(address, sockets[0], cookie=f"spatialviz={token}") == 101
    other = open_tab()
    answer = other.page.goto(tab.page.url)
    assert answer is not None
    assert answer.status == 401, "a copied address lets others in"
    other.problems.clear()


def test_who_has_no_token_gets_a_page_that_says_so(guarded: Server, open_tab: OpenTab) -> None:
    """To everybody: axe-core finds nothing on it."""
    tab = open_tab(bypass_csp=True)
    answer = tab.page.goto(guarded.address)
    assert answer is not None
    assert answer.status == 401
    assert tab.page.locator("h1").inner_text() == "No access"
    found = axe(tab)
    assert not found, found
    tab.problems.clear()
