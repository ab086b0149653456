"""Addresses outside this machine: which requests they let in, and which a notebook finds itself."""

from __future__ import annotations

import http.server
import json
import re
import sys
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from test_access import TOKEN, request, status

import spatialviz as sp
from pipeline.system.errors import InputError
from spatialviz.app.access import Access
from spatialviz.app.in_notebook import addresses_of_notebook
from spatialviz.app.outer_address import OuterAddress, outer_address

COOKIE = f"spatialviz={TOKEN}"
HUB, SPACE = "https://hub.example.org/user/ann/proxy/8080/", "https://x-8080.app.github.dev/"
ADDRESSES = [outer_address(text) for text in (HUB, SPACE, "http://lab.example.org:9000/sv")]
NAMELESS = [OuterAddress("", "/user/ann/proxy/8080/")]


@pytest.mark.parametrize(
    ("host", "origin", "wanted"),
    [
        ("hub.example.org", "", 200),
        ("hub.example.org:443", "", 200),
        ("HUB.example.org", "https://hub.example.org", 200),
        ("hub.example.org", "http://hub.example.org", 403),
        ("hub.example.org", "https://hub.example.org:8443", 403),
        ("hub.example.org", "https://hub.example.org.evil.com", 403),
        ("hub.example.org", "https://x-8080.app.github.dev", 403),
        ("hub.example.org", "http://127.0.0.1:8080", 403),
        ("hub.example.org", "null", 403),
        ("hub.example.org:80", "", 421),
        ("hub.example.org:8443", "", 421),
        ("hub.example.org.evil.com", "", 421),
        ("evil-hub.example.org", "", 421),
        ("lab.example.org:9000", "http://lab.example.org:9000", 200),
        ("lab.example.org", "http://lab.example.org", 421),
        # Codespaces, and nginx without a line for it, name this machine as the host.
        ("localhost:8080", "https://x-8080.app.github.dev", 200),
        ("localhost:8080", "http://localhost:8080", 200),
        ("localhost:8080", "https://y-8080.app.github.dev", 403),
        ("localhost:8080", "http://localhost:9090", 403),
    ],
)
def test_names_and_pages_outside(host: str, origin: str, wanted: int) -> None:
    headers = {"Host": host} | ({"Origin": origin} if origin else {})
    access = Access("127.0.0.1", {TOKEN: ""}, ADDRESSES)
    assert status(access, request(Cookie=COOKIE, **headers)) == wanted
    # What a request says of proxies is no evidence.
    forwarded = {
        "X_Forwarded_Host": "hub.example.org",
        "X_Forwarded_Proto": "https",
        "Forwarded": "host=hub.example.org",
    }
    assert status(access, request(Cookie=COOKIE, **headers, **forwarded)) == wanted
    assert status(access, request(**headers)) == {200: 401}.get(wanted, wanted)


@pytest.mark.parametrize(
    ("headers", "wanted"),
    [
        ({"Host": "hub.example.org", "Origin": "https://hub.example.org", "Cookie": COOKIE}, 200),
        ({"Host": "hub.example.org", "Cookie": COOKIE}, 200),
        ({"Host": "hub.example.org", "Origin": "https://evil.example", "Cookie": COOKIE}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 421),
        ({"Host": "127.0.0.1:8080"}, 401),
    ],
)
def test_where_the_name_is_not_known_it_comes_with_the_token(headers: dict[str, str], wanted: int) -> None:
    access = Access("127.0.0.1", {TOKEN: ""}, NAMELESS)
    assert status(access, request(**headers)) == wanted
    assert access.links("http://127.0.0.1:8080") == [f"http://127.0.0.1:8080/?token={TOKEN}"]


