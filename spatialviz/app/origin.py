"""Refuse websocket connections from foreign web pages.

viser accepts any Origin, so that any page open in the user's browser could read
the scene and press the buttons. The check is added where the socket is opened.
"""

from __future__ import annotations

import http
import inspect
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server as ws

LOCAL_NAMES = ("127.0.0.1", "localhost", "[::1]")


def allowed_origins(host: str, port: int) -> list[Any]:
    """Origins that may connect to a server on this host and port.

    A program that is no browser sends no Origin and may connect. Port 0 means
    that the system chooses, so that any port of this machine is accepted.
    """
    names = [*LOCAL_NAMES]
    if host not in ("", "0.0.0.0", "::", *LOCAL_NAMES):
        names.append(host)
    if port == 0:
        return [None, re.compile(rf"https?://({'|'.join(re.escape(n) for n in names)})(:\d+)?")]
    open_to_all = host in ("", "0.0.0.0", "::")
    exact: list[Any] = [None, *(f"{scheme}://{n}:{port}" for n in names for scheme in ("http", "https"))]
    if open_to_all:
        # The name by which others reach this machine is not known here: numbers and plain
        # names of a local network may be it, and `same_origin` sees that they are. Dotted
        # web names are refused, or a page could point its own name at this address.
        exact.append(re.compile(rf"https?://(\d+(\.\d+){{3}}|\[[0-9a-f:]+\]|[\w-]+(\.local)?):{port}"))
    return exact


def same_origin(headers: Any) -> bool:
    """Whether a request comes from the page of the server that it goes to, or from no page at all."""
    origin = headers.get("Origin")
    return origin is None or urlsplit(origin).netloc == headers.get("Host")


@contextmanager
def checked_origins() -> Iterator[None]:
    """While this is open, every websocket server that is started checks the Origin."""
    original = ws.serve

    def serve(handler: Any, host: Any = None, port: Any = None, **options: Any) -> Any:
        options.setdefault("origins", allowed_origins(str(host or ""), int(port or 0)))
        answer = options.get("process_request")

        async def process_request(connection: Any, request: Any) -> Any:
            if not same_origin(request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "This page belongs to another site.\n")
            response = None if answer is None else answer(connection, request)
            return await response if inspect.isawaitable(response) else response

        options["process_request"] = process_request
        return original(handler, host, port, **options)

    ws.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        ws.serve = original  # pyright: ignore[reportAttributeAccessIssue]
