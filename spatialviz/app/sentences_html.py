"""The Answer tab while labels are shown: the chosen expression, all of the frame, and who changed what."""

from __future__ import annotations

from pipeline.corrections.label_editor import EventLine
from pipeline.corrections.object_card import ExpressionCard
from pipeline.corrections.wording import ref_text, value_text
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.relation_names import PHRASE
from spatialviz.app.label_view import LabelView
from spatialviz.app.markup import BAD, DOUBT, GOOD, Child, Element, button, chosen, dot, h, heading, joined, note, panel
from spatialviz.app.state import State
from spatialviz.app.toolbar import up_chip

ORIGINS = {"auto": "auto", "human": "by hand", "recomputed": "recomputed", "stale": "stale"}
MARKED = {"BAD_LABEL": "label wrong", "BAD_BOX": "box wrong"}
SHOWN, SHOWN_EVENTS = 200, 30


def sentence_html(state: State, view: LabelView) -> Element:
    """The expression that is looked at, and everything that can be done to it."""
    chip = h.div(h.span(), up_chip(state), cls="under")
    card = view.sentence
    if card is None:
        what = (
            "Choose an expression below, or step through them with Alt+J."
            if view.expressions
            else "The labels have no expressions of this frame."
        )
        return panel(h.div(what, cls="dim hint"), chip)
    colors = palette(state.dark)
    means = h.span(
        (dot(colors["target"]), f"{card.target}·{card.target_object} "),
        h.span(PHRASE.get(card.relation, card.relation), cls="dim"),
        (" ", dot(colors["reference"]), f"{card.reference}·{card.reference_object}"),
    )
    text = h.input(
        cls="sent",
        value=card.text,
        spellcheck="true",
        title="Enter saves, Escape leaves it (Alt+I)",
        aria_label="text of the expression",
        enter="expression-text",
    )
    return panel(
        text,
        h.div(means, h.span(_origin(card, "text"), cls="dim", title=card.origins["text"]), cls="means"),
        note(f"Left out of the labels: {card.withdrawn}", DOUBT) if card.withdrawn else None,
        h.div(
            (h.span("true of", cls="label"), _answers(state, view, card)),
            (h.span("selected", cls="label"), _selected(state, view, card)),
            _verdicts(card, view.author),
            cls="sets",
        ),
        chip,
    )


def _answers(state: State, view: LabelView, card: ExpressionCard, row: str = "") -> Element:
    """The objects that an expression is true of, in a row of the list if its id is given."""
    numbers = [*card.targets, *(n for n in card.acceptable if n not in card.targets)]
    chips = [_chip(state, view, card, n, row) for n in numbers]
    if row:
        return h.div(chips, cls="obs")
    marks = {ORIGINS[card.origins[name].source] for name in ("targets", "acceptable")} - {"auto"}
    title = "; ".join(str(card.origins[name]) for name in ("targets", "acceptable"))
    told = (h.span(mark, cls="dim", title=title) for mark in sorted(marks))
    return h.div(chips or h.span("nothing", cls="dim"), told, cls="obs")


def _chip(state: State, view: LabelView, card: ExpressionCard, number: int, row: str) -> Element:
    color = palette(state.dark)["target" if number == card.target_object else "other"]
    sure = card.certainty(number) == "sure"
    kinds = {
        "ob": True,
        "maybe": not sure,
        "gone": view.place(number) is None,
        "at": state.selected is not None and view.numbers[state.selected] == number,
    }
    name = f"{card.names.get(number) or 'gone'}·{number}"
    said = "true of it" if sure else "may be true of it"
    drop = h.button(
        "×", cls="drop", do=f"true-of:no:{number}", title="not true of it", aria_label=f"{name}: not true of it"
    )
    return h.span(
        h.button(name, do=f"number:{number}", title=f"{said}; click selects"),
        None if row else drop,
        id=f"{row}-{number}" if row else None,
        cls=" ".join(kind for kind, holds in kinds.items() if holds),
        css={"--c": hex_color(color)},
    )


def _selected(state: State, view: LabelView, card: ExpressionCard) -> Element:
    if state.selected is None:
        return h.span("no object: click one in the scene or the picture", cls="dim")
    doubt = card.certainty(view.numbers[state.selected])
    return h.div(
        h.b(state.shown.names[state.selected]),
        _toggle(doubt == "sure", GOOD, "true-of:sure", "true of it", "Alt+T (again: not true of it)"),
        _toggle(doubt == "likely", DOUBT, "true-of:likely", "maybe", "Alt+U (again: not true of it)"),
        cls="acts",
    )


def _toggle(on: bool, color: str, do: str, words: str, title: str) -> Element:
    return h.button(words, aria_pressed=str(on).lower(), css={"--c": color}, do=do, title=title)


