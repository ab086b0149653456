"""Evidence of the stages SRM and ATTRIBUTE: how the chosen pair stands in each relation, and fits what was said."""

from __future__ import annotations

from pipeline.answering.ask import Trace
from pipeline.answering.json_records import link_words, probability
from pipeline.geometry.palette import RGB, hex_color, palette
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import letter
from pipeline.relations.scorer import RelationScores
from spatialviz.app.edit_scene import REGION_COLORS
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.relation_region import asked_pair
from spatialviz.app.state import State
from spatialviz.app.text import dot, named, was

NOT_ASKED: RGB = (125, 136, 150)


def relations_evidence(state: State, trace: Trace) -> list[Child]:
    """Every relation of the chosen pair, always in the same order; a click asks with that relation."""
    pair = state.chosen
    if pair is None or pair.reference is None:
        return [h.p("No relation between two objects is asked, or no pair is chosen.", cls="dim")]

    def name(i: int) -> str:
        return state.shown.names[state.shown.place[i]]

    # "the table holding the lamp" asks for the lamp on the table.
    a, b = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    bars = [
        _bar(
            state,
            relation,
            float(trace.scores.probabilities[a, b, n]),
            letter(trace.scores.states[a, b, n]),
            None if state.edited is None else state.edited.relation_before(a, b, relation),
            n,
        )
        for n, relation in enumerate(trace.scores.relations)
    ]
    if trace.relation and trace.relation not in trace.scores.relations:
        bars.append(_bar(state, trace.relation, pair.p_relation))
    links = pair.links if len(pair.links) > 1 else ()
    return [
        h.h3(f"{name(a)} → {name(b)}", h.span(f"by {_scored_by(trace.scores, trace.scorer)}")),
        bars,
        (h.p(f"{link_words(link, name)}: {probability(link.probability)}") for link in links),
        _placement(state),
    ]


def _scored_by(scores: RelationScores, scorer: str) -> str:
    """The scorer, and what the relations it has nothing for are scored by: "rel26; on, in, near by rule"."""
    others: dict[str, list[str]] = {}
    for relation in scores.relations:
        if scores.scored_by[relation] != scorer:
            others.setdefault(scores.scored_by[relation], []).append(relation)
    return "; ".join([scorer, *(f"{', '.join(names)} by {other}" for other, names in others.items())])


def _bar(
    state: State, relation: str, p: float, mark: str = "", before: float | None = None, number: int | None = None
) -> Element:
    """A probability from 0 to 1; a button where the scorer has a `number` for the relation."""
    asked = state.trace is not None and relation == state.trace.relation
    color = palette(state.dark)["target"] if asked else NOT_ASKED
    hint = was(p, before)
    title = f"{PHRASE[relation]}: {p:.3f}" + (f" ({mark}); click to ask it" if mark else "")
    return h.button(
        h.span(PHRASE[relation]),
        level(p),
        h.span(mark, cls="s"),
        h.span(f"{p:.2f}", cls="n chg" if hint else "n"),
        cls="bar on" if asked else "bar",
        css={"--c": hex_color(color)},
        title=f"{title}; {hint}" if hint else title,
        do=None if number is None else f"relation:{number}",
        disabled=number is None,
        id=f"relation-{relation}",
    )


def level(p: float) -> Element:
    """A probability as a bar."""
    return h.span(h.span(cls="f", css={"width": f"{p:.0%}"}), cls="t")


def _placement(state: State) -> list[Child]:
    """Where the chosen target falls in the relation's region, by the rule, and why."""
    asked = asked_pair(state)
    if asked is None:
        return []
    a, b = (state.shown.names[i] for i in asked.places)
    shown = state.flags.region
    toggle = h.button(
        "region", cls="try", do="flag:region", aria_pressed=str(shown).lower(), title="show it in the scene (Shift+R)"
    )
    legend = (
        h.span(dot(color), f"{'holds' if label == 'T' else 'undecided'} ({label})")
        for label, color in REGION_COLORS.items()
    )
    return [
        h.h3("By the rule", h.span(toggle)),
        h.p(f"{a} {PHRASE[asked.relation]} {b}", cls="dim"),
        h.p(asked.placement.why),
        h.div(legend, cls="legend") if shown else None,
    ]


def attributes_evidence(state: State, trace: Trace) -> list[Child]:
    """What the question says of each object of the chosen pair alone, and how surely it is so."""
    pair = state.chosen
    if pair is None or not pair.factors:
        return [h.p("No pair is chosen.", cls="dim")]
    rows = []
    for factor in pair.factors:
        place = state.shown.place[factor.object]
        color = palette(state.dark)[state.roles.get(place, "other")]
        rows.append(
            h.tr(
                h.td(h.b(factor.text), h.span(f" {factor.kind}", cls="dim")),
                h.td(named(color, state.shown.names[place]), cls="w"),
                h.td(level(factor.probability), css={"--c": hex_color(color)}),
                h.td(f"{factor.probability:.2f}", cls="n" if factor.holds else "n low"),
            )
        )
    head = h.tr(h.th("said"), h.th("of"), h.td(), h.th("P", cls="n"))
    return [h.table(h.thead(head), h.tbody(rows), cls="factors")]
