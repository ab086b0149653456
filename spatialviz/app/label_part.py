"""Base of the page's parts showing or correcting labels: saves in the journal, and updates the page."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

from pipeline.corrections.journal.edits import Edits
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Saved
from pipeline.corrections.label_editor import ANYTHING, LabelEditor, Outcome, Target
from pipeline.corrections.object_card import LabelView
from pipeline.corrections.scene import labelled_objects
from pipeline.corrections.unsaved import JournalLocation
from pipeline.corrections.wording import consequences, outcome_text
from pipeline.diagnosis.whatif.answer_view import ShownObjects
from pipeline.system.errors import needed, require
from spatialviz.app.channel import Command
from spatialviz.app.context import Part
from spatialviz.app.state import State

NO_LABELS = "no labels are open: `spatialviz view DATASET --labels LABELS`"


class LabelPart(Part):
    """Part of a page showing or correcting labels of the current pipeline."""

    # Failures raise InputError, shown by `PageSession.handle`.

    @property
    def view(self) -> LabelView:
        """Shown labels; InputError without any."""
        return needed(self.state.labels, "show the labels first")

    @property
    def location(self) -> JournalLocation:
        """Location of the corrections; InputError without open labels."""
        return needed(self.ctx.shared.journals.get(self.state.source), NO_LABELS)

    @property
    def editor(self) -> LabelEditor:
        """Editor of the labels; InputError without open labels."""
        return needed(self.ctx.editors.of(self.state.source), NO_LABELS)

    @property
    def number(self) -> int | None:
        """Number of the selected labelled object."""
        view = self.state.labels
        return None if view is None else view.number(self.state.selected)

    @property
    def asked(self) -> str:
        """Name of the open item, else of the frame, by which the page says what its commands are about."""
        item = self.view.item
        return self.view.frame.frame if item is None else " ".join(map(str, item.plain))

    def check_asked(self) -> None:
        """Raise InputError for a command that was sent while the page still showed another item."""
        shown = self.ctx.shown
        require(shown in (None, self.asked), "the next item had not been shown yet: nothing was changed")

    def look_at(self, wanted: Target) -> None:
        """Show the labels of a frame, with a pair or an object."""
        self.ctx.editors.wanted = wanted
        if wanted.frame == self.state.frame_id:
            self.show()
            self.ctx.draw()
        else:
            self.ctx.open_frame(wanted.frame)

    def show(self) -> None:
        """Take the frame's labels and the wanted item into the state, without drawing; InputError without labels."""
        editors, state = self.ctx.editors, self.state
        wanted, editors.wanted = editors.wanted or ANYTHING, None
        editor = self.editor
        if state.loaded is None:
            return
        require(state.frame_id in editor, f"the labels have no frame {state.frame_id}")
        frame = editor.frame(state.frame_id)
        view = LabelView(frame)
        numbers: list[int] = []
        if wanted.frame == frame.frame:
            item = wanted.item
            asked = item.what if item is not None and item.kind == "expression" else None
            view = replace(view, relation=wanted.relation, item=item, expression=asked)
            numbers = [n for n in wanted.objects if n in frame.objects]
        self.state = _looking_at(state.unasked, view, numbers, numbers[0] if numbers else None)
        if wanted.frame != frame.frame and editor.disputed:
            self.ctx.handle(Command("conflict"))

    def renew(self) -> None:
        """Reload changed labels, keeping the selection and the chosen pair by number."""
        state, view = self.state, self.state.labels
        if view is not None:
            pair = [view.numbers[i] for i in state.pair or ()]
            view = replace(view, frame=self.editor.frame(state.frame_id))
            self.state = _looking_at(state, view, pair, self.number)

    def save(self, made: Callable[[EffectiveFrame], Edits], draw: bool = True) -> Outcome:
        """Save the edits of an action, made on the labels as seen by this client.

        InputError for an invalid action, or one that was meant for another item.
        """
        self.check_asked()
        outcome = self.editor.save(made(self.view.frame))
        self.came_to(outcome, "saved", draw)
        return outcome

    def came_to(self, outcome: Outcome, verb: str, draw: bool = True) -> None:
        """Show the outcome of an action, with its consequences."""
        before = None if self.state.labels is None else self.state.labels.frame
        said, bad = outcome_text(outcome, verb, before)
        undo = "" if bad or verb.startswith("taken") else "take-back"
        self.tell(said, bad, None if isinstance(outcome, Conflict) else before, undo)
        if isinstance(outcome, Saved):
            shown = [listener(outcome.events) for listener in self.ctx.editors.on_saved]
            # A listener that shows something else has drawn the page.
            draw &= not any(shown)
        if draw:
            self.ctx.draw()
        if isinstance(outcome, Conflict):
            self.ctx.handle(Command("conflict"))

    def tell(self, said: str, bad: bool = False, before: EffectiveFrame | None = None, undo: str = "") -> None:
        """Say what came of something, with the current labels, without drawing; `undo` is a command."""
        self.renew()
        view = self.state.labels
        if view is not None and before is not None and (followed := consequences(before, view.frame)):
            said = f"{said} · {followed}"
        self.ctx.editors.said = said, bad
        if said:
            title, _, text = re.sub(r"\b·\b", " ", said).partition(": ")
            self.ctx.toast(title[0].upper() + title[1:], text, bad and not self.editor.waiting, undo)


def _looking_at(state: State, view: LabelView, pair: Sequence[int], selected: int | None) -> State:
    """State with the labels of a view; pair and selection by number."""
    objects = labelled_objects(view.frame)
    return replace(
        state,
        labels=view,
        found=ShownObjects(objects, tuple(f"{o.label} {o.id}" for o in objects), {}),
        pair=view.places(*pair) if len(pair) > 1 else None,
        selected=None if selected is None else view.place(selected),
    )
