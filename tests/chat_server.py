"""A server on this machine that speaks OpenAI's chat protocol, and can be told to misbehave."""

from __future__ import annotations

import base64
import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import cv2
import numpy as np
from waiting import LONG_S

from pipeline.system import ChatClient

MODELS = ("llava-1.5-7b", "qwen-vl")
Make = Callable[..., ChatClient]
"""Makes a client; see the fixture `client_of`."""


def flat(value: int = 90, height: int = 24, width: int = 32) -> np.ndarray:
    """A picture of one grey."""
    return np.full((height, width, 3), value, np.uint8)


class Clock:
    """Time that passes only by sleeping."""

    def __init__(self) -> None:
        self.now, self.slept = 1000.0, list[float]()
        self._lock = threading.Lock()

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        with self._lock:
            self.slept.append(seconds)
            self.now += seconds


@dataclass(frozen=True)
class Request:
    """What the server was asked, checked against the protocol."""

    body: dict[str, Any]
    headers: dict[str, str]
    at: float

    @property
    def prompt(self) -> str:
        return next(part["text"] for part in self.body["messages"][0]["content"] if part["type"] == "text")

    @property
    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 RGB."""
        (url,) = (p["image_url"]["url"] for p in self.body["messages"][0]["content"] if p["type"] == "image_url")
        head, data = url.split(",", 1)
        assert head == "data:image/jpeg;base64"
        image = cv2.imdecode(np.frombuffer(base64.b64decode(data, validate=True), np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        return image[..., ::-1]


@dataclass(frozen=True)
class Raw:
    """A reply as it goes over the wire."""

    status: int = 200
    body: bytes = b""
    headers: dict[str, str] = field(default_factory=dict)


class Slow:
    """No answer until the server ends."""


class Trickle:
    """An answer that comes byte by byte and does not end."""


@dataclass(frozen=True)
class CutOff:
    """The connection ends after some bytes of a longer body; before the first byte where there are none."""

    sent: bytes = b""


Script = str | dict[str, Any] | Raw | Slow | Trickle | CutOff


def completion(text: str | None, *, usage: bool = True, finish: str = "stop", **choice: Any) -> dict[str, Any]:
    """A reply as vLLM gives it."""
    reply: dict[str, Any] = {
        "id": "chatcmpl-1",
        "object": "chat.completion",
        "created": 1,
        "model": MODELS[0],
        "choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": finish, **choice}],
    }
    return reply | ({"usage": {"prompt_tokens": 600, "completion_tokens": 3, "total_tokens": 603}} if usage else {})


def error(status: int, message: str, **more: Any) -> Raw:
    headers = more.pop("headers", {})
    body = {"error": {"message": message, "type": "error", "param": None, "code": status, **more}}
    return Raw(status, json.dumps(body).encode(), headers)


class ChatServer:
    """Answers by a script, one entry a request, and then by a function of the request."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.script: list[Script] = []
        self.answer: Callable[[Request], Script] = lambda _: "Yes"
        self.requests: list[Request] = []
        self.problems: list[str] = []
        self.clock, self.lock, self.ended = clock, threading.Lock(), threading.Event()
        self.key: str | None = None
        self.gate: threading.Event | None = None
        server = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, format: str, *args: Any) -> None:
                pass

            def do_GET(self) -> None:
                if self.path == "/v1/models":
                    data = [{"id": name, "object": "model"} for name in MODELS]
                    self._send(Raw(200, json.dumps({"object": "list", "data": data}).encode()))
                else:
                    self._send(Raw(404, b'{"detail":"Not Found"}'))

            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if self.path != "/v1/chat/completions":
                    return self._send(Raw(404, b'{"detail":"Not Found"}'))
                reply = server.reply(body, {k.lower(): v for k, v in self.headers.items()})
                if server.gate is not None:
                    server.gate.wait(LONG_S)
                if isinstance(reply, Slow):
                    server.ended.wait(LONG_S)
                    self.close_connection = True
                elif isinstance(reply, Trickle):
                    self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n")
                    with suppress(OSError):
                        while not server.ended.wait(0.02):
                            self.wfile.write(b" ")
                    self.close_connection = True
                elif isinstance(reply, CutOff):
                    self._cut(reply)
                elif isinstance(reply, Raw):
                    self._send(reply)
                else:
                    table = completion(reply) if isinstance(reply, str) else reply
                    self._send(Raw(200, json.dumps(table, ensure_ascii=False).encode()))

            def _send(self, reply: Raw) -> None:
                self.send_response(reply.status)
                headers = {"Content-Type": "application/json", "Content-Length": str(len(reply.body)), **reply.headers}
                for name, value in headers.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(reply.body)

            def _cut(self, reply: CutOff) -> None:
                if reply.sent:
                    self.wfile.write(
                        b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 5000\r\n\r\n"
                    )
                    self.wfile.write(reply.sent)
                else:
                    # Linger of 0 makes the close a reset.
                    self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                self.close_connection = True

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.http.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.http.server_address[1]}/v1"

    def reply(self, body: bytes, headers: dict[str, str]) -> Script:
        """What to answer; what is against the protocol is written down."""
        table = json.loads(body)
        request = Request(table, headers, self.clock())
        with self.lock:
            self.requests.append(request)
            self.problems += problems_of(table, headers)
            if self.key is not None and headers.get("authorization") != f"Bearer {self.key}":
                return error(401, "Incorrect API key provided")
            if table["model"] not in MODELS:
                return error(404, f"The model `{table['model']}` does not exist.")
            return self.script.pop(0) if self.script else self.answer(request)


def problems_of(body: dict[str, Any], headers: dict[str, str]) -> list[str]:
    """What a strict server would object to."""
    found = []
    if headers.get("content-type") != "application/json":
        found.append("content type")
    if not isinstance(body.get("model"), str) or body.get("stream") not in (False, None):
        found.append("model or stream")
    known = {"model", "messages", "max_tokens", "temperature", "seed", "stream", "logprobs", "top_logprobs"}
    known.add("response_format")
    if set(body) - known:
        found.append(f"unknown keys {sorted(set(body) - known)}")
    if body.get("top_logprobs") is not None and body.get("logprobs") is not True:
        found.append("top_logprobs without logprobs")
    messages = body.get("messages")
    if not isinstance(messages, list) or len(messages) != 1 or messages[0].get("role") != "user":
        return [*found, "messages"]
    kinds = [sorted(part) for part in messages[0]["content"]]
    picture = [] if "response_format" in body else [["image_url", "type"]]
    if sorted(kinds) != [*picture, ["text", "type"]]:
        found.append(f"content {kinds}")
    return found


@contextmanager
def running(clock: Callable[[], float]) -> Iterator[ChatServer]:
    server = ChatServer(clock)
    thread = threading.Thread(target=server.http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.ended.set()
        if server.gate is not None:
            server.gate.set()
        server.http.shutdown()
        server.http.server_close()
        thread.join(LONG_S)
