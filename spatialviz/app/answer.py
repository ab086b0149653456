"""The head of the answer: its names, the relation's probability, the product, and the verdict in a whole sentence."""

from __future__ import annotations

from pipeline.answering.json_records import headline, probability, told, why_no_answer
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.ranking import alone
from pipeline.diagnosis.verdict import MODULE_OF, Diagnosis
from pipeline.diagnosis.whatif.changes import each_edit
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.counted import counted
from spatialviz.app.failures import verdict_chip
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.state import State
from spatialviz.app.text import BAD, named, note, panel
from spatialviz.app.up_html import level_html, up_chip

HINT = "Type TARGET RELATION REFERENCE above, for example “mug left of the laptop”, and press Enter."
NOTHING_TO_ASK = "Nothing can be asked: the dataset has no annotations, and no detector was named (--detector)."
TITLES = {
    "attributes": ("P(attributes)", "how surely the attributes and choices that were said fit the objects"),
    "product": ("product", "P(target) · P(reference) · P(relation), and P(attributes) where some were said"),
}


def answer_html(state: State, can_ask: bool = True) -> Element:
    """The answer in one line, the relation's probability and the product, below them the posterior and the verdict."""
    trace, under = state.trace, h.div(up_chip(state), mend_button(state), cls="under")
    if state.problem:
        return panel(note(f"This frame is broken: {state.problem}", BAD), cls="answer")
    if trace is None:
        # Why a question could not be asked stands in its stage, PARSE.
        hint = "No answer." if state.error else HINT if can_ask else NOTHING_TO_ASK
        return panel(level_html(state), h.p(hint, cls="lead dim"), under, cls="answer")
    reason = why_no_answer(trace)
    told_: Child = [note(_capital(reason), BAD), _alone(state)] if reason is not None else _pair(state)
    return panel(level_html(state), before_html(state), told_, verdict_html(state), under, cls="answer")


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


def verdict_chip_of(judged: Diagnosis) -> Element:
    """The verdict in its colour, with what it says more."""
    return verdict_chip(judged.verdict, "lucky" if judged.lucky else judged.detail)


def verdict_html(state: State) -> Element | None:
    """The verdict; its chip opens the stage that failed, which has its sentence; where none did it stands here."""
    judged = state.judged
    if judged is None:
        return None
    if isinstance(judged, str):
        return h.div(h.p(f"No verdict: {judged}", cls="dim sentence"), cls="verdict")
    stage = MODULE_OF.get(judged.verdict, "" if judged.verdict == "COMPOUND" else "LABEL")
    button = h.button(verdict_chip_of(judged), cls="plain", do=f"stage:{stage}", id="verdict", title="show why")
    said = None if state.task == "explain" and judged.verdict in MODULE_OF else h.p(judged.text, cls="sentence")
    return h.div(button, said, cls="verdict")


def mend_button(state: State) -> Element | None:
    """A button that leads to the labels of the verdict; it stands out where the label itself is in doubt."""
    if not state.correctable or not state.text:
        return None
    doubted = isinstance(state.judged, Diagnosis) and state.judged.verdict == "LABEL"
    hint = "the labelled pair and its expression (Shift+M)"
    return h.button("correct this label", cls="try mend go" if doubted else "try mend", do="mend", title=hint)


def answer_in_words(state: State) -> str:
    """The answer as a line of the log."""
    trace = state.trace
    assert trace is not None
    reason = why_no_answer(trace)
    total = sum(trace.timings.values()) * 1000
    if reason is not None or state.pair is None:
        return f"“{state.text}”: {reason} ({total:.0f} ms)"
    names = ", ".join(state.shown.names[i] for i in dict.fromkeys(state.pair))
    answer = told(trace, lambda place: state.shown.names[state.shown.place[place]])
    return f"“{state.text}”: {answer.sentence(names)} ({total:.0f} ms)"


def _pair(state: State) -> list[Child]:
    """The chosen pair, as the answer or beside it."""
    trace, best = state.trace, state.ranked[0]
    assert trace is not None
    pair = state.chosen or best
    answer = told(trace, lambda place: state.shown.names[state.shown.place[place]], pair)
    # Of the answer itself it is said that there is none; another pair that was clicked is only looked at.
    absent = note(_capital(answer.lead.strip())) if pair is best and answer.lead else None
    fails = h.div(f"not so: {'; '.join(answer.fails)}", cls="dim") if answer.fails else None
    return [absent, _names(state, pair), _headline(pair), fails, h.div(answer.below, cls="dim")]


def _alone(state: State) -> Element | None:
    """What the verdict is of where there is no pair: as in an evaluation, the best target by its name alone."""
    trace = state.trace
    if trace is None or trace.missing or not isinstance(state.judged, Diagnosis):
        return None
    candidates = trace.candidates.get(trace.query.target)
    found = None if candidates is None else alone(candidates)
    if found is None:
        return None
    name = state.shown.names[state.shown.place[found]]
    return h.div(f"The verdict is of the best {trace.query.target} alone, as in an evaluation: {name}", cls="dim")


def _names(state: State, pair: ScoredPair) -> Element:
    assert state.trace is not None
    colors = palette(state.dark)
    target, *ends = state.at(pair)
    parts: list[Child] = [named(colors["target"], state.shown.names[target])]
    for k, end in enumerate(() if pair.reference is None else ends):
        between = h.span("and" if k else state.trace.phrase, cls="dim")
        parts += [" ", between, " ", named(colors["reference"], state.shown.names[end])]
    return h.h2(parts, cls="names")


def _headline(pair: ScoredPair) -> Element:
    """The numbers at the top: that the pair stands in the relation, and the product of all factors."""
    cells = []
    for what, value in headline(pair):
        name, title = TITLES.get(what, (f"P({what})", f"the probability of the {what}"))
        low = "low" if what != "product" and not pair.holds else ""
        cells.append(h.span(f"{name} ", h.b(probability(value), cls=low), title=title))
    return h.div(cells, cls="heads")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
