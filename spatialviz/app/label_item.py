"""Card of the review item: claim and reason, large buttons, and the next items."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.label_view import LabelView
from pipeline.corrections.review.items import ItemKey
from pipeline.labels.by_hand import grows
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import F, T, U
from spatialviz.app.markup import Element, button, h, progress

RULE = re.compile(r"^[a-z]+/[a-z-]+: ")
UNNAMED = "unnamed"
"""Class of an outlined object without a name."""
SAYS = {T: "true", U: "undecided", F: "false"}
Row = Mapping[str, Any]


def plain_reason(reason: str) -> str:
    """Reason without the name of its rule."""
    return RULE.sub("", reason)


def idle_card(queued: bool) -> Element:
    """Instructions without an open item or a selection."""
    start = answer("Begin", "J", "next-item:1", "open the first item of the queue", "yes")
    return h.div(
        h.div("One label after the other" if queued else "The queue is being built", cls="claim"),
        h.div("Each is asked with its reason; one key settles it and opens the next.", cls="dim"),
        h.div(start, cls="answers") if queued else None,
        cls="task-item",
    )


def answer(name: str, key: str, do: str, hint: str, cls: str = "", **more: object) -> Element:
    """Large button with its key."""
    keys = h.span(h.kbd(part) for part in key.split("+"))
    return h.button(h.span(name), keys, cls=cls, do=do, title=f"{hint} ({key})", aria_keyshortcuts=key, **more)


def small(name: str, key: str, do: str, hint: str) -> Element:
    """Small button."""
    return h.button(name, h.kbd(key), cls="try", do=do, title=hint, aria_keyshortcuts=key)


def item_card(view: LabelView, item: ItemKey | None, row: Row | None, selected: int | None) -> Element | None:
    """Open item, else the selected object; None without either."""
    reasons = [] if row is None else list(row["reasons"])
    match item:
        case ItemKey(kind="relation") if item.b is not None:
            return _relation(view, item, reasons)
        case ItemKey(kind="expression"):
            text = (view.frame.expression(item.what) or {}).get("text", "")
            return _card("expression", f"“{text}”", "Is this sentence true of what is marked?", reasons)
        case ItemKey() if item.a < 0:
            label = "" if row is None else row["label"]
            return _card("object", f"No {label} is labelled here", "Is there none?", reasons)
    if selected is None or (labelled := view.frame.objects.get(selected)) is None:
        return None
    name = labelled["label"]
    if name == UNNAMED:
        return _card("object", "What is this?", "Name it: Shift+O, or the digit of its class.", reasons)
    ask = "Are its name, its pixels and its box right?"
    return _card("object", f"{name}·{selected}", ask, reasons)


def _relation(view: LabelView, item: ItemKey, reasons: Sequence[str]) -> Element:
    assert item.b is not None
    one, other = (f"{(view.frame.object(n) or {}).get('label', 'object')}·{n}" for n in (item.a, item.b))
    state = view.frame.pairs.state(item.a, item.b, item.what)
    claim = f"{one} {PHRASE[item.what]} {other}"
    kinds = ((T, "It is so", "T"), (U, "Undecided", "U"), (F, "It is not so", "F"))
    answers = h.div(
        (
            answer(name, key, f"settle:{key}", f"label it {SAYS[s]}", aria_pressed=str(s == state).lower())
            for s, name, key in kinds
        ),
        cls="answers",
    )
    labelled = "not labelled" if state is None else f"labelled {SAYS[state]}"
    return _frame(claim, f"It is {labelled}. Is that right?", reasons, answers, "keep it as it is")


def _card(kind: str, claim: str, ask: str, reasons: Sequence[str]) -> Element:
    answers = h.div(
        answer("Right", "Y", "accept-item", "accept it", "yes"),
        answer("Wrong", "N", "reject-item", "leave it out" if kind == "object" else "it is not so", "no"),
        answer("Unsure", "Shift+U", "unsure-item", "ask somebody else"),
        cls="answers",
    )
    return _frame(claim, ask, reasons, answers, "")


def _frame(claim: str, ask: str, reasons: Sequence[str], answers: Element, accept: str) -> Element:
    why = (
        h.ul((h.li(plain_reason(reason)) for reason in reasons), cls="because", aria_label="why it is asked")
        if reasons
        else None
    )
    lesser = h.div(
        small("Accept", "Y", "accept-item", accept) if accept else None,
        small("Unsure", "⇧U", "unsure-item", "ask somebody else") if accept else None,
        small("Undo", "^Z", "take-back", "take the last action back"),
        small("Skip", "J", "next-item:1", "the next item"),
        small("Zoom", "⇧F", "focus", "look at it in the scene"),
        cls="lesser",
    )
    return h.div(h.div(claim, cls="claim"), h.div(ask, cls="dim"), why, answers, lesser, cls="task-item")


def digits_row(names: Sequence[str], label: str) -> Element | None:
    """Classes chosen by digits."""
    chips = (
        h.button(
            h.kbd(str(k)),
            name,
            cls="try",
            do=f"digit:{k}",
            aria_pressed=str(name == label).lower(),
            title=f"it is a {name} ({k})",
        )
        for k, name in enumerate(names, 1)
    )
    return h.div(chips, cls="digits", role="group", aria_label="Class by its digit") if names else None


def begin_card(view: LabelView, editor: LabelEditor) -> Element:
    """Instructions for a frame without labels."""
    where = f"Saved from the first stroke, in {editor.labels.root}" if grows(editor.labels) else None
    tools = h.div(
        answer("Rectangle", "Shift+N", "px-new", "drag a rectangle: the surface inside it"),
        answer("Brush", "Shift+W", "px-new:brush", "paint it"),
        answer("Depth", "Shift+Q", "px-new:depth", "click it: the surface around the click"),
        cls="answers",
    )
    return h.div(
        h.div("Nothing is labelled in this frame", cls="claim"),
        h.div("Outline a thing, then type its name: its 3D box and its relations follow.", cls="dim"),
        tools,
        None if where is None else h.div(where, cls="dim hint"),
        cls="task-item begin",
    )


def pace_html(settled: int, items: int) -> Element | None:
    """Progress through the queue."""
    if not items:
        return None
    told = h.span(h.b(f"{settled:,}"), f" of {items:,} settled")
    return h.div(told, progress("settled of the queue", settled, items), cls="pace", id="pace")


def bulk_html(find: str, found: int, all_items: int) -> Element:
    """Filter of the queue, and acceptance of all results."""
    field = h.input(
        cls="find",
        value=find,
        live="queue-find:",
        placeholder="filter: left, mug, 000002 …",
        spellcheck="false",
        aria_label="Only items whose words or reasons hold this",
        id="queue-find",
    )
    accept = button(
        f"Accept all {found:,}" if find or found < all_items else "Accept all …",
        "accept-found",
        "as one step, which one undo takes back",
        disabled=not found or not find,
    )
    told = counted(found, "open item") if find else "Filter first: then all that is found can be accepted at once."
    return h.div(field, accept, h.span(told, cls="dim"), cls="bulk", id="queue-bulk")
