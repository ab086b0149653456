"""Label: card of the open item, labels of the pair, and the queue of suspect labels."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.review.decisions import Answer, ReviewQuestion
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.review.label_jobs import CANCELLED, QueueProgress
from pipeline.corrections.review.worklist import Worklist
from pipeline.corrections.scene import PairCard, RelationLine
from pipeline.labels.by_hand import grows
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import F, T, U, letter
from spatialviz.app.markup import (
    Child,
    Element,
    button,
    chosen,
    h,
    heading,
    note,
    panel,
    progress,
    segments,
    sign,
    textbox,
    toggle,
)
from spatialviz.app.state import State

STATES = {T: ("good", "true"), U: ("doubt", "undecided"), F: ("idle", "false")}
MARKS = {"auto": "", "human": "by hand", "recomputed": "recomputed", "stale": "stale"}


def review_head_html(state: State, opened: bool, desk: LabelEditor | None) -> Element:
    """Author's name, and edits that are not saved."""
    if not opened:
        return panel(h.div("No labels are open (--labels).", cls="dim hint"))
    waiting, disputed = ((), ()) if desk is None else (desk.waiting, desk.disputed)
    kept = f"{counted(len(waiting), 'action')} not saved yet, kept here and tried again every few seconds: "
    decide = "Somebody was faster than you: nothing of yours is saved until you decide."
    hint, name = "every answer is saved at once, under this name", "" if desk is None else desk.author
    who = textbox("reviewer", hint, value=name, maxlength=200, change="author")
    return panel(
        None if state.labels is None else h.h2("Labelling as", who, cls="mode-title"),
        (note(kept + waiting[-1].problem, "bad"), button("try again", "save-again", cls="go")) if waiting else None,
        (note(decide, "bad"), button("decide", "conflict", cls="go")) if disputed else None,
    )


def pair_html(state: State) -> Element | None:
    """Every relation of the pair, each settled by T, U or F."""
    view = state.labels
    if view is None or view.card is None:
        return None
    card, item = view.card, view.item
    head = h.summary("All relations of ", h.b(f"{card.names[0]} {card.a} … {card.names[1]} {card.b}"))
    if card.why_none:
        return panel(head, note(f"Takes part in no relation: {card.why_none}"))
    # Pairs beside the open item are settled by a click on a row.
    beside = item is not None and item.kind == "relation" and (item.a, item.b) != (card.a, card.b)
    only = h.div("Only looked at: the keys act on the open item.", cls="dim") if beside else None
    swap = button("swap", "swap", "the other way round (X)")
    rows = (_line(line, view.relation) for line in card.lines)
    return panel(h.details(head, swap, only, rows, open=item is None or beside, id=f"pair-{card.a}-{card.b}"))


def _line(line: RelationLine, focused: str | None) -> Element:
    settle = f"settle:{line.relation}:"
    cells = (
        toggle(letter(t), settle + letter(t), line.state == t, f"{word} ({letter(t)})", color=color)
        for t, (color, word) in STATES.items()
    )
    # A person's judgement against the rule has no margin: 0 is not a distance then.
    overruled = line.origin.source == "human" and line.margin == 0
    margin = "" if line.margin is None or overruled else f"{line.margin * 100:+.1f} cm"
    mark = MARKS[line.origin.source] + (f" · {line.status}" if line.status else "")
    return h.div(
        h.span(PHRASE[line.relation]),
        h.span(cells, cls="tuf"),
        h.span(margin, cls="n dim"),
        h.span(mark, cls="dim"),
        id=f"label-{line.relation}",
        **chosen(line.relation == focused, "lab"),
        role="group",
        do=f"relation-row:{line.relation}",
        title=f"{'none' if line.state is None else letter(line.state)}: {line.origin}",
    )


def doubt_html(card: PairCard, line: RelationLine, state: int) -> Element:
    """Geometric objection to a judgement, as a question before saving."""
    a, b = f"{card.names[0]} {card.a}", f"{card.names[1]} {card.b}"
    says, said = letter(F if state == T else T), letter(state)
    return h.div(
        h.div(h.b(a), f" {PHRASE[line.relation]} ", h.b(b), f": {said}?", cls="what"),
        h.div(f"Geometry says {says}, by {line.against(state) * 100:.1f} cm."),
        h.div(f"{said} once more saves it all the same, Escape leaves the label as it is.", cls="dim"),
        cls="dispute",
    )


