"""Everything of one client that shows, reviews and corrects labels; others' edits are looked for."""

from __future__ import annotations

import threading
from contextlib import suppress

from pipeline.corrections.unsaved import Waiting
from pipeline.system.errors import InputError
from spatialviz.app.context import Context
from spatialviz.app.correct import Correct
from spatialviz.app.label_object import LabelObject
from spatialviz.app.pixels import Pixels
from spatialviz.app.retrain_panel import RetrainPanel
from spatialviz.app.review_queue import ReviewQueue
from spatialviz.app.sentences import Conflicts, Sentences


class Labelling:
    """The labels of one client."""

    def __init__(self, ctx: Context) -> None:
        self.correct, self.pixels, self.object = Correct(ctx), Pixels(ctx), LabelObject(ctx)
        self._queue, self._retrain = ReviewQueue(ctx), RetrainPanel(ctx)
        self.parts = (
            self.correct, self.pixels, self.object, self._queue, self._retrain, Sentences(ctx), Conflicts(ctx),
        )  # fmt: skip
        if ctx.shared.journals:
            threading.Thread(target=_watch, args=(ctx, self.correct), daemon=True, name="labels-watch").start()

    def follow(self) -> None:
        """Bring the tabs of the labels up to the state."""
        for part in (self.correct, self._queue, self._retrain, self.pixels):
            part.follow()


PERIOD_SECONDS = 2.0


def _watch(ctx: Context, correct: Correct) -> None:
    """Ask the journal every few seconds, on a thread of its own, so that a slow one holds nobody up.

    What is found is handled on the page's own thread.
    """
    told = (), ()
    while not ctx.closed.wait(PERIOD_SECONDS):
        state, editor = ctx.state, ctx.editors.opened(ctx.state.source)
        if editor is None:
            continue
        # Where the journal cannot be read now, what waits says so already, and is tried again all the same.
        with suppress(InputError):
            for outcome in editor.retry() if editor.waiting else ():
                if not isinstance(outcome, Waiting):
                    ctx.post(lambda outcome=outcome: correct.came_to(outcome, "saved at last"))
            # Another page of the same author may have saved or decided something, too.
            kept = tuple((w.group, w.problem) for w in editor.waiting), editor.disputed
            if kept != told:
                told = kept
                ctx.post(correct.refresh)
        with suppress(InputError):
            frame = state.frame_id
            found = editor.news(frame) if state.labels is not None else ()
            if found or (state.labels is not None and editor.replaced(frame)):
                ctx.post(lambda frame=frame, found=found: correct.took(frame, found))
