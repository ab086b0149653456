"""Whether a database server answers, known once in a process, so that nobody waits again for one that does not."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from functools import cache
from typing import Protocol, TypeVar

SLOW_S = 1.0
"""A server that fails after a longer time is not waited for again until it is known to answer."""
AGAIN_S = 2.0
"""How long after that it is asked once more, on a thread of its own."""


class Link(Protocol):
    """A connection."""

    def close(self) -> None: ...


Answer = TypeVar("Answer")


class Server:
    """One server, as this process knows it; shared by threads.

    While it is away, `ask` fails at once, and whoever asks has it looked for in the background.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: list[float] = []
        self._away: Exception | None = None
        self._again = 0.0
        """When it may be looked for."""

    def ask(self, question: Callable[[], Answer], connect: Callable[[], Link]) -> Answer:
        """What the server answers, or the error that it makes.

        Parameters
        ----------
        question : callable
            Connects, or says something on a connection.
        connect : callable
            Makes a connection, to find out whether the server is back.

        Raises
        ------
        Exception
            That of the question; while the server is away, the one that made it known, or TimeoutError where another
            thread waits for an answer right now.
        """
        began = time.monotonic()
        with self._lock:
            if self._away is not None:
                if began >= self._again:
                    self._again = float("inf")
                    threading.Thread(target=self._look, args=(connect,), daemon=True, name="journal-server").start()
                raise copy(self._away)
            if self._asked and began - self._asked[0] > SLOW_S:
                raise TimeoutError("it does not answer")
            self._asked.append(began)
        try:
            return question()
        except Exception as error:
            if time.monotonic() - began > SLOW_S:
                self._know(error)
            raise
        finally:
            with self._lock:
                self._asked.remove(began)

    def is_silent(self, error: Exception) -> None:
        """It did not answer on a connection that it had: whoever asks next need not find out by waiting."""
        self._know(error)

    def _look(self, connect: Callable[[], Link]) -> None:
        try:
            link = connect()
        except Exception as error:
            self._know(error)
            return
        self._know(None)
        with suppress(Exception):
            link.close()

    def _know(self, away: Exception | None) -> None:
        with self._lock:
            self._away, self._again = away, time.monotonic() + AGAIN_S


@cache
def server_at(host: str, port: int) -> Server:
    """What is known of the server at an address."""
    return Server()
