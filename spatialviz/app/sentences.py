"""Labelled expressions are looked at and corrected; who was faster is told, and decided on field by field."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timezone

from pipeline.corrections.journal.edits import Edits, set_ambiguous, set_mark, set_status, set_text
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.object_card import ExpressionCard, set_answer
from pipeline.corrections.unsaved import Dispute, disputes
from pipeline.corrections.wording import ref_text, value_text
from pipeline.diagnosis.marks import MARKS
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.system.errors import InputError, needed
from spatialviz.app.context import command, there
from spatialviz.app.label_part import LabelPart
from spatialviz.app.label_view import paired
from spatialviz.app.markup import Element, h

NEXT_MARK = {None: "BAD_LABEL", "BAD_LABEL": "BAD_BOX", "BAD_BOX": None}


class Sentences(LabelPart):
    """Corrects the expressions of the frame that one client looks at."""

    # ---- what is looked at --------------------------------------------------------------

    @command("expression")
    def select(self, name: str) -> None:
        """Look at an expression: its labelled pair is chosen, and its target selected."""
        view = self.view
        card = there(next((c for c in view.expressions if c.id == name), None))
        pair = view.places(card.target_object, card.reference_object)
        relation = view.relation if pair is None else card.relation
        selected = view.place(card.target_object)
        view = replace(view, expression=name, relation=relation)
        self.ctx.show(labels=view, pair=pair or self.state.pair, selected=selected)

    @command("next-expression")
    def step(self, step: int) -> None:
        """Look at the next expression of the list."""
        names, now = [c.id for c in self.view.expressions], self.view.expression
        if names:
            self.select(names[(names.index(now) + step if now in names else 0) % len(names)])

    @command("number")
    def select_object(self, number: int) -> None:
        """Select an object by its number in the labels."""
        state, place = self.state, self.view.place(number)
        if place is not None and place != state.selected:
            self.ctx.show(selected=place, pair=paired(state.pair, place, state.selected))

    @command("mend")
    def mend(self) -> None:
        """From the answer of the debugger to the labels that it is judged by: the labelled pair and its expression."""
        judged = self.state.judged
        if self.state.labels is not None:
            return
        self.show()
        if isinstance(judged, Diagnosis):
            # As far as they still are there.
            view, case = self.view, judged.case
            target, reference = (int(judged.truth.numbers[k]) for k in (case.target_object, case.reference_object))
            pair = None if target == reference else view.places(target, reference)
            name = case.id if case.id in view.frame.sentences else None
            view = replace(view, expression=name, relation=case.relation)
            self.state = replace(self.state, labels=view, pair=pair, selected=view.place(target))
        self.ctx.draw()

    @command("edit-text")
    def _edit_text(self) -> None:
        self.ctx.page.call("sentence")

    # ---- edits ------------------------------------------------------------------------

    def _save(self, made: Callable[[EffectiveFrame, ExpressionCard], Edits]) -> None:
        card = needed(self.view.sentence, "choose an expression first")
        self.save(lambda frame: made(frame, card))

    @command("ambiguous")
    def _ambiguous(self) -> None:
        self._save(lambda frame, card: set_ambiguous(frame, card.id, not card.ambiguous))

    @command("true-of")
    def answer(self, said: str) -> None:
        """Say whether the expression is true of an object: "sure", "likely" or "no", of the selected one or "no:4".

        What is said already is taken off.
        """
        certainty, _, number = said.partition(":")
        sentence = there(self.view.sentence)
        if certainty in ("sure", "likely", "no"):
            which = needed(int(number) if number else self.number, "select an object that the expression is true of")
            now = "no" if sentence.certainty(which) == certainty else certainty
            self._save(lambda frame, card: set_answer(frame, card.id, which, now))

    @command("mark")
    def mark(self, mark: str) -> None:
        """Mark the expression BAD_LABEL or BAD_BOX, the same mark again takes it off; "next" steps through them."""
        wanted = mark if mark in MARKS else None

        def made(frame: EffectiveFrame, card: ExpressionCard) -> Edits:
            now = NEXT_MARK[card.mark] if mark == "next" else None if card.mark == wanted else wanted
            return set_mark(frame, card.id, now)

        self._save(made)

    @command("expression-status")
    def status(self, status: str) -> None:
        """Accept or reject the expression as this person sees it; the same again takes it back."""
        author = self.editor.author

        def made(frame: EffectiveFrame, card: ExpressionCard) -> Edits:
            cell = FieldRef("expression", card.frame, card.id, "status")
            return set_status(frame, cell, None if card.statuses.get(author) == status else status, author=author)

        self._save(made)

    @command("expression-text")
    def reword(self, text: str) -> None:
        """Another sentence for the same question."""
        words, sentence = " ".join(text.split()), self.view.sentence
        if sentence is not None and sentence.text != words:
            self._save(lambda frame, card: set_text(frame, card.id, words))


class Conflicts(LabelPart):
    """Shows the conflicts of one client, the oldest first."""

    @command("conflict")
    def show_first(self) -> None:
        """Show the oldest conflict that is not decided."""
        if not self.editor.disputed:
            return
        conflict, frame = self.editor.disputed[0], None
        # As the labels are now, where they can be read.
        with suppress(InputError):
            frame = self.editor.frame(conflict.rivals[0].edit.ref.frame)
        found = disputes(conflict, self.editor.corrector.setting)
        one = (
            h.button("Mine instead (M)", do="decide:0", aria_keyshortcuts="M"),
            h.button("Keep theirs (T)", do="decide:", aria_keyshortcuts="T"),
        )
        buttons = one if len(found) == 1 else (h.button("Save as chosen", local="checked:decide:"),)
        self.ctx.dialog.show("Somebody was faster", conflict_html(found, frame), *buttons)

    @command("decide")
    def decide(self, mine: str) -> None:
        """Save one's own in the disputes that are named: "0,2"."""
        self.ctx.dialog.close()
        if not self.editor.disputed:
            return
        outcome = self.editor.decide(self.editor.disputed[0], {int(k) for k in mine.split(",") if k.isdecimal()})
        if outcome is None:
            self.tell("kept as the other one has it")
            self.ctx.draw()
        else:
            self.came_to(outcome, "saved instead of theirs")
        self.show_first()


