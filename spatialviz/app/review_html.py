"""Label: card of the open item, labels of the pair, and the queue of suspect labels."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.object_card import LabelView
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.review.label_jobs import CANCELLED, QueueProgress
from pipeline.corrections.review.worklist import Worklist
from pipeline.corrections.scene import PairCard, RelationLine
from pipeline.geometry.palette import palette
from pipeline.labels.by_hand import grows
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import F, T, U, letter
from spatialviz.app.keys import KEYS_OF_ONE
from spatialviz.app.markup import (
    BAD,
    DOUBT,
    GOOD,
    Child,
    Element,
    button,
    chosen,
    dot,
    h,
    heading,
    note,
    panel,
    progress,
    segments,
)
from spatialviz.app.state import State

STATES = {T: ("T", GOOD, "true"), U: ("U", DOUBT, "undecided"), F: ("F", "#8a919c", "false")}
MARKS = {"auto": "", "human": "by hand", "recomputed": "recomputed", "stale": "stale"}


def review_head_html(state: State, opened: bool, desk: LabelEditor | None) -> Element:
    """State of the labels: shown or not, author's name, outcome of the last edit, and unsaved edits."""
    if not opened:
        return panel(h.div("No labels are open (--labels).", cls="dim hint"))
    view = state.labels
    show = button(
        "show the labels" if view is None else "labels are shown",
        "labels",
        "Shift+L",
        aria_pressed=str(view is not None).lower(),
    )
    waiting, disputed = ((), ()) if desk is None else (desk.waiting, desk.disputed)
    # Unsaved edits carry the reason.
    said = note(view.said, BAD if view.bad else GOOD) if view and view.said and not (waiting and view.bad) else None
    kept = f"{counted(len(waiting), 'action')} not saved yet, kept here and tried again every few seconds: "
    decide = "Somebody was faster than you: nothing of yours is saved until you decide."
    who = (
        None
        if desk is None
        else h.label(
            h.span("reviewer", cls="dim"),
            h.input(cls="find", value=desk.author, maxlength=200, change="author"),
            cls="who",
            title="under whose name corrections are saved",
        )
    )
    title = h.h2("Labelling", h.span("every action is saved at once", cls="dim"), cls="mode-title")
    return panel(
        None if view is None else title,
        h.div(show, who, cls="nav"),
        said,
        (note(kept + waiting[-1].problem, BAD), button("try again", "save-again", cls="go")) if waiting else None,
        (note(decide, BAD), button("decide", "conflict", cls="go")) if disputed else None,
    )


def pair_html(state: State) -> Element | None:
    """Every relation of the pair, each settled by T, U or F."""
    view = state.labels
    if view is None:
        return None
    card, item = view.card, view.item
    if card is None:
        keys = None if state.selected is None else (h.br(), f"{KEYS_OF_ONE}.")
        pair = "Select two objects, one after the other, or open an item of the queue."
        # An item shows its own keys.
        return panel(h.div(pair, keys, cls="dim")) if item is None else None
    colors = palette(state.dark)
    first = dot(colors["target"]), f"{card.names[0]}·{card.a}"
    second = dot(colors["reference"]), f"{card.names[1]}·{card.b}"
    head = heading(h.b(first, " … ", second), button("swap", "swap", "the other way round (X)"))
    if card.why_none:
        return panel(head, note(f"Takes part in no relation: {card.why_none}"))
    # Pairs beside the open item are settled by a click on a row.
    beside = item is not None and item.kind == "relation" and (item.a, item.b) != (card.a, card.b)
    only = h.div("Only looked at: the keys act on the open item.", cls="dim") if beside else None
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
    # A person's judgement against the rule has no margin: 0 is not a distance then.
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
    """Geometric objection to a judgement, as a question before saving."""
    a, b = f"{card.names[0]}·{card.a}", f"{card.names[1]}·{card.b}"
    says, said = letter(F if state == T else T), letter(state)
    return h.div(
        h.div(h.b(a), f" {PHRASE[line.relation]} ", h.b(b), f": {said}?", cls="what"),
        h.div(f"Geometry says {says}, by {line.against(state) * 100:.1f} cm."),
        h.div(f"{said} once more saves it all the same, Escape leaves the label as it is.", cls="dim"),
        cls="dispute",
    )


