"""Bytes that no browser sends, to the page's server: it answers the next one, and says no more than a line."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import urllib.request

import load_page
from load_page import GARBAGE, SCENE_GARBAGE
from mutate import VALUES, binary, value
from promises import Kind, promise
from servers import Server
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from spatialviz.app.viser_socket import subprotocol

REQUEST = (
    b"GET /%s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)
COMMANDS = (
    "frame", "open", "ask", "object", "class", "edit", "pair", "task", "labels", "data", "stage", "search", "restore",
    "px-stroke", "mend-live", "edit-live", "rows", "next-pair", "take-back", "drawer", "click", "camera", "settle",
    "box",
)  # fmt: skip
AT_ONCE = 20
LARGER = 500
"""MB by which a server may be larger in the end."""


class Fuzzed:
    """A server to which strange bytes are sent."""

    def __init__(self) -> None:
        self._server = Server("demo")
        self._server.served(120)
        self._start = load_page.resident_mb(self._server.process.pid)

    def send(self, kind: str, rng: random.Random, counted: Kind) -> None:
        """Send some strange things of a kind, and ask for the page."""
        for _ in range(AT_ONCE):
            counted.times += 1
            with contextlib.suppress(OSError, WebSocketException, TimeoutError, EOFError):
                (self._http if kind == "http" else self._socket)(rng, counted)
        promise(self._server.process.poll() is None, "the server lives")
        with urllib.request.urlopen(self._server.address, timeout=60) as answer:
            promise(answer.status == 200, "the page is served afterwards", answer.status)
        counted.most("MB more", load_page.resident_mb(self._server.process.pid) - self._start)

    def _http(self, rng: random.Random, _: Kind) -> None:
        path = rng.choice(
            (b"", b"app/index.html", b"app/socket?id=" + b"a" * 32, b"scene/" + b"a" * 32, b"app/image/x.jpg")
        )
        with socket.create_connection(("127.0.0.1", self._server.port), 5) as one:
            one.sendall(binary(REQUEST % (path, self._server.port), rng))
            one.settimeout(0.3)
            one.recv(4096)

    def _socket(self, rng: random.Random, counted: Kind) -> None:
        name, at = rng.randbytes(16).hex(), f"ws://127.0.0.1:{self._server.port}"
        origin = f"http://127.0.0.1:{self._server.port}"
        if rng.random() < 0.3:
            spoken = [Subprotocol(subprotocol())]
            with connect(f"{at}/scene/{name}", origin=origin, subprotocols=spoken, compression=None) as scene:  # type: ignore[arg-type]
                scene.send(binary(rng.choice(SCENE_GARBAGE[2:4])[:30_000], rng))  # type: ignore[arg-type]
            return
        with connect(f"{at}/app/socket?id={name}", origin=origin) as page:  # type: ignore[arg-type]
            page.send('{"type": "hello"}')
            for _ in range(rng.randint(1, 6)):
                arguments = [
                    rng.choice((*VALUES, "0", "1:2", "mug left of the laptop")) for _ in range(rng.randint(0, 3))
                ]
                command = {"type": "command", "name": rng.choice(COMMANDS), "arguments": arguments}
                if rng.random() < 0.3:
                    command = value(command, rng)
                page.send(rng.choice(GARBAGE) if rng.random() < 0.1 else json.dumps(command))
            # Who sends what no page sends may be told of a fault; the page must go on for all others.
            with contextlib.suppress(TimeoutError):
                while "A fault of the program" not in str(page.recv(timeout=0.3)):
                    pass
                counted.counts["told as a fault"] += 1

    def end(self) -> None:
        """Stop the server: it has said only its own plain lines."""
        grown = load_page.resident_mb(self._server.process.pid) - self._start
        said = self._server.end()
        odd = [line for line in said if not line.startswith(("spatialviz:", "(viser) Server stopped", "  "))]
        promise(not odd, "the server says nothing but its own plain lines", odd[:5])
        promise(grown < LARGER, f"at most {LARGER} MB more", grown)
