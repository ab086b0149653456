"""The Answer tab while labels are shown: the chosen expression, all of the frame, and who changed what."""

from __future__ import annotations

import json

from pipeline.corrections.label_editor import EventLine
from pipeline.corrections.object_card import ExpressionCard
from pipeline.corrections.wording import ref_text, value_text
from pipeline.geometry.palette import RGB, hex_color, palette
from pipeline.language.relation_names import PHRASE
from spatialviz.app.label_view import LabelView
from spatialviz.app.state import State
from spatialviz.app.text import BAD, DOUBT, GOOD, dot, heading, note, panel, safe
from spatialviz.app.up_html import up_chip

ORIGINS = {"auto": "auto", "human": "by hand", "recomputed": "recomputed", "stale": "stale"}
MARKED = {"BAD_LABEL": "label wrong", "BAD_BOX": "box wrong"}
SHOWN, SHOWN_EVENTS = 200, 30


def sentence_html(state: State) -> str:
    """The expression that is looked at, and everything that can be done to it."""
    view = state.labels
    if view is None:
        return ""
    said = "" if not view.said else note(view.said, BAD if view.bad else GOOD)
    chip = f'<div class="under"><span></span>{up_chip(state)}</div>'
    card = view.sentence
    if card is None:
        what = (
            "Choose an expression below, or step through them with Alt+J."
            if view.expressions
            else ("The labels have no expressions of this frame.")
        )
        return panel(f'<div class="dim" style="padding:.6em 0 .3em">{what}</div>', said, chip)
    colors = palette(state.dark)
    means = (
        f"{dot(colors['target'])}{safe(card.target)}·{card.target_object} "
        f'<span class="dim">{safe(PHRASE.get(card.relation, card.relation))}</span> '
        f"{dot(colors['reference'])}{safe(card.reference)}·{card.reference_object}"
    )
    origin = card.origins["text"]
    field = (
        f'<input class="sent" value="{safe(card.text)}" data-was="{safe(card.text)}" spellcheck="true" '
        f'title="Enter saves, Escape leaves it (Alt+I)" aria-label="text of the expression" '
        f'onkeydown="svReword(event,this)" onkeyup="event.stopPropagation()">'
    )
    parts = [
        field,
        f'<div class="means"><span>{means}</span><span class="dim" title="{safe(origin)}">'
        f"{_origin(card, 'text')}</span></div>",
        note(f"Left out of the labels: {card.withdrawn}", DOUBT) if card.withdrawn else "",
        '<div class="sets">',
        f"<label>true of</label>{_answers(state, view, card)}",
        f"<label>selected</label>{_selected(state, view, card)}",
        _verdicts(card, view.author),
        "</div>",
        said,
        chip,
    ]
    return panel(*parts)


def _answers(state: State, view: LabelView, card: ExpressionCard, small: bool = False) -> str:
    numbers = [*card.targets, *(n for n in card.acceptable if n not in card.targets)]
    chips = "".join(_chip(state, view, card, n, small) for n in numbers)
    if small:
        return f'<div class="obs">{chips}</div>'
    marks = {ORIGINS[card.origins[name].source] for name in ("targets", "acceptable")} - {"auto"}
    title = safe("; ".join(str(card.origins[name]) for name in ("targets", "acceptable")))
    told = "".join(f'<span class="dim" title="{title}">{m}</span>' for m in sorted(marks))
    return f'<div class="obs">{chips or "<span class=dim>nothing</span>"}{told}</div>'


def _chip(state: State, view: LabelView, card: ExpressionCard, number: int, small: bool) -> str:
    colors = palette(state.dark)
    color: RGB = colors["target"] if number == card.target_object else colors["other"]
    kinds = ["ob"]
    sure = card.certainty(number) == "sure"
    kinds += [] if sure else ["maybe"]
    kinds += ["gone"] if view.place(number) is None else []
    kinds += ["at"] if state.selected is not None and view.numbers[state.selected] == number else []
    name = f"{safe(card.names.get(number) or 'gone')}·{number}"
    said = "true of it" if sure else "may be true of it"
    drop = f"event.stopPropagation();sv('true-of:no:{number}')"
    off = "" if small else f'<i role="button" title="not true of it" onclick="{drop}">×</i>'
    return (
        f'<span class="{" ".join(kinds)}" style="--c:{hex_color(color)}" title="{said}; click selects" '
        f"onclick=\"event.stopPropagation();sv('number:{number}')\"><span>{name}</span>{off}</span>"
    )


def _selected(state: State, view: LabelView, card: ExpressionCard) -> str:
    if state.selected is None:
        return '<span class="dim">no object: click one in the scene or the picture</span>'
    number = view.numbers[state.selected]
    doubt = card.certainty(number)
    cells = "".join(
        f'<span class="{"on" if doubt == key else ""}" style="--c:{color}" onclick="sv(\'true-of:{key}\')" '
        f'title="{key_} (again: not true of it)">{word}</span>'
        for key, word, color, key_ in (("sure", "true of it", GOOD, "Alt+T"), ("likely", "maybe", DOUBT, "Alt+U"))
    )
    name = safe(state.shown.names[state.selected])
    return f'<div class="acts" style="align-items:center"><b>{name}</b>{cells}</div>'


