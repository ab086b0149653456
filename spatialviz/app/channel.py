"""The socket of one page: what it says is handled one at a time on a thread of its own, what is said to it is sent."""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from collections.abc import Callable
from typing import Any
from weakref import WeakSet

import websockets.exceptions

from spatialviz.app.messages import Call, Command, Incoming, Outgoing, write

WAITING_BYTES = 8 * 2**20
"""A browser that lets so much wait is cut off; it comes back and is sent the page as it is then."""
MANY, REST_SECONDS = 10, 0.25
"""Where more jobs than that wait for one page, it rests after each: others are answered meanwhile."""
LASTING = ("ask-typed", "edit-live", "hover")
"""Commands of which only the last one counts, where several wait."""


class Channel:
    """Jobs of one page, in order, off the server's loop; and its outgoing messages, which any thread may send.

    Parameters
    ----------
    name : str
        Of its thread.
    on_message : callable
        Handles a message.
    """

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
        """When the browser went away, on the monotonic clock."""
        self._thread = threading.Thread(target=self._work, daemon=True, name=f"page-{name}")
        self._thread.start()
        _STARTED.add(self)

    @property
    def connected(self) -> bool:
        """Whether a browser listens."""
        return self._outgoing is not None

    def post(self, job: Callable[[], None]) -> None:
        """Run something after everything that waits already."""
        self._jobs.put(job)

    def receive(self, message: Incoming) -> None:
        """Handle a message of the browser after everything that waits already."""
        kind = message.text.partition(":")[0] if isinstance(message, Command) else ""
        if kind in LASTING:
            self._latest[kind] = message
        self.post(lambda: None if self._latest.get(kind, message) is not message else self._on_message(message))

    @property
    def behind(self) -> int:
        """How much waits to be handled."""
        return self._jobs.qsize()

    def send(self, message: Outgoing) -> None:
        """Send a message, where a browser listens. Any thread may call it."""
        with self._lock:
            loop, outgoing = self._loop, self._outgoing
            if loop is None or outgoing is None or loop.is_closed():
                return
            text = write(message)
            self._waiting += len(text)
            if self._waiting > WAITING_BYTES:
                # It does not read, not even that it is cut off.
                loop.call_soon_threadsafe(self._abort)
                return
            loop.call_soon_threadsafe(outgoing.put_nowait, text)

    def attach(self, connection: Any) -> asyncio.Queue[str | None]:
        """A browser is there: what is said from now on waits here. A second one takes the first one's place."""
        outgoing: asyncio.Queue[str | None] = asyncio.Queue()
        with self._lock:
            if self._outgoing is not None:
                self._outgoing.put_nowait(None)
            self._loop, self._outgoing, self._waiting = asyncio.get_running_loop(), outgoing, 0
            self._abort = connection.transport.abort
        return outgoing

    async def serve(self, connection: Any, outgoing: asyncio.Queue[str | None]) -> None:
        """Send what waits until the browser goes away."""
        try:
            while (text := await outgoing.get()) is not None:
                await connection.send(text)
                self._waiting -= len(text)
            await connection.close(1013, "This page was opened elsewhere.")
        except websockets.exceptions.ConnectionClosed:
            pass

    def detach(self, outgoing: asyncio.Queue[str | None]) -> None:
        """The browser that this waits for has gone."""
        with self._lock:
            if self._outgoing is outgoing:
                self._loop = self._outgoing = None
                self._abort = lambda: None
                self.left = time.monotonic()

    def close(self) -> None:
        """Handle what waits, and then nothing."""
        self._jobs.put(None)

    def end(self, until: float) -> None:
        """Finish what is being handled, at the latest at this time of the monotonic clock, and nothing that waits."""
        self._ended = True
        self.close()
        self._thread.join(max(0.0, until - time.monotonic()))

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None and not self._ended:
            _AT_WORK.add(self)
            try:
                job()
            except Exception as error:  # One failed click must not end the session.
                said = {"title": "Something went wrong", "text": f"{type(error).__name__}: {error}", "bad": True}
                self.send(Call("toast", said))
            finally:
                _AT_WORK.discard(self)
            if self.behind > MANY and not self._ended:
                time.sleep(REST_SECONDS)


_AT_WORK: set[Channel] = set()
_STARTED: WeakSet[Channel] = WeakSet()


def answering() -> bool:
    """Whether any page is being answered."""
    return bool(_AT_WORK)


def end_all(within: float) -> None:
    """Finish what every page is at, within so many seconds in all."""
    until = time.monotonic() + within
    for channel in list(_STARTED):
        channel.end(until)