ROWS, STEP = 16, 8
STATUS_MARKS = {
    "unreviewed": ("", None),
    "accepted": ("✓", "good"),
    "corrected": ("✎", "good"),
    "rejected": ("✗", "idle"),
    "unsure": ("?", "doubt"),
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
    found: Sequence[int] | None = None,
) -> Element:
    """Sources of the queue, progress, filters, and the list from the current item on; of a filter what it found."""
    stop = button("stop", "stop-queue", "ends the asking; the queue that there is stays")
    make = button("rebuild" if work else "build", "make-queue", "ranks the labels by what is switched on here")
    hint = "beside the rules and the linter, networks that have not learnt from a label"
    switch = button("networks", "queue-networks", hint, role="switch", aria_checked=networks)
    parts = [
        heading("Next", switch, stop if making.running else make).with_(id="queue-head"),
        h.div(_busy(making), id="queue-busy"),
    ]
    if work is None:
        return panel(parts, None if making.running else h.div("No queue yet.", cls="dim"))
    places, at = shown_places(work, kind, item, found), None if item is None else work.indices.get(item.plain)
    rows = [_row(place, row, names, place == at) for place, row in zip(places, work.rows(places), strict=True)]
    none = "nothing of this kind" if found is None else "nothing with these words"
    return panel(
        parts,
        segments("queue-kind", KINDS, kind, "Items of one kind"),
        bulk,
        h.div(rows or none, id="queue-rows", cls="queue"),
    )


def _busy(making: QueueProgress) -> Child:
    """Progress of the queue in preparation, or the reason of a failure."""
    if not making.running:
        failed = making.problem and making.problem != CANCELLED
        stays = "was not made" if making.work is None else "stays as it is"
        return note(f"The queue {stays}: {making.problem}", "bad") if failed else None
    _, done, of = making.step or ("", 0, 0)
    what = f"asking network {done + 1} of {of}" if done < of else "ranking the labels"
    return progress(what, done, of), h.div(what, cls="dim")


def shown_places(work: Worklist, kind: str, item: ItemKey | None, found: Sequence[int] | None = None) -> Sequence[int]:
    """Rows around the current item, or around its place among those found; scrolls by `STEP` rows, so that the next
    item sends few.
    """
    at = 0 if item is None else work.indices.get(item.plain, 0)
    if found is not None:
        first = max(0, bisect_left(found, at) - 3) // STEP * STEP
        return found[first : first + ROWS]
    start = max(0, at - 3) // STEP * STEP
    places = (k for k in range(start, len(work)) if kind in ("all", work.keys[k].kind) and not work.gone[k])
    return list(islice(places, ROWS))


def _row(place: int, row: Row, names: Names, shown: bool) -> Element:
    mark, color = STATUS_MARKS[row["state"]]
    return h.div(
        h.i(css={"--v": f"{row['score']:.2f}"}),
        h.span(said(row, names)),
        h.b(mark, color=color),
        # Truncated at the left by right-to-left text; marks keep the ends in place.
        h.em(f"\u200e{row['frame']}\u200e"),
        id=f"item-{place}",
        **chosen(shown, "q"),
        do=f"item:{place}",
        title=next(iter(row["reasons"]), None),
    )


def said(row: Mapping[str, Any], names: Names) -> str:
    """Claim of the label, in words."""
    frame, kind = row["frame"], row["kind"]

    def named(number: int) -> str:
        return f"{names.get((frame, number), 'object')} {number}"

    match kind:
        case "relation":
            return f"{named(row['a'])} {PHRASE[row['relation']]} {named(row['b'])}: {row['label']}"
        case "object":
            return f"no {row['label']} labelled here" if row["a"] < 0 else named(row["a"])
    return f"“{row['label']}”"


RULE = re.compile(r"^([a-z]+/[a-z-]+: )?('.*?': )?")
"""Name of a reason's rule, and the sentence that it is about."""
Row = Mapping[str, Any]
DECISIONS: dict[Answer, tuple[str, str]] = {
    "right": ("Correct", "Y"),
    "wrong": ("Wrong", "N"),
    "unsure": ("Unsure", "U"),
}


