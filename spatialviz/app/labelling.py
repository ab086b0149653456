"""Labels of a client: composition of the parts, choice of pairs, undo.

Polls for other people's edits. *This pair is correct*, under any answer, immediately becomes the truth of that answer.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from pydantic import NonNegativeInt

from pipeline.corrections.journal.events import Event, Saved
from pipeline.corrections.judging import right_pair, why_not_kept
from pipeline.corrections.label_editor import Target
from pipeline.corrections.unsaved import Waiting
from pipeline.corrections.wording import events_text, outcome_text
from pipeline.system.errors import InputError, needed, require
from spatialviz.app.answer import mend_button
from spatialviz.app.carry_panel import CarryPanel
from spatialviz.app.context import Context, command, there
from spatialviz.app.label_object import LabelObject, SidePanel
from spatialviz.app.label_part import LabelPart
from spatialviz.app.markup import Element, button, h
from spatialviz.app.pixels import Pixels
from spatialviz.app.retrain_panel import RetrainPanel
from spatialviz.app.review_html import pair_html, review_head_html
from spatialviz.app.review_queue import ReviewQueue
from spatialviz.app.sentences import Conflicts, Sentences


class Labelling(LabelPart):
    """Shows the labels of a client's current pipeline, and undoes this person's edits."""

    def __init__(
        self,
        ctx: Context,
        ask: Callable[[str], None],
        reopen: Callable[[], None],
    ) -> None:
        super().__init__(ctx)
        self._reopen, self._ask = reopen, ask
        self._kept = ("", "")  # Frame and question whose pair was confirmed
        shown = LabelObject(ctx)
        self._following = (
            shown,
            CarryPanel(ctx, shown.picture),
            ReviewQueue(ctx),
            RetrainPanel(ctx),
            Pixels(ctx),
            SidePanel(ctx),
        )
        # All parts with commands
        self.parts = self, *self._following, Sentences(ctx), Conflicts(ctx)
        if ctx.shared.journals:
            threading.Thread(target=_watch, args=(ctx, self), daemon=True, name="labels-watch").start()

    # ---- display ----------------------------------------------------------------------

    @command("labels-at")
    def look_at_pair(self, a: NonNegativeInt, b: NonNegativeInt, relation: str, frame: str) -> None:
        self.look_at(Target(frame, (a, b), relation or None))

    @command("labels")
    def toggle(self) -> None:
        """Switch between labels and answer."""
        if self.state.labels is not None:
            self.state = replace(self.state, labels=None)
            self._reopen()
        else:
            self.show()
            self.ctx.draw()

    def detail(self) -> None:
        """Update card, expressions and history after a change of the chosen pair or selection."""
        state, view = self.state, self.state.labels
        if view is not None:
            self.state = replace(state, labels=view.detailed(self.editor, state.pair, state.selected))

    def follow(self) -> None:
        """Update all label panels beside the scene."""
        state, journals = self.state, self.ctx.shared.journals
        if journals:
            head = review_head_html(state, state.source in journals, self.ctx.editors.opened(state.source))
            self.ctx.page.fill({"review-head": head, "review-pair": pair_html(state)})
        self.ctx.page.show("right-pair", self._offer())
        for part in self._following:
            part.follow()

    def refresh(self) -> None:
        """Show the unsaved edits on the current labels."""
        self.renew()
        self.ctx.draw()

    def took(self, frame: str, events: tuple[Event, ...]) -> None:
        """Reload a frame after other people's edits or a replaced journal, and show a notice."""
        if self.state.labels is None or self.state.frame_id != frame:
            return
        events = tuple(e for e in events if not self.editor.has_seen(e))
        if self.editor.replaced(frame):
            self.tell("the journal was replaced by another, such as an older copy: this is what it has", True)
        elif events:
            self.tell(f"{events[-1].author}: {events_text(events[::-1], self.view.frame)}")
        self.ctx.draw()

    # ---- undo -------------------------------------------------------------------------

    @command("take-back=undo", "bring-back=redo")
    def taken_back(self, which: str, group: str | None = None) -> None:
        """Undo or redo the author's newest action, or undo the action of a group."""
        require(self.state.labels is not None, "show the labels first")
        outcome = self.editor.undo(group) if which == "undo" else self.editor.redo()
        self.came_to(needed(outcome, f"nothing to {which}"), "taken back" if which == "undo" else "brought back")

    @command("undo-group")
    def undo_group(self, group: str) -> None:
        """Undo the author's action of a group."""
        self.taken_back("undo", group)

    @command("save-again")
    def save_again(self) -> None:
        """Retry saving the pending edits."""
        for outcome in self.editor.retry():
            self.came_to(outcome, "saved")

    @command("author")
    def sign(self, author: str) -> None:
        """Change the author's name, remembered by the browser."""
        self.ctx.editors.sign(author)
        self.ctx.page.call("author", author.strip())
        self.ctx.draw()

    # ---- pairs ------------------------------------------------------------------------

    @command("swap")
    def swap(self) -> None:
        pair = self.state.pair
        if pair is not None and self.state.labels is not None:
            self.ctx.show(pair=(pair[1], pair[0]))

    @command("relation-row")
    def focus_relation(self, relation: str) -> None:
        """Focus a relation of the pair."""
        if relation in self.view.relations:
            self.ctx.show(labels=replace(self.view, relation=relation))

    @command("next-row")
    def step_relation(self, step: int) -> None:
        """Focus the next relation of the pair."""
        names, now = self.view.relations, self.view.relation
        if names:
            self.focus_relation(names[((names.index(now) if now in names else 0) + step) % len(names)])

    # ---- the truth of a question --------------------------------------------------------

    @command("right-pair")
    def confirm(self, shown: str) -> None:
        """Confirm the chosen pair, or the first, as right, while it is the `shown` one."""
        state, editor = self.state, self.editor
        pair = state.chosen or next(iter(state.ranked), None)
        if state.labels is None:
            require(shown == self._answered, "another answer had not been shown yet: nothing was kept")
            outcome = editor.save(right_pair(editor, there(state.trace), there(pair)))
            said, bad = outcome_text(outcome, "kept as true", editor.frame(state.frame_id))
            self._kept = (state.frame_id, state.text) if isinstance(outcome, Saved) else ("", "")
            self.ctx.toast("Not saved" if bad else "This pair is correct", said, bad)
            self._ask(state.text)

    @property
    def _answered(self) -> str:
        """Frame, pair and question of what `confirm` is about."""
        state = self.state
        pair = state.chosen or next(iter(state.ranked), None)
        return f"{state.frame_id} {None if pair is None else state.at(pair)} {state.text}"

    @command("right-undo")
    def take_back(self) -> None:
        """Undo the confirmation."""
        if self._kept == (self.state.frame_id, self.state.text):
            outcome, self._kept = self.editor.undo(), ("", "")
            self.ctx.toast("Taken back", outcome_text(outcome, "taken back", None)[0])
            self._ask(self.state.text)

    def _offer(self) -> Element | None:
        """Ways from an answer to its label: the labelled pair, or the answered one as right."""
        state = self.state
        pair = state.chosen or next(iter(state.ranked), None)
        if state.labels is not None or state.source not in self.ctx.shared.journals:
            return None
        wrong, made, told = mend_button(state), None, None
        if self._kept == (state.frame_id, state.text):
            told, made = (
                "This pair is kept as correct.",
                button("Undo", "right-undo", "this pair is not correct after all"),
            )
        elif state.trace is not None and pair is not None:
            known, why = state.judged is not None, why_not_kept(state.trace.root)
            told = None if known else "No truth is known here yet."
            if not why and pair.reference is not None:
                hint = "it is kept as true, with its objects, and the answer is judged by it at once"
                made = button("This pair is correct", f"right-pair:{self._answered}", hint, cls="" if known else "go")
            elif told and why:
                told += f" None is kept of this answer: {why}. Outline things under Label."
        if not any((wrong, made, told)):
            return None
        ways: Element | None = wrong or made
        if wrong and made and not told:
            choices = h.div(wrong.with_(cls=""), made.with_(cls=""))
            ways = h.details(h.summary("Label is wrong"), choices, cls="menu up")
        elif told:
            ways = h.span(wrong, made, cls="chips")
        return h.div(h.span(told, cls="sub") if told else None, ways, cls="rightpair panel")


PERIOD_SECONDS = 2.0


def _watch(ctx: Context, labels: Labelling) -> None:
    """Poll the journal every few seconds on a separate thread, so that a slow journal blocks nobody."""
    told = (), ()
    while not ctx.closed.wait(PERIOD_SECONDS):
        state, editor = ctx.state, ctx.editors.opened(ctx.state.source)
        if editor is None:
            continue
        # Unsaved edits already show an unreadable journal, and are retried.
        with suppress(InputError):
            for outcome in editor.retry() if editor.waiting else ():
                if not isinstance(outcome, Waiting):
                    ctx.post(lambda outcome=outcome: labels.came_to(outcome, "saved at last"))
            # Another page of the same author may have saved or decided, too.
            kept = tuple((w.group, w.problem) for w in editor.waiting), editor.disputed
            if kept != told:
                told = kept
                ctx.post(labels.refresh)
        with suppress(InputError):
            frame = state.frame_id
            found = editor.news(frame) if state.labels is not None else ()
            if found or (state.labels is not None and editor.replaced(frame)):
                ctx.post(lambda frame=frame, found=found: labels.took(frame, found))