ROWS, STEP = 40, 20
STATUS_MARKS = {
    "unreviewed": ("", "inherit"),
    "accepted": ("✓", GOOD),
    "corrected": ("✎", GOOD),
    "rejected": ("✗", "#8a919c"),
    "unsure": ("?", DOUBT),
}
KINDS = {"all": "all", "relation": "relations", "object": "objects", "expression": "sentences"}
Names = Mapping[tuple[str, int], str]


def queue_html(
    work: Worklist | None,
    making: QueueProgress,
    networks: bool,
    kind: str,
    item: ItemKey | None,
    names: Names,
    bulk: Element | None = None,
) -> Element:
    """Sources of the queue, progress, filters, and the list from the current item on."""
    again = "build again" if work is not None else "build"
    stop = button("stop", "stop-queue", "ends the asking; the queue that there is stays")
    make = button(again, "make-queue", "ranks the labels by what is switched on here")
    head = heading("Queue", stop if making.running else make).with_(id="queue-head")
    hint = "beside the rules and the linter, networks that have not learnt from a label"
    switch = button("with networks", "queue-networks", hint, role="switch", aria_checked=str(networks).lower())
    parts = [head, h.div(switch, id="queue-asks", cls="asks"), h.div(_busy(making), id="queue-busy")]
    if work is None:
        return panel(parts, None if making.running else h.div("No queue yet.", cls="dim"))
    rows = [_row(work, place, names, item) for place in shown_places(work, kind, item)]
    return panel(
        parts,
        segments("queue-kind", KINDS, kind, "Items of one kind"),
        bulk,
        h.div(rows or "nothing of this kind", id="queue-rows", cls="queue"),
    )


def _busy(making: QueueProgress) -> Child:
    """Progress of the queue in preparation, or the reason of a failure."""
    if not making.running:
        failed = making.problem and making.problem != CANCELLED
        stays = "was not made" if making.work is None else "stays as it is"
        return note(f"The queue {stays}: {making.problem}", BAD) if failed else None
    _, done, of = making.step or ("", 0, 0)
    what = f"asking network {done + 1} of {of}" if done < of else "ranking the labels"
    return progress(what, done, of), h.div(what, cls="dim")


def shown_places(work: Worklist, kind: str, item: ItemKey | None) -> Sequence[int]:
    """Rows around the current item; scrolls by `STEP` rows, so that the next item sends few."""
    at = 0 if item is None else work.indices.get(item.plain, 0)
    start = max(0, at - 3) // STEP * STEP
    places = (k for k in range(start, len(work)) if kind in ("all", work.keys[k].kind) and not work.gone[k])
    return list(islice(places, ROWS))


def _row(work: Worklist, place: int, names: Names, item: ItemKey | None) -> Element:
    key = work.keys[place]
    row = work.queue.slice(place, 1).to_pylist()[0]
    mark, color = STATUS_MARKS[work.state(key)]
    reason = row["reasons"][0] if row["reasons"] else ""
    return h.div(
        h.i(css={"--v": f"{row['score']:.2f}"}),
        h.span(said(row, names)),
        h.b(mark, css={"color": color}),
        # Truncated at the left by right-to-left text; marks keep the ends in place.
        h.em(f"\u200e{row['frame']}\u200e"),
        id=f"item-{place}",
        **chosen(item is not None and key == item.plain, "q"),
        do=f"item:{place}",
        title=reason or None,
    )


def said(row: Mapping[str, Any], names: Names) -> str:
    """Claim of the label, in words."""
    frame, kind = row["frame"], row["kind"]

    def named(number: int) -> str:
        return f"{names.get((frame, number), 'object')}·{number}"

    match kind:
        case "relation":
            return f"{named(row['a'])} {PHRASE[row['relation']]} {named(row['b'])}: {row['label']}"
        case "object":
            return f"no {row['label']} labelled here" if row["a"] < 0 else named(row["a"])
    return f"“{row['label']}”"


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
