"""Head of the answer: names, probabilities, the verdict in a sentence, and a comparison with the labels."""

from __future__ import annotations

import numpy as np

from pipeline.answering.answer_words import headline, pair_words, probability, why_no_answer, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.ranking import alone
from pipeline.diagnosis.answer import failed_stages
from pipeline.diagnosis.story_words import TRUTHS, Story
from pipeline.diagnosis.verdict import MODULE_OF, Diagnosis, shown_detail
from pipeline.diagnosis.whatif.answer_view import BothAnswers, OtherAnswer
from pipeline.diagnosis.whatif.changes import each_edit
from pipeline.evaluation.run_figures import Recorded, judged_by
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.palette import VERDICTS, hex_color, palette
from pipeline.language.counted import counted
from pipeline.language.glossary import glossary
from spatialviz.app.markup import BAD, Child, Element, button, h, hint_of, named, note, panel, term, with_terms
from spatialviz.app.state import State
from spatialviz.app.toolbar import ground_chips, level_html

HINT = "Type TARGET RELATION REFERENCE above, for example “mug left of the laptop”, and press Enter."
NOTHING_TO_ASK = "Nothing can be asked: the dataset has no annotations, and no detector was named (--detector)."


def answer_html(state: State, can_ask: bool = True) -> Element:
    """Answer in one line, with the relation's probability and the product; below, the posterior and the verdict."""
    trace, under = state.trace, h.div(ground_chips(state), mend_button(state), cls="under")
    if state.problem:
        return panel(note(f"This frame is broken: {state.problem}", BAD), cls="answer")
    if trace is None:
        # The stage PARSE carries the reason of a refused question.
        hint = "No answer." if state.error else HINT if can_ask else NOTHING_TO_ASK
        return panel(level_html(state), h.p(hint, cls="lead dim"), verdict_html(state), under, cls="answer")
    reason = why_no_answer(trace)
    told_: Child = [note(_capital(reason), BAD), _alone(state, trace)] if reason is not None else _pair(state, trace)
    before = None if state.edited is None else before_html(state, state.edited)
    return panel(level_html(state), before, told_, verdict_html(state), under, cls="answer")


def before_html(state: State, edited: BothAnswers) -> Element:
    """Answer without the edits, in one line."""
    trace, colors = edited.before.trace, palette(state.dark)
    reason, count = why_no_answer(trace), len(each_edit(state.edits))
    answer: list[Child] = [h.span(reason or "no answer", cls="dim")]

    def name(i: int) -> str:
        return state.named(edited.before.keys[i])

    if reason is None and trace.ranking is not None:
        best, lead = trace.ranking.pairs[0], words_of_answer(trace, name).lead.strip()
        references = (i for i in (best.reference, best.second_reference) if i is not None)
        answer = [
            h.span(lead, cls="dim") if lead else None,
            named(colors["target"], name(best.target)),
            *(named(colors["reference"], name(i)) for i in references),
            h.b(probability(best.relation_probability), title=hint_of("P(relation)")),
        ]
    return h.div(
        h.b(_became(state, edited)),
        h.span("before", cls="dim"),
        h.span(answer, cls="said"),
        verdict_chip_of(edited.judged) if isinstance(edited.judged, Diagnosis) else None,
        cls="before",
        css={"--c": hex_color(colors["edited"])},
        title=f"{counted(count, 'edit')}; 0 takes {'it' if count == 1 else 'them'} back",
    )


def _became(state: State, edited: BothAnswers) -> str:
    """Whether the edits have changed the answer, in a sentence."""
    if not edited.changed:
        return "The answer is unchanged."
    if why_no_answer(edited.after.trace) is not None:
        return "Now there is no answer."
    verdicts = [d.verdict if isinstance(d, Diagnosis) else "" for d in (edited.judged, state.judged)]
    right = [v == "CORRECT" for v in verdicts]
    # Of an answer without a verdict, and of one beside the label, neither is said.
    told = right[0] != right[1] and not {"", "LABEL"} & set(verdicts)
    return "Another answer." if not told else "Now it is right." if right[1] else "Now it is wrong."


def verdict_chip_of(judged: Diagnosis) -> Element:
    """Chip with the verdict in its colour, and the tooltip."""
    return verdict_chip(judged.verdict, judged.detail, judged.lucky)


