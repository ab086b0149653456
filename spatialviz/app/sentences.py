"""Labelled expressions are looked at and corrected; who was faster is told, and decided on field by field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timezone

from pipeline.corrections.journal.edits import Edits, set_ambiguous, set_mark, set_status, set_text
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.object_card import ExpressionCard, set_answer
from pipeline.corrections.unsaved import Dispute, disputes
from pipeline.corrections.wording import ref_text, value_text
from pipeline.diagnosis.marks import MARKS
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command
from spatialviz.app.correct import Correct
from spatialviz.app.label_view import LabelView, paired
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State

NEXT_MARK = {None: "BAD_LABEL", "BAD_LABEL": "BAD_BOX", "BAD_BOX": None}


class Sentences(Part):
    """Corrects the expressions of the frame that one client looks at."""

    def __init__(self, ctx: Context, correct: Correct) -> None:
        super().__init__(ctx)
        self._correct = correct

    # ---- what is looked at --------------------------------------------------------------

    @command("expression")
    def select(self, name: str) -> None:
        """Look at an expression: its labelled pair is chosen, and its target selected."""
        state, view = self.state, self.state.labels
        card = None if view is None else next((c for c in view.expressions if c.id == name), None)
        if view is None or card is None:
            return
        ends = view.place(card.target_object), view.place(card.reference_object)
        pair = None if None in ends else tuple(p for p in ends if p is not None)
        relation = card.relation if pair is not None else view.relation
        view = replace(view, expression=name, relation=relation)
        self.ctx.show(labels=view, pair=pair or state.pair, selected=ends[0])

    @command("next-expression")
    def step(self, step: int) -> None:
        """Look at the next expression of the list."""
        view = self.state.labels
        if view is None or not view.expressions:
            return
        names = [c.id for c in view.expressions]
        at = names.index(view.expression) + step if view.expression in names else 0
        self.select(names[at % len(names)])

    @command("number")
    def select_object(self, number: int) -> None:
        """Select an object by its number in the labels."""
        state, view = self.state, self.state.labels
        place = None if view is None else view.place(number)
        if place is not None and place != state.selected:
            self.ctx.show(selected=place, pair=paired(state.pair, place, state.selected))

    @command("mend")
    def mend(self) -> None:
        """From the answer of the debugger to the labels that it is judged by: the labelled pair and its expression."""
        state = self.state
        judged = state.judged if isinstance(state.judged, Diagnosis) else None
        if state.labels is not None:
            return
        self._correct.show()
        state, view = self.state, self.state.labels
        if view is None:
            return
        if judged is not None:
            self.state = _of_case(state, view, judged)
        self.ctx.draw()

    @command("ambiguous")
    def _ambiguous(self) -> None:
        self._save(lambda frame, card: set_ambiguous(frame, card.id, not card.ambiguous))

    @command("edit-text")
    def _edit_text(self) -> None:
        self.ctx.page.call("sentence")

    @command("undo-group")
    def _undo_group(self, group: str) -> None:
        self._correct.taken_back("undo", group)

    # ---- edits ------------------------------------------------------------------------

    @command("true-of")
    def answer(self, said: str) -> None:
        """Say whether the expression is true of an object: "sure", "likely" or "no", of the selected one or "no:4".

        What is said already is taken off.
        """
        doubt, _, number = said.partition(":")
        state, view = self.state, self.state.labels
        if view is None or view.sentence is None or doubt not in ("sure", "likely", "no"):
            return
        if not number and state.selected is None:
            self._correct.refuse("select an object that the expression is true of")
            return
        which = int(number) if number else view.numbers[state.selected or 0]
        now = "no" if view.sentence.certainty(which) == doubt else doubt
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
        desk = self._correct.desk
        author = "" if desk is None else desk.author

        def made(frame: EffectiveFrame, card: ExpressionCard) -> Edits:
            cell = FieldRef("expression", card.frame, card.id, "status")
            return set_status(frame, cell, None if card.statuses.get(author) == status else status, author=author)

        self._save(made)

    @command("expression-text")
    def reword(self, text: str) -> None:
        """Another sentence for the same question."""
        view = self.state.labels
        words = " ".join(text.split())
        if view is not None and view.sentence is not None and view.sentence.text != words:
            self._save(lambda frame, card: set_text(frame, card.id, words))

    def _save(self, made: Callable[[EffectiveFrame, ExpressionCard], Edits]) -> None:
        view = self.state.labels
        card = None if view is None else view.sentence
        if view is None:
            return
        if card is None:
            self._correct.refuse("choose an expression first")
            return
        self._correct.save(lambda frame: made(frame, card))

    @command("author")
    def sign(self, author: str) -> None:
        """Save what follows under another name, and have the browser remember it."""
        try:
            self._correct.sign(author)
        except InputError as error:
            self._correct.refuse(str(error))
            return
        self.ctx.page.call("author", author.strip())
        self.ctx.draw()


def _of_case(state: State, view: LabelView, judged: Diagnosis) -> State:
    """The state with the labelled pair of a case chosen, and its expression, as far as they still are there."""
    case, numbers = judged.case, judged.truth.numbers
    ends = [view.place(int(numbers[k])) for k in (case.target_object, case.reference_object)]
    pair = None if None in ends or ends[0] == ends[1] else tuple(p for p in ends if p is not None)
    name = case.id if case.id in view.frame.sentences else None
    return replace(state, labels=replace(view, expression=name, relation=case.relation), pair=pair, selected=ends[0])


class Conflicts(Part):
    """Shows the conflicts of one client, the oldest first."""

    def __init__(self, ctx: Context, correct: Correct) -> None:
        super().__init__(ctx)
        self._correct = correct

    def _first(self) -> Conflict | None:
        desk = self._correct.desk
        return None if desk is None or not desk.disputed else desk.disputed[0]

    @command("conflict")
    def show(self) -> None:
        """Show the oldest conflict that is not decided."""
        conflict, desk = self._first(), self._correct.desk
        if conflict is None or desk is None:
            return
        frame = self._correct.frame_of(conflict)
        found = disputes(conflict, desk.corrector.setting)
        mine = h.button("Mine instead (M)", do="decide:0", aria_keyshortcuts="M")
        theirs = h.button("Keep theirs (T)", do="decide:", aria_keyshortcuts="T")
        save = h.button("Save as chosen", local="checked:decide:")
        buttons = (save,) if len(found) > 1 else (mine, theirs)
        self.ctx.dialog.show("Somebody was faster", conflict_html(found, frame), *buttons)

    @command("decide")
    def decide(self, mine: str) -> None:
        """Save one's own in the disputes that are named: "0,2"."""
        conflict, desk = self._first(), self._correct.desk
        self.ctx.dialog.close()
        if conflict is None or desk is None:
            return
        chosen = {int(k) for k in mine.split(",") if k.isdecimal()}
        try:
            outcome = desk.decide(conflict, chosen)
        except InputError as error:
            self._correct.refuse(str(error))
            return
        if outcome is None:
            self._correct.tell("kept as the other one has it")
        else:
            self._correct.came_to(outcome, "saved instead of theirs")
        if self._first() is not None:
            self.show()


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
