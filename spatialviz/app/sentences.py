"""Labelled expressions: view, correction and history; notice and decision of conflicts."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timezone
from typing import Literal

from pipeline.corrections.journal.edits import Edits, set_ambiguous, set_mark, set_status, set_text
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Rival
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.label_editor import EventLine
from pipeline.corrections.object_card import ExpressionCard, LabelView, expression_card, paired, set_answer
from pipeline.corrections.unsaved import disputes
from pipeline.corrections.wording import ref_text, value_text
from pipeline.diagnosis.marks import MARKS as KINDS
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.geometry.palette import palette
from pipeline.language.relation_names import PHRASE
from pipeline.system.errors import InputError, needed
from spatialviz.app.context import command, there
from spatialviz.app.label_part import LabelPart
from spatialviz.app.markup import Element, button, chosen, dot, h, heading, joined, note, panel, sign, textbox, toggle
from spatialviz.app.review_html import MARKS
from spatialviz.app.state import State
from spatialviz.app.toolbar import up_chip

NEXT_MARK = {None: "BAD_LABEL", "BAD_LABEL": "BAD_BOX", "BAD_BOX": None}


class Sentences(LabelPart):
    """Corrects the expressions of a client's current frame."""

    # ---- choice -------------------------------------------------------------------------

    @command("expression")
    def select(self, name: str) -> None:
        """Show an expression, with its labelled pair and target."""
        view = self.view
        there(name if name in view.order else None)
        card = expression_card(view.frame, name)
        pair = view.places(card.target_object, card.reference_object)
        relation = view.relation if pair is None else card.relation
        selected = view.place(card.target_object)
        view = replace(view, expression=name, relation=relation)
        self.ctx.show(labels=view, pair=pair or self.state.pair, selected=selected)

    @command("next-expression")
    def step(self, step: int) -> None:
        """Show the next expression of the list."""
        names, now = self.view.order, self.view.expression
        if names:
            self.select(names[(names.index(now) + step if now in names else 0) % len(names)])

    @command("number")
    def select_object(self, number: int) -> None:
        """Select an object by number in the labels."""
        state, place = self.state, self.view.place(number)
        if place is not None and place != state.selected:
            self.ctx.show(selected=place, pair=paired(state.pair, place, state.selected))

    @command("mend")
    def mend(self) -> None:
        """Switch from the debugger's answer to the underlying labels: the labelled pair and expression."""
        judged = self.state.judged
        if self.state.labels is not None:
            return
        self.show()
        if isinstance(judged, Diagnosis):
            # Objects may have gone since.
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
    def answer(self, certainty: Literal["sure", "likely", "no"], number: int | Literal[""]) -> None:
        """Set the expression's truth of an object, by default the selected; the same again removes it."""
        sentence = there(self.view.sentence)
        which = needed(self.number if number == "" else number, "select an object that the expression is true of")
        now = "no" if sentence.certainty(which) == certainty else certainty
        self._save(lambda frame, card: set_answer(frame, card.id, which, now))

    @command("mark")
    def mark(self, mark: str) -> None:
        """Mark the expression BAD_LABEL or BAD_BOX; a repeated mark is removed; "next" steps through marks."""
        wanted = mark if mark in KINDS else None

        def made(frame: EffectiveFrame, card: ExpressionCard) -> Edits:
            now = NEXT_MARK[card.mark] if mark == "next" else None if card.mark == wanted else wanted
            return set_mark(frame, card.id, now)

        self._save(made)

    @command("expression-status")
    def status(self, status: str) -> None:
        """Accept or reject the expression under this person's name; the same again removes the status."""
        author = self.editor.author

        def made(frame: EffectiveFrame, card: ExpressionCard) -> Edits:
            cell = FieldRef("expression", card.frame, card.id, "status")
            return set_status(frame, cell, None if card.statuses.get(author) == status else status, author=author)

        self._save(made)

    @command("expression-text")
    def reword(self, text: str) -> None:
        """Save another wording of the same question."""
        words, sentence = " ".join(text.split()), self.view.sentence
        if sentence is not None and sentence.text != words:
            self._save(lambda frame, card: set_text(frame, card.id, words))


class Conflicts(LabelPart):
    """Shows the conflicts of a client, the oldest first."""

    @command("conflict")
    def show_first(self) -> None:
        """Show the oldest undecided conflict."""
        if not self.editor.disputed:
            return
        conflict, frame = self.editor.disputed[0], None
        # With the present labels, if readable.
        with suppress(InputError):
            frame = self.editor.frame(conflict.rivals[0].edit.ref.frame)
        found = disputes(conflict, self.editor.corrector.setting)
        one = (
            h.button("Mine instead (M)", do="resolve:0", aria_keyshortcuts="M"),
            h.button("Keep theirs (T)", do="resolve:", aria_keyshortcuts="T"),
        )
        buttons = one if len(found) == 1 else (h.button("Save as chosen", local="checked:resolve:"),)
        self.ctx.dialog.show("Somebody was faster", conflict_html(found, frame), *buttons)

    @command("resolve")
    def resolve(self, mine: str) -> None:
        """Save the author's own version in the named disputes: "0,2"."""
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


