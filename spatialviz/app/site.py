"""HTTP server: the page at `/`, viser's client as its frame, and access control."""

from __future__ import annotations

import asyncio
import gzip
import http
import re
import secrets
from collections.abc import Awaitable, Callable, Mapping
from contextvars import ContextVar
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import SplitResult, parse_qs, parse_qsl, quote, urlencode, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from pipeline.system.errors import as_input_error, require
from spatialviz.app.frames import IMAGES
from spatialviz.app.viser_socket import scene_page

if TYPE_CHECKING:
    from spatialviz.app.frames import FramePictures

PAGE_ID: ContextVar[str] = ContextVar("page_id")
"""Page of viser's socket during the handling of its connection."""
ID = re.compile(r"[0-9a-f]{32}")
REFUSED_SECONDS, MOST_WAITING = 1.0, 100
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
SCENE_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src data:; connect-src 'self' data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
"""Content policy for viser's client: inline script and styles, blob workers."""
SCENE_STYLE = (
    "<style>#root :has(canvas) ~ :not(:has(canvas), canvas), .mantine-Notifications-root, body > [data-portal] "
    "{ display: none !important }</style>"
)
"""Hides viser's panels in favour of the page's own."""


class PageSessions(Protocol):
    """Sessions of the open pages, as used by a site; implemented by `pages.Pages`."""

    def has(self, page_id: str) -> bool:
        """True for an open page, or a session kept for a return."""
        ...

    def opens(self, page_id: str, connection: Any, request: Any) -> bool:
        """True if a socket of a page may be opened now."""
        ...

    def closed(self, page_id: str, connection: Any) -> None:
        """Handle a closed socket."""

    def download(self, page_id: str, key: str) -> tuple[str, bytes] | None:
        """File name and content of a page's download."""
        ...

    async def socket(self, page_id: str, connection: Any) -> None:
        """Serve the socket of a page."""

    async def scene(self, page_id: str, connection: Any, viser_handler: Callable[[Any], Awaitable[None]]) -> None:
        """Serve viser's socket of a page's scene."""

    def log(self, problem: str) -> None:
        """Print a problem with a request, rate-limited."""


