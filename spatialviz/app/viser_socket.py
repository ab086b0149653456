"""The websocket server that viser starts, with our own answers to requests and sockets put around its own.

viser answers HTTP and opens sockets where it calls `websockets.asyncio.server.serve`; ours is put around that, so
that both stand on one port.
"""

from __future__ import annotations

import http
import logging
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import websockets.asyncio.server as ws
from websockets.extensions.permessage_deflate import ServerPerMessageDeflateFactory
from websockets.http11 import Request, Response

from spatialviz.app.channel import LONGEST_COMMAND, LONGEST_DRAWING

DEFLATED = {"level": 7, "memLevel": 6}
LONGEST_OF_SCENE = 64_000
LONGEST_MESSAGE = LONGEST_DRAWING + LONGEST_COMMAND
"""Bytes."""
CLOSE_SECONDS = 2.0
"""Who does not take leave in that time is cut off."""


class ConnectionHandler(Protocol):
    """Answers to requests and sockets of one server."""

    async def answer(self, connection: Any, request: Request) -> Response | None:
        """The answer to a request; None lets a socket be opened."""
        ...

    async def socket(self, connection: Any, viser_handler: Callable[[Any], Awaitable[None]]) -> None:
        """Serve an open socket."""

    def log(self, problem: str) -> None:
        """Print what was wrong with what came."""


class RefuseAll:
    """Refuses every request: a handler for a server that only draws."""

    async def answer(self, connection: Any, request: Request) -> Response | None:
        """Refused."""
        return connection.respond(http.HTTPStatus.FORBIDDEN, "nobody is served here\n")

    async def socket(self, connection: Any, viser_handler: Callable[[Any], Awaitable[None]]) -> None:
        """Never opened."""

    def log(self, problem: str) -> None:
        """Dropped."""


@contextmanager
def served_by(handler: ConnectionHandler) -> Iterator[None]:
    """While this is open, a websocket server that is started answers as the handler does."""
    original = ws.serve

    def serve(viser_handler: Any, host: Any = None, port: Any = None, **options: Any) -> Any:
        async def both(connection: Any) -> None:
            await handler.socket(connection, viser_handler)

        async def process_request(connection: Any, request: Request) -> Response | None:
            # What is longer closes the socket before it is read.
            connection.protocol.max_message_size = LONGEST_OF_SCENE
            if request.path.startswith("/app/"):
                connection.protocol.max_message_size = LONGEST_MESSAGE
                # Words are worth it; points, on viser's sockets, are not.
                connection.protocol.available_extensions = [ServerPerMessageDeflateFactory(compress_settings=DEFLATED)]
            return await handler.answer(connection, request)

        def told(record: logging.LogRecord) -> bool:
            handler.log(f"{record.getMessage()}: {record.exc_info[1] if record.exc_info else ''}")
            return False

        # What websockets logs is said shortly: whoever breaks off would fill the terminal with it.
        logger = logging.Logger("spatialviz.sockets", logging.WARNING)
        logger.addFilter(told)
        options |= {
            "logger": logger,
            "close_timeout": CLOSE_SECONDS,
            "process_request": process_request,
            "max_size": LONGEST_MESSAGE,
        }
        return original(both, host, port, **options)

    ws.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        ws.serve = original  # pyright: ignore[reportAttributeAccessIssue]
