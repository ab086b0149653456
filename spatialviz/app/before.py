"""The answer before the edits, above the one after them; and marks on the numbers that they changed."""

from __future__ import annotations

from pipeline.answering.json_records import probability, told, why_no_answer
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.changes import each_edit
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.counted import counted
from spatialviz.app.failures import verdict_chip
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.state import State
from spatialviz.app.text import named

CHANGED = 0.005
"""Numbers are shown with two digits; one that differs by less is the same."""


def before_html(state: State) -> Element | None:
    """What was answered without the edits, in one line; None where nothing is edited."""
    edited = state.edited
    if edited is None:
        return None
    trace, colors = edited.before.trace, palette(state.dark)
    reason = why_no_answer(trace)
    answer: list[Child] = [h.span(reason or "no answer", cls="dim")]
    if reason is None and trace.ranking is not None:
        best = trace.ranking.pairs[0]
        target, *ends = (
            state.named(edited.before.keys[i])
            for i in (best.target, best.reference, best.second_reference)
            if i is not None
        )
        lead = told(trace, lambda i: state.named(edited.before.keys[i])).lead.strip()
        names = [named(colors["target"], target), *(named(colors["reference"], name) for name in ends)]
        p = h.b(probability(best.relation_probability), title="P(relation)")
        answer = [h.span(lead, cls="dim") if lead else None, *names, p]
    verdict = verdict_chip(edited.judged.verdict) if isinstance(edited.judged, Diagnosis) else None
    count = len(each_edit(state.edits))
    return h.div(
        h.span("before", cls="dim"),
        h.span(answer, cls="said"),
        verdict,
        cls="before",
        css={"--c": hex_color(colors["edited"])},
        title=f"{counted(count, 'edit')}; 0 takes {'it' if count == 1 else 'them'} back",
    )


def was(now: float, before: float | None) -> str | None:
    """What is said of a number that the edits changed; None where it is the same."""
    return None if before is None or abs(now - before) < CHANGED else f"was {before:.2f}"


def cell(content: Child, hint: str | None = None, cls: str = "n") -> Element:
    """A cell of a table, marked where its number was another one."""
    return h.td(content, cls=f"{cls} chg".strip() if hint else cls, title=hint)