def _verdicts(card: ExpressionCard, author: str) -> Element:
    status, own = "expression-status:", card.statuses.get(author, card.status)
    others = "".join(f" · {name}: {said}" for name, said in card.statuses.items() if name != author)
    accept, reject = (_hint(card, "status", key) + others for key in ("Alt+Y", "Alt+N"))
    return h.div(
        _toggle(own == "accepted", GOOD, f"{status}accepted", "accepted", accept),
        _toggle(own == "rejected", BAD, f"{status}rejected", "rejected", reject),
        _toggle(card.ambiguous, DOUBT, "ambiguous", "ambiguous", _hint(card, "ambiguous", "Alt+B")),
        (
            _toggle(card.mark == mark, BAD, f"mark:{mark}", words, _hint(card, "mark", "Alt+M steps"))
            for mark, words in MARKED.items()
        ),
        cls="acts all",
    )


def _hint(card: ExpressionCard, field: str, key: str) -> str:
    origin = card.origins[field]
    return key if origin.source == "auto" else f"{key} · {origin}"


def _origin(card: ExpressionCard, field: str) -> str:
    origin = card.origins[field]
    by = f" · {origin.author}" if origin.author and origin.source == "human" else ""
    return f"{ORIGINS[origin.source]}{by}"


def expressions_html(state: State, view: LabelView) -> Element | None:
    """All expressions of the frame, those of the chosen pair first."""
    if not view.expressions:
        return None
    left_out = sum(bool(c.withdrawn) for c in view.expressions)
    count = f"{len(view.expressions)}" + (f", {left_out} left out" if left_out else "")
    if len(view.expressions) > SHOWN:
        count += f"; {SHOWN} are listed"
    own = [card for card in view.expressions if view.about and card.is_of(view.about)]
    out = [card for card in view.expressions if card.withdrawn and card not in own]
    # All stay where they are, hidden while they stand above or below: another pair, and an edit, send few rows.
    at = {name: k for k, name in enumerate(view.frame.sentences)}
    rows = sorted(view.expressions, key=lambda card: at[card.id])[:SHOWN]
    others = h.div("others of the frame", cls="dim others", hidden=not 0 < len(own) < len(view.expressions))
    return panel(
        heading("Expressions", count).with_(id="expressions-head"),
        h.div(
            h.div((_row(state, view, card, "own") for card in own), others, id="expressions-own"),
            h.div((_row(state, view, card, "any", card in own or card in out) for card in rows), id="expressions-all"),
            h.div((_row(state, view, card, "out") for card in out[:SHOWN]), id="expressions-out"),
            cls="scroll expressions",
        ),
    )


def _row(state: State, view: LabelView, card: ExpressionCard, kind: str, hidden: bool = False) -> Element:
    name = f"{kind}-{card.id}"
    marks = [(MARKED[card.mark], BAD)] if card.mark is not None else []
    marks += [(status, GOOD) for status in sorted({*card.statuses.values()} - {"rejected"})]
    marks += [("ambiguous", DOUBT)] if card.ambiguous else []
    origins = {ORIGINS[o.source] for f, o in card.origins.items() if f not in ("mark", "status")} - {"auto"}
    tags = [*(h.b(word, css={"--c": color}) for word, color in marks), *sorted(origins)]
    out = h.div(card.withdrawn, cls="dim") if card.withdrawn else None
    return h.div(
        h.div(h.span(card.text, cls="say"), h.span(joined(tags), cls="tags")),
        out or _answers(state, view, card, name),
        id=name,
        hidden=hidden,
        **chosen(card.id == view.expression and not hidden, "ex out" if card.withdrawn else "ex"),
        role="group",
        do=f"expression:{card.id}",
        title=f"left out: {card.withdrawn}" if card.withdrawn else card.text,
    )


def history_html(view: LabelView) -> Element:
    """Who changed what of the selected object, the chosen pair and the expression."""
    if not view.history:
        return panel(heading("History"), h.div("Nobody has changed anything of what is selected.", cls="dim"))
    more = f"newest {SHOWN_EVENTS} of {len(view.history)}" if len(view.history) > SHOWN_EVENTS else ""
    return panel(heading("History", more), (_event(view, line) for line in view.history[:SHOWN_EVENTS]))


def _event(view: LabelView, line: EventLine) -> Element:
    event = line.event
    before, after = (value_text(event.ref, value, view.frame) for value in (event.before, event.after))
    what = ref_text(event.ref, view.frame)
    told: list[Child] = [event.author, event.time.astimezone().strftime("%d %b %H:%M:%S")]
    told += [event.reason] if event.reason else []
    if line.waiting:
        told.append(h.b("not saved yet", cls="bad"))
    elif line.undone is not None:
        told.append(f"undone by {line.undone.author}")
    mine = line.group and not line.waiting and line.undone is None
    undo = button("undo", f"undo-group:{line.group}", "take this action back") if mine else None
    return h.div(
        h.div(f"{what}: {before} → ", h.b(after), cls="" if line.undone is None else "gone"),
        undo,
        h.div(joined(told), cls="dim"),
        cls="ev",
        title=f"{what}: {before} -> {after}",
    )
