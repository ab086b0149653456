"""Evidence of the stage LABEL: what the labels say of the answer, which truth would mend it, and the other run."""

from __future__ import annotations

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.geometry.boxes import iou_2d
from spatialviz.app.answer import verdict_chip_of
from spatialviz.app.markup import Child, h
from spatialviz.app.state import State
from spatialviz.app.text import note

ORACLE_WORDS = {
    "RECALL": ("missing objects", "every labelled object the detector missed joins the candidates"),
    "LIFT": ("true geometry", "every candidate that is an object gets the geometry of its own labelled pixels"),
    "SRM": ("true relations", "the relation of every pair of real objects is .99, .5 or .01, as labelled"),
    "ATTRIBUTE": ("true attributes", "attributes of real objects are .99, .5 or .01, as far as they are known"),
    "CONF": ("true confidences", "real objects of the asked class get .99, false positives .01"),
}
UNKNOWN = "No verdict: nothing is known of the truth in this frame. It needs labels (a run) or annotations."


def verdict_evidence(state: State, trace: Trace) -> list[Child]:
    """What would mend the answer, and what the other run answers; the verdict itself stands above."""
    judged = state.judged
    if not isinstance(judged, Diagnosis):
        return [h.p(UNKNOWN if judged is None else f"No verdict: {judged}.", cls="dim")]
    return [_other(state, trace), _oracles(judged)]


def _oracles(d: Diagnosis) -> list[Child]:
    """Each oracle alone: is the answer right with it, and by what margin."""
    rows = []
    for k, name in enumerate(("", *d.oracles)):
        subset = 0 if k == 0 else 1 << (k - 1)
        right, margin = bool(d.right_with >> subset & 1), float(d.margins[subset])
        words, hint = ("nothing: as it is", "the pipeline's own answer") if k == 0 else ORACLE_WORDS[name]
        rows.append(
            h.tr(
                h.th(name, scope="row"),
                h.td(words),
                h.td("✓ right" if right else "✗ wrong", cls="right" if right else "wrong"),
                h.td(f"{margin:+.2f}" if np.isfinite(margin) else "–", cls="n"),
                cls="on" if name in (d.mends or d.repair) else "",
                title=hint,
            )
        )
    repair = f"smallest repair: {' + '.join(d.repair)}" if d.repair else ""
    if len(d.mends) > 1:
        repair = f"each alone would do: {', '.join(d.mends)}"
    hint = "score of the best acceptable pair less that of the best other one"
    head = h.tr(h.td(), h.td(), h.th("target"), h.th("margin", cls="n", title=hint))
    table = h.table(h.thead(head), h.tbody(rows), cls="oracles")
    return [h.h3("With the truth in place of", h.span(repair)), table]


def _other(state: State, trace: Trace) -> list[Child]:
    """The other run's answer beside this one: what moved."""
    other, mine = state.other, state.ranked[0] if state.ranked else None
    if other is None:
        return []
    if other.error:
        return [h.h3("The other run", h.span(other.name)), note(other.error)]
    rows = []
    for name, pair, asked in (("this", mine, trace), ("other", other.best, other.trace)):
        if pair is None or asked is None or pair.reference is None:
            rows.append(h.tr(h.th(name, scope="row"), h.td("no answer", colspan=4)))
            continue
        names = " · ".join(_named_here(state, asked.objects[i]) for i in (pair.target, pair.reference))
        factors = (h.td(f"{p:.2f}", cls="n") for p in (pair.p_target, pair.p_reference, pair.p_relation))
        rows.append(h.tr(h.th(name, scope="row"), h.td(names, cls="w", title=names), factors))
    moved = ""
    if mine is not None and other.best is not None and other.trace is not None:
        ours, theirs = trace.objects[mine.target].bbox, other.trace.objects[other.best.target].bbox
        moved = "the same target" if float(iou_2d(ours, theirs)[0, 0]) >= 0.5 else "another target"
    head = h.tr(h.td(), h.td(), (h.th(name, cls="n") for name in ("tgt", "ref", "rel")))
    return [
        h.h3("Against the other run", h.span(f"{other.name}: {moved}")),
        verdict_chip_of(other.judged) if isinstance(other.judged, Diagnosis) else None,
        h.table(h.thead(head), h.tbody(rows), cls="other"),
    ]


def _named_here(state: State, entry: SceneObject) -> str:
    """An object as this page calls it; by its class alone where this run does not have it."""
    overlap = iou_2d(np.array([o.bbox for o in state.shown.objects]), entry.bbox)[:, 0]
    return state.shown.names[int(overlap.argmax())] if overlap.max() >= 0.5 else entry.label
