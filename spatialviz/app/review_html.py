"""The Review tab: what is to be looked at next, the labels of the pair, and how they came to be."""

from __future__ import annotations

from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.scene import PairCard, RelationLine
from pipeline.geometry.palette import palette
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import F, T, U, letter
from spatialviz.app.keys import KEYS_OF_ONE
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State
from spatialviz.app.text import BAD, DOUBT, GOOD, button, chosen, dot, heading, note, panel

STATES = {T: ("T", GOOD, "true"), U: ("U", DOUBT, "undecided"), F: ("F", "#8a919c", "false")}
MARKS = {"auto": "", "human": "by hand", "recomputed": "recomputed", "stale": "stale"}


def review_head_html(state: State, opened: bool, desk: LabelEditor | None) -> Element:
    """Whether labels are shown, under whose name they are corrected, what came of the last edit, and what waits.

    `desk` is None until labels are shown for the first time.
    """
    if not opened:
        return panel(h.div("No labels are open (--labels).", cls="dim hint"))
    on = state.labels is not None
    show = button("labels are shown" if on else "show the labels", "labels", "Shift+L", aria_pressed=str(on).lower())
    parts = [h.div(show, _reviewer(desk), cls="nav")]
    waiting = [] if desk is None else [*desk.waiting]
    # What waits says why itself.
    if state.labels is not None and state.labels.said and not (waiting and state.labels.bad):
        parts.append(note(state.labels.said, BAD if state.labels.bad else GOOD))
    if waiting:
        count = f"{counted(len(waiting), 'action')} not saved yet"
        parts.append(note(f"{count}, kept here and tried again every few seconds: {waiting[-1].problem}", BAD))
        parts.append(button("try again", "save-again", cls="go"))
    if desk is not None and desk.disputed:
        parts.append(note("Somebody was faster than you: nothing of yours is saved until you decide.", BAD))
        parts.append(button("decide", "conflict", cls="go"))
    return panel(*parts)


def _reviewer(desk: LabelEditor | None) -> Element | None:
    if desk is None:
        return None
    return h.label(
        h.span("reviewer", cls="dim"),
        h.input(cls="find", value=desk.author, maxlength=200, change="author"),
        cls="who",
        title="under whose name corrections are saved",
    )


def pair_html(state: State) -> Element | None:
    """Every relation of the pair, each settled by T, U or F."""
    view = state.labels
    if view is None:
        return None
    card = view.card
    if card is None and view.item is not None:
        return None  # The item itself says which keys are meant.
    if card is None:
        keys = None if state.selected is None else (h.br(), f"{KEYS_OF_ONE}.")
        pair = "Select two objects, one after the other, or open an item of the queue."
        return panel(h.div(pair, keys, cls="dim"))
    colors = palette(state.dark)
    first = dot(colors["target"]), f"{card.names[0]}·{card.a}"
    second = dot(colors["reference"]), f"{card.names[1]}·{card.b}"
    head = heading(h.b(first, " … ", second), button("swap", "swap", "the other way round (X)"))
    if card.why_none:
        return panel(head, note(f"Takes part in no relation: {card.why_none}"))
    item, only = view.item, None
    if item is not None and item.kind == "relation" and (item.a, item.b) != (card.a, card.b):
        # What is looked at beside the open item is settled by a click on its row.
        only = h.div("Only looked at: the keys act on the open item.", cls="dim")
    return panel(head, only, (_line(card, line, line.relation == view.relation) for line in card.lines))


def _line(card: PairCard, line: RelationLine, focused: bool) -> Element:
    cells = (
        h.button(
            name,
            aria_pressed=str(line.state == state).lower(),
            css={"--c": color},
            do=f"settle:{line.relation}:{name}",
            title=f"{word} ({name})",
        )
        for state, (name, color, word) in STATES.items()
    )
    # Where a person says otherwise than the rule, the rule's margin is none: 0 is not a distance then.
    overruled = line.origin.source == "human" and line.margin == 0
    margin = "" if line.margin is None or overruled else f"{line.margin * 100:+.1f} cm"
    mark = MARKS[line.origin.source] + (f" · {line.status}" if line.status else "")
    now = "none" if line.state is None else letter(line.state)
    return h.div(
        h.span(PHRASE[line.relation]),
        h.span(cells, cls="tuf"),
        h.span(margin, cls="n dim"),
        h.span(mark, cls="dim"),
        id=f"label-{line.relation}",
        **chosen(focused, "lab"),
        role="group",
        do=f"relation-row:{line.relation}",
        title=f"{now}: {line.origin}",
    )


def doubt_html(card: PairCard, line: RelationLine, state: int) -> Element:
    """What geometry says against a judgement, as the question before it is saved."""
    a, b = f"{card.names[0]}·{card.a}", f"{card.names[1]}·{card.b}"
    says, said = letter(F if state == T else T), letter(state)
    return h.div(
        h.div(h.b(a), f" {PHRASE[line.relation]} ", h.b(b), f": {said}?", cls="what"),
        h.div(f"Geometry says {says}, by {line.against(state) * 100:.1f} cm."),
        h.div(f"{said} once more saves it all the same, Escape leaves the label as it is.", cls="dim"),
        cls="dispute",
    )