def test_an_outer_address_makes_a_token_and_its_cookie_secure() -> None:
    access = Access.of("127.0.0.1", outer=[outer_address("https://{{port}}.example.org")])
    access.listens(8081)
    assert access.links("http://127.0.0.1:8081")[1] == f"https://8081.example.org/?token={access.unnamed}"
    for host, secure in (("8081.example.org", True), ("127.0.0.1:8081", False)):
        entered = access.entered(request(f"/?token={access.unnamed}", Host=host))
        assert entered is not None
        assert entered.headers["Set-Cookie"].endswith("; Secure") == secure


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        ("/user/ann/proxy/8080/", "/"),
        ("/user/ann/proxy/8080/?ask=a/b", "/?ask=a/b"),
        ("/user/ann/proxy/8080/app/socket?id=1", "/app/socket?id=1"),
        ("/user/%61nn/proxy/8080/scene/1/", "/scene/1/"),
        ("/app/core.mjs", "/app/core.mjs"),
        ("/user/ann/proxy/80801/app/core.mjs", "/user/ann/proxy/80801/app/core.mjs"),
        ("/user/ann/proxy/8080/etc/passwd", "/user/ann/proxy/8080/etc/passwd"),
    ],
)
def test_a_path_that_the_proxy_keeps_is_taken_away(asked: str, wanted: str) -> None:
    assert Access("127.0.0.1", {}, [outer_address(HUB)]).inside(asked) == wanted


def test_paths_of_a_proxy_that_are_those_of_the_page() -> None:
    access = Access("127.0.0.1", {}, [outer_address("https://example.org/app/")])
    assert access.inside("/app/core.mjs") == "/app/core.mjs"
    assert access.inside("/app/app/core.mjs") == "/app/core.mjs"


@pytest.mark.parametrize(
    "text",
    [
        "hub.example.org",
        "/user/ann/",
        "ftp://a.example/",
        "https://",
        "https://ann:secret@a.example/",
        "https://a.example/?token=1",
        "https://a.example/#a",
        "https://a.example/a b/",
        "https://a.example/<b>/",
        "https://a.example:port/",
        "https://ä.example/",
        "https://a..example/",
        "https://a.example\n",
        "*",
    ],
)
def test_texts_that_are_no_outer_address(text: str) -> None:
    with pytest.raises(InputError, match="--outer-address is not an address"):
        outer_address(text)


@pytest.mark.parametrize(
    ("path", "headers", "named"),
    [
        ("/", {"Host": "hub.example.org"}, "https://hub.example.org/"),
        ("/user/ann/proxy/absolute/1/app/a.mjs", {"Host": "a.example"}, "https://a.example/user/ann/proxy/absolute/1/"),
        ("/", {"Host": "a.example", "Origin": "http://a.example"}, "http://a.example/"),
        ("/", {"Host": "a.example", "X-Forwarded-Prefix": "/user/ann/proxy/1"}, "https://a.example/user/ann/proxy/1/"),
        ("/app/socket?id=1", {"Origin": "https://x-1.app.github.dev"}, "https://x-1.app.github.dev/"),
        ("/", {"Host": "a.example'><script>alert(1)</script>"}, "https://HOST/PATH/"),
        ("/'<b>", {"Host": "a.example"}, "https://HOST/PATH/"),
        ("/", {"Origin": "null"}, "https://HOST/PATH/"),
    ],
)
def test_a_refusal_names_the_option_with_what_was_asked_for(path: str, headers: dict[str, str], named: str) -> None:
    refused = Access("127.0.0.1").refusal(request(path, **headers))
    assert refused is not None
    assert f"--outer-address {named}<" in bytes(refused.body).decode()


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    """A process that takes itself for the kernel of a notebook, with nothing around it."""
    shell = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=None))
    monkeypatch.setitem(sys.modules, "IPython", shell)
    paths = SimpleNamespace(jupyter_runtime_dir=lambda: str(tmp_path))
    monkeypatch.setitem(sys.modules, "jupyter_core", SimpleNamespace(paths=paths))
    monkeypatch.setitem(sys.modules, "jupyter_core.paths", paths)
    for name in (
        "CODESPACE_NAME",
        "GITHUB_CODESPACES_PORT_FORWARDING_DOMAIN",
        "JPY_PARENT_PID",
        "JUPYTERHUB_PUBLIC_URL",
        "JUPYTERHUB_SERVICE_PREFIX",
        "VSCODE_PROXY_URI",
    ):
        monkeypatch.delenv(name, raising=False)
    return monkeypatch


