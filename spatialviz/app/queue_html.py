"""The review queue as a list: what may be wrong, how surely, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.review.label_jobs import CANCELLED, QueueProgress
from pipeline.corrections.review.worklist import Worklist
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from spatialviz.app.text import BAD, DOUBT, GOOD, heading, note, panel, safe, tail

ROWS = 40
SKIPPED = 8
"""Frames that a hint names."""
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
class Asked:
    """What a queue that is made next is made of, besides the rules and the linter.

    Attributes
    ----------
    networks : bool
    detector : bool
    named : str
        The detector that can be asked; empty without one.
    """

    networks: bool = False
    detector: bool = True
    named: str = ""


def item_html(work: Worklist, names: Names, item: ItemKey) -> str:
    """The item that is looked at: what the label says, how probably it is wrong, and every reason; and the progress."""
    row, counts = work.row(item), work.counts
    wrong = f'<span class="p" title="how probably the label is wrong">{row["score"]:.0%}</span>'
    network = "" if row["probability"] is None else f" · networks: {row['probability']:.2f} that it holds"
    reasons = "".join(f"<div>{safe(reason)}</div>" for reason in row["reasons"])
    ways = "T U F settle it, Y accepts" if item.kind == "relation" else "Y accepts, Shift+Y rejects"
    leave = _button("leave-item", "×", "leave the item: the keys act on what is selected again")
    return (
        f'<div class="item"><div class="big"><b>{said(row, names)}</b>{wrong}{leave}</div>'
        f'<div class="why">{reasons}</div><div class="ways dim"><span>{ways}, Shift+U unsure{network}</span>'
        f'<span title="{_settled(counts)}">{counts["settled"]:,} of {counts["items"]:,}</span></div></div>'
    )


def queue_html(
    work: Worklist | None, making: QueueProgress, asked: Asked, kind: str, item: ItemKey | None, names: Names
) -> str:
    """What the queue is made of, how far that is, and the list from the current item on."""
    again = "make again" if work is not None else "make"
    stop = _button("stop-queue", "stop", "ends the asking; the queue that there is stays")
    make = _button("make-queue", again, "ranks the labels by what is switched on here")
    parts = [heading("Queue", stop if making.running else make), _asked(asked), _busy(making)]
    if work is None:
        return panel(*parts, "" if making.running else '<div class="dim">No queue yet.</div>')
    counts = work.counts
    tally = " · ".join(f"{counts[state]:,} {state}" for state in MARKS if state != "unreviewed" and counts[state])
    chosen = "".join(
        f'<span class="{"on" if name == kind else ""}" onclick="sv(\'queue-kind:{name}\')">{label}</span>'
        for name, label in KINDS.items()
    )
    rows = "".join(_row(work, place, names, item) for place in shown_places(work, kind, item))
    return panel(
        *parts,
        _known(making.made),
        f'<div class="dim">{_settled(counts)}{" · " + tally if tally else ""}</div>',
        f'<div class="seg" style="margin:3px 0">{chosen}</div>',
        f'<div class="queue">{rows or "nothing of this kind"}</div>',
    )


def _asked(asked: Asked) -> str:
    """What goes into the next queue: switches."""
    parts = ['<span class="try on" style="cursor:default" title="always in it">rules and linter</span>']
    parts.append(_switch("networks", "networks", asked.networks, "networks that have not learnt from a label"))
    if asked.named:
        hint = f"what the detector {asked.named} sees otherwise in the labelled frames"
        parts.append(_switch("detector", f"detector {asked.named}", asked.detector, hint))
    return f'<div class="asks">{"".join(parts)}</div>'


def _switch(name: str, label: str, on: bool, hint: str) -> str:
    return (
        f'<span class="try{" on" if on else ""}" role="switch" aria-checked="{str(on).lower()}" '
        f'onclick="sv(\'queue-from:{name}\')" title="{safe(hint)}">{safe(label)}</span>'
    )


def _busy(making: QueueProgress) -> str:
    """How far a queue that is made is, or why there is none."""
    if not making.running:
        failed = making.problem and making.problem != CANCELLED
        stays = "was not made" if making.work is None else "stays as it is"
        return note(f"The queue {stays}: {making.problem}", BAD) if failed else ""
    share, what = 0.0, "ranking the labels"
    if making.step is not None:
        kind, done, of = making.step
        share = done / of if of else 0.0
        if done < of:
            what = f"asking network {done + 1} of {of}" if kind == "networks" else f"detector: frame {done + 1} of {of}"
    return f'<div class="prog"><i style="width:{share:.0%}"></i></div><div class="dim">{what}</div>'


def _known(made: Mapping[str, Any] | None) -> str:
    """What the queue was made of: what networks and a detector said; and how far reviewers agreed by then."""
    if made is None:
        return ""
    parts, hint = ["rules and linter"], "what this queue was made of"
    if made["estimated_wrong"] is not None:
        parts.append(f"networks: {made['estimated_wrong']:.0f} relations wrong")
    if (said := made["detector"]) is not None:
        skipped = said["skipped"]
        left_out = f", {len(skipped)} skipped" if skipped else ""
        parts.append(f"{safe(said['name'])}: {counted(said['frames'], 'frame')}{left_out}")
        hint += "".join(f"\n{frame}: {why}" for frame, why in list(skipped.items())[:SKIPPED])
        hint += f"\nand {len(skipped) - SKIPPED} more" if len(skipped) > SKIPPED else ""
    for pair in made["agreement"]:
        kappa = "–" if pair["kappa"] is None else f"{pair['kappa']:.2f}"
        parts.append(f"{' and '.join(map(safe, pair['reviewers']))}: κ {kappa} on {counted(pair['items'], 'item')}")
    return f'<div class="dim" title="{safe(hint)}">made of {" · ".join(parts)}</div>'


def shown_places(work: Worklist, kind: str, item: ItemKey | None) -> Sequence[int]:
    """The rows around the current one."""
    at = 0 if item is None else work.indices.get(item.plain, 0)
    start = max(0, at - 3)
    places = []
    for place in range(start, len(work)):
        if kind in ("all", work.keys[place].kind) and not work.gone[place]:
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


def _settled(counts: Mapping[str, int]) -> str:
    return f"{counts['settled']:,} of {counts['items']:,} settled"


def _button(message: str, label: str, hint: str) -> str:
    return f'<span class="try" role="button" onclick="sv(\'{message}\')" title="{safe(hint)}">{label}</span>'
