"""The labels of one client: they are shown and put together here, pairs are looked at, what was done is taken back.

What others save meanwhile is looked for.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import replace

from pipeline.corrections.journal.events import Event
from pipeline.corrections.object_card import expression_cards
from pipeline.corrections.scene import pair_card
from pipeline.corrections.unsaved import Waiting
from pipeline.corrections.wording import events_text
from pipeline.system.errors import InputError, needed, require
from spatialviz.app.context import Context, command
from spatialviz.app.label_object import LabelObject
from spatialviz.app.label_part import LabelPart
from spatialviz.app.label_view import LabelView, Target
from spatialviz.app.pixels import Pixels
from spatialviz.app.retrain_panel import RetrainPanel
from spatialviz.app.review_html import pair_html, review_head_html
from spatialviz.app.review_queue import ReviewQueue
from spatialviz.app.right_pair import RightPair
from spatialviz.app.sentences import Conflicts, Sentences
from spatialviz.app.side_panel import SidePanel


class Labelling(LabelPart):
    """Shows the labels of the source that a client looks at, and takes back what they did to them.

    Attributes
    ----------
    parts : tuple of Part
        All that have commands, with this one.
    pixels : Pixels
    object : LabelObject
    """

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self.pixels, self.object = Pixels(ctx), LabelObject(ctx)
        self._following = ReviewQueue(ctx), RetrainPanel(ctx), self.pixels, SidePanel(ctx), RightPair(ctx)
        self.parts = self, self.object, *self._following, Sentences(ctx), Conflicts(ctx)
        if ctx.shared.journals:
            threading.Thread(target=_watch, args=(ctx, self), daemon=True, name="labels-watch").start()

    # ---- what is shown ----------------------------------------------------------------

    @command("labels-at")
    def look_at_pair(self, said: str) -> None:
        """Show a pair: "a,b,relation,frame"."""
        a, b, relation, frame = (said.split(",", 3) + [""] * 3)[:4]
        if a.isdecimal() and b.isdecimal() and frame:
            self.look_at(Target(frame, (int(a), int(b)), relation or None))

    @command("labels")
    def toggle(self) -> None:
        """Show the labels, or the answer again."""
        if self.state.labels is not None:
            self.state = replace(self.state, labels=None)
            self.ctx.reopen()
            return
        self.show()
        self.ctx.draw()

    def detail(self) -> None:
        """The chosen pair, or what is selected, may be another: its card, its expressions and its history follow."""
        state, view = self.state, self.state.labels
        if view is None:
            return
        ends = None if state.pair is None else (view.numbers[state.pair[0]], view.numbers[state.pair[1]])
        pair = None if ends is None or ends[0] == ends[1] else ends
        view = replace(view, card=None if pair is None else pair_card(view.frame, *pair))
        names, sentence = _relations(view), view.sentence
        relation = view.relation if view.relation in names else next(iter(names), None)
        about = view.about if pair is None or (sentence is not None and sentence.is_of(pair)) else pair
        objects = () if self.number is None else (self.number,)
        lines = self.editor.history(view.frame.frame, objects=objects, pair=pair, expression=view.expression)
        view = replace(
            view, relation=relation, about=about, expressions=expression_cards(view.frame, about), history=lines,
            author=self.editor.author,
        )  # fmt: skip
        self.state = replace(state, labels=view)

    def follow(self) -> None:
        """Bring everything beside the scene that is of labels up to the state."""
        state, journals = self.state, self.ctx.shared.journals
        if journals:
            head = review_head_html(state, state.source in journals, self.ctx.editors.opened(state.source))
            self.ctx.page.show("review-head", head)
            self.ctx.page.show("review-pair", pair_html(state))
        for part in self._following:
            part.follow()

    def refresh(self) -> None:
        """Show what waits, and what it is made on, as it is now."""
        self.renew()
        self.ctx.draw()

    def took(self, frame: str, events: tuple[Event, ...]) -> None:
        """Others have saved something in a frame, or put another journal in its place: look at it, and say so."""
        if self.state.labels is None or self.state.frame_id != frame:
            return
        events = tuple(e for e in events if not self.editor.has_seen(e))
        if self.editor.replaced(frame):
            self.tell("the journal was replaced by another, such as an older copy: this is what it has", True)
        elif events:
            self.tell(f"{events[-1].author}: {events_text(events[::-1], self.view.frame)}")
        self.ctx.draw()

    # ---- what was done ----------------------------------------------------------------

    @command("take-back=undo", "bring-back=redo")
    def taken_back(self, which: str, group: str | None = None) -> None:
        """Undo or redo one's newest action, or undo the one of a group."""
        require(self.state.labels is not None, "show the labels first")
        outcome = self.editor.undo(group) if which == "undo" else self.editor.redo()
        self.came_to(needed(outcome, f"nothing to {which}"), "taken back" if which == "undo" else "brought back")

    @command("undo-group")
    def undo_group(self, group: str) -> None:
        """Undo one's action of a group."""
        self.taken_back("undo", group)

    @command("save-again")
    def save_again(self) -> None:
        """Try to save what waits."""
        for outcome in self.editor.retry():
            self.came_to(outcome, "saved")

    @command("author")
    def sign(self, author: str) -> None:
        """Save what follows under another name, and have the browser remember it."""
        self.ctx.editors.sign(author)
        self.ctx.page.call("author", author.strip())
        self.ctx.draw()

    # ---- pairs ------------------------------------------------------------------------

    @command("swap")
    def swap(self) -> None:
        """The pair the other way round."""
        pair = self.state.pair
        if pair is not None and self.state.labels is not None:
            self.ctx.show(pair=(pair[1], pair[0]))

    @command("relation-row")
    def focus_relation(self, relation: str) -> None:
        """Look at a relation of the pair."""
        if relation in _relations(self.view):
            self.ctx.show(labels=replace(self.view, relation=relation))

    @command("next-row")
    def step_relation(self, step: int) -> None:
        """Look at the next relation of the pair."""
        names, now = _relations(self.view), self.view.relation
        if names:
            self.focus_relation(names[((names.index(now) if now in names else 0) + step) % len(names)])


def _relations(view: LabelView) -> list[str]:
    return [] if view.card is None else [line.relation for line in view.card.lines]


PERIOD_SECONDS = 2.0


def _watch(ctx: Context, labels: Labelling) -> None:
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
                    ctx.post(lambda outcome=outcome: labels.came_to(outcome, "saved at last"))
            # Another page of the same author may have saved or decided something, too.
            kept = tuple((w.group, w.problem) for w in editor.waiting), editor.disputed
            if kept != told:
                told = kept
                ctx.post(labels.refresh)
        with suppress(InputError):
            frame = state.frame_id
            found = editor.news(frame) if state.labels is not None else ()
            if found or (state.labels is not None and editor.replaced(frame)):
                ctx.post(lambda frame=frame, found=found: labels.took(frame, found))
