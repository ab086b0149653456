"""Internals of viser: websocket server, messages, and client page.

viser answers HTTP and opens sockets by `websockets.asyncio.server.serve`, wrapped by this program's server on a single
port. No other module reaches into viser: a release without a needed name is refused by `internal`, with that name.
"""

from __future__ import annotations

import http
import logging
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import viser
import viser._messages
import websockets.asyncio.server as ws
from websockets.extensions.permessage_deflate import ServerPerMessageDeflateFactory
from websockets.http11 import Request, Response

from pipeline.system.errors import InputError, require
from spatialviz.app.channel import LONGEST_COMMAND, LONGEST_DRAWING

DEFLATED = {"level": 7, "memLevel": 6}
LONGEST_OF_SCENE = 64_000
LONGEST_MESSAGE = LONGEST_DRAWING + LONGEST_COMMAND
"""Bytes."""
CLOSE_SECONDS = 2.0
"""Seconds for a closing handshake, then the connection is cut."""


OF_SCENE = (
    "ViewerCameraMessage",
    "ScenePointerMessage",
    "SceneNodeClickMessage",
    "SceneNodeDragMessage",
    "TransformControlsUpdateMessage",
    "TransformControlsDragStartMessage",
    "TransformControlsDragEndMessage",
)
"""Messages allowed of a scene: none of viser's panels, uploads and tunnels."""
TUNNELS = ("ShareUrlRequest", "ShareUrlDisconnect")
"""Messages requesting a tunnel to a server of viser's makers."""


def internal(name: str, owner: Any = viser) -> Any:
    """Private name of viser, such as "_messages.Message"; InputError if the installed release has none."""
    try:
        return attrgetter(name)(owner)
    except AttributeError:
        raise InputError(
            f"viser {viser.__version__} has no {'' if owner is viser else type(owner).__name__ + '.'}{name}",
            expected="viser>=1.1.1,<1.2",
            cause="another release names its internals otherwise",
        ) from None


def scene_page() -> str:
    """Client page of viser as HTML."""
    path = Path(viser.__file__).parent / "client" / "build" / "index.html"
    require(path.is_file(), f"viser {viser.__version__} has no client page", expected="viser>=1.1.1,<1.2", path=path)
    return path.read_text("utf-8")


def subprotocol() -> str:
    """Websocket subprotocol of viser's client."""
    return f"viser-v{viser.__version__}"


def close_tunnels(server: viser.ViserServer) -> None:
    """Ignore requests for a tunnel to viser's makers."""
    for name in TUNNELS:
        internal("_websock_server.unregister_handler", server)(internal(f"_messages.{name}"))


class SceneConnection:
    """Socket of viser for a scene, reduced to the messages OF_SCENE, rate-limited by awaiting `pace`."""

    def __init__(self, connection: Any, pace: Callable[[], Awaitable[None]]) -> None:
        self._connection, self._pace = connection, pace
        self._read = internal("_messages.Message.deserialize")
        self._allowed = tuple(internal(f"_messages.{name}") for name in OF_SCENE)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        """Next allowed message."""
        while True:
            data = await self._connection.recv()
            await self._pace()
            require(isinstance(data, bytes), "not a message of a scene")
            if isinstance(self._read(data), self._allowed):
                return data


class ConnectionHandler(Protocol):
    """Answers to requests and sockets of a server."""

    def inside(self, target: str) -> str:
        """Request target as the handler knows it, without what a proxy has put in front."""
        ...

    async def answer(self, connection: Any, request: Request) -> Response | None:
        """Response to a request; None admits a socket."""
        ...

    async def socket(self, connection: Any, viser_handler: Callable[[Any], Awaitable[None]]) -> None:
        """Serve an open socket."""

    def log(self, problem: str) -> None:
        """Print a problem with a request."""


@contextmanager
def served_by(handler: ConnectionHandler | None) -> Iterator[None]:
    """Route websocket servers started in this context to the handler; None refuses every request."""
    original = ws.serve

    def serve(viser_handler: Any, host: Any = None, port: Any = None, **options: Any) -> Any:
        async def both(connection: Any) -> None:
            if handler is not None:
                await handler.socket(connection, viser_handler)

        async def process_request(connection: Any, request: Request) -> Response | None:
            if handler is None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, "nobody is served here\n")
            request.path = handler.inside(request.path)
            # Longer messages close the socket unread.
            connection.protocol.max_message_size = LONGEST_OF_SCENE
            if request.path.startswith("/app/"):
                connection.protocol.max_message_size = LONGEST_MESSAGE
                # Compression pays for text, not for the points of viser's sockets.
                connection.protocol.available_extensions = [ServerPerMessageDeflateFactory(compress_settings=DEFLATED)]
            return await handler.answer(connection, request)

        def told(record: logging.LogRecord) -> bool:
            if handler is not None:
                handler.log(f"{record.getMessage()}: {record.exc_info[1] if record.exc_info else ''}")
            return False

        # Short log lines: broken connections would fill the terminal.
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