def conflict_html(found: tuple[Conflict, ...], frame: EffectiveFrame | None) -> Element:
    """Disputed fields: author, change and time, beside this person's version."""
    one = "Nothing of yours was saved, and nothing of theirs is lost."
    several = "Nothing of yours was saved yet, and nothing of theirs is lost. Choose for each field."
    rows = (_dispute(dispute.rivals[0], frame, k if len(found) > 1 else None) for k, dispute in enumerate(found))
    return h.div(h.div(several if len(found) > 1 else one), rows, cls="conflict")


def _dispute(rival: Rival, frame: EffectiveFrame | None, number: int | None) -> Element:
    event, edit = rival.event, rival.edit
    what = ref_text(edit.ref, frame)
    if event is None:
        theirs, who = "not what you saw", "It was taken back in the meantime"
    else:
        theirs = value_text(edit.ref, event.after, frame)
        reason = f" · {event.reason}" if event.reason else ""
        who = (h.b(event.author), f" changed it {_when(event.time)}{reason}")
    saw, yours = (value_text(edit.ref, value, frame) for value in (edit.before, edit.after))
    values = (("you saw", saw), ("theirs", theirs), ("yours", yours))
    return h.div(
        h.div(what, cls="what"),
        h.div(who, cls="dim"),
        h.div(((h.span(whose), h.b(value)) for whose, value in values), cls="two"),
        None if number is None else _choice(number, what),
        cls="dispute",
    )


def _choice(k: int, what: str) -> Element:
    """Choice of a disputed field's version; checked boxes are sent with the final decision."""
    name = f"dispute-{k}"
    theirs = h.label(h.input(type="radio", name=name, value="", checked=True), "keep theirs")
    mine = h.label(h.input(type="radio", name=name, value=k), "mine instead")
    return h.fieldset(h.legend(what, cls="unseen"), theirs, mine, cls="seg pick")


def _when(time: datetime) -> str:
    seconds = (datetime.now(timezone.utc) - time).total_seconds()
    clock = time.strftime("%Y-%m-%d %H:%M:%S UTC")
    return f"{seconds:.0f} s ago ({clock})" if 0 <= seconds < 120 else f"at {clock}"


MARKED = {"BAD_LABEL": "label wrong", "BAD_BOX": "box wrong"}
SHOWN_EVENTS = 30


def sentence_html(state: State, view: LabelView) -> Element | None:
    """Current expression, with all actions; else a doubt of up."""
    card, up = view.sentence, up_chip(state)
    if card is None:
        return panel(up) if up else None
    colors, origin = palette(state.dark), card.origins["text"]
    means = h.span(
        (dot(colors["target"]), f"{card.target} {card.target_object} "),
        h.span(PHRASE.get(card.relation, card.relation), cls="dim"),
        (" ", dot(colors["reference"]), f"{card.reference} {card.reference_object}"),
    )
    given = {"value": card.text, "spellcheck": "true", "enter": "expression-text"}
    text = textbox("text of the expression", "Enter saves, Escape leaves it (Alt+I)", "sent", **given)
    by = f" · {origin.author}" if origin.author and origin.source == "human" else ""
    return panel(
        text,
        h.div(means, h.span(MARKS[origin.source] or "auto", by, cls="dim", title=origin), cls="means"),
        note(f"Left out of the labels: {card.withdrawn}") if card.withdrawn else None,
        h.div(
            (h.span("true of", cls="label"), _answers(state, view, card)),
            (h.span("selected", cls="label"), _selected(state, view, card)),
            _verdicts(card, view.author, view.item is not None and view.item.what == card.id),
            cls="sets",
        ),
        up,
    )


def _answers(state: State, view: LabelView, card: ExpressionCard) -> Element:
    """Objects meeting an expression."""
    numbers = [*card.targets, *(n for n in card.acceptable if n not in card.targets)]
    chips = [_chip(state, view, card, n) for n in numbers]
    origins = [card.origins[name] for name in ("targets", "acceptable")]
    title = "; ".join(map(str, origins))
    told = (h.span(mark, cls="dim", title=title) for mark in sorted({MARKS[o.source] for o in origins} - {""}))
    return h.div(chips or h.span("nothing", cls="dim"), told, cls="obs")


