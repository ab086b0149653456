"""The Review tab: what is to be looked at next, the labels of the pair, and how they came to be."""

from __future__ import annotations

from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.scene import PairCard, RelationLine
from pipeline.geometry.palette import palette
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import F, T, U, letter
from spatialviz.app.keys import KEYS_OF_ONE
from spatialviz.app.state import State
from spatialviz.app.text import BAD, DOUBT, GOOD, dot, heading, note, panel, safe

STATES = {T: ("T", GOOD, "true"), U: ("U", DOUBT, "undecided"), F: ("F", "#8a919c", "false")}
MARKS = {"auto": "", "human": "by hand", "recomputed": "recomputed", "stale": "stale"}


def review_head_html(state: State, opened: bool, desk: LabelEditor | None) -> str:
    """Whether labels are shown, under whose name they are corrected, what came of the last edit, and what waits.

    `desk` is None until labels are shown for the first time.
    """
    if not opened:
        return panel('<div class="dim" style="padding:.7em 0">No labels are open (--labels).</div>')
    on = state.labels is not None
    button = f'<span class="try{" on" if on else ""}" role="button" onclick="sv(\'labels\')" title="Shift+L">'
    button += f"{'labels are shown' if on else 'show the labels'}</span>"
    parts = [f'<div class="nav" style="padding-top:.6em">{button}{_reviewer(desk)}</div>']
    waiting = [] if desk is None else [*desk.waiting]
    # What waits says why itself.
    if state.labels is not None and state.labels.said and not (waiting and state.labels.bad):
        parts.append(note(state.labels.said, BAD if state.labels.bad else GOOD))
    if waiting:
        count = f"{counted(len(waiting), 'action')} not saved yet"
        parts.append(note(f"{count}, kept here and tried again every few seconds: {waiting[-1].problem}", BAD))
        parts.append('<span class="try go" role="button" onclick="sv(\'save-again\')">try again</span>')
    if desk is not None and desk.disputed:
        parts.append(note("Somebody was faster than you: nothing of yours is saved until you decide.", BAD))
        parts.append('<span class="try go" role="button" onclick="sv(\'conflict\')">decide</span>')
    return panel(*parts)


def _reviewer(desk: LabelEditor | None) -> str:
    if desk is None:
        return ""
    send = "sv('author:'+this.value)"
    return (
        '<label class="who" title="under whose name corrections are saved"><span class="dim">reviewer</span>'
        f'<input class="find" value="{safe(desk.author)}" maxlength="200" onchange="{send}"></label>'
    )


def pair_html(state: State) -> str:
    """Every relation of the pair, each settled by T, U or F."""
    view = state.labels
    if view is None:
        return ""
    card = view.card
    if card is None and view.item is not None:
        return ""  # The item itself says which keys are meant.
    if card is None:
        keys = "" if state.selected is None else f"<br>{KEYS_OF_ONE}."
        pair = "Select two objects, one after the other, or open an item of the queue."
        return panel(f'<div class="dim">{pair}{keys}</div>')
    colors = palette(state.dark)
    swap = '<span class="try" role="button" onclick="sv(\'swap\')" title="the other way round (X)">swap</span>'
    first = f"{dot(colors['target'])}{safe(card.names[0])}·{card.a}"
    second = f"{dot(colors['reference'])}{safe(card.names[1])}·{card.b}"
    head = heading(f"<b>{first}</b> … <b>{second}</b>", swap)
    if card.why_none:
        return panel(head, note(f"Takes part in no relation: {card.why_none}"))
    item = view.item
    if item is not None and item.kind == "relation" and (item.a, item.b) != (card.a, card.b):
        # What is looked at beside the open item is settled by a click on its row.
        head += '<div class="dim">Only looked at: the keys act on the open item.</div>'
    return panel(head, "".join(_line(card, line, line.relation == view.relation) for line in card.lines))


def _line(card: PairCard, line: RelationLine, focused: bool) -> str:
    cells = "".join(
        f'<span class="{"on" if line.state == state else ""}" style="--c:{color}" '
        f'onclick="sv(\'settle:{line.relation}:{name}\')" title="{word} ({name})">{name}</span>'
        for state, (name, color, word) in STATES.items()
    )
    # Where a person says otherwise than the rule, the rule's margin is none: 0 is not a distance then.
    overruled = line.origin.source == "human" and line.margin == 0
    margin = "" if line.margin is None or overruled else f"{line.margin * 100:+.1f} cm"
    mark = MARKS[line.origin.source] + (f" · {line.status}" if line.status else "")
    now = "none" if line.state is None else letter(line.state)
    return (
        f'<div class="lab{" sel" if focused else ""}" onclick="sv(\'relation-row:{line.relation}\')" '
        f'title="{safe(f"{now}: {line.origin}")}"><span>{PHRASE[line.relation]}</span>'
        f'<span class="tuf" onclick="event.stopPropagation()">{cells}</span>'
        f'<span class="n dim">{margin}</span><span class="dim">{safe(mark)}</span></div>'
    )


def doubt_html(card: PairCard, line: RelationLine, state: int) -> str:
    """What geometry says against a judgement, as the question before it is saved."""
    a, b = f"{card.names[0]}·{card.a}", f"{card.names[1]}·{card.b}"
    says = letter(F if state == T else T)
    return (
        f'<div class="dispute"><div class="what"><b>{safe(a)}</b> {PHRASE[line.relation]} <b>{safe(b)}</b>: '
        f"{letter(state)}?</div><div>Geometry says {says}, by {line.against(state) * 100:.1f} cm.</div>"
        f'<div class="dim">{letter(state)} once more saves it all the same, Escape leaves the label as it is.</div>'
        "</div>"
    )
