"""Story of an answer, and the evidence of its verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.answering.answer_words import pair_words, why_no_answer, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.diagnosis.cards import Card, CardObject, cards_of
from pipeline.diagnosis.story import unjudged_story
from pipeline.diagnosis.story_words import TRUTHS, Story, capital
from pipeline.diagnosis.verdict import MODULE_OF, NOT_SEEN, Diagnosis, Unseen, shown_detail, shown_verdict
from pipeline.diagnosis.whatif.answer_view import BothAnswers
from pipeline.diagnosis.whatif.changes import became, each_edit
from pipeline.evaluation.run_figures import Recorded, judged_by
from pipeline.geometry.palette import VERDICTS, hex_color, palette
from pipeline.language.counted import counted
from pipeline.language.glossary import glossary
from spatialviz.app.compare_runs import both_html, switch_html
from spatialviz.app.markup import Child, Element, button, h, hint_of, joined, named, note, panel, term
from spatialviz.app.mend import mend_html
from spatialviz.app.picture import thumb
from spatialviz.app.state import State
from spatialviz.app.toolbar import depth_chip, level_html, up_chip

HINT = "Type TARGET RELATION REFERENCE above, for example “mug left of the laptop”, and press Enter."
NOTHING_TO_ASK = "Nothing can be asked: the dataset has no annotations, and no detector was named (--detector)."
MARKS = {"right": "✓", "also right": "!", "wrong": "✕", "none": "?"}
TONES = {"right": "good", "also right": "doubt", "wrong": "bad", "none": "idle"}
"""Classes of a tone."""
AREAS = {
    "PARSE": "reading",
    "OPM": "detection",
    "LIFT": "lifting",
    "SRM": "relation",
    "ATTRIBUTE": "looks",
    "PRM": "ranking",
    "LABEL": "label",
}
"""Step of the pipeline that a verdict blames, in plain words."""


def answer_html(state: State, can_ask: bool = True) -> Element:
    """Story of the answer: right or wrong, what was answered and what it should be, why, and what would mend it."""
    if state.problem:
        return panel(note(f"This frame is broken: {state.problem}", "bad"), cls="answer")
    if state.trace is None and not state.error:
        head = h.div(
            h.div(h.h2("Nothing is asked" if can_ask else "Nothing to ask yet", id="verdict")), cls="verd idle"
        )
        hint = h.p(HINT if can_ask else NOTHING_TO_ASK, cls="sub")
        return panel(level_html(state), head, hint, doubts_html(state), cls="answer")
    told, recorded = story_of(state), state.recorded
    if recorded is not None and recorded.is_that(state.judged):
        recorded = None
    before = None if state.edited is None else before_html(state, state.edited)
    said = recorded or told
    why = h.p(said.sentence, cls=f"why {TONES[said.tone]}")
    return panel(
        level_html(state),
        switch_html(state, told.tone),
        _head(state, said, recorded or (None if isinstance(state.judged, str) else state.judged)),
        before,
        _cards(state),
        why,
        h.p(state.offers.words, cls="sub") if state.error and state.offers.names else None,
        None if recorded is None else _recorded(state),
        mend_html(state, told) if recorded is None else None,
        doubts_html(state),
        cls="answer",
    )


def story_of(state: State) -> Story:
    """Story of the shown answer; without a verdict it is the answer itself."""
    judged, trace = state.judged, state.trace
    if isinstance(judged, Diagnosis):
        return judged.story
    if isinstance(judged, Unseen):
        return judged.story("any")
    told = unjudged_story(trace, state.error or None, judged)
    pair = state.chosen or next(iter(state.ranked), None)
    if trace is None or pair is None:
        return told
    answer = words_of_answer(trace, state.name_of, pair).sentence(pair_words(trace, pair, state.name_of))
    return replace(told, sentence=f"{capital(answer)}.", mend=told.sentence)


def _head(state: State, shown: Story | Recorded, judged: Diagnosis | Unseen | Recorded | None) -> Element:
    """Verdict in words; below it the blamed step, and how many answers of the run are like it."""
    below, listing = None, state.listing
    if judged is not None:
        verdict, detail = NOT_SEEN if isinstance(judged, Unseen) else judged.verdict, judged.detail
        code = shown_verdict(verdict, detail, not isinstance(judged, Unseen) and judged.lucky)
        known = listing is not None and verdict != "CORRECT" and state.side != "b"
        alike = listing.figures.counts.get((verdict, detail or None), 0) if known and listing is not None else 0
        do = f"alike:{verdict} {detail or ''}".strip()
        listed = h.button(f"{alike:,} such in this run", do=do, cls="link", title="list them") if alike else None
        said = h.span(joined(filter(None, (AREAS.get(MODULE_OF.get(verdict, "")), code))), title=hint_of(verdict))
        below = h.p(said, h.span(" · ", listed, cls="together") if listed else None, cls="sub")
    return h.div(
        h.span(MARKS[shown.tone], cls="mark", aria_hidden="true"),
        h.div(h.h2(shown.head, id="verdict"), below),
        cls=f"verd {TONES[shown.tone]}",
    )


def _cards(state: State) -> Element | None:
    """The answer beside what is right, each thing with its crop; below, another pair that is looked at."""
    best, pair = next(iter(state.ranked), None), state.chosen

    def name(i: int) -> str:
        return state.name_of(i).replace("·", " ")

    found = cards_of(state.trace, state.judged, best, name)
    if not found or state.loaded is None:
        return None
    looked = None
    if pair is not None and pair is not best:
        rank = next(n for n, p in enumerate(state.ranked, 1) if p is pair)
        ends = " · ".join(name(i) for i in (pair.target, pair.reference) if i is not None)
        looked = h.p(f"Looked at: pair {rank} of {len(state.ranked)}, {ends}", cls="sub", id="looked-at")
    return h.div(h.div((_card(state, card) for card in found), cls="duel"), looked)


def _card(state: State, card: Card) -> Element:
    """Card of a pair; a ranked pair that is not looked at already is by a click."""
    ends = [thing.index for thing in card.objects]
    rank = next((k for k, p in enumerate(state.ranked) if [p.target, p.reference][: len(ends)] == ends), None)
    inner = (h.span(card.title, cls="title"), (_thing(state, thing) for thing in card.objects))
    look = {"cls": f"pair-card of-{card.kind}", "id": f"card-{card.kind}"}
    if rank is None:
        return h.div(inner, **look)
    look["hover"] = f"hover:{','.join(str(state.shown.place[i]) for i in ends if i is not None)}"
    if state.ranked[rank] is (state.chosen or state.ranked[0]):
        return h.div(inner, aria_current="true", **look)
    return h.button(inner, do=f"pair:{rank}", title="look at this pair", **look)


def _thing(state: State, thing: CardObject) -> Element:
    """Thing of a card, with its crop."""
    words = h.span(h.b(thing.name), h.small(thing.note) if thing.note else None)
    return h.span(thumb(state.loaded, thing.bbox), words, cls=f"thing {thing.role}")


def doubts_html(state: State) -> Element | None:
    """Doubts of what all geometry rests on."""
    parts = [*filter(None, (up_chip(state), depth_chip(state)))]
    return h.div(parts, cls="upchips") if parts else None


def before_html(state: State, edited: BothAnswers) -> Element:
    """Answer without the edits, in one line, headed by whether it has changed."""
    trace, colors = edited.before.trace, palette(state.dark)
    reason, count = why_no_answer(trace), len(each_edit(state.edits))
    answer: list[Child] = [h.span(reason or "no answer", cls="dim")]
    if reason is None and trace.ranking is not None:
        best = trace.ranking.pairs[0]
        references = (i for i in (best.reference, best.second_reference) if i is not None)
        answer = [
            named(colors["target"], state.named(edited.before.keys[best.target])),
            *(named(colors["reference"], state.named(edited.before.keys[i])) for i in references),
        ]
    return h.div(
        h.b(became(edited.before, edited.after, edited.story, story_of(state))),
        h.span("before", cls="dim"),
        h.span(answer, cls="said"),
        verdict_chip_of(edited.judged) if isinstance(edited.judged, Diagnosis) else None,
        # What is tried is taken back where it was tried.
        None if state.edits == state.tried else button("Take back", "edit-reset", f"{counted(count, 'edit')} (0)"),
        cls="before",
        css={"--c": hex_color(colors["edited"])},
    )


def verdict_chip_of(judged: Diagnosis | Unseen) -> Element:
    """Chip with the verdict in its colour, and the tooltip."""
    if isinstance(judged, Unseen):
        return verdict_chip(NOT_SEEN, judged.detail, False)
    return verdict_chip(judged.verdict, judged.detail, judged.lucky)


def _recorded(state: State) -> Element:
    """Present verdict beside that of the run, where the two differ."""
    judged, run = state.judged, None if state.listing is None else state.listing.figures.run
    by = "" if run is None else judged_by(run.manifest)
    now: Child = judged if isinstance(judged, str) else "no verdict" if judged is None else verdict_chip_of(judged)
    why = by or "labels, models or data are not those of the run any more"
    return h.p("So says the run. Judged now: ", now, f". The run: {why}.", cls="sub")


def mend_button(state: State) -> Element | None:
    """Button leading to the labels of the verdict."""
    if not state.correctable or not state.text:
        return None
    return button("Correct it…", "mend", "the labelled pair and its expression, to correct them (Shift+M)", "mend")


def answer_in_words(state: State, trace: Trace) -> str:
    """Answer as a line of the log."""
    sentence = why_no_answer(trace)
    if sentence is None and state.pair is not None:
        sentence = words_of_answer(trace, state.name_of).sentence(pair_words(trace, state.ranked[0], state.name_of))
    return f"“{state.text}”: {sentence} ({sum(trace.timings.values()) * 1000:.0f} ms)"


UNKNOWN = "No verdict: nothing is known of the truth in this frame. It needs labels (a run) or annotations."


def verdict_evidence(state: State, trace: Trace) -> list[Child]:
    """Repairs of the answer, and the answer of the other run."""
    judged = state.judged
    if not isinstance(judged, Diagnosis):
        told = judged.story("any").sentence if isinstance(judged, Unseen) else f"No verdict: {judged}."
        return [h.p(UNKNOWN if judged is None else told, cls="dim")]
    return [None if state.other is None else both_html(state, trace, state.other), *_oracles(judged)]


def _oracles(d: Diagnosis) -> list[Child]:
    """Correctness and margin of the answer with each oracle alone; empty for predictions without them."""
    if d.right_with is None:
        return []
    names = [("", 0), *((name, 1 << k) for k, name in enumerate(d.oracles))]
    rows = [_oracle(d, name, bool(d.right_with >> subset & 1), float(d.margins[subset])) for name, subset in names]
    repair = f"smallest repair: {' + '.join(d.repair)}" if d.repair else ""
    if len(d.mends) > 1:
        repair = f"each alone would do: {', '.join(d.mends)}"
    head = h.tr(h.td(), h.td(), h.th(term("target")), h.th(term("margin"), cls="n"))
    return [
        h.h3("With the truth in place of", h.span(repair)),
        h.table(h.thead(head), h.tbody(rows), cls="oracles"),
    ]


def _oracle(d: Diagnosis, name: str, right: bool, margin: float) -> Element:
    words = TRUTHS.get(name, "nothing: as it is")
    return h.tr(
        h.th(term(name) if name else "none", scope="row"),
        h.td(words),
        h.td("✓ correct" if right else "✗ wrong", cls="right" if right else "wrong"),
        h.td(f"{margin:+.2f}" if np.isfinite(margin) else "–", cls="n"),
        cls="on" if name in (d.mends or d.repair) else "",
        title=glossary()[name].text if name else "the pipeline's own answer",
    )


def verdict_chip(verdict: str, detail: str | None = None, lucky: bool = False) -> Element:
    """Verdict in its colour, with a detail."""
    said = shown_detail(detail, lucky)
    more = (" ", h.i(said.lower().replace("_", " "))) if said else None
    return h.span(verdict, more, cls="vd", css={"--c": hex_color(VERDICTS[verdict])}, title=hint_of(verdict))
