"""*This pair is right*, under any answer: it becomes the truth by which the answer gets its verdict at once."""

from __future__ import annotations

import shlex

from pipeline.corrections.confirming import right_objects, right_pair, why_not_kept, words_of
from pipeline.corrections.journal.events import Saved
from pipeline.corrections.wording import outcome_text
from pipeline.language.tree import Query
from spatialviz.app.context import Context, command
from spatialviz.app.label_part import LabelPart
from spatialviz.app.markup import Element, button, h


class RightPair(LabelPart):
    """Says what is true of the question of one client."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._kept = ("", "")
        self._query: Query | None = None

    @command("right-pair")
    def confirm(self) -> None:
        """The chosen pair, or the first one, is right."""
        state, editor = self.state, self.editor
        pair = state.chosen or next(iter(state.ranked), None)
        if state.trace is None or pair is None or state.labels is not None:
            return
        outcome = editor.save(right_pair(editor, state.trace, pair))
        said, bad = outcome_text(outcome, "kept as true", editor.frame(state.frame_id))
        self._kept = (state.frame_id, state.text) if isinstance(outcome, Saved) else ("", "")
        self.ctx.toast("Not saved" if bad else "This pair is right", said, bad)
        self.ctx.ask(state.text)

    @command("right-undo")
    def take_back(self) -> None:
        """It is not, after all."""
        if self._kept != (self.state.frame_id, self.state.text):
            return
        outcome, self._kept = self.editor.undo(), ("", "")
        self.ctx.toast("Taken back", outcome_text(outcome, "taken back", None)[0])
        self.ctx.ask(self.state.text)

    @command("right-objects")
    def means(self) -> None:
        """The question that was asked last means the two objects that are chosen among the labels."""
        pair, query = self.state.pair, self._query
        if pair is None or query is None:
            return
        a, b = (self.view.numbers[k] for k in pair[:2])
        self.save(lambda frame: right_objects(frame, query, a, b))

    def follow(self) -> None:
        """Offer it under an answer that has a pair."""
        if self.state.trace is not None:
            self._query = self.state.trace.query
        self.ctx.page.show("right-pair", self._offer())

    def _offer(self) -> Element | None:
        state = self.state
        if state.labels is not None:
            if state.pair is None or self._query is None or words_of(self._query) is None:
                return None
            hint = "the two chosen objects become the true answer to the question"
            return h.div(button(f"“{self._query.text}” means this pair", "right-objects", hint), cls="rightpair panel")
        pair = state.chosen or next(iter(state.ranked), None)
        if state.trace is None or pair is None:
            return None
        if state.source not in self.ctx.shared.journals:
            return self._how_to_correct() if self.ctx.run is None and state.trace.frame.annotations else None
        if self._kept == (state.frame_id, state.text):
            back = button("Undo", "right-undo", "this pair is not right after all")
            return h.div(h.span("This pair is kept as true.", cls="dim"), back, cls="rightpair panel")
        known, why = state.judged is not None, why_not_kept(state.trace.root)
        if why or pair.reference is None:
            told = f"No truth is known here yet, and none is kept of this answer: {why}. Outline things under Label."
            return None if known or not why else h.div(told, cls="rightpair panel dim")
        hint = "it is kept as true, with its objects, and the answer is judged by it at once"
        made = button("This pair is right", "right-pair", hint, cls="try" if known else "try go")
        return h.div(made, None if known else h.span("No truth is known here yet.", cls="dim"), cls="rightpair panel")

    def _how_to_correct(self) -> Element:
        """What corrects the truth of a dataset that is opened without labels."""
        path = shlex.quote(str(self.ctx.source.dataset.root))
        commands = (f"spatialviz label {path} --out LABELS", f"spatialviz view {path} --labels LABELS")
        told = h.p("It is what the dataset's annotations say. Labels made of them can be corrected here:", cls="dim")
        return h.details(h.summary("Is the truth wrong?"), told, map(h.code, commands), cls="panel rightpair")
