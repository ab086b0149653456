"""Everything of one client that shows, reviews and corrects labels; others' edits are looked for."""

from __future__ import annotations

import threading
from contextlib import suppress

from platformdirs import user_data_path

from pipeline.corrections.unsaved import Waiting
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part
from spatialviz.app.correct import Correct
from spatialviz.app.label_object import LabelObject
from spatialviz.app.pixels import Pixels
from spatialviz.app.retrain_panel import RetrainPanel
from spatialviz.app.review_queue import ReviewQueue
from spatialviz.app.right_pair import RightPair
from spatialviz.app.selection import Selection
from spatialviz.app.sentences import Conflicts, Sentences
from spatialviz.app.side_panel import SidePanel


class Labelling:
    """The labels of one client."""

    def __init__(self, ctx: Context, selection: Selection) -> None:
        self.correct = correct = Correct(ctx)
        self.pixels = Pixels(ctx, correct, selection)
        self.object = LabelObject(ctx, correct)
        self._sides, self._right = SidePanel(ctx, correct), RightPair(ctx, correct)
        self._queue = ReviewQueue(ctx, correct)
        self._retrain = RetrainPanel(ctx, user_data_path("spatialviz") / "retrained")
        conflicts = Conflicts(ctx, correct)
        correct.on_conflict = conflicts.show
        self.parts = (
            correct,
            self.pixels,
            self.object,
            self._sides,
            self._right,
            self._queue,
            self._retrain,
            Sentences(ctx, correct),
            conflicts,
        )
        if ctx.shared.journals:
            Watch(ctx, correct)

    def follow(self) -> None:
        """Bring the tabs of the labels up to the state."""
        self.correct.follow()
        self._queue.follow()
        self._retrain.draw()
        self.pixels.follow()
        self._sides.follow()
        self._right.follow()


PERIOD_SECONDS = 2.0


class Watch(Part):
    """Asks the journal of one client every few seconds on a thread of its own, so that a slow one holds nobody up.

    What is found is handled on the session's thread.
    """

    def __init__(self, ctx: Context, correct: Correct) -> None:
        super().__init__(ctx)
        self._correct = correct
        self._told: object = None
        threading.Thread(target=self._work, daemon=True, name="labels-watch").start()

    def _work(self) -> None:
        while not self.ctx.closed.wait(PERIOD_SECONDS):
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
                self.ctx.post(lambda outcome=outcome: self._correct.came_to(outcome, "saved at last"))
        # Another page of the same author may have saved or decided something, too.
        kept = tuple((w.group, w.problem) for w in desk.waiting), desk.disputed
        if kept != (self._told or ((), ())):
            self._told = kept
            self.ctx.post(self._correct.refresh)

    def _look(self) -> None:
        state, desk = self.state, self._correct.open_desk
        if desk is None or state.labels is None:
            return
        frame = state.frame_id
        found = desk.news(frame)
        if found or desk.replaced(frame):
            self.ctx.post(lambda: self._correct.took(frame, found))
