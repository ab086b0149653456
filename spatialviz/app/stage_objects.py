"""Evidence of the stages OPM, LIFT, SRM and ATTRIBUTE: facts of objects, and of the chosen pair."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from pipeline.answering.answer_words import link_words, probability
from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.ranking import Candidates
from pipeline.diagnosis.story_words import capital
from pipeline.diagnosis.verdict import Diagnosis, Missed
from pipeline.diagnosis.whatif.region import AskedPair, asked_pair
from pipeline.geometry.cleaning import Pixel
from pipeline.geometry.palette import DROPPED, RGB, palette
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import F, T, U
from pipeline.relations.scorer import RelationScores
from spatialviz.app.markup import Child, Element, button, dot, h, more, named, note, panel, score_text, term, was, words
from spatialviz.app.state import State
from spatialviz.app.what_if import REGION_COLORS

KEPT: RGB = (53, 169, 107)
NOT_ASKED: RGB = (125, 136, 150)
FEW = 6
"""Candidates that are shown before more are wanted."""


def candidates_evidence(state: State, trace: Trace) -> list[Child]:
    """Table of candidates for each name of the question, best first, the blamed name's first."""
    judged = state.judged if isinstance(state.judged, Diagnosis) else None
    blamed = None if judged is None else judged.missed_name
    if judged is not None and blamed is None and judged.false_reference and not judged.false_target:
        blamed = judged.case.reference
    names = sorted(trace.candidates, key=lambda name: name != blamed)
    tables = [_candidates(state, judged, name, trace.candidates[name]) for name in names]
    count = sum(len(found.index) for found in trace.candidates.values())
    return [more(f"all {count} candidates") if count > FEW else None, *tables]


def _candidates(state: State, judged: Diagnosis | None, name: str, found: Candidates) -> Element:
    raw = None if found.raw_scores is None or np.allclose(found.raw_scores, found.scores) else found.raw_scores
    rows = []
    for k in np.argsort(-found.scores, kind="stable").tolist():
        i, score = int(found.index[k]), float(found.scores[k])
        place = state.shown.place[i]
        mark, cls = ("", "") if judged is None or not judged.gold else _mark(judged, i)
        rows.append(
            h.tr(
                h.td(named(state.color(place), state.name_of(i)), cls="w"),
                h.td(mark, cls=f"mark {cls}".strip(), title=mark or None),
                h.td(h.span(h.i(css={"width": f"{min(score, 1):.0%}"}), cls="score")),
                h.td(score_text(score), cls="n"),
                None if raw is None else h.td(f"{raw[k]:.2f}", cls="n dim", title="as the detector gave it"),
                id=f"candidate-{name}-{i}",
                do=f"object:{place}",
                hover=f"hover:{place}",
                # Keys reach the objects in the drawer.
                tabindex=-1,
                cls="r",
            )
        )
    if judged is not None and judged.missed is not None and judged.missed_name == name:
        rows.append(h.tr(h.td(_missed(judged.missed, name), colspan=5), cls="missed"))
    none = h.tr(h.td("nothing of this name was found", cls="dim", colspan=5))
    return h.table(h.caption(f"“{name}”, by score"), h.tbody(rows or none), cls="candidates")


def _mark(judged: Diagnosis, i: int) -> tuple[str, str]:
    """Mark of a candidate by the labels, and CSS class."""
    match, case = judged.evidence.match, judged.case
    labelled = int(match[i]) if i < len(match) else -1
    if labelled < 0:
        return "no labelled object", "low"
    if labelled in (case.target_object, case.reference_object):
        return f"labelled {'target' if labelled == case.target_object else 'reference'}", "ok"
    return ("correct, too", "ok") if labelled in case.acceptable else (f"labelled {judged.truth.labels[labelled]}", "")


def _missed(missed: Missed, name: str) -> str:
    facts = (
        f"best overlap {missed.overlap:.2f}",
        "" if missed.score is None else f"score {missed.score:.2f}",
        "" if missed.rank is None else f"place {missed.rank} by score",
        "suppressed by a better-scored box" if missed.suppressed else "",
    )
    return f"missed: the correct {name} ({', '.join(filter(None, facts))})"


