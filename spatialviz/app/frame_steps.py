"""From one frame to another: by its number, to the next, where a robot can go, and in the grid of small pictures."""

from __future__ import annotations

import threading
from collections.abc import Callable

from pipeline.datasets import moves
from spatialviz.app.frames import FrameStore
from spatialviz.app.layout import Page
from spatialviz.app.picture import frames_html, window
from spatialviz.app.state import State

BROWSED = 6
"""Small pictures that are made at once: whatever the user does comes between."""


class FrameSteps:
    """Opens frames for one client, and fills its grid of them.

    Parameters
    ----------
    page : Page
    store : FrameStore
    closed : threading.Event
        Set when the client has gone.
    state : callable
        Gives the client's state.
    open_frame : callable
        Shows a frame.
    post : callable
        Runs something later, on the client's own thread.
    """

    def __init__(
        self,
        page: Page,
        store: FrameStore,
        closed: threading.Event,
        *,
        state: Callable[[], State],
        open_frame: Callable[[str], None],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        self._page, self._store, self._closed = page, store, closed
        self._state, self._open_frame, self._post = state, open_frame, post

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {"open": self._open_frame, "frame": self.open_number, "next-frame": self.step, "move": self.move}

    @property
    def _ids(self) -> tuple[str, ...]:
        return tuple(self._store.sources[self._state().source].dataset.frame_ids)

    def open_number(self, number: str) -> None:
        """Show the frame of a number."""
        if number.isdecimal() and int(number) < len(self._ids):
            self._open_frame(self._ids[int(number)])

    def step(self, by: str) -> None:
        """Show the next frame, or the one before."""
        if by.lstrip("-").isdecimal():
            self.open_number(str(self._ids.index(self._state().frame_id) + int(by)))

    def move(self, move: str) -> None:
        """Go where a move of the dataset's robot leads; one that is not possible does nothing."""
        state = self._state()
        to = moves(self._store.sources[state.source].dataset, state.frame_id).get(move)
        if to is not None:
            self._open_frame(to)

    def browse(self) -> None:
        """Fill the grid of small pictures bit by bit, behind whatever the user does."""
        ids, state = self._ids, self._state()
        current = (state.source, state.frame_id)
        total = len(window(ids, ids.index(state.frame_id)))

        def fill(ready: int) -> None:
            now = self._state()
            if (now.source, now.frame_id) != current or self._closed.is_set():
                return
            self._page.show("frames", frames_html(now, ids, self._store, ready))
            if ready < total:
                self._post(lambda: fill(min(ready + BROWSED, total)))
            else:
                at = ids.index(now.frame_id)
                self._store.prepare(now.source, (*ids[at + 1 : at + 2], *ids[max(0, at - 1) : at]))

        self._post(lambda: fill(min(BROWSED, total)))
