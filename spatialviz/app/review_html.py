"""Review tab: queue of suspect labels, labels of the pair, and their history."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.review.label_jobs import CANCELLED, QueueProgress
from pipeline.corrections.review.worklist import Worklist
from pipeline.corrections.scene import PairCard, RelationLine
from pipeline.geometry.palette import palette
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
    switch = button("networks", "queue-networks", hint, role="switch", aria_checked=str(networks).lower())
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