def lift_evidence(state: State, trace: Trace) -> list[Child]:
    """Objects of the chosen pair, those to blame first; remarks on an assumed up or estimated depth."""
    doubt = "" if state.loaded is None else state.loaded.doubt
    said = (
        (trace.viewer.up_source == "assumed", "The up vector is assumed."),
        (trace.viewer.up_doubt, f"Up may be wrong: {trace.viewer.up_doubt}."),
        (trace.frame.depth_source, f"The depth is {trace.frame.depth_source}."),
        (doubt, capital(doubt)),
    )
    doubts: list[Child] = [note(text) for holds, text in said if holds]
    right = state.judged.right if isinstance(state.judged, Diagnosis) and state.judged.verdict == "LIFT" else None
    ends = () if right is None else (right.target, right.reference)
    blamed = (state.shown.place[i] for i in ends if i is not None and i in state.shown.place)
    places = dict.fromkeys((*blamed, *(state.pair or ())))
    return [*doubts, *([_facts(state, i) for i in places] or [h.p("No object is chosen.", cls="dim")])]


def object_html(state: State) -> Element | None:
    i = state.selected
    return None if i is None or i >= len(state.shown.objects) else panel(_facts(state, i))


def _facts(state: State, i: int) -> Element:
    """Size, place, and outcome of every mask pixel of an object."""
    entry = state.shown.objects[i]
    lifted, quality, score = entry.lifted, entry.lifted.quality, score_text(entry.score)
    facts: dict[str, Child] = {}
    if lifted.box is not None:
        width, height, depth = lifted.box.size
        facts["size"] = f"{width:.2f} wide × {height:.2f} high × {depth:.2f} deep m"
        if (whole := entry.estimated) is not None:
            edges = " × ".join(f"{edge:.2f}" for edge in whole.box.size)
            facts["whole box"] = f"{edges} m, by {whole.by}, ± {100 * whole.within:.0f} cm"
        facts["distance"] = f"{quality.distance:.2f} m · ", term("yaw"), f" confidence {lifted.yaw_confidence:.2f}"
    if lifted.open_sides:
        sides = term("open sides", ", ".join(lifted.open_sides))
        facts["may go on"] = h.span(sides, h.span(" (edges with a gap)", cls="dim"))
    made = " by a segmenter" if quality.mask_source == "segmenter" else ""
    facts["points"] = f"{quality.points:,} of {quality.mask_pixels:,} mask pixels{made} ({quality.kept:.0%})"
    cleaned: list[Child] = []
    if lifted.evidence is not None and quality.mask_pixels:
        counts = lifted.evidence.counts()
        colors = {Pixel.KEPT: KEPT, **DROPPED}
        shares = [(words(r), c, counts[r.name.lower()] / quality.mask_pixels) for r, c in colors.items()]
        shares = [share for share in shares if share[2]]
        bar = (h.i(color=c, css={"width": f"{p:.1%}"}, title=f"{name} {p:.0%}") for name, c, p in shares)
        legend = (h.span(dot(color), h.span(term(name), f" {p:.0%}")) for name, color, p in shares)
        cleaned = [h.div(bar, cls="stack"), h.div(legend, cls="legend")]
    return h.article(
        h.h3(named(state.color(i), state.shown.names[i]), h.span(f"score {score}" if score else None)),
        cleaned,
        h.dl(((h.dt(name), h.dd(value)) for name, value in facts.items()), cls="facts"),
        note("; ".join(quality.concerns)) if quality.concerns else None,
        cls="object",
    )


BY_GEOMETRY = {T: "yes", F: "no", U: "unsure"}


def relations_evidence(state: State, trace: Trace) -> list[Child]:
    """Relations of the chosen pair, in fixed order; a click asks with that relation."""
    pair = state.chosen
    if pair is None or pair.reference is None:
        return [h.p("No relation between two objects is asked, or no pair is chosen.", cls="dim")]
    # "the table holding the lamp" asks for the lamp on the table.
    a, b = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    # Imported relations are marked as given or worked out; the rule's opinion is no part of them.
    ours = trace.scores.worked_out(a, b)
    bars = []
    for n, relation in enumerate(trace.scores.relations):
        told = "worked out" if relation in ours else "given"
        mark = BY_GEOMETRY[int(trace.scores.states[a, b, n])] if trace.scores.given is None else told
        before = None if state.edited is None else state.edited.relation_before(a, b, relation)
        bars.append(_bar(state, relation, float(trace.scores.probabilities[a, b, n]), mark, before, n))
    if trace.relation and trace.relation not in trace.scores.relations:
        bars.append(_bar(state, trace.relation, pair.p_relation))
    by = _scored_by(trace.scores, trace.scorer, ours)
    by += "; yes or no by geometry" if trace.scores.given is None else ""
    links, asked = pair.links if len(pair.links) > 1 else (), asked_pair(trace, pair, state.edits)
    return [
        _beside_right(state, trace, pair),
        h.h3(f"{state.name_of(a)} → {state.name_of(b)}", h.span(f"by {by}")),
        bars,
        (h.p(f"{link_words(link, state.name_of)}: {probability(link.probability)}") for link in links),
        None if asked is None else _placement(state, asked),
    ]


