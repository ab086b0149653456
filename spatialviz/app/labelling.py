"""Everything of one client that shows, reviews and corrects labels; others' edits are looked for."""

from __future__ import annotations

import getpass
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from platformdirs import user_data_path

from pipeline.corrections.journal_location import JournalLocation
from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.unsaved import Waiting
from pipeline.evaluation.run_folder import Run
from pipeline.system.errors import InputError
from spatialviz.app.correct import Correct
from spatialviz.app.frames import FrameStore
from spatialviz.app.label_object import LabelObject
from spatialviz.app.layout import Dialog, Page
from spatialviz.app.pixels import Pixels
from spatialviz.app.place import Place
from spatialviz.app.retrain_panel import RetrainPanel
from spatialviz.app.review_queue import ReviewQueue
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_client import SceneClient
from spatialviz.app.selection import Selection
from spatialviz.app.sentences import sentences_and_conflicts
from spatialviz.app.state import State


class Labelling:
    """The labels of one client.

    Parameters
    ----------
    client : SceneClient
    page : Page
    scene : SceneView
    dialog : Dialog
    selection : Selection
    store : FrameStore
    runs : mapping of str to Run
    journals : mapping of str to JournalPlace
        Where the labels of each source are corrected; what lacks one has none.
    author : str or None
        Where none is given, the name that the browser has kept, else that of the login.
    closed : threading.Event
        Set when the client has gone.
    state, take : callable
        Give and take the client's state.
    draw : callable
        Draws all of the page; with True what follows a drag.
    open_frame : callable
    ask : callable
        Asks the question of the state again.
    go : callable
        Looks at a place.
    handle : callable
        Carries out a command.
    note : callable
        Writes a line of the log.
    post : callable
        Runs something later, on the client's own thread.
    """

    def __init__(
        self,
        client: SceneClient,
        page: Page,
        scene: SceneView,
        dialog: Dialog,
        selection: Selection,
        store: FrameStore,
        runs: Mapping[str, Run],
        journals: Mapping[str, JournalLocation],
        author: str | None,
        closed: threading.Event,
        *,
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[bool], None],
        open_frame: Callable[[str], None],
        ask: Callable[[], None],
        go: Callable[[Place], None],
        handle: Callable[[str], None],
        note: Callable[[str], None],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        def opener(name: str, place: JournalLocation) -> Callable[[], LabelEditor]:
            return lambda: LabelEditor(place.labels, place, author or login_name(), store.sources[name].dataset)

        def whole() -> None:
            draw(False)

        def use(network: str) -> None:
            # While labels are shown nothing is asked that it could answer.
            if state().labels is None:
                handle(f"edit:set:scorer:{network}")

        desks = {name: opener(name, place) for name, place in journals.items()}
        to_state: dict[str, Any] = {"state": state, "take": take}
        self.correct = Correct(page, desks, **to_state, draw=whole, ask=ask, open_frame=open_frame, note=note)
        self.correct.keeps_name = author is not None
        self.pixels = Pixels(client, page, scene, self.correct, selection, **to_state, draw=whole, note=note)
        self._object = LabelObject(client, page, scene, self.correct, **to_state, draw=draw, note=note, post=post)
        self._queue = ReviewQueue(page, store, journals, self.correct, dialog, state=state, note=note, post=post)
        self._retrain = RetrainPanel(
            page, store.sources, runs, journals, user_data_path("spatialviz") / "retrained", state=state, go=go,
            use=use, note=note, post=post,
        )  # fmt: skip
        spoken = sentences_and_conflicts(self.correct, dialog, page, state, take, whole)
        self._parts = (self.correct, self.pixels, self._object, self._queue, self._retrain, *spoken)
        if journals:
            Watch(self.correct, state, post, closed)

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {name: run for part in self._parts for name, run in part.commands().items()}

    def follow(self) -> None:
        """Bring the tabs of the labels up to the state."""
        self.correct.follow()
        self._queue.follow()
        self._retrain.draw()
        self.pixels.follow()

    def follow_object(self, live: bool) -> None:
        """Bring the handles and the Edit tab up to the state; `live` follows a drag."""
        self._object.follow(live)

    def close(self) -> None:
        """End what is running."""
        self._retrain.close()
        self._queue.close()


def login_name() -> str:
    """The name that the user is logged in with; "somebody" where there is none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # A container may know no name of its user.
        return "somebody"


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
