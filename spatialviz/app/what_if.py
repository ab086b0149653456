"""What-if edits of a client's question, answered at interactive speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

from pipeline.answering.ask import Trace
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif import Baseline, Edits, rerun
from pipeline.diagnosis.whatif.answer_view import BothAnswers
from pipeline.diagnosis.whatif.changes import each_edit, without_edit
from pipeline.diagnosis.whatif.edit_words import edit_from_words
from pipeline.geometry.boxes import Box3D
from pipeline.language.counted import counted
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, choice, command
from spatialviz.app.edit_panel import cost_html, edit_html
from spatialviz.app.edit_scene import MODES, BoxGizmo, EditScene

UNDOS = 200
Judge = Callable[[Trace, RankConfig | None], Diagnosis | str | None]


class WhatIf(Part):
    """Edits a client's question."""

    def __init__(self, ctx: Context, judge: Judge) -> None:
        super().__init__(ctx)
        self._judge = judge
        self._baseline: Baseline | None = None
        self._judged: Diagnosis | str | None = None
        self._of: tuple[str, str, str] | None = None
        self._undo: list[Edits] = []
        self._live_since: Edits | None = None
        self._held: str | None = None
        self._gizmo = BoxGizmo(ctx, self._dragged)
        self._shown = EditScene(ctx)

    # ---- questions ------------------------------------------------------------------

    def check(self) -> None:
        """Drop edits of a former question."""
        asked = self._asked()
        if self._of is None or asked == self._of:
            return
        if self.state.edits:
            count = len(each_edit(self.state.edits))
            self.ctx.note(f"{counted(count, 'edit')} dropped: of “{self._of[2]}” in frame {self._of[1]}")
        self.state = replace(self.state, edits=Edits(), edited=None)
        self._undo, self._of, self._baseline, self._live_since = [], None, None, None

    def answered(self) -> None:
        """Edit a new answer again if to the edited question."""
        self.check()
        if self.state.edits:
            self._judged = self.state.judged
            self._apply(self.state.edits)

    def _asked(self) -> tuple[str, str, str] | None:
        state = self.state
        return None if state.trace is None else (state.source, state.frame_id, state.trace.query.text)

    def _base(self) -> Baseline:
        """Question without edits, read once."""
        state, asked = self.state, self._asked()
        if asked is None or state.loaded is None:
            raise InputError("nothing is asked: edits are of a question")
        if self._baseline is None or self._of != asked:
            self._baseline, self._of = Baseline(self.ctx.source, state.loaded.context, asked[2]), asked
            # The shown answer is still without edits.
            self._judged = state.judged
        return self._baseline

    # ---- edits ----------------------------------------------------------------------

    @command("edit", "edit-live")
    def _edit(self, said: str, by: str) -> None:
        """Apply an edit such as "size:1:0.2"; live edits of a drag form a single step."""
        live = by == "edit-live"
        self._try(lambda: edit_from_words(said, self.state, self.ctx.source, self.keys(self._base())), live)

    def _try(self, change: Callable[[], Edits], live: bool = False) -> None:
        try:
            edits = change()
            before = self.state.edits if self._live_since is None else self._live_since
            self._live_since = before if live else None
            if not live and edits != before:
                self._undo = [*self._undo, before][-UNDOS:]
            self._apply(edits)
        except InputError as error:
            self._live_since = None
            self.ctx.toast("Not edited", str(error), bad=True)
        self.ctx.draw(live)

    @command("edit-remove")
    def _remove(self, id: str) -> None:
        self._try(lambda: without_edit(self.state.edits, id))

    @command("edit-undo")
    def _undo_last(self) -> None:
        if self._undo:
            edits, self._undo = self._undo[-1], self._undo[:-1]
            self._apply(edits)
            self.ctx.draw()

    @command("edit-reset")
    def _reset(self) -> None:
        if self.state.edits:
            self._try(Edits)

    def _apply(self, edits: Edits) -> None:
        """Answer again, and take the answer into the state."""
        baseline = self._base()
        start = perf_counter()
        outcome = rerun(baseline, edits)
        seconds = perf_counter() - start
        rank = replace(baseline.source.config.rank, **edits.rank) if edits.rank else None
        judged = self._judge(outcome.trace, rank) if edits else self._judged
        edited = BothAnswers(baseline.outcome, outcome, self._judged, seconds)
        self.state = self.state.under(edits, edited, judged, self.keys(baseline))

    def keys(self, baseline: Baseline) -> tuple[str, ...]:
        """Keys of the shown answer's objects."""
        edited = self.state.edited
        return baseline.outcome.keys if edited is None else edited.after.keys

    # ---- dragging -------------------------------------------------------------------

    def _dragged(self, box: Box3D, ended: bool) -> None:
        key = self._held
        if key is not None and self.state.loaded is not None:
            self._try(lambda: self.state.edits.with_box(key, box), live=not ended)

    @command("edit-mode")
    def _set_mode(self, mode: str) -> None:
        state, chosen = self.state, choice(MODES, self.state.mode, mode)
        if chosen is not None and state.labels is None:
            selected = state.pair[0] if state.selected is None and state.pair is not None else state.selected
            self.ctx.show(mode=chosen, selected=selected)

    # ---- drawing --------------------------------------------------------------------

    def _selected_key(self) -> str | None:
        """Key of the selected object; None if not a candidate."""
        i = self.state.selected
        if i is None or i not in self.state.shown.place.values():
            return None
        return self.state.key_at(i, self.keys(self._base()))

    def follow(self, live: bool = False) -> None:
        """Draw handles, edits and the Edit tab for the state."""
        state, selected = self.state, self.state.selected
        if state.labels is not None:
            self._gizmo.show(None, "off")
            self.ctx.page.show("cost")
            return
        candidate = selected is not None and selected in state.shown.place.values()
        box = None
        if selected is not None and candidate and state.mode != "off":
            box, self._held = state.shown.objects[selected].lifted.box, self._selected_key()
        self._gizmo.show(None if box is None else self.ctx.scene.shown_box(box), state.mode)
        self._shown.draw(state)
        # Without objects there is nothing to edit.
        self.ctx.page.show("cost", cost_html(state, len(self._undo)) if state.shown.objects else None)
        if not live:
            hidden = selected is not None and f"#{state.shown.objects[selected].id}" in state.edits.hidden
            trace, editable = state.trace, candidate or hidden
            self.ctx.page.show("edit", None if trace is None else edit_html(state, trace, self.ctx.source, editable))