def _beside_right(state: State, trace: Trace, pair: ScoredPair) -> Element | None:
    """Asked relation of the right pair, where the one that is looked at is another."""
    right = state.judged.right if isinstance(state.judged, Diagnosis) and state.judged.gold else None
    if right is None or right.reference is None or (right.target, right.reference) == (pair.target, pair.reference):
        return None
    ends = f"{state.name_of(right.target)} {trace.phrase} {state.name_of(right.reference)}"
    return h.p("Of the correct pair: ", ends, " ", h.b(probability(right.p_relation)), cls="sub")


def _scored_by(scores: RelationScores, scorer: str, ours: Collection[str]) -> str:
    """Scorer, and scorers of other relations: "rel32; on, in, near by rule"; those in `ours` are worked out here."""
    others: dict[str, list[str]] = {}
    for relation in scores.relations:
        by = "worked out here" if relation in ours else f"by {scores.scored_by[relation]}"
        if relation in ours or scores.scored_by[relation] != scorer:
            others.setdefault(by, []).append(relation)
    return "; ".join([scorer, *(f"{', '.join(names)} {by}" for by, names in others.items())])


def _bar(
    state: State, relation: str, p: float, mark: str = "", before: float | None = None, number: int | None = None
) -> Element:
    """Probability from 0 to 1; a button if the scorer has a `number` for the relation."""
    asked = state.trace is not None and relation == state.trace.relation
    hint = was(p, before)
    title = f"{PHRASE[relation]}: {p:.3f}" + (f" ({mark}); click to ask it" if mark else "")
    return h.button(
        h.span(PHRASE[relation]),
        level(p),
        h.span(mark, cls="s"),
        h.span(f"{p:.2f}", cls="n chg" if hint else "n"),
        cls="bar on" if asked else "bar",
        color=palette(state.dark)["target"] if asked else NOT_ASKED,
        title=f"{title}; {hint}" if hint else title,
        do=None if number is None else f"relation:{number}",
        disabled=number is None,
        id=f"relation-{relation}",
    )


def level(p: float) -> Element:
    """Probability as a bar."""
    return h.span(h.span(cls="f", css={"width": f"{p:.0%}"}), cls="t")


def _placement(state: State, asked: AskedPair) -> list[Child]:
    """Position of the chosen target in the relation's region, by the rule, with the reason."""
    a, b = map(state.name_of, asked.ends)
    toggle = button("region", "flag:region", "show it in the scene (Shift+R)", aria_pressed=state.flags.region)
    meanings = {"T": "holds", "U": "undecided"}
    legend = (h.span(dot(color), f"{meanings[label]} ({label})") for label, color in REGION_COLORS.items())
    return [
        h.h3("By the rule", h.span(toggle)),
        h.p(f"{a} {PHRASE[asked.trace.relation]} {b}", cls="dim"),
        h.p(asked.placement.why),
        h.div(legend, cls="legend") if state.flags.region else None,
    ]


def attributes_evidence(state: State, trace: Trace) -> list[Child]:
    """Attributes of each object of the chosen pair, with probabilities."""
    factors = () if state.chosen is None else state.chosen.factors
    head = h.tr(h.th("said"), h.th("of"), h.td(), h.th("P", cls="n"))
    rows = (
        h.tr(
            h.td(h.b(factor.text), h.span(f" {factor.kind}", cls="dim")),
            h.td(named(state.color(place), state.shown.names[place]), cls="w"),
            h.td(level(factor.probability), color=state.color(place)),
            h.td(f"{factor.probability:.2f}", cls="n" if factor.holds else "n low"),
        )
        for factor, place in ((factor, state.shown.place[factor.object]) for factor in factors)
    )
    table = h.table(h.thead(head), h.tbody(rows), cls="factors")
    return [table if factors else h.p("No pair is chosen.", cls="dim")]