def _chip(state: State, view: LabelView, card: ExpressionCard, number: int) -> Element:
    sure, place = card.certainty(number) == "sure", view.place(number)
    kinds = {"maybe": not sure, "gone": place is None, "at": place is not None and place == state.selected}
    name = f"{card.names.get(number) or 'gone'} {number}"
    said = f"{'true of it' if sure else 'may be true of it'}; click selects"
    return h.span(
        h.button(name, do=f"number:{number}", title=said),
        sign("×", f"true-of:no:{number}", f"{name}: not true of it", title="not true of it"),
        cls=" ".join(["ob", *(kind for kind, holds in kinds.items() if holds)]),
        color=palette(state.dark)["target" if number == card.target_object else "other"],
    )


def _selected(state: State, view: LabelView, card: ExpressionCard) -> Element:
    if state.selected is None:
        return h.span("no object: click one in the scene or the picture", cls="dim")
    doubt = card.certainty(view.numbers[state.selected])
    return h.div(
        h.b(state.shown.names[state.selected]),
        toggle("true of it", "true-of:sure", doubt == "sure", "Alt+T (again: not true of it)", color="good"),
        toggle("maybe", "true-of:likely", doubt == "likely", "Alt+U (again: not true of it)", color="doubt"),
        cls="acts",
    )


def _verdicts(card: ExpressionCard, author: str, asked: bool) -> Element:
    """Marks of an expression; where it is not `asked` below, its answers, too."""
    own = card.statuses.get(author, card.status)
    others = "".join(f" · {name}: {said}" for name, said in card.statuses.items() if name != author)
    answers = (("accepted", "good", "correct", "Alt+Y"), ("rejected", "bad", "wrong", "Alt+N"))

    def hint(field: str, key: str) -> str:
        origin = card.origins[field]
        return key if origin.source == "auto" else f"{key} · {origin}"

    return h.div(
        (
            toggle(word, f"expression-status:{status}", own == status, hint("status", key) + others, color=color)
            for status, color, word, key in (() if asked else answers)
        ),
        toggle("ambiguous", "ambiguous", card.ambiguous, hint("ambiguous", "Alt+B"), color="doubt"),
        (
            toggle(words, f"mark:{mark}", card.mark == mark, hint("mark", "Alt+M steps"), color="bad")
            for mark, words in MARKED.items()
        ),
        cls="acts all",
    )


def expressions_html(view: LabelView) -> Element | None:
    """Expressions of the frame, starting with the chosen pair's."""
    if not view.expressions:
        return None
    count = f"{len(view.expressions)} of {len(view.order)}, those of the pair first"
    rows = h.div((_row(view, card) for card in view.expressions), id="expressions-all", cls="expressions")
    return panel(heading("Sentences", count).with_(id="expressions-head"), rows)


def _row(view: LabelView, card: ExpressionCard) -> Element:
    origins = {MARKS[o.source] for f, o in card.origins.items() if f not in ("mark", "status")} - {""}
    tags = [
        h.b(MARKED[card.mark], color="bad") if card.mark is not None else None,
        *(h.b(status, color="good") for status in sorted({*card.statuses.values()} - {"rejected"})),
        h.b("ambiguous", color="doubt") if card.ambiguous else None,
        *sorted(origins),
    ]
    return h.div(
        h.div(h.span(card.text, cls="say"), h.span(joined(filter(None, tags)), cls="tags")),
        h.div(card.withdrawn, cls="dim") if card.withdrawn else None,
        id=f"expression-{card.id}",
        **chosen(card.id == view.expression, "ex out" if card.withdrawn else "ex"),
        role="group",
        do=f"expression:{card.id}",
        title=f"left out: {card.withdrawn}" if card.withdrawn else card.text,
    )


def history_html(view: LabelView) -> Element | None:
    """History of the selected object, the chosen pair and the expression; None without any."""
    if not view.history:
        return None
    more = f"newest {SHOWN_EVENTS} of {len(view.history)}" if len(view.history) > SHOWN_EVENTS else ""
    return panel(heading("History", more), (_event(view, line) for line in view.history[:SHOWN_EVENTS]))


def _event(view: LabelView, line: EventLine) -> Element:
    event = line.event
    before, after = (value_text(event.ref, value, view.frame) for value in (event.before, event.after))
    what = ref_text(event.ref, view.frame)
    became = f"undone by {line.undone.author}" if line.undone is not None else ""
    became = h.b("not saved yet", cls="bad") if line.waiting else became
    told = event.author, f"{event.time.astimezone():%d %b %H:%M:%S}", event.reason, became
    mine = line.group and not line.waiting and line.undone is None
    return h.div(
        h.div(f"{what}: {before} → ", h.b(after), cls="" if line.undone is None else "gone"),
        button("undo", f"undo-group:{line.group}", "take this action back") if mine else None,
        h.div(joined(filter(None, told)), cls="dim"),
        cls="ev",
        title=f"{what}: {before} -> {after}",
    )
