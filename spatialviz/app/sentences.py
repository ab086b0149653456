"""The Answer tab while labels are shown: expressions are looked at, stepped through, and corrected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pipeline.corrections.journal.edits import Edits, set_ambiguous, set_mark, set_status, set_text
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.object_card import ExpressionCard, set_answer
from pipeline.diagnosis.marks import MARKS
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.system.errors import InputError
from spatialviz.app.conflict import Conflicts
from spatialviz.app.correct import Correct
from spatialviz.app.dialog import Dialog
from spatialviz.app.label_view import LabelView, paired
from spatialviz.app.layout import Page
from spatialviz.app.state import State

NEXT_MARK = {None: "BAD_LABEL", "BAD_LABEL": "BAD_BOX", "BAD_BOX": None}


class Sentences:
    """Corrects the expressions of the frame that one client looks at.

    Parameters
    ----------
    correct : Correct
        Saves what is done.
    page : Page
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    draw : callable
    """

    def __init__(
        self,
        correct: Correct,
        page: Page,
        *,
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[], None],
    ) -> None:
        self._correct, self._page = correct, page
        self._state, self._take, self._draw = state, take, draw

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "expression": self.select,
            "next-expression": lambda step: self.step(int(step)),
            "number": lambda number: self.select_object(int(number)),
            "true-of": self.answer,
            "ambiguous": lambda _: self._save(lambda f, c: set_ambiguous(f, c.id, not c.ambiguous)),
            "mark": self.mark,
            "expression-status": self.status,
            "expression-text": self.reword,
            "edit-text": lambda _: self._page.call("sentence"),
            "undo-group": lambda group: self._correct.taken_back("undo", group),
            "mend": lambda _: self.mend(),
            "author": self.sign,
        }

    # ---- what is looked at --------------------------------------------------------------

    def select(self, name: str) -> None:
        """Look at an expression: its labelled pair is chosen, and its target selected."""
        state, view = self._state(), self._state().labels
        card = None if view is None else next((c for c in view.expressions if c.id == name), None)
        if view is None or card is None:
            return
        ends = view.place(card.target_object), view.place(card.reference_object)
        pair = None if None in ends else tuple(p for p in ends if p is not None)
        relation = card.relation if pair is not None else view.relation
        view = replace(view, expression=name, relation=relation)
        self._take(replace(state, labels=view, pair=pair or state.pair, selected=ends[0]))
        self._draw()

    def step(self, step: int) -> None:
        """Look at the next expression of the list."""
        view = self._state().labels
        if view is None or not view.expressions:
            return
        names = [c.id for c in view.expressions]
        at = names.index(view.expression) + step if view.expression in names else 0
        self.select(names[at % len(names)])

    def select_object(self, number: int) -> None:
        """Select an object by its number in the labels."""
        state, view = self._state(), self._state().labels
        place = None if view is None else view.place(number)
        if place is not None and place != state.selected:
            self._take(replace(state, selected=place, pair=paired(state.pair, place, state.selected)))
            self._draw()

    def mend(self) -> None:
        """From the answer of the debugger to the labels that it is judged by: the labelled pair and its expression."""
        state = self._state()
        judged = state.judged if isinstance(state.judged, Diagnosis) else None
        if state.labels is not None:
            return
        self._correct.show()
        state, view = self._state(), self._state().labels
        if view is None:
            return
        if judged is not None:
            self._take(_of_case(state, view, judged))
        self._draw()

    # ---- edits ------------------------------------------------------------------------

    def answer(self, said: str) -> None:
        """Say whether the expression is true of an object: "sure", "likely" or "no", of the selected one or "no:4".

        What is said already is taken off.
        """
        doubt, _, number = said.partition(":")
        state, view = self._state(), self._state().labels
        if view is None or view.sentence is None or doubt not in ("sure", "likely", "no"):
            return
        if not number and state.selected is None:
            self._correct.refuse("select an object that the expression is true of")
            return
        which = int(number) if number else view.numbers[state.selected or 0]
        now = "no" if view.sentence.certainty(which) == doubt else doubt
        self._save(lambda frame, card: set_answer(frame, card.id, which, now))

    def mark(self, mark: str) -> None:
        """Mark the expression BAD_LABEL or BAD_BOX, the same mark again takes it off; "next" steps through them."""
        wanted = mark if mark in MARKS else None

        def made(frame: EffectiveFrame, card: ExpressionCard) -> Edits:
            now = NEXT_MARK[card.mark] if mark == "next" else None if card.mark == wanted else wanted
            return set_mark(frame, card.id, now)

        self._save(made)

    def status(self, status: str) -> None:
        """Accept or reject the expression as this person sees it; the same again takes it back."""
        desk = self._correct.desk
        author = "" if desk is None else desk.author

        def made(frame: EffectiveFrame, card: ExpressionCard) -> Edits:
            cell = FieldRef("expression", card.frame, card.id, "status")
            return set_status(frame, cell, None if card.statuses.get(author) == status else status, author=author)

        self._save(made)

    def reword(self, text: str) -> None:
        """Another sentence for the same question."""
        view = self._state().labels
        words = " ".join(text.split())
        if view is not None and view.sentence is not None and view.sentence.text != words:
            self._save(lambda frame, card: set_text(frame, card.id, words))

    def _save(self, made: Callable[[EffectiveFrame, ExpressionCard], Edits]) -> None:
        view = self._state().labels
        card = None if view is None else view.sentence
        if view is None:
            return
        if card is None:
            self._correct.refuse("choose an expression first")
            return
        self._correct.save(lambda frame: made(frame, card))

    def sign(self, author: str) -> None:
        """Save what follows under another name, and have the browser remember it."""
        try:
            self._correct.sign(author)
        except InputError as error:
            self._correct.refuse(str(error))
            return
        self._page.call("author", author.strip())
        self._draw()


def sentences_and_conflicts(
    correct: Correct,
    dialog: Dialog,
    page: Page,
    state: Callable[[], State],
    take: Callable[[State], None],
    draw: Callable[[], None],
) -> tuple[Sentences, Conflicts]:
    """What corrects the expressions of one client, and what lets them decide where others were faster."""
    conflicts = Conflicts(dialog, correct)
    correct.on_conflict = conflicts.show
    return Sentences(correct, page, state=state, take=take, draw=draw), conflicts


def _of_case(state: State, view: LabelView, judged: Diagnosis) -> State:
    """The state with the labelled pair of a case chosen, and its expression, as far as they still are there."""
    case, numbers = judged.case, judged.truth.numbers
    ends = [view.place(int(numbers[k])) for k in (case.target_object, case.reference_object)]
    pair = None if None in ends or ends[0] == ends[1] else tuple(p for p in ends if p is not None)
    name = case.id if case.id in view.frame.auto.expressions else None
    return replace(state, labels=replace(view, expression=name, relation=case.relation), pair=pair, selected=ends[0])
