"""Access to the server: its names, in and outside this machine, tokens, and responses with the common headers."""

from __future__ import annotations

import html
import http
import re
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import parse_qsl, urlencode, urlsplit

from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

from pipeline.system.errors import InputError, as_input_error, require
from spatialviz.app.outer_address import OuterAddress, outer_address

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
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

    def __init__(self, host: str, tokens: Mapping[str, str] | None = None, outer: Sequence[OuterAddress] = ()) -> None:
        self._tokens = dict(tokens or {})
        self._host = host.lower()
        self.outer = tuple(outer)

    @classmethod
    def of(cls, host: str, file: Path | None = None, outer: Sequence[OuterAddress] = ()) -> Access:
        """Access by address: free on this machine alone, else tokens of a file (InputError if invalid) or a new one."""
        if file is not None:
            return cls(host, read_tokens(file), outer)
        free = host in (*LOCAL_NAMES, "::1") and not outer
        return cls(host, {} if free else {secrets.token_urlsafe(24): ""}, outer)

    def listens(self, port: int) -> None:
        """Fill the server's port into the outer addresses."""
        self.outer = tuple(address.at(port) for address in self.outer)

    def links(self, address: str) -> list[str]:
        """Addresses to open, with the token where one is needed: this machine's `address`, then those outside."""
        token = self.unnamed or ("" if self.open else "THEIRS")
        return [
            f"{link}{token and f'?token={token}'}"
            for link in (f"{address}/", *(str(one) for one in self.outer if one.origin))
        ]

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

        The Host must be a name of this machine or an outer address's: a foreign page may point its own name here. A
        socket, and any other request with an Origin, must come from the page served here: where a proxy names this
        machine as Host, from a page of any outer address, else from one of the very address.
        """
        try:
            return self._refusal(request)
        except (ValueError, MultipleValuesError):
            return refused(http.HTTPStatus.BAD_REQUEST, "This request is malformed.")

    def _refusal(self, request: Request) -> Response | None:
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        host, origin = (found[0].lower() if len(found) == 1 else "" for found in (hosts, origins))
        same = origin in (f"http://{host}", f"https://{host}")
        known = _token(urlsplit(request.path).query) in self._tokens or self.name(request) is not None
        local, outer = self._names(host), [address for address in self.outer if host in address.hosts]
        # A foreign page that has pointed its name here has no token for it.
        local_or_told = local or (known and any(not address.origin for address in self.outer))
        if not host or not (local_or_told or outer):
            asked = origin if same else f"https://{host}"
            return _not_named(
                http.HTTPStatus.MISDIRECTED_REQUEST, "This server does not go by that name.", request, asked
            )
        trusted = {address.origin for address in (self.outer if local else outer)}
        if origins and not (origin and (origin in trusted or (local_or_told and same))):
            return _not_named(http.HTTPStatus.FORBIDDEN, "This page belongs to another site.", request, origin)
        if request.headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none") and not (
            request.headers.get("Sec-Fetch-Mode") == "navigate" and request.headers.get("Sec-Fetch-Dest") == "document"
        ):
            return refused(http.HTTPStatus.FORBIDDEN, "This page belongs to another site.")
        if self._tokens and not known:
            return refused(
                http.HTTPStatus.UNAUTHORIZED, "A token is needed: open the address that the server has printed."
            )
        return None

    def inside(self, target: str) -> str:
        """Request target without the path of an outer address, which some proxies leave in it."""
        path, mark, query = target.partition("?")
        found = next(filter(None, (address.inside(path) for address in self.outer)), path)
        return found + mark + query

    def entered(self, request: Request) -> Response | None:
        """Redirect from an address with a token to the address without, with the token in a cookie."""
        parts = urlsplit(request.path)
        token = _token(parts.query)
        if not token:
            return None
        kept = urlencode([(k, v) for k, v in parse_qsl(parts.query, keep_blank_values=True) if k != "token"])
        headers = {
            # Relative, as are the page's own addresses: a proxy may serve it below a path that is not known here.
            "Location": "./" + ("?" + kept if kept else ""),
            "Content-Length": "0",
            "Cache-Control": "no-store",
        }
        if token in self._tokens:
            host = request.headers.get("Host", "").lower()
            secure = any(host in address.hosts and address.origin.startswith("https:") for address in self.outer)
            # Without a path it is that of the page.
            headers["Set-Cookie"] = f"{COOKIE}={token}; HttpOnly; SameSite=Lax{'; Secure' * secure}"
        return Response(http.HTTPStatus.FOUND, "Found", Headers(headers), b"")

    def name(self, request: Request) -> str | None:
        """Name by a request's token; None without a valid token."""
        # Proxies may leave HTTP/2's several headers of cookies apart.
        for part in ";".join(request.headers.get_all("Cookie")).split(";"):
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
    """Refusal as a page readable to everybody."""
    return response(status, REFUSAL.format(html.escape(text)).encode(), ".html", {"Cache-Control": "no-store"})


def _not_named(status: http.HTTPStatus, text: str, request: Request, origin: str) -> Response:
    """Refusal naming the option for a proxy, with the address by which the request came, where it can be told."""
    begin = re.split(r"/(?:app/|scene/|\?|$)", request.path, maxsplit=1)[0]
    path = next(iter(request.headers.get_all("X-Forwarded-Prefix")), begin)
    try:
        address = str(outer_address(origin + path))
    except InputError:
        address = "https://HOST/PATH/"
    return refused(status, f"{text} If it is this one behind a proxy, start it with --outer-address {address}")


def response(status: http.HTTPStatus, body: bytes, suffix: str = "", more: Mapping[str, str] | None = None) -> Response:
    """Response with the common headers; `suffix` is of the file, `more` are further headers."""
    kind = KINDS.get(suffix, "application/octet-stream" if status == http.HTTPStatus.OK else "text/plain")
    headers = {"Content-Type": f"{kind}; charset=utf-8" if kind.startswith("text") else kind, **SAFE}
    headers |= {"Content-Security-Policy": PAGE_POLICY} if kind == KINDS[".html"] else {}
    headers |= {"Cache-Control": "no-cache", "Content-Length": str(len(body)), **(more or {})}
    return Response(status, status.phrase, Headers(headers), body)
