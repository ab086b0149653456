"""Two runs side by side: a switch of whose answer is shown, and a table of both answers."""

from __future__ import annotations

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.diagnosis.story_words import Tone
from pipeline.diagnosis.verdict import shown_verdict
from pipeline.diagnosis.whatif.answer_view import OtherAnswer
from pipeline.geometry.boxes import iou_2d
from spatialviz.app.markup import Child, Element, h, note, segments, term
from spatialviz.app.state import State

MARKS: dict[Tone, str] = {"right": " ✓", "also right": " !", "wrong": " ✕", "none": ""}


def switch_html(state: State, tone: Tone) -> Element | None:
    """Switch between the answers of two runs, each with its mark; None for a single run.

    `tone`: of the shown answer.
    """
    other, listing = state.other, state.listing
    if other is None or listing is None or listing.figures.names is None:
        return None
    tones = (tone, other.story.tone)
    names = {
        side: f"{side.upper()} · {name}{MARKS[mark]}"
        for side, name, mark in zip("ab", listing.figures.names, tones[:: -1 if state.side == "b" else 1], strict=True)
    }
    moved = state.other_pair or ("the other cannot be asked" if other.problem else "one of them gives no answer")
    hints = {
        "a": "answer of the first run; the second's boxes are drawn thin",
        "b": "answer of the second run; the first's boxes are drawn thin",
        "both": "both answers in a table",
    }
    return h.div(
        segments("side", names | {"both": "both"}, state.side, "Answer of which run", hints),
        h.p(f"The other run: {moved}.", cls="sub"),
        cls="sides-of-runs",
    )


def both_html(state: State, trace: Trace, other: OtherAnswer) -> list[Child]:
    """Shown answer beside that of the other run, with the difference."""
    mine = state.ranked[0] if state.ranked else None
    names = None if state.listing is None else state.listing.figures.names
    if other.problem:
        return [h.h3("The other run", h.span(other.name)), note(other.problem)]
    own = "this run" if names is None else names[state.side == "b"]
    rows = []
    for name, pair, asked in ((own, mine, trace), (other.name, next(iter(other.pairs), None), other.trace)):
        cells: Child = h.td("no answer", colspan=4)
        if pair is not None and asked is not None and pair.reference is not None:
            shown = " · ".join(_named_here(state, asked.objects[i]) for i in (pair.target, pair.reference))
            factors = (pair.p_target, pair.p_reference, pair.p_relation)
            cells = [h.td(shown, cls="w", title=shown), *(h.td(f"{p:.2f}", cls="n") for p in factors)]
        rows.append(h.tr(h.th(name, scope="row"), cells))
    head = h.tr(
        h.td(), h.td(), (h.th(term(f"P({name})", name[:3]), cls="n") for name in ("target", "reference", "relation"))
    )
    d = other.diagnosis
    verdict = None if d is None else f"{other.story.head} ({shown_verdict(d.verdict, d.detail, d.lucky)})"
    return [
        h.h3("Two runs", h.span(state.other_pair)),
        h.table(h.thead(head), h.tbody(rows), cls="other"),
        h.p(f"{other.name}: {verdict}. {other.story.sentence}", cls="sub") if verdict else None,
    ]


def _named_here(state: State, entry: SceneObject) -> str:
    """Name of an object on this page; its class where this run lacks the object."""
    overlap = iou_2d(np.array([o.bbox for o in state.shown.objects]), entry.bbox)[:, 0]
    return state.shown.names[int(overlap.argmax())] if overlap.max() >= 0.5 else entry.label
