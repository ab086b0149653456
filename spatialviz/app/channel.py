"""Socket of a page and its protocol: JSON texts, commands in, patches of the page out.

The browser first sends a `Hello`, then `Command`s and, on a change of the address by hand, `Go`s, handled in order on a
thread of the page. The server sends `Patch`es (elements by id, as HTML), `Call`s of functions of the page, and the
`PageAddress` of the view.
"""

from __future__ import annotations

import asyncio
import json
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Any, Literal, TypeAlias
from weakref import WeakSet

import websockets.exceptions
from pydantic import Field, TypeAdapter

from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked

WAITING_BYTES = 8 * 2**20
"""Limit of unread output; slower browsers are cut off, reconnect, and get the page anew."""
MANY, REST_SECONDS = 10, 0.25
"""A page with more queued jobs pauses after each, so that other pages are answered."""
LASTING = ("ask-typed", "edit-live", "frame-typed", "mend-live", "rows")
"""Commands replaced by a later command of the same name in the queue."""


class Channel:
    """Job queue of a page, in order, off the server's loop; outgoing messages may come from any thread."""

    def __init__(self, name: str, on_message: Callable[[Incoming], None]) -> None:
        self._on_message = on_message
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self._outgoing: asyncio.Queue[str | None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiting = 0
        self._latest: dict[str, Incoming] = {}
        self._lock = threading.Lock()
        self._ended = False
        self._abort: Callable[[], None] = lambda: None
        self.left = time.monotonic()
        """Time of the disconnect, monotonic clock."""
        self._thread = threading.Thread(target=self._work, daemon=True, name=f"page-{name}")
        self._thread.start()
        _STARTED.add(self)

    @property
    def connected(self) -> bool:
        """True while a browser listens."""
        return self._outgoing is not None

    def post(self, job: Callable[[], None]) -> None:
        """Queue a job."""
        self._jobs.put(job)

    def receive(self, message: Incoming) -> None:
        """Queue a message of the browser."""
        kind = message.name if isinstance(message, Command) else ""
        if kind in LASTING:
            self._latest[kind] = message
        self.post(lambda: None if self._latest.get(kind, message) is not message else self._on_message(message))

    @property
    def behind(self) -> int:
        """Number of queued jobs."""
        return self._jobs.qsize()

    def send(self, message: Outgoing) -> None:
        """Send a message to a connected browser, from any thread."""
        with self._lock:
            loop, outgoing = self._loop, self._outgoing
            if loop is None or outgoing is None or loop.is_closed():
                return
            text = write(message)
            self._waiting += len(text)
            if self._waiting > WAITING_BYTES:
                # The browser does not read, not even a close message.
                loop.call_soon_threadsafe(self._abort)
                return
            loop.call_soon_threadsafe(outgoing.put_nowait, text)

    def attach(self, connection: Any) -> asyncio.Queue[str | None]:
        """Connect a browser, in place of an earlier connection, and return the queue of outgoing messages."""
        outgoing: asyncio.Queue[str | None] = asyncio.Queue()
        with self._lock:
            if self._outgoing is not None:
                self._outgoing.put_nowait(None)
            self._loop, self._outgoing, self._waiting = asyncio.get_running_loop(), outgoing, 0
            self._abort = connection.transport.abort
        return outgoing

    async def serve(self, connection: Any, outgoing: asyncio.Queue[str | None]) -> None:
        """Send queued messages until the browser disconnects."""
        try:
            while (text := await outgoing.get()) is not None:
                await connection.send(text)
                self._waiting -= len(text)
            await connection.close(1013, "This page was opened elsewhere.")
        except websockets.exceptions.ConnectionClosed:
            pass

    def detach(self, outgoing: asyncio.Queue[str | None]) -> None:
        """Disconnect the browser of a queue."""
        with self._lock:
            if self._outgoing is outgoing:
                self._loop = self._outgoing = None
                self._abort = lambda: None
                self.left = time.monotonic()

    def close(self) -> None:
        """Handle the queued jobs, then stop."""
        self._jobs.put(None)

    def end(self, until: float) -> None:
        """Finish the current job by a time of the monotonic clock, and drop the queued jobs."""
        self._ended = True
        self.close()
        self._thread.join(max(0.0, until - time.monotonic()))

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None and not self._ended:
            _AT_WORK.add(self)
            try:
                job()
            except Exception as error:  # A failed click must not end the session.
                said = f"A fault of the program; the page goes on. For its makers: {type(error).__name__}: {error}"
                self.send(Call("toast", {"title": "Something went wrong", "text": said, "bad": True}))
            finally:
                _AT_WORK.discard(self)
            if self.behind > MANY and not self._ended:
                time.sleep(REST_SECONDS)


_AT_WORK: set[Channel] = set()
_STARTED: WeakSet[Channel] = WeakSet()


def answering() -> bool:
    """True while any page handles a job."""
    return bool(_AT_WORK)


def end_all(within: float) -> None:
    """Finish the current job of every page, within a number of seconds in all."""
    until = time.monotonic() + within
    for channel in list(_STARTED):
        channel.end(until)


LONGEST_ADDRESS = 4_000
LONGEST_COMMAND, LONGEST_DRAWING = 20_000, 500_000
"""Characters; a stroke of the pixel editor takes a few tens of thousands."""
DRAWING = "px-"
"""Prefix of the pixel editor's commands."""


@dataclass(frozen=True)
class Hello:
    """First message: address, author as kept by the browser, and theme."""

    type: Literal["hello"]
    address: Annotated[str, Field(max_length=LONGEST_ADDRESS)] = ""  # Query of the page's address, without "?"
    author: Annotated[str, Field(max_length=LONGEST_ADDRESS)] = ""  # Name kept by the browser; "" for none
    theme: Literal["", "dark", "light"] = ""  # As chosen there, else the server's, else the system's


@dataclass(frozen=True)
class Command:
    """User action, written in an element's `do` as "name" or "name:argument"."""

    name: str
    arguments: tuple[Any, ...] = ()
    # Label item that the page showed by then; "" for none, and with a key that is held down; None for who shows no page
    shown: Annotated[str, Field(max_length=LONGEST_ADDRESS)] | None = None
    type: Literal["command"] = "command"

    @classmethod
    def read(cls, text: str) -> Command:
        """Parse an element's `do`."""
        name, with_argument, argument = text.partition(":")
        return cls(name, (argument,) if with_argument else ())


@dataclass(frozen=True)
class Go:
    """Change of the address by Back, Forward or hand."""

    type: Literal["go"]
    address: Annotated[str, Field(max_length=LONGEST_ADDRESS)]


Incoming: TypeAlias = "Hello | Command | Go"
_INCOMING: TypeAdapter[Incoming] = TypeAdapter(Annotated[Hello | Command | Go, Field(discriminator="type")])


@dataclass(frozen=True)
class Patch:
    """Elements replacing those of the same ids."""

    parts: tuple[tuple[str, str], ...]  # (id, HTML)
    type: Literal["patch"] = "patch"


@dataclass(frozen=True)
class Call:
    """Function of the page (`calls` of static/core.mjs) and a JSON argument."""

    name: str
    data: Any
    type: Literal["call"] = "call"


@dataclass(frozen=True)
class PageAddress:
    """Address and title of the page."""

    query: str  # Without "?"
    title: str
    push: bool  # True for a new entry of the browser's history
    type: Literal["address"] = "address"


@dataclass(frozen=True)
class Scene:
    """Path of the scene shown in the page's frame."""

    path: str
    type: Literal["scene"] = "scene"


Outgoing: TypeAlias = "Patch | Call | PageAddress | Scene"


def read(text: str | bytes) -> Incoming:
    """Parse a message of the browser; InputError for an invalid message."""
    message = checked(_INCOMING.validate_json, text, "not a message of the page, at {}")
    if isinstance(message, Command) and len(text) > LONGEST_COMMAND and not message.name.startswith(DRAWING):
        raise InputError("not a message of the page", got=f"a command of {len(text)} characters")
    return message


def write(message: Outgoing) -> str:
    """Encode a message to the browser."""
    return json.dumps(vars(message), ensure_ascii=False, separators=(",", ":"), default=asdict)
