"""Refuse websocket connections from foreign web pages.

viser accepts any Origin, so that any page open in the user's browser could read
the scene and press the buttons. The check is added where the socket is opened.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

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
        # Under a public address the page's own name is not known; numbers and
        # plain host names of a local network are accepted, dotted web names are not.
        exact.append(re.compile(rf"https?://(\d+(\.\d+){{3}}|[\w-]+(\.local)?):{port}"))
    return exact


@contextmanager
def checked_origins() -> Iterator[None]:
    """While this is open, every websocket server that is started checks the Origin."""
    original = ws.serve

    def serve(handler: Any, host: Any = None, port: Any = None, **options: Any) -> Any:
        options.setdefault("origins", allowed_origins(str(host or ""), int(port or 0)))
        return original(handler, host, port, **options)

    ws.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        ws.serve = original  # pyright: ignore[reportAttributeAccessIssue]