def _verdicts(card: ExpressionCard, author: str) -> str:
    def cell(on: bool, color: str, message: str, words: str, title: str) -> str:
        return (
            f'<span class="{"on" if on else ""}" style="--c:{color}" onclick="sv(\'{message}\')" '
            f'title="{safe(title)}">{words}</span>'
        )

    status, own = "expression-status:", card.statuses.get(author, card.status)
    others = "".join(f" · {name}: {said}" for name, said in card.statuses.items() if name != author)
    accept, reject = (_hint(card, "status", key) + others for key in ("Alt+Y", "Alt+N"))
    cells = [
        cell(own == "accepted", GOOD, f"{status}accepted", "accepted", accept),
        cell(own == "rejected", BAD, f"{status}rejected", "rejected", reject),
        cell(card.ambiguous, DOUBT, "ambiguous", "ambiguous", _hint(card, "ambiguous", "Alt+B")),
        *(
            cell(card.mark == mark, BAD, f"mark:{mark}", words, _hint(card, "mark", "Alt+M steps"))
            for mark, words in MARKED.items()
        ),
    ]
    return f'<div class="acts all">{"".join(cells)}</div>'


def _hint(card: ExpressionCard, field: str, key: str) -> str:
    origin = card.origins[field]
    return key if origin.source == "auto" else f"{key} · {origin}"


def _origin(card: ExpressionCard, field: str) -> str:
    origin = card.origins[field]
    by = f" · {safe(origin.author)}" if origin.author and origin.source == "human" else ""
    return f"{ORIGINS[origin.source]}{by}"


def expressions_html(state: State) -> str:
    """All expressions of the frame, those of the chosen pair first."""
    view = state.labels
    if view is None or not view.expressions:
        return ""
    left_out = sum(bool(c.withdrawn) for c in view.expressions)
    rows, first = [], True
    for card in view.expressions[:SHOWN]:
        if view.about and first and not card.is_of(view.about) and rows:
            rows.append('<div class="dim" style="font-size:11px;padding:4px 0 1px">others of the frame</div>')
        first = card.is_of(view.about)
        rows.append(_row(state, view, card))
    count = f"{len(view.expressions)}" + (f", {left_out} left out" if left_out else "")
    if len(view.expressions) > SHOWN:
        count += f"; {SHOWN} are listed"
    listed = f'<div class="scroll" style="--mh:max(150px,calc(34vh - 96px))">{"".join(rows)}</div>'
    return panel(heading("Expressions", count), listed)


def _row(state: State, view: LabelView, card: ExpressionCard) -> str:
    tags = []
    if card.mark is not None:
        tags.append(f'<b style="--c:{BAD}">{MARKED[card.mark]}</b>')
    tags += [f'<b style="--c:{GOOD}">{safe(s)}</b>' for s in sorted({*card.statuses.values()} - {"rejected"})]
    if card.ambiguous:
        tags.append(f'<b style="--c:{DOUBT}">ambiguous</b>')
    changed = {ORIGINS[o.source] for f, o in card.origins.items() if f not in ("mark", "status")} - {"auto"}
    tags += sorted(changed)
    kinds = f"ex{' sel' if card.id == view.expression else ''}{' out' if card.withdrawn else ''}"
    title = f"left out: {card.withdrawn}" if card.withdrawn else card.text
    below = (
        _answers(state, view, card, small=True)
        if not card.withdrawn
        else (f'<div class="dim" style="font-size:11px"><span>{safe(card.withdrawn)}</span></div>')
    )
    return (
        f'<div class="{kinds}" onclick="{_sends("expression:" + card.id)}" title="{safe(title)}">'
        f'<div><span class="say">{safe(card.text)}</span><span class="tags">{" · ".join(tags)}</span></div>'
        f"{below}</div>"
    )


def _sends(message: str) -> str:
    """A call of the page's bus, as an attribute's value: what is said is data, and no part of the script."""
    return safe(f"sv({json.dumps(message)})")


def history_html(state: State) -> str:
    """Who changed what of the selected object, the chosen pair and the expression."""
    view = state.labels
    if view is None:
        return ""
    if not view.history:
        return panel(heading("History"), '<div class="dim">Nobody has changed anything of what is selected.</div>')
    rows = "".join(_event(view, line) for line in view.history[:SHOWN_EVENTS])
    more = f"newest {SHOWN_EVENTS} of {len(view.history)}" if len(view.history) > SHOWN_EVENTS else ""
    return panel(heading("History", more), rows)


def _event(view: LabelView, line: EventLine) -> str:
    event = line.event
    before, after = (value_text(event.ref, value, view.frame) for value in (event.before, event.after))
    what = ref_text(event.ref, view.frame)
    change = f"{safe(before)} → <b>{safe(after)}</b>"
    when = event.time.astimezone().strftime("%d %b %H:%M:%S")
    told = f"{safe(event.author)} · {when}"
    told += f" · {safe(event.reason)}" if event.reason else ""
    action = ""
    if line.waiting:
        told += f' · <b style="color:{BAD}">not saved yet</b>'
    elif line.undone is not None:
        told += f" · undone by {safe(line.undone.author)}"
    elif line.group:
        action = (
            f'<span class="try" role="button" onclick="{_sends("undo-group:" + line.group)}" '
            'title="take this action back">undo</span>'
        )
    gone = ' class="gone"' if line.undone is not None else ""
    title = safe(f"{what}: {before} -> {after}")
    return (
        f'<div class="ev" title="{title}"><div{gone}>{safe(what)}: {change}</div>'
        f'<span class="do">{action}</span><div class="dim">{told}</div></div>'
    )