def story_html(told: Story) -> Element:
    """Head, sentence and mend of a verdict."""
    return h.div(
        h.p(h.b(f"{told.head}. "), told.sentence, cls="sentence"),
        h.p(told.mend, cls="dim small") if told.mend else None,
    )


def verdict_html(state: State) -> Element | None:
    """Verdict chip; opens the failed stage, or carries the verdict's sentence where no stage failed."""
    judged = state.judged
    if state.recorded is not None and not state.recorded.is_that(judged):
        return _recorded(state, state.recorded)
    if judged is None:
        return None
    if isinstance(judged, str):
        return h.div(h.p(f"No verdict: {judged}", cls="dim sentence"), cls="verdict")
    stage = MODULE_OF.get(judged.verdict, "" if judged.verdict in ("COMPOUND", "UNEXPLAINED") else "LABEL")
    return h.div(
        h.button(verdict_chip_of(judged), cls="plain", do=f"stage:{stage}", id="verdict", title="show why"),
        # A failed stage carries the sentence.
        None if state.task == "explain" and failed_stages(state.trace, judged) else story_html(judged.story),
        None if state.other is None or state.trace is None else _second(state.other, state.other_pair),
        cls="verdict",
    )


def _recorded(state: State, found: Recorded) -> Element:
    """Verdict as recorded in the run, beside the present verdict where the two differ."""
    judged, run = state.judged, None if state.listing is None else state.listing.figures.run
    by = "" if run is None else judged_by(run.manifest)
    now: Child = verdict_chip_of(judged) if isinstance(judged, Diagnosis) else judged or "no verdict"
    why = by or "labels, models or data are not those of the run any more"
    return h.div(
        h.button(
            verdict_chip(found.verdict, found.detail, found.lucky),
            cls="plain",
            id="verdict",
            do="stage:LABEL",
            title="as the run has it",
        ),
        h.p(found.said, cls="sentence"),
        h.p("Judged now: ", now, f". The run: {why}.", cls="dim small"),
        cls="verdict",
    )


def mend_button(state: State) -> Element | None:
    """Button leading to the labels of the verdict; highlighted where the label itself is in doubt."""
    if not state.correctable or not state.text:
        return None
    doubted = isinstance(state.judged, Diagnosis) and state.judged.verdict == "LABEL"
    hint = "the labelled pair and its expression (Shift+M)"
    return button("correct this label", "mend", hint, "mend go" if doubted else "mend")


def answer_in_words(state: State, trace: Trace) -> str:
    """Answer as a line of the log."""
    sentence = why_no_answer(trace)
    if sentence is None and state.pair is not None:
        sentence = words_of_answer(trace, state.name_of).sentence(pair_words(trace, state.ranked[0], state.name_of))
    return f"“{state.text}”: {sentence} ({sum(trace.timings.values()) * 1000:.0f} ms)"


def _pair(state: State, trace: Trace) -> list[Child]:
    """Chosen pair, as the answer or as a lower rank."""
    best = state.ranked[0]
    pair = state.chosen or best
    answer = words_of_answer(trace, state.name_of, pair)
    return [
        # The lead sentence belongs to the best pair, not to another clicked pair.
        note(_capital(answer.lead.strip())) if pair is best and answer.lead else None,
        _names(state, trace, pair),
        _headline(trace, pair),
        h.div(f"not so: {'; '.join(answer.fails)}", cls="dim") if answer.fails else None,
        h.div(with_terms(answer.below, "posterior", "margin"), cls="dim", id="answer-below"),
    ]


def _alone(state: State, trace: Trace) -> Element | None:
    """Subject of the verdict without a pair: the best target by name alone, as in an evaluation."""
    candidates = trace.candidates.get(trace.query.target)
    found = None if candidates is None else alone(candidates)
    if found is None or trace.missing or not isinstance(state.judged, Diagnosis):
        return None
    said = f"The verdict is of the best {trace.query.target} alone, as in an evaluation: {state.name_of(found)}"
    return h.div(said, cls="dim")


