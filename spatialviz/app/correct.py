"""Correcting labels: what one client does to them goes to the journal, and the page follows."""

from __future__ import annotations

import getpass
from collections.abc import Callable
from dataclasses import replace

from pipeline.corrections.journal.edits import Edits, judge_relation, set_relation, settle
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Event, Saved
from pipeline.corrections.journal.field_refs import LONGEST_NAME, plain_text, relation_ref
from pipeline.corrections.label_editor import LabelEditor, Outcome
from pipeline.corrections.object_card import expression_cards
from pipeline.corrections.scene import ASKED_BEYOND_M, PairCard, RelationLine, labelled_objects, pair_card
from pipeline.corrections.wording import consequences, events_text, outcome_text
from pipeline.system.errors import InputError, require
from spatialviz.app.context import Context, Part, command
from spatialviz.app.label_view import ANYTHING, LabelView, Target
from spatialviz.app.review_html import pair_html, review_head_html
from spatialviz.app.state import Shown, State


class Correct(Part):
    """Shows and corrects the labels of the source that a client looks at."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._desks: dict[str, LabelEditor] = {}
        self._author = ""
        self.keeps_name, self._token_name = ctx.shared.author is not None, False
        self.on_conflict: Callable[[], None] = lambda: None
        self.on_doubt: Callable[[PairCard, RelationLine, int], None] = lambda card, line, state: None
        self._wanted: Target | None = None
        self._listeners: list[Callable[[tuple[Event, ...]], object]] = []
        self._said: tuple[str, bool] = "", False

    # ---- what is shown ----------------------------------------------------------------

    @property
    def desk(self) -> LabelEditor | None:
        """The desk of the source that is looked at, opened when it is first needed."""
        return self._opened(self.state.source)

    def _opened(self, name: str) -> LabelEditor | None:
        if name not in self._desks and name in self.ctx.shared.journals:
            place, dataset = self.ctx.shared.journals[name], self.ctx.shared.store.sources[name].dataset
            author = self._author or self.ctx.shared.author or login_name()
            self._desks[name] = LabelEditor(place.labels, place, author, dataset)
        return self._desks.get(name)

    def greeted(self, author: str) -> None:
        """Take the name that a browser has kept, unless one was given."""
        try:
            if author and not self.keeps_name:
                self.sign(author)
        except InputError as error:
            self.ctx.note(str(error))

    def signed_as(self, author: str) -> None:
        """Correct under the name of whoever's token it is; the page cannot change it."""
        self.sign(author)
        self.keeps_name = self._token_name = True

    @property
    def open_desk(self) -> LabelEditor | None:
        """The desk of the source that is looked at, where it was needed before; any thread may ask."""
        return self._desks.get(self.state.source)

    def corrected(self, source: str, frame: str) -> EffectiveFrame | None:
        """The labels of a frame as they were corrected by now; None where nobody has corrected any."""
        desk = self._opened(source)
        return None if desk is None else desk.corrected(frame)

    def sign(self, author: str) -> None:
        """Save what follows under another name; raises as `LabelEditor.sign`."""
        name = plain_text(author.strip(), "an author", LONGEST_NAME).strip()
        require(not self._token_name, "corrections are under the name of your token", got=name, expected=self._author)
        # All of them, or none.
        for desk in self._desks.values():
            desk.check_name(name)
        for desk in self._desks.values():
            desk.sign(name)
        self._author = name

    @property
    def stays(self) -> bool:
        """Whether a frame that is opened shows its labels."""
        return self.state.labels is not None or self._wanted is not None

    def stay(self, wanted: Target = ANYTHING) -> None:
        """Have the frame that is opened next show its labels, and in them what is wanted."""
        self._wanted = wanted

    @command("labels-at")
    def look_at_said(self, said: str) -> None:
        """Show a pair: "a,b,relation,frame"."""
        parts = said.split(",", 3)
        if len(parts) == 4 and parts[0].isdecimal() and parts[1].isdecimal():
            self.look_at(Target(parts[3], (int(parts[0]), int(parts[1])), parts[2] or None))

    def look_at(self, wanted: Target) -> None:
        """Show the labels of a frame, and in it a pair or an object."""
        self._wanted = wanted
        if wanted.frame == self.state.frame_id:
            self.show()
            self.ctx.draw()
        else:
            self.ctx.open_frame(wanted.frame)

    @command("labels")
    def toggle(self) -> None:
        """Show the labels, or the answer again."""
        if self.state.labels is not None:
            self.state = replace(self.state, labels=None)
            self.ctx.reopen()
            return
        self.show()
        self.ctx.draw()

    def show(self) -> None:
        """Show the labels of the frame that is looked at, where there are any."""
        state, desk = self.state, self.desk
        wanted, self._wanted = self._wanted, None
        if desk is None:
            self.refuse("no labels are open: `spatialviz view DATASET --labels LABELS`")
            return
        if state.loaded is None:
            return
        if state.frame_id not in desk:
            self.refuse(f"the labels have no frame {state.frame_id}")
            return
        try:
            frame = desk.frame(state.frame_id)
        except InputError as error:
            self.refuse(str(error))
            return
        view = LabelView(frame, said=self._said[0], bad=self._said[1])
        if wanted is None or wanted.frame != frame.frame:
            self.state = _looking_at(replace(state.unasked, labels=None), view)
            if desk.disputed:
                self.on_conflict()
            return
        view = replace(view, relation=wanted.relation, item=wanted.item)
        standing = [n for n in wanted.objects if n in frame.objects]
        chosen = tuple(standing) if len(standing) > 1 else None
        selected = standing[0] if standing else None
        self.state = _looking_at(replace(state.unasked, labels=None), view, chosen, selected)

    def renew(self) -> None:
        """Look at the labels again after they changed; what is selected and chosen stays by its number."""
        state, desk = self.state, self.desk
        view = state.labels
        if view is None or desk is None:
            return
        numbers = view.numbers
        chosen = None if state.pair is None else tuple(numbers[i] for i in state.pair)
        selected = None if state.selected is None else numbers[state.selected]
        view = replace(view, frame=desk.frame(state.frame_id), moved=None)
        self.state = _looking_at(state, view, chosen, selected)

    def chosen(self) -> None:
        """The chosen pair may be another: its card follows."""
        state = self.state
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
        self.state = replace(state, labels=self._detailed(replace(view, card=card, relation=relation)))

    def _detailed(self, view: LabelView) -> LabelView:
        """With the expressions of the frame, and the history of what is selected."""
        state, desk, card, sentence = self.state, self.desk, view.card, view.sentence
        about = view.about
        if card is not None and (sentence is None or not sentence.is_of((card.a, card.b))):
            about = card.a, card.b
        objects = () if state.selected is None else (view.numbers[state.selected],)
        pair = None if card is None else (card.a, card.b)
        lines = () if desk is None else desk.history(
            view.frame.frame, objects=objects, pair=pair, expression=view.expression
        )  # fmt: skip
        cards = expression_cards(view.frame, about)
        return replace(view, about=about, expressions=cards, history=lines, author="" if desk is None else desk.author)

    def follow(self) -> None:
        """Bring the Review tab up to the state."""
        if not self.ctx.shared.journals:
            return
        state = self.state
        self.ctx.page.show(
            "review-head", review_head_html(state, state.source in self.ctx.shared.journals, self.open_desk)
        )
        self.ctx.page.show("review-pair", pair_html(state))

    # ---- edits ------------------------------------------------------------------------

    def on_saved(self, listener: Callable[[tuple[Event, ...]], object]) -> None:
        """Have something called with the events of everything that this client saves or takes back."""
        self._listeners.append(listener)

    def settle(
        self, ends: tuple[int, int], relation: str | None, state: int, *, last_word: bool = False, sure: bool = False
    ) -> bool:
        """Settle a relation of two objects, given by their numbers; True where it was saved. Draws nothing.

        A label that is right already is accepted, under this person's name. One
        that somebody else has settled by hand stays as it is, too: this person's
        word on it is noted, and reviewers who differ are told; where they do,
        `last_word` settles it for all of them. What geometry contradicts by
        decimetres is handed to `on_doubt`, and saved only where they are `sure`.
        """
        view, desk = self.state.labels, self.desk
        if view is None or desk is None:
            return False
        try:
            card = pair_card(view.frame, *ends)
        except InputError as error:
            self.refuse(str(error))
            return False
        line = next((x for x in card.lines if x.relation == relation), None)
        if line is None or relation is None:
            self.refuse(card.why_none or "the pair has no such relation")
            return False
        if not sure and line.against(state) > ASKED_BEYOND_M:
            self.on_doubt(card, line, state)
            return False
        others = line.origin.source == "human" and line.origin.author != desk.author

        def made(frame: EffectiveFrame) -> Edits:
            if last_word:
                cell = relation_ref(frame.frame, card.a, card.b, f"{line.relation}.status")
                status = "accepted" if line.state == state else "corrected"
                return settle(frame, cell, status, state=state)
            if line.state == state or others:
                return judge_relation(frame, card.a, card.b, line.relation, state, desk.author)
            return set_relation(frame, card.a, card.b, line.relation, state)

        return self.save(made, draw=False) is not None

    def save(self, made: Callable[[EffectiveFrame], Edits], draw: bool = True) -> Outcome | None:
        """Save what an action comes down to, made on the labels as this client sees them; None where it is none."""
        view, desk = self.state.labels, self.desk
        if view is None or desk is None:
            return None
        try:
            outcome = desk.save(made(view.frame))
        except InputError as error:
            self.refuse(str(error))
            return None
        self.came_to(outcome, "saved", draw)
        return outcome

    def came_to(self, outcome: Outcome | None, verb: str, draw: bool = True) -> None:
        """Show what came of an action, and what followed from it."""
        before = self.state.labels
        said, bad = outcome_text(outcome, verb, None if before is None else before.frame)
        own = None if before is None or isinstance(outcome, Conflict) else before.frame
        self.tell(said, bad, draw=False, before=own)
        if isinstance(outcome, Saved):
            for listener in self._listeners:
                listener(outcome.events)
        if draw:
            self.ctx.draw()
        if isinstance(outcome, Conflict):
            self.on_conflict()

    def tell(self, said: str, bad: bool = False, draw: bool = True, before: EffectiveFrame | None = None) -> None:
        """Say something where the outcome of actions is said, with the labels as they are now."""
        self.renew()
        view = self.state.labels
        if view is not None and before is not None and (followed := str(consequences(before, view.frame))):
            said = f"{said} · {followed}"
        self._said = said, bad
        if view is not None:
            self.state = replace(self.state, labels=replace(view, said=said, bad=bad))
        elif said:
            self.ctx.page.toast("Labels", said)
        self.ctx.note(said)
        if draw:
            self.ctx.draw()

    def refresh(self) -> None:
        """Show what waits, and what it is made on, as it is now."""
        self.renew()
        self.ctx.draw()

    def took(self, frame: str, events: tuple[Event, ...]) -> None:
        """Others have saved something in a frame, or put another journal in its place: look at it, and say so."""
        state, desk = self.state, self.desk
        if desk is None or state.labels is None or state.frame_id != frame:
            return
        events = tuple(e for e in events if not desk.has_seen(e))
        if desk.replaced(frame):
            self.tell("the journal was replaced by another, such as an older copy: this is what it has", True)
        elif events:
            self.tell(f"{events[-1].author}: {events_text(events[::-1], state.labels.frame)}")

    def frame_of(self, conflict: Conflict) -> EffectiveFrame | None:
        """The labels of the frame that a conflict is in, as they are now; None where they cannot be read."""
        desk = self.desk
        try:
            return None if desk is None else desk.frame(conflict.rivals[0].edit.ref.frame)
        except InputError:
            return None

    @command("take-back=undo", "bring-back=redo")
    def taken_back(self, which: str, group: str | None = None) -> None:
        """Undo or redo one's newest action, or undo the one of a group."""
        desk = self.desk
        if desk is None or self.state.labels is None:
            return
        try:
            outcome = desk.undo(group) if which == "undo" else desk.redo()
        except InputError as error:
            self.refuse(str(error))
            return
        if outcome is None:
            self.refuse(f"nothing to {which}")
            return
        self.came_to(outcome, "taken back" if which == "undo" else "brought back")

    @command("save-again")
    def save_again(self) -> None:
        """Try to save what waits."""
        for outcome in () if self.desk is None else self.desk.retry():
            self.came_to(outcome, "saved")

    # ---- pairs ------------------------------------------------------------------------

    @command("swap")
    def swap(self) -> None:
        """The pair the other way round."""
        state = self.state
        if state.pair is not None and state.labels is not None:
            self.ctx.show(pair=(state.pair[1], state.pair[0]))

    @command("relation-row")
    def focus_relation(self, relation: str) -> None:
        """Look at a relation of the pair."""
        view = self.state.labels
        if view is not None and view.card is not None and any(x.relation == relation for x in view.card.lines):
            self.ctx.show(labels=replace(view, relation=relation))

    @command("next-row")
    def step_relation(self, step: int) -> None:
        """Look at the next relation of the pair."""
        view = self.state.labels
        if view is None or view.card is None or not view.card.lines:
            return
        names = [x.relation for x in view.card.lines]
        at = names.index(view.relation) if view.relation in names else 0
        self.focus_relation(names[(at + step) % len(names)])

    def refuse(self, problem: str) -> None:
        """Say why something was not done."""
        self.ctx.note(f"not done: {problem}")
        self.ctx.page.toast("Not done", problem)


def login_name() -> str:
    """The name that the user is logged in with; "somebody" where there is none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # A container may know no name of its user.
        return "somebody"


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
