"""The review queue as a list: what may be wrong, how surely, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.relations import PHRASE
from pipeline.review.items import ItemKey
from pipeline.review.worklist import Worklist
from spatialviz.app.text import BAD, DOUBT, GOOD, heading, note, panel, safe, tail

ROWS = 40
MARKS = {
    "unreviewed": ("", ""),
    "accepted": ("✓", GOOD),
    "corrected": ("✎", GOOD),
    "rejected": ("✗", "#8a919c"),
    "unsure": ("?", DOUBT),
}
KINDS = {"all": "all", "relation": "relations", "object": "objects", "expression": "sentences"}
Names = Mapping[tuple[str, int], str]


@dataclass(frozen=True)
class Making:
    """How far a queue that is being made is.

    Attributes
    ----------
    running : bool
    networks : bool
        Whether networks are asked.
    done, of : int
        Of the networks.
    problem : str
    made : dict or None
        What is known of the queue that was made last: `queue_job.make_queue`.
    """

    running: bool = False
    networks: bool = False
    done: int = 0
    of: int = 0
    problem: str = ""
    made: Mapping[str, Any] | None = None


def item_html(row: Mapping[str, Any] | None, names: Names, item: ItemKey | None) -> str:
    """The item that is looked at: what the label says, how probably it is wrong, and every reason."""
    if row is None or item is None:
        return ""
    wrong = f'<span class="p" title="how probably the label is wrong">{row["score"]:.0%}</span>'
    network = "" if row["probability"] is None else f" · networks: {row['probability']:.2f} that it holds"
    reasons = "".join(f"<div>{safe(reason)}</div>" for reason in row["reasons"])
    ways = "T U F settle it, Y accepts" if item.kind == "relation" else "Y accepts, Shift+Y rejects"
    return (
        f'<div class="item"><div class="big"><b>{said(row, names)}</b>{wrong}</div>'
        f'<div class="why">{reasons}</div><div class="dim">{ways}, Shift+U unsure{network}</div></div>'
    )


def queue_html(
    work: Worklist | None, making: Making, kind: str, item: ItemKey | None, names: Names, can_learn: bool = True
) -> str:
    """The list from the current item on, what it was made from, and the buttons that make it anew."""
    if making.running:
        share = making.done / making.of if making.of else 0.0
        what = f"asking network {making.done + 1} of {making.of}" if making.of else "ranking the labels"
        busy = f'<div class="prog"><i style="width:{share:.0%}"></i></div><div class="dim">{what}</div>'
    else:
        busy = note(f"No queue: {making.problem}", BAD) if making.problem else ""
    again = _button("make-queue:networks", "rank by networks", "asks networks that have not learnt from a label")
    again = "" if making.running or not can_learn else again
    if work is None:
        return panel(heading("Queue", again), busy or '<div class="dim">No queue yet.</div>')
    counts = work.counts
    tally = " · ".join(f"{counts[state]:,} {state}" for state in MARKS if state != "unreviewed" and counts[state])
    chosen = "".join(
        f'<span class="{"on" if name == kind else ""}" onclick="sv(\'queue-kind:{name}\')">{label}</span>'
        for name, label in KINDS.items()
    )
    rows = "".join(_row(work, place, names, item) for place in shown_places(work, kind, item))
    return panel(
        heading("Queue", again),
        busy,
        f'<div class="dim">{counts["settled"]:,} of {counts["items"]:,} settled{" · " + tally if tally else ""}</div>',
        _known(making.made),
        f'<div class="seg" style="margin:3px 0">{chosen}</div>',
        f'<div class="queue">{rows or "nothing of this kind"}</div>',
    )


def _known(made: Mapping[str, Any] | None) -> str:
    """How many labels the networks hold for wrong, and how far reviewers agree."""
    if made is None:
        return ""
    parts = []
    if made["estimated_wrong"] is not None:
        parts.append(f"networks hold {made['estimated_wrong']:.0f} relation labels for wrong")
    for pair in made["agreement"]:
        kappa = "–" if pair["kappa"] is None else f"{pair['kappa']:.2f}"
        parts.append(f"{' and '.join(map(safe, pair['reviewers']))}: κ {kappa} on {pair['items']} items")
    return f'<div class="dim" title="when the queue was made">{" · ".join(parts)}</div>' if parts else ""


def shown_places(work: Worklist, kind: str, item: ItemKey | None) -> Sequence[int]:
    """The rows around the current one."""
    at = 0 if item is None else work.places.get(item.plain, 0)
    start = max(0, at - 3)
    places = []
    for place in range(start, len(work)):
        if kind in ("all", work.keys[place].kind):
            places.append(place)
        if len(places) == ROWS:
            break
    return places


def _row(work: Worklist, place: int, names: Names, item: ItemKey | None) -> str:
    key = work.keys[place]
    row = work.queue.slice(place, 1).to_pylist()[0]
    mark, color = MARKS[work.state(key)]
    reason = row["reasons"][0] if row["reasons"] else ""
    selected = " sel" if item is not None and key == item.plain else ""
    return (
        f'<div class="q{selected}" onclick="sv(\'item:{place}\')" title="{safe(reason)}">'
        f'<i style="--v:{row["score"]:.2f}"></i><span>{said(row, names)}</span>'
        f'<b style="color:{color}">{mark}</b><em>{tail(row["frame"])}</em></div>'
    )


def said(row: Mapping[str, Any], names: Names) -> str:
    """What the label says, as HTML."""
    frame, kind = row["frame"], row["kind"]

    def named(number: int) -> str:
        return safe(f"{names.get((frame, number), 'object')}·{number}")

    if kind == "relation":
        return f"{named(row['a'])} {PHRASE[row['relation']]} {named(row['b'])}: {row['label']}"
    if kind == "object":
        return safe(f"no {row['label']} labelled here") if row["a"] < 0 else named(row["a"])
    return safe(f"“{row['label']}”")


def _button(message: str, label: str, hint: str) -> str:
    return f'<span class="try" role="button" onclick="sv(\'{message}\')" title="{safe(hint)}">{label}</span>'
