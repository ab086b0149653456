"""Correcting labels: what one client does to them goes to the journal, and the page follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import viser

from pipeline.correcting.cards import pair_card
from pipeline.correcting.desk import Desk, Outcome, Waiting
from pipeline.correcting.scene import labelled_objects
from pipeline.errors import InputError
from pipeline.journal.edits import Edits, set_relation
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Conflict, Saved
from pipeline.relations import F, T, U
from spatialviz.app.label_view import LabelView
from spatialviz.app.layout import Page
from spatialviz.app.review_html import pair_html, review_head_html
from spatialviz.app.state import Shown, State
from spatialviz.app.text import safe

LETTERS = {"T": T, "U": U, "F": F}


class Correct:
    """Shows and corrects the labels of the source that a client looks at.

    Parameters
    ----------
    client : viser.ClientHandle
    page : Page
    desks : mapping of str to callable
        By name of the source: opens this client's desk.
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    draw : callable
    ask : callable
        Asks the question of the state again, where labels are shown no longer.
    note : callable
        Writes a line of the log.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        page: Page,
        desks: Mapping[str, Callable[[], Desk]],
        *,
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[], None],
        ask: Callable[[], None],
        note: Callable[[str], None],
    ) -> None:
        self._client, self._page, self._openers = client, page, desks
        self._state, self._take, self._draw, self._ask, self._note = state, take, draw, ask, note
        self._desks: dict[str, Desk] = {}

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "labels": lambda _: self.toggle(),
            "settle": self.settle,
            "relation-row": self.focus_relation,
            "next-row": lambda step: self.step_relation(int(step)),
            "swap": lambda _: self.swap(),
            "take-back": lambda _: self._taken_back("undo"),
            "bring-back": lambda _: self._taken_back("redo"),
            "save-again": lambda _: self.save_again(),
        }

    # ---- what is shown ----------------------------------------------------------------

    @property
    def desk(self) -> Desk | None:
        """The desk of the source that is looked at, opened when it is first needed."""
        name = self._state().source
        if name not in self._desks and name in self._openers:
            self._desks[name] = self._openers[name]()
        return self._desks.get(name)

    def toggle(self) -> None:
        """Show the labels, or the answer again."""
        if self._state().labels is not None:
            self._take(replace(self._state(), labels=None))
            self._ask()
            return
        self.show()
        self._draw()

    def show(self) -> None:
        """Show the labels of the frame that is looked at, where there are any."""
        state, desk = self._state(), self.desk
        if desk is None:
            self._refuse("no labels are open: `spatialviz view DATASET --labels LABELS`")
            return
        if state.loaded is None:
            return
        if state.frame_id not in desk:
            self._refuse(f"the labels have no frame {state.frame_id}")
            return
        try:
            frame = desk.frame(state.frame_id)
        except InputError as error:
            self._refuse(str(error))
            return
        self._take(_looking_at(replace(state.unasked, labels=None), LabelView(frame)))

    def renew(self) -> None:
        """Look at the labels again after they changed; what is selected and chosen stays by its number."""
        state, desk = self._state(), self.desk
        view = state.labels
        if view is None or desk is None:
            return
        numbers = view.numbers
        chosen = None if state.pair is None else tuple(numbers[i] for i in state.pair)
        selected = None if state.selected is None else numbers[state.selected]
        view = replace(view, frame=desk.frame(state.frame_id), moved=None)
        self._take(_looking_at(state, view, chosen, selected))

    def chosen(self) -> None:
        """The chosen pair may be another: its card follows."""
        state = self._state()
        view = state.labels
        if view is None:
            return
        card = None
        if state.pair is not None and state.pair[0] != state.pair[1]:
            a, b = (view.numbers[i] for i in state.pair[:2])
            card = pair_card(view.frame, a, b)
        lines = () if card is None else card.lines
        relation = view.relation if any(x.relation == view.relation for x in lines) else None
        if relation is None and lines:
            relation = lines[0].relation
        self._take(replace(state, labels=replace(view, card=card, relation=relation)))

    def follow(self) -> None:
        """Bring the Review tab up to the state."""
        if self._page.review_head is None or self._page.review_pair is None:
            return
        self.chosen()
        state = self._state()
        opened = self._openers.get(state.source) is not None
        self._page.review_head.content = review_head_html(state, self.desk if opened else None, None)
        self._page.review_pair.content = pair_html(state)

    # ---- edits ------------------------------------------------------------------------

    def settle(self, said: str) -> None:
        """Settle a relation of the chosen pair: "left:T", or "T" for the one that is looked at."""
        view = self._state().labels
        *named, letter = said.split(":")
        if view is None or view.card is None or letter not in LETTERS:
            return
        relation = named[0] if named else view.relation
        card = view.card
        if relation is None:
            return
        self._take(replace(self._state(), labels=replace(view, relation=relation)))
        self.save(lambda frame: set_relation(frame, card.a, card.b, relation, LETTERS[letter]))

    def save(self, made: Callable[[EffectiveFrame], Edits]) -> Outcome | None:
        """Save what an action comes down to, made on the labels as this client sees them; None where it is none."""
        view, desk = self._state().labels, self.desk
        if view is None or desk is None:
            return None
        try:
            outcome = desk.save(made(view.frame))
        except InputError as error:
            self._refuse(str(error))
            return None
        self._came_to(outcome, "saved")
        return outcome

    def _came_to(self, outcome: Outcome | None, verb: str) -> None:
        said, bad = outcome_said(outcome, verb)
        self.renew()
        view = self._state().labels
        if view is not None:
            self._take(replace(self._state(), labels=replace(view, said=said, bad=bad)))
        self._note(said)
        self._draw()

    def _taken_back(self, which: str) -> None:
        desk = self.desk
        if desk is None or self._state().labels is None:
            return
        try:
            outcome = desk.undo() if which == "undo" else desk.redo()
        except InputError as error:
            self._refuse(str(error))
            return
        if outcome is None:
            self._refuse(f"nothing to {which}")
            return
        self._came_to(outcome, "taken back" if which == "undo" else "brought back")

    def save_again(self) -> None:
        """Try to save what waits."""
        desk = self.desk
        for outcome in () if desk is None else desk.retry():
            self._came_to(outcome, "saved")

    # ---- pairs ------------------------------------------------------------------------

    def swap(self) -> None:
        """The pair the other way round."""
        state = self._state()
        if state.pair is not None and state.labels is not None:
            self._take(replace(state, pair=(state.pair[1], state.pair[0])))
            self._draw()

    def focus_relation(self, relation: str) -> None:
        """Look at a relation of the pair."""
        view = self._state().labels
        if view is not None and view.card is not None and any(x.relation == relation for x in view.card.lines):
            self._take(replace(self._state(), labels=replace(view, relation=relation)))
            self._draw()

    def step_relation(self, step: int) -> None:
        """Look at the next relation of the pair."""
        view = self._state().labels
        if view is None or view.card is None or not view.card.lines:
            return
        names = [x.relation for x in view.card.lines]
        at = names.index(view.relation) if view.relation in names else 0
        self.focus_relation(names[(at + step) % len(names)])

    def _refuse(self, problem: str) -> None:
        self._note(f"not done: {problem}")
        self._client.add_notification("Not done", safe(problem), auto_close_seconds=8)


def outcome_said(outcome: Outcome | None, verb: str) -> tuple[str, bool]:
    """What came of an action in words, and whether it was not done."""
    if isinstance(outcome, Saved):
        first, more = outcome.events[0], len(outcome.events) - 1
        return f"{verb}: {first}" + (f" (and {more} more)" if more else ""), False
    if isinstance(outcome, Conflict):
        return "not saved, somebody was faster: " + "; ".join(map(str, outcome.rivals)), True
    if isinstance(outcome, Waiting):
        return f"not saved yet: {outcome.problem}", True
    return "", False


def _looking_at(
    state: State, view: LabelView, chosen: tuple[int, ...] | None = None, selected: int | None = None
) -> State:
    """The state with the labels of a view shown; the pair and the selected object are given by their numbers."""
    objects = labelled_objects(view.frame)
    names = tuple(f"{o.label}·{o.id}" for o in objects)
    places = None if chosen is None else [view.place(n) for n in chosen]
    pair = None if places is None or None in places else tuple(p for p in places if p is not None)
    return replace(
        state,
        labels=view,
        shown=Shown(objects, names, {}),
        pair=pair,
        selected=None if selected is None else view.place(selected),
    )
