"""Who may ask the server of the page: foreign names, foreign pages and missing tokens are refused."""

import asyncio
import http
from pathlib import Path
from typing import Any

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from pipeline.system.errors import InputError
from spatialviz.app.access import Access
from spatialviz.app.site import Site
from spatialviz.app.view_strings import needs_file

TOKEN = "a-token-of-24-characters"


def request(path: str = "/", **headers: str) -> Request:
    return Request(path, Headers({"Host": "127.0.0.1:8080"} | {k.replace("_", "-"): v for k, v in headers.items()}))


def status(access: Access, asked: Request) -> int:
    refused = access.refusal(asked)
    return http.HTTPStatus.OK if refused is None else refused.status_code


@pytest.mark.parametrize(
    ("headers", "wanted"),
    [
        ({}, 200),
        ({"Host": "localhost:8080"}, 200),
        ({"Origin": "http://127.0.0.1:8080"}, 200),
        ({"Host": "evil.example"}, 421),
        ({"Host": "127.0.0.1.evil.example:8080"}, 421),
        ({"Host": ""}, 421),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "http://127.0.0.1:9090"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "localhost", "Origin": "capacitor://localhost"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "image"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}, 200),
    ],
)
def test_names_and_pages(headers: dict[str, str], wanted: int) -> None:
    assert status(Access("127.0.0.1"), request(**headers)) == wanted


@pytest.mark.parametrize(
    ("host", "wanted"),
    [("192.168.1.7:8080", 200), ("lab-pc:8080", 200), ("lab-pc.local", 200), ("evil.example:80", 421)],
)
def test_names_of_a_machine_that_others_reach(host: str, wanted: int) -> None:
    assert status(Access("0.0.0.0"), request(Host=host)) == wanted


def test_a_token_comes_once_by_the_address_and_then_by_the_cookie() -> None:
    access = Access("0.0.0.0", {TOKEN: "ana"})
    assert status(access, request()) == 401
    assert status(access, request(f"/?token={TOKEN[:-1]}")) == 401
    assert status(access, request(Cookie=f"spatialviz={TOKEN[:-1]}x")) == 401
    first = request(f"/?ask=mug&token={TOKEN}")
    assert status(access, first) == 200
    entered = access.entered(first)
    assert entered is not None
    assert entered.headers["Location"] == "./?ask=mug"
    cookie = entered.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Lax" in cookie
    known = request(Cookie=f"other=1; {cookie.partition(';')[0]}")
    assert status(access, known) == 200
    assert access.name(known) == "ana"


def test_an_address_with_a_token_leads_to_itself_without_it() -> None:
    entered = Access("127.0.0.1").entered(request(f"////evil.example/?token={TOKEN}"))
    assert entered is not None
    assert entered.headers["Location"] == "./"
    assert "Set-Cookie" not in entered.headers


def test_malformed_requests_are_refused_and_cookies_may_come_apart() -> None:
    access = Access("0.0.0.0", {TOKEN: "ana"})
    assert status(access, request("//[::/", Cookie=f"spatialviz={TOKEN}")) == 400
    asked = request(Cookie="other=1")
    asked.headers["Cookie"] = f"spatialviz={TOKEN}"
    assert status(access, asked) == 200
    asked.headers["Sec-Fetch-Site"] = "none"
    asked.headers["Sec-Fetch-Site"] = "cross-site"
    assert status(access, asked) == 400


def test_others_need_a_token_and_this_machine_does_not() -> None:
    assert Access.of("127.0.0.1").open
    assert len(Access.of("0.0.0.0").unnamed) >= 24


@pytest.mark.parametrize(
    "text", ["", "ana", "ana short", f"ana {TOKEN}\nbob {TOKEN}", f"ana {TOKEN} x", "ana ümlautümlautümlaut"]
)
def test_files_of_tokens_that_are_none(text: str, tmp_path: Path) -> None:
    file = tmp_path / "tokens"
    file.write_text(text, "utf-8")
    with pytest.raises(InputError):
        Access.of("0.0.0.0", file)


FILE = "network.onnx"


@pytest.mark.parametrize("there", [True, False])
def test_where_a_token_is_needed_no_file_is_a_network(there: bool, tmp_path: Path) -> None:
    path = str(tmp_path / FILE)
    if there:
        (tmp_path / FILE).write_bytes(b"no network")
    with pytest.raises(InputError) as refused:
        needs_file(path, None, alone=False)
    assert str(refused.value).replace(path, "") == (
        "the view scores relations with a network that is not installed here; got ; expected rule, trained, or an "
        "installed one (where a token is needed no other file is loaded)"
    )
    assert needs_file(path, None, alone=True), "who is alone is asked"


def test_named_networks_and_that_of_the_owner_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_NETWORKS", str(tmp_path))
    (tmp_path / "mine.onnx").write_bytes(b"")
    for alone in (True, False):
        assert not any(needs_file(name, None, alone) for name in (None, "rule", "trained", "mine"))
    assert not needs_file("/some/network.onnx", "/some/network.onnx", alone=False)
    for name in ("other", "mine.onnx", "../mine", "/some/else.onnx"):
        with pytest.raises(InputError):
            needs_file(name, "/some/network.onnx", alone=False)


def test_every_document_has_a_policy() -> None:
    class NoPages:
        def __getattr__(self, name: str) -> object:
            return lambda *_: False

    site: Any = Site(Access("127.0.0.1"), NoPages(), None)  # pyright: ignore[reportArgumentType]
    for path in ("/", "/app/index.html", f"/scene/{'0' * 32}/"):
        answer = asyncio.run(site.answer(None, request(path)))
        if answer.headers["Content-Type"].startswith("text/html"):
            assert "default-src 'none'" in answer.headers.get("Content-Security-Policy", ""), path
    assert asyncio.run(site.answer(None, request("/"))).status_code == http.HTTPStatus.OK