def decision_bar(question: ReviewQuestion | None) -> Element:
    """The three answers, always at the same place; each says what it does."""
    buttons = (
        h.button(
            h.b(h.kbd(key), name),
            h.small("" if question is None else question.choices[answer].does),
            cls=answer,
            do=f"decide:{answer}",
            aria_keyshortcuts=key,
            disabled=question is None,
        )
        for answer, (name, key) in DECISIONS.items()
    )
    return h.div(buttons, cls="decision", role="group", aria_label="Answer")


def _card(claim: str, ask: str, *more: Child, cls: str = "task-item") -> Element:
    return h.div(h.div(claim, cls="claim"), h.div(ask, cls="dim"), more, cls=cls)


def idle_card(queued: bool) -> Element:
    """Instructions without an open item or a selection."""
    begin = h.div(answer("Begin", "J", "next-item:1", "open the first item of the queue"), cls="answers")
    claim = "One label after the other" if queued else "The queue is being built"
    ask = "Each is asked with its reason; one key answers it and opens the next."
    return _card(claim, ask, begin if queued else None)


def answer(name: str, key: str, do: str, hint: str) -> Element:
    """Large button with its key."""
    keys = h.span(h.kbd(part) for part in key.split("+"))
    return h.button(h.span(name), keys, do=do, title=f"{hint} ({key})", aria_keyshortcuts=key)


def item_card(question: ReviewQuestion, reasons: Sequence[str]) -> Element:
    """What is asked, why, and where people differ what each of them said."""
    said = (
        h.div(h.b(w.text), h.span(w.author), h.span(f"{w.time.astimezone():%d %b %H:%M}", cls="dim"), cls="word")
        for w in question.words
    )
    words = h.div(said, cls="words", role="group", aria_label="who said what")
    # What the cards of people who differ say is no reason beside them.
    reasons = [r for r in reasons if not (question.words and r.startswith("reviewers disagree"))]
    why = h.ul((h.li(RULE.sub("", reason)) for reason in reasons), cls="because", aria_label="why it is asked")
    return _card(question.claim, question.ask, words if question.words else None, why if reasons else None)


def digits_row(names: Sequence[str], label: str) -> Element | None:
    """Classes chosen by digits."""
    chips = (
        button((h.kbd(k), name), f"digit:{k}", f"it is a {name} ({k})", aria_pressed=name == label)
        for k, name in enumerate(names, 1)
    )
    return h.div(chips, cls="digits", role="group", aria_label="Class by its digit") if names else None


def begin_card(editor: LabelEditor) -> Element:
    """Instructions for a frame without labels."""
    where = f"Saved from the first stroke, in {editor.labels.root}"
    tools = h.div(
        answer("Rectangle", "Shift+N", "px-new", "drag a rectangle: the surface inside it"),
        answer("Brush", "Shift+W", "px-new:brush", "paint it"),
        answer("Depth", "Shift+Q", "px-new:depth", "click it: the surface around the click"),
        cls="answers",
    )
    ask = "Outline a thing, then type its name: its 3D box and its relations follow."
    place = h.div(where, cls="dim hint") if grows(editor.labels) else None
    return _card("Nothing is labelled in this frame", ask, tools, place, cls="task-item begin")


def pace_html(counts: Mapping[str, int]) -> Element:
    """Progress through the queue, steps in it, and the one pair of undo and redo."""
    settled, items = counts["settled"], counts["items"]
    return h.div(
        h.span(h.b(f"{settled:,}"), f" of {items:,} settled", cls="done"),
        _step("‹", "K", "next-item:-1", "the item before"),
        _step("›", "J", "next-item:1", "skip it: the next item"),
        _step("↶", "Ctrl+Z", "take-back", "undo"),
        _step("↷", "Ctrl+Y", "bring-back", "redo"),
        progress("settled of the queue", settled, items),
        cls="pace",
    )


def _step(mark: str, key: str, do: str, name: str) -> Element:
    shortcut = key.replace("Ctrl", "Control")
    return sign(mark, do, name, "try", title=f"{name} ({key})", aria_keyshortcuts=shortcut)


def bulk_html(find: str, found: int) -> Element:
    """Filter of the queue, and acceptance of all results."""
    given = {"value": find, "live": "queue-find:", "placeholder": "filter: left, mug, 000002 …", "id": "queue-find"}
    field = textbox("Only items whose words or reasons hold this", **given)
    hint = "as one step, which one undo takes back; filter first"
    accept = button(f"All {found:,} are correct", "accept-found", hint, disabled=not found or not find)
    return h.div(field, accept, cls="bulk", id="queue-bulk")