class Site:
    """Answers every request of a server."""

    def __init__(self, access: Access, pages: PageSessions, pictures: FramePictures) -> None:
        self._access, self._pages, self._pictures = access, pages, pictures
        self._waiting = 0
        static = resources.files("spatialviz.app") / "static"
        self._files = {f.name: f.read_bytes() for f in static.iterdir() if Path(f.name).suffix in KINDS}
        self._scene = gzip.compress(scene_page().replace("</title>", "</title>" + SCENE_STYLE, 1).encode(), 6)

    async def answer(self, connection: Any, request: Request) -> Response | None:
        refused = self._access.refusal(request)
        if refused is not None:
            return refused
        parts = urlsplit(request.path)
        if request.headers.get("Upgrade", "").lower() == "websocket":
            page_id = self._page_of(parts)
            if not page_id:
                return response(http.HTTPStatus.NOT_FOUND, b"no such socket\n")
            return None if self._pages.opens(page_id, connection, request) else await self._later()
        entered = self._access.entered(request)
        if entered is not None:
            return entered
        if parts.path.startswith("/app/frame/"):
            picture = await self._pictures.get(parts.path)
            if picture is None:
                return response(http.HTTPStatus.NOT_FOUND, b"no such picture\n")
            return response(http.HTTPStatus.OK, picture, ".jpg", {"Cache-Control": "private, max-age=600"})
        return self._file(parts.path, parse_qs(parts.query))

    def _page_of(self, parts: SplitResult) -> str:
        """Page of a socket; "" for none."""
        if parts.path != "/app/socket":
            return _scene_of(parts.path) if self._pages.has(_scene_of(parts.path)) else ""
        page_id = parse_qs(parts.query).get("id", [""])[0]
        return page_id if ID.fullmatch(page_id) else ""

    async def _later(self) -> Response:
        """Delayed refusal: repeated attempts wait, while few are waiting."""
        if self._waiting < MOST_WAITING:
            self._waiting += 1
            try:
                await asyncio.sleep(REFUSED_SECONDS)
            finally:
                self._waiting -= 1
        return response(http.HTTPStatus.TOO_MANY_REQUESTS, b"too many sockets, or not the messages of a page\n")

    def _file(self, path: str, query: dict[str, list[str]]) -> Response:
        folder, _, name = path.rpartition("/")
        data, kind, more = None, Path(name).suffix, dict[str, str]()
        match folder:
            case "" if not name:
                data, kind = self._files["index.html"], ".html"
            case "/app":
                data = self._files.get(name)
            case "/app/image":
                data, more = IMAGES.get(name), {"Cache-Control": "private, max-age=86400, immutable"}
            case "/app/file":
                given, data = self._pages.download(query.get("id", [""])[0], name) or ("", None)
                kind, more = "", {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(given)}"}
            case _ if folder.startswith("/scene/") and not name and ID.fullmatch(_scene_of(folder)):
                data, kind = self._scene, ".html"
                more = {"Content-Security-Policy": SCENE_POLICY, "Content-Encoding": "gzip"}
        if data is None:
            return response(http.HTTPStatus.NOT_FOUND, b"not found\n")
        return response(http.HTTPStatus.OK, data, kind, more)

    async def socket(self, connection: Any, viser_handler: Callable[[Any], Awaitable[None]]) -> None:
        """Serve an open socket: the page's own, or viser's of its scene."""
        parts = urlsplit(connection.request.path)
        page_id = self._page_of(parts)
        try:
            if parts.path == "/app/socket":
                await self._pages.socket(page_id, connection)
            elif page_id:
                PAGE_ID.set(page_id)
                await self._pages.scene(page_id, connection, viser_handler)
        finally:
            self._pages.closed(page_id, connection)

    def log(self, problem: str) -> None:
        self._pages.log(problem)


def _scene_of(path: str) -> str:
    return path.removeprefix("/scene/").rstrip("/")


LOCAL_NAMES = ("127.0.0.1", "localhost", "[::1]")
COOKIE = "spatialviz"
EVERYWHERE = ("", "0.0.0.0", "::")
REFUSAL = (
    '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    '<meta name="color-scheme" content="dark light"><title>spatialviz: no access</title></head>'
    "<body><main><h1>No access</h1><p>{}</p></main></body></html>\n"
)
KINDS = {
    ".html": "text/html",
    ".mjs": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".jpg": "image/jpeg",
    ".png": "image/png",
}
SAFE = {
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
}