@pytest.fixture
def jupyter(kernel: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[int]]:
    """The server of the kernel's notebook, with the status that it gives to whoever is not logged in."""
    given = [302]

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(given[0] if self.path == "/user/ann/proxy/1" else 500)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        told = {"url": f"http://127.0.0.1:{server.server_port}/user/ann/", "base_url": "/user/ann/"}
        (tmp_path / "jpserver-7.json").write_text(json.dumps(told))
        kernel.setenv("JPY_PARENT_PID", "7")
        yield given
        server.shutdown()


def test_outside_notebooks_nothing_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VSCODE_PROXY_URI", "https://code.example.org/proxy/{{port}}/")
    assert addresses_of_notebook() == ((), False)


def test_a_notebook_on_this_machine_alone_finds_nothing(kernel: pytest.MonkeyPatch) -> None:
    assert addresses_of_notebook() == ((), False)
    kernel.setenv("VSCODE_PROXY_URI", "./proxy/{{port}}")
    assert addresses_of_notebook() == ((), False)


def test_jupyter_shows_the_page_where_it_has_a_proxy(jupyter: list[int], kernel: pytest.MonkeyPatch) -> None:
    assert addresses_of_notebook() == ((OuterAddress("", "/user/ann/proxy/{port}/"),), True)
    kernel.setenv("JUPYTERHUB_PUBLIC_URL", "https://hub.example.org/user/ann/")
    assert addresses_of_notebook() == ((OuterAddress("https://hub.example.org", "/user/ann/proxy/{port}/"),), True)
    jupyter[0] = 404
    assert addresses_of_notebook() == ((), False)


def test_a_kernel_of_a_hub_away_from_its_server(kernel: pytest.MonkeyPatch) -> None:
    kernel.setenv("JUPYTERHUB_SERVICE_PREFIX", "/user/ann/")
    assert addresses_of_notebook() == ((OuterAddress("", "/user/ann/proxy/{port}/"),), True)


def test_visual_studio_code_and_codespaces(kernel: pytest.MonkeyPatch) -> None:
    kernel.setenv("VSCODE_PROXY_URI", "https://code.example.org/proxy/{{port}}/")
    kernel.setenv("CODESPACE_NAME", "x")
    kernel.setenv("GITHUB_CODESPACES_PORT_FORWARDING_DOMAIN", "app.github.dev")
    found, framed = addresses_of_notebook()
    wanted = ["https://code.example.org/proxy/8080/", "https://x-8080.app.github.dev/"]
    assert ([str(address.at(8080)) for address in found], framed) == (wanted, False)


def test_show_in_jupyter_puts_the_page_below_the_cell(jupyter: list[int], kernel: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    kernel.setitem(sys.modules, "IPython.display", SimpleNamespace(HTML=str, display=shown.append))
    server = sp.show("demo", port=0, block=False)
    assert server is not None
    (path, token), *others = re.findall(r'"(/user/ann/proxy/\d+/)\?token=([\w-]+)"', "".join(shown))
    assert path == f"/user/ann/proxy/{server.get_port()}/"
    assert others == [(path, token)]
    # As Jupyter's proxy asks: by the name that the browser knows, without its own path.
    headers = {"Host": "hub.example.org", "Cookie": f"spatialviz={token}"}
    asked = urllib.request.Request(f"http://127.0.0.1:{server.get_port()}/", headers=headers)
    with urllib.request.urlopen(asked, timeout=10) as page:
        assert b"app/page.mjs" in page.read()
    server.stop()
