"""The answer before the edits, above the one after them; and marks on the numbers that they changed."""

from __future__ import annotations

from pipeline.answering.json_records import probability, told, why_no_answer
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.changes import each_edit
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.counted import counted
from spatialviz.app.failures import verdict_chip
from spatialviz.app.state import State
from spatialviz.app.text import dot, safe

CHANGED = 0.005
"""Numbers are shown with two digits; one that differs by less is the same."""


def before_html(state: State) -> str:
    """What was answered without the edits, in one line; empty where nothing is edited."""
    edited = state.edited
    if edited is None:
        return ""
    trace, colors = edited.before.trace, palette(state.dark)
    reason = why_no_answer(trace)
    if reason is not None or trace.ranking is None:
        said, p = f'<span class="dim">{safe(reason or "no answer")}</span>', ""
    else:
        best = trace.ranking.pairs[0]
        ends = [i for i in (best.reference, best.second_reference) if i is not None]
        names = [safe(state.named(edited.before.keys[i])) for i in (best.target, *ends)]
        references = " ".join(f"{dot(colors['reference'])}{name}" for name in names[1:])
        said = f"{dot(colors['target'])}{names[0]} {references}"
        lead = told(trace, lambda i: state.named(edited.before.keys[i])).lead
        said = f'<span class="dim">{lead.strip()}</span> {said}' if lead else said
        p = f'<b title="P(relation)">{probability(best.relation_probability)}</b>'
    verdict = ""
    if isinstance(edited.judged, Diagnosis):
        verdict = verdict_chip(edited.judged.verdict)
    count = len(each_edit(state.edits))
    hint = f"{counted(count, 'edit')}; 0 takes {'it' if count == 1 else 'them'} back"
    return (
        f'<div class="before" style="--c:{hex_color(colors["edited"])}" title="{hint}"><span class="dim">before</span>'
        f'<span class="said1">{said}</span>{verdict}{p}</div>'
    )


def changed(now: float, was: float | None) -> tuple[str, str]:
    """(class, title) of a cell: marked where the number was another one; both begin with a blank or are empty."""
    if was is None or abs(now - was) < CHANGED:
        return "", ""
    return " chg", f' title="was {was:.2f}"'
