"""Behind a page that corrects labels: others' edits are looked for, and what could not be saved is tried again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress

from pipeline.corrections.unsaved import Waiting
from pipeline.system.errors import InputError
from spatialviz.app.correct import Correct
from spatialviz.app.state import State

PERIOD_SECONDS = 2.0


class Watch:
    """Asks the journal of one client every few seconds on a thread of its own, so that a slow one holds nobody up.

    What is found is handled on the session's thread.

    Parameters
    ----------
    correct : Correct
    state : callable
        Gives the client's state.
    post : callable
        Runs something on the session's thread.
    closed : threading.Event
        Set when the client has gone.
    """

    def __init__(
        self,
        correct: Correct,
        state: Callable[[], State],
        post: Callable[[Callable[[], None]], None],
        closed: threading.Event,
    ) -> None:
        self._correct, self._state, self._post, self._closed = correct, state, post, closed
        self._told: object = None
        threading.Thread(target=self._work, daemon=True, name="labels-watch").start()

    def _work(self) -> None:
        while not self._closed.wait(PERIOD_SECONDS):
            # Where the journal cannot be read now, what waits says so already, and is tried again all the same.
            for job in (self._save_again, self._look):
                with suppress(InputError):
                    job()

    def _save_again(self) -> None:
        desk = self._correct.open_desk
        if desk is None:
            return
        for outcome in desk.retry() if desk.waiting else ():
            if not isinstance(outcome, Waiting):
                self._post(lambda outcome=outcome: self._correct.came_to(outcome, "saved at last"))
        # Another page of the same author may have saved or decided something, too.
        kept = tuple((w.group, w.problem) for w in desk.waiting), desk.disputed
        if kept != (self._told or ((), ())):
            self._told = kept
            self._post(self._correct.refresh)

    def _look(self) -> None:
        state, desk = self._state(), self._correct.open_desk
        if desk is None or state.labels is None:
            return
        frame = state.frame_id
        found = desk.news(frame)
        if found or desk.replaced(frame):
            self._post(lambda: self._correct.took(frame, found))