class Access:
    """Checks requests; with tokens (names by token), each needs a token, in a cookie or once in the address."""

    def __init__(self, host: str, tokens: Mapping[str, str] | None = None) -> None:
        self._tokens = dict(tokens or {})
        self._host = host

    @classmethod
    def of(cls, host: str, file: Path | None = None) -> Access:
        """Access by address: free on this machine, else tokens of a file (InputError if invalid), or a new token."""
        if file is not None:
            return cls(host, read_tokens(file))
        return cls(host, {} if host in (*LOCAL_NAMES, "::1") else {secrets.token_urlsafe(24): ""})

    @property
    def unnamed(self) -> str:
        """Token without a name; "" for none."""
        return next((token for token, name in self._tokens.items() if not name), "")

    @property
    def open(self) -> bool:
        """True if no token is needed."""
        return not self._tokens

    def refusal(self, request: Request) -> Response | None:
        """Refusal of a request; None if allowed.

        The Host must be a name of this machine: a foreign page may point its own name here. A socket, and any other
        request with an Origin, must come from the page served here.
        """
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        host = hosts[0] if len(hosts) == 1 else ""
        if not self._names(host):
            return refused(http.HTTPStatus.MISDIRECTED_REQUEST, "This server does not go by that name.")
        if len(origins) > 1 or (origins and urlsplit(origins[0]).netloc != host):
            return refused(http.HTTPStatus.FORBIDDEN, "This page belongs to another site.")
        if request.headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none") and not (
            request.headers.get("Sec-Fetch-Mode") == "navigate" and request.headers.get("Sec-Fetch-Dest") == "document"
        ):
            return refused(http.HTTPStatus.FORBIDDEN, "This page belongs to another site.")
        asked = _token(urlsplit(request.path).query)
        if self._tokens and self.name(request) is None and asked not in self._tokens:
            return refused(
                http.HTTPStatus.UNAUTHORIZED, "A token is needed: open the address that the server has printed."
            )
        return None

    def entered(self, request: Request) -> Response | None:
        """Redirect from an address with a token to the address without, with the token in a cookie."""
        parts = urlsplit(request.path)
        token = _token(parts.query)
        if not token:
            return None
        kept = urlencode([(k, v) for k, v in parse_qsl(parts.query, keep_blank_values=True) if k != "token"])
        headers = {
            "Location": "/" + ("?" + kept if kept else ""),
            "Content-Length": "0",
            "Cache-Control": "no-store",
        }
        if token in self._tokens:
            headers["Set-Cookie"] = f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Lax"
        return Response(http.HTTPStatus.FOUND, "Found", Headers(headers), b"")

    def name(self, request: Request) -> str | None:
        """Name by a request's token; None without a valid token."""
        for part in request.headers.get("Cookie", "").split(";"):
            key, _, value = part.strip().partition("=")
            if key == COOKIE and value in self._tokens:
                return self._tokens[value]
        return None

    def _names(self, host: str) -> bool:
        name = re.sub(r":\d+$", "", host)
        if name in LOCAL_NAMES or name in (self._host, f"[{self._host}]"):
            return True
        # This machine's names in a network are unknown here: numbers and plain local names are accepted.
        # Dotted web names are refused, or a page could point its own name at this address.
        return self._host in EVERYWHERE and bool(
            re.fullmatch(r"\d+(\.\d+){3}|\[[0-9a-f:]+\]|[\w-]+(\.local)?", name, re.ASCII)
        )


def read_tokens(file: Path) -> dict[str, str]:
    """Names by token, from a file of lines "NAME TOKEN"; "#" begins a comment. InputError if invalid."""
    how = "a line NAME TOKEN for each person, the token at least 16 letters, digits, - or _"
    tokens: dict[str, str] = {}
    with as_input_error("the tokens cannot be read", OSError, UnicodeDecodeError, path=file):
        lines = file.read_text("utf-8").splitlines()
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        good = len(words) == 2 and re.fullmatch(r"[\w-]{16,}", words[1], re.ASCII) and words[1] not in tokens
        require(good, f"line {number} is not a name and a token of its own", expected=how, path=file)
        tokens[words[1]] = words[0]
    require(tokens, "the file holds no token", expected=how, path=file)
    return tokens


def _token(query: str) -> str:
    return dict(parse_qsl(query)).get("token", "")


def refused(status: http.HTTPStatus, text: str) -> Response:
    """Refusal as a page readable to everybody; `text` is the program's own."""
    return response(status, REFUSAL.format(text).encode(), ".html", {"Cache-Control": "no-store"})


def response(status: http.HTTPStatus, body: bytes, suffix: str = "", more: Mapping[str, str] | None = None) -> Response:
    """Response with the common headers; `suffix` is of the file, `more` are further headers."""
    kind = KINDS.get(suffix, "application/octet-stream" if status == http.HTTPStatus.OK else "text/plain")
    headers = {"Content-Type": f"{kind}; charset=utf-8" if kind.startswith("text") else kind, **SAFE}
    headers |= {"Content-Security-Policy": PAGE_POLICY} if kind == KINDS[".html"] else {}
    headers |= {"Cache-Control": "no-cache", "Content-Length": str(len(body)), **(more or {})}
    return Response(status, status.phrase, Headers(headers), body)