def _names(state: State, trace: Trace, pair: ScoredPair) -> Element:
    colors = palette(state.dark)
    parts: list[Child] = [named(colors["target"], state.name_of(pair.target))]
    ends = [k for k in (pair.reference, pair.second_reference) if k is not None]
    for k, end in enumerate(ends):
        joint = h.span("and" if k else trace.phrase, cls="dim")
        parts += [" ", joint, " ", named(colors["reference"], state.name_of(end))]
    return h.h2(parts, cls="names", id="answer-names")


def _headline(trace: Trace, pair: ScoredPair) -> Element:
    """Relation's probability and the product of all factors, or a remark on an imported answer without a ranking."""
    if trace.answered is not None:
        return h.div(_capital(trace.answered), cls="dim", id="answer-heads")
    cells = []
    for what, value in headline(pair, trace.own_scores):
        name = what if what == "product" else f"P({what})"
        low = "low" if what != "product" and not pair.holds else ""
        cells.append(h.span(term(name), " ", h.b(probability(value), cls=low)))
    return h.div(cells, cls="heads", id="answer-heads")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


UNKNOWN = "No verdict: nothing is known of the truth in this frame. It needs labels (a run) or annotations."


def verdict_evidence(state: State, trace: Trace) -> list[Child]:
    """Repairs of the answer, and the answer of the other run."""
    judged = state.judged
    if not isinstance(judged, Diagnosis):
        return [h.p(UNKNOWN if judged is None else f"No verdict: {judged}.", cls="dim")]
    return [None if state.other is None else _other(state, trace, state.other), *_oracles(judged)]


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
        h.td("✓ right" if right else "✗ wrong", cls="right" if right else "wrong"),
        h.td(f"{margin:+.2f}" if np.isfinite(margin) else "–", cls="n"),
        cls="on" if name in (d.mends or d.repair) else "",
        title=glossary()[name].text if name else "the pipeline's own answer",
    )


def _second(other: OtherAnswer, moved: str) -> Element:
    """Verdict of the second run in a line with the difference; opens both answers."""
    chip = None if other.diagnosis is None else verdict_chip_of(other.diagnosis)
    what = (h.span("second run ", cls="dim"), chip, f" {moved or 'no answer'}")
    return h.button(what, cls="plain", do="stage:LABEL", title=f"{other.name}: both answers")


def _other(state: State, trace: Trace, other: OtherAnswer) -> list[Child]:
    """Answer of the other run beside this answer, with the difference."""
    mine = state.ranked[0] if state.ranked else None
    if other.problem:
        return [h.h3("The second run", h.span(other.name)), note(other.problem)]
    rows = []
    for name, pair, asked in (("first", mine, trace), ("second", next(iter(other.pairs), None), other.trace)):
        cells: Child = h.td("no answer", colspan=4)
        if pair is not None and asked is not None and pair.reference is not None:
            names = " · ".join(_named_here(state, asked.objects[i]) for i in (pair.target, pair.reference))
            factors = (pair.p_target, pair.p_reference, pair.p_relation)
            cells = [h.td(names, cls="w", title=names), *(h.td(f"{p:.2f}", cls="n") for p in factors)]
        rows.append(h.tr(h.th(name, scope="row"), cells))
    head = h.tr(
        h.td(), h.td(), (h.th(term(f"P({name})", name[:3]), cls="n") for name in ("target", "reference", "relation"))
    )
    return [
        h.h3("The second run", h.span(f"{other.name}: {state.other_pair}" if state.other_pair else other.name)),
        None if other.diagnosis is None else verdict_chip_of(other.diagnosis),
        h.table(h.thead(head), h.tbody(rows), cls="other"),
    ]


def _named_here(state: State, entry: SceneObject) -> str:
    """Name of an object on this page; its class where this run lacks the object."""
    overlap = iou_2d(np.array([o.bbox for o in state.shown.objects]), entry.bbox)[:, 0]
    return state.shown.names[int(overlap.argmax())] if overlap.max() >= 0.5 else entry.label


def verdict_chip(verdict: str, detail: str | None = None, lucky: bool = False) -> Element:
    """Verdict in its colour, with a detail."""
    said = shown_detail(detail, lucky)
    more = (" ", h.i(said.lower().replace("_", " "))) if said else None
    return h.span(verdict, more, cls="vd", css={"--c": hex_color(VERDICTS[verdict])}, title=hint_of(verdict))