def conflict_html(found: tuple[Dispute, ...], frame: EffectiveFrame | None) -> Element:
    """Each disputed field: who made it what and when, and what one wanted."""
    rows = []
    for k, dispute in enumerate(found):
        rival = dispute.rivals[0]
        event, cell, edit = rival.event, rival.edit.ref, rival.edit
        what = ref_text(cell, frame)
        if event is None:
            theirs, who = "not what you saw", "It was taken back in the meantime"
        else:
            theirs = value_text(cell, event.after, frame)
            reason = f" · {event.reason}" if event.reason else ""
            who = (h.b(event.author), f" changed it {_when(event.time)}{reason}")
        values = (
            ("you saw", value_text(cell, edit.before, frame)),
            ("theirs", theirs),
            ("yours", value_text(cell, edit.after, frame)),
        )
        rows.append(
            h.div(
                h.div(what, cls="what"),
                h.div(who, cls="dim"),
                h.div(((h.span(whose), h.b(value)) for whose, value in values), cls="two"),
                _choice(k, what) if len(found) > 1 else None,
                cls="dispute",
            )
        )
    said = (
        "Nothing of yours was saved, and nothing of theirs is lost."
        if len(found) == 1
        else ("Nothing of yours was saved yet, and nothing of theirs is lost. Choose for each field.")
    )
    return h.div(h.div(said), rows, cls="conflict")


def _choice(k: int, what: str) -> Element:
    """Theirs or one's own of a disputed field; what is checked is sent when all is decided."""
    name = f"dispute-{k}"
    theirs = h.label(h.input(type="radio", name=name, value="", checked=True), "keep theirs")
    mine = h.label(h.input(type="radio", name=name, value=k), "mine instead")
    return h.fieldset(h.legend(what, cls="unseen"), theirs, mine, cls="seg pick")


def _when(time: datetime) -> str:
    seconds = (datetime.now(timezone.utc) - time).total_seconds()
    clock = time.strftime("%Y-%m-%d %H:%M:%S UTC")
    return f"{seconds:.0f} s ago ({clock})" if 0 <= seconds < 120 else f"at {clock}"
