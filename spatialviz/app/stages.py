"""Pipeline as connected stages: outcome and failure of each stage, and the evidence of PARSE and PRM."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.answering.answer_words import headline, probability, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.ranking import Candidates
from pipeline.diagnosis.answer import Stage, failed_stages, parse_notes, stages_of, unasked_stages
from pipeline.diagnosis.minimal_repair import threshold
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.lexicon import wording
from pipeline.language.tree import Attachment, Node, Span
from spatialviz.app.answer import verdict_evidence
from spatialviz.app.markup import Child, Element, cell, h, hint_of, joined, more, named, term, was, with_terms
from spatialviz.app.stage_objects import attributes_evidence, candidates_evidence, lift_evidence, relations_evidence
from spatialviz.app.state import State


def failed(state: State) -> tuple[str, ...]:
    """Failed stages; none without a question."""
    return failed_stages(state.trace, state.judged, state.stopped) if state.trace is not None or state.error else ()


def opened(state: State) -> str:
    """Stage with open evidence: the chosen stage, else the one to blame, else the pairs."""
    return state.stage or next(iter(failed(state)), "LABEL" if state.label_blamed else "PRM")


STEPS = {
    "PARSE": "read",
    "OPM": "detect",
    "LIFT": "lift",
    "SRM": "relate",
    "ATTRIBUTE": "look",
    "PRM": "rank",
    "LABEL": "label",
}
"""Stages in plain words."""
SIGNS = {"good": "✓", "doubt": "!", "bad": "✕", "idle": "·"}


def stages_html(state: State, open_stage: str = "") -> Element:
    """Row of stages, and below it the evidence of one; `open_stage` is as `State.stage`."""
    open_stage, stages = open_stage or opened(state), _stages(state)
    shown = next((stage for stage in stages if stage.name == open_stage), None)
    stop = shown or stages[0]
    buttons = (_step(stage, stage is shown, stage is stop) for stage in stages)
    steps = h.div(buttons, cls="steps", role="toolbar", aria_label="stages")
    return h.div(steps, None if shown is None else _evidence(state, shown), cls="stages")


def all_stages_html(state: State) -> Element:
    """Every stage with its evidence."""
    return h.div((_evidence(state, stage, h.h3(*_names(stage))) for stage in _stages(state)), cls="stages")


def _names(stage: Stage) -> tuple[Element, str]:
    return h.i(SIGNS[stage.mark], cls=stage.mark), STEPS[stage.name]


def _step(stage: Stage, shown: bool, stop: bool) -> Element:
    key, code = stage.name.lower(), hint_of(stage.name) or stage.name
    return h.button(
        *_names(stage),
        cls=f"step {stage.mark}",
        do=f"stage:{stage.name}",
        id=f"head-{key}",
        tabindex=0 if stop else -1,
        aria_expanded=str(shown).lower(),
        aria_controls=f"evidence-{key}",
        title=" · ".join(filter(None, (f"{code} {stage.words}", stage.cost))),
    )


def _evidence(state: State, stage: Stage, head: Element | None = None) -> Element:
    """Outcome of a stage in words, and what it rests on."""
    told = None if state.trace is None else EVIDENCE[stage.name](state, state.trace)
    look = {"id": f"evidence-{stage.name.lower()}", "role": "region", "aria_label": f"evidence of {STEPS[stage.name]}"}
    # The numbers of PRM's evidence say as much.
    said = None if stage.name == "PRM" and head is None and state.ranked else h.p(stage.words, cls="sub")
    return h.div(head, said, told, cls=f"evidence {stage.mark}", **look)


def _stages(state: State) -> tuple[Stage, ...]:
    loaded = state.loaded
    if state.trace is None:
        annotated = 0 if loaded is None else len(loaded.context.frame.annotations)
        return unasked_stages(state.judged, annotated, state.stopped)
    odd = loaded is not None and bool(loaded.doubt)
    return stages_of(state.trace, state.judged, pair=state.chosen, name=state.name_of, odd_depth=odd)


def parse_evidence(state: State, trace: Trace) -> list[Child]:
    """Words, readings, notes and the tree."""
    return [
        h.div((_chip(state, trace.query.text[span.start : span.end], span) for span in trace.query.spans), cls="chips"),
        _readings(trace),
        [h.p(note, cls="dim") for note in parse_notes(trace)],
        h.ul(_noun(trace.root), cls="tree"),
    ]


def _chip(state: State, text: str, span: Span) -> Element:
    match span.role:
        case "target" | "reference" as role:
            css = {"--c": hex_color(palette(state.dark)[role])}
            return h.button(text, cls="chip", css=css, do=f"chip:{role}", title=f"select the {role}")
        case "unused":
            return h.span(h.s(text), cls="chip rel unused", title=f"not used: {span.note}")
    return h.span(text, cls="chip rel", title=span.role)


def _readings(trace: Trace) -> Element | None:
    """Readings of an ambiguous question, with scores."""
    ranking, readings = trace.ranking, trace.query.readings
    if len(readings) < 2 or ranking is None:
        return None
    return h.ul(
        (
            h.li(
                h.span("read as " if reading is ranking.reading else "or ", cls="dim"),
                reading.description,
                cls="taken" if reading is ranking.reading else "",
                title=f"best score {score:.2f}",
            )
            for reading, score in zip(readings, ranking.reading_scores, strict=True)
        ),
        cls="readings",
    )


def _noun(node: Node) -> Element:
    """Noun with its modifiers below."""
    said = [*map(str, node.attributes), *(c.text for c in node.choices)]
    below = [_attachment(a) for a in node.attachments]
    below += [h.li(h.i("not", cls="neg"), h.ul(_noun(other))) for other in node.excluded]
    return h.li(
        h.b(node.name),
        f" × {node.count}" if node.count else "",
        ((" ", h.span(a, cls="attr")) for a in said),
        h.ul(below) if below else None,
    )


def _attachment(attachment: Attachment) -> Element:
    meant = wording(attachment.relation, inverse=attachment.inverse)
    return h.li(
        h.i(f"not {attachment.phrase}" if attachment.negated else attachment.phrase),
        h.span(f" {meant}", cls="dim") if meant != attachment.phrase else None,
        h.ul(_noun(n) for n in attachment.nodes),
        cls="neg" if attachment.negated else "",
    )


SHOWN_PAIRS, FEW = 30, 6
"""Pairs that are listed, and how many of them before more are wanted."""
MATRIX_LIMIT = 14


def pairs_evidence(state: State, trace: Trace) -> list[Child]:
    """Ranked pairs, then the reasons."""
    if not state.ranked:
        return [h.p("There are no pairs to rank.", cls="dim")]
    return [_numbers_of(state, trace), _ranked(state), _against(state), _matrix(state, trace)]


def _numbers_of(state: State, trace: Trace) -> list[Child]:
    """Numbers of the chosen pair, and what of the question it does not fulfil."""
    pair = state.chosen or state.ranked[0]
    answer = words_of_answer(trace, state.name_of, pair)
    if trace.answered is not None:
        return [h.p(trace.answered, cls="sub", id="answer-numbers")]
    numbers = (
        (term(name if name == "product" else f"P({name})"), " ", h.b(probability(value)))
        for name, value in headline(pair, trace.own_scores)
    )
    fails = f"not so: {'; '.join(answer.fails)}" if answer.fails else None
    below = with_terms(answer.below, "posterior", "margin")
    return [h.p(joined(part for part in (*numbers, below, fails) if part), cls="sub", id="answer-numbers")]


def _ranked(state: State) -> list[Child]:
    """Ranked pairs with each factor; the weakest factor of a pair stands out."""
    fit = any(p.factors for p in state.ranked)
    names = {"tgt": "P(target)", "ref": "P(reference)", "rel": "P(relation)"}
    names |= {"fit": "P(attributes)"} if fit else {}
    names["P"] = "posterior"
    heads = (h.th(term(name, shown), cls="n") for shown, name in names.items())
    count = len(state.ranked)
    said = f"all {count} pairs" if count <= SHOWN_PAIRS else f"best {SHOWN_PAIRS} of {count} pairs"
    return [
        more(said) if count > FEW else None,
        h.table(
            h.thead(h.tr(h.th("#", cls="n"), h.th("target, reference"), heads)),
            h.tbody(_row(state, i, pair, fit) for i, pair in enumerate(state.ranked[:SHOWN_PAIRS])),
            cls="pairs",
        ),
    ]


def _numbers(pair: ScoredPair, fit: bool) -> list[float]:
    """Factors of a pair, then the posterior."""
    return [pair.p_target, pair.p_reference, pair.p_relation, *([pair.p_attributes] * fit), pair.probability]


def _row(state: State, i: int, pair: ScoredPair, fit: bool) -> Element:
    colors = palette(state.dark)
    others = [k for k in (pair.reference, pair.second_reference) if k is not None]
    rank, before = (None, None) if state.edited is None else state.edited.pair_before(pair)
    *factors, posterior = _numbers(pair, fit)
    old = [None] * (len(factors) + 1) if before is None else _numbers(before, fit)
    cells = [
        cell(
            "–" if pair.reference is None and k in (1, 2) else f"{p:.2f}",
            was(p, old[k]),
            "n low" if p == min(factors) and p < 0.5 else "n",
        )
        for k, p in enumerate(factors)
    ]
    judged = state.judged
    right = isinstance(judged, Diagnosis) and pair is judged.right
    return h.tr(
        cell(f"{i + 1} ✓" if right else i + 1, None if rank in (None, i + 1) else f"was rank {rank}", "n dim"),
        h.td(
            h.div(named(colors["target"], state.name_of(pair.target))),
            None
            if pair.reference is None
            else h.div(named(colors["reference"], ", ".join(state.name_of(k) for k in others))),
            cls="w",
        ),
        cells,
        cell(h.b(f"{posterior:.2f}"), was(posterior, old[-1])),
        id=f"pair-{i}",
        do=f"pair:{i}",
        hover="hover:" + ",".join(map(str, dict.fromkeys(state.at(pair)))),
        cls="r ok" if right else "r",
    )


def _against(state: State) -> list[Child]:
    """Answer against the best acceptable pair, factor by factor, as log-contributions."""
    d = state.judged
    if not isinstance(d, Diagnosis) or not d.gold or d.winner is None or d.right is None or d.winner == d.right:
        return []
    config = d.evidence.answers.source.config.rank
    weights = {"target": config.target_weight, "reference": config.reference_weight, "relation": config.relation_weight}
    shares = {name: weights.get(name, 1.0) * share for name, share in (d.contributions or {}).items()}
    scale, colors = max(1e-9, *(abs(v) for v in shares.values())), palette(state.dark)
    needed = {n.factor: n.right_above for n in d.needed}
    rows = []
    for name, share in shares.items():
        above, right = needed.get(name), getattr(d.right, f"p_{name}")
        css = {"--c": hex_color(colors["bad" if share > 0 else "truth"]), "width": f"{abs(share) / scale / 2:.1%}"}
        wanted = (
            None if above is None else h.div(f"needs {threshold(above, right)[0]}", cls="dim", title=hint_of("needed"))
        )
        rows.append(
            h.tr(
                h.th(name, scope="row"),
                h.td(f"{getattr(d.winner, f'p_{name}'):.2f}", cls="n"),
                h.td(f"{right:.2f}", wanted, cls="n"),
                h.td(h.div(h.i(cls="for" if share >= 0 else "against", css=css), cls="diverge")),
                h.td(f"{share:+.2f}", cls="n"),
            )
        )
    total = f"{d.winner.log_score - d.right.log_score:+.2f}"
    rows.append(h.tr(h.th("sum", scope="row"), h.td(colspan=3), h.td(h.b(total), cls="n"), cls="sum"))
    head = h.tr(
        h.td(),
        h.th("answer", cls="n"),
        h.th("correct", cls="n"),
        h.th("correct · answer", title="which of the two the factor favours"),
        h.th(term("Δ log"), cls="n"),
    )
    return [
        h.h3("Answer against the correct pair"),
        h.dl(h.dt("answer"), _ends(state, d.winner), h.dt("correct"), _ends(state, d.right), cls="facts"),
        h.table(h.thead(head), h.tbody(rows), cls="against"),
    ]


def _ends(state: State, pair: ScoredPair) -> Element:
    colors = palette(state.dark)
    target, reference = (_name(state, i) for i in (pair.target, pair.reference))
    return h.dd(named(colors["target"], target), " · ", named(colors["reference"], reference))


def _name(state: State, place: int | None) -> str:
    return "?" if place is None or place not in state.shown.place else state.name_of(place)


def _matrix(state: State, trace: Trace) -> list[Child]:
    """Candidate pairs as a heat map, targets down and references across; a click chooses the pair."""
    if trace.root.triple is None or trace.relation == "between":
        return []
    colors = palette(state.dark)
    targets, references = trace.candidates[trace.query.target], trace.candidates[trace.root.triple.nodes[0].label]
    columns = _best(references)
    ranks = {(p.target, p.reference): k for k, p in enumerate(state.ranked)}
    accepted = state.judged.acceptable_pairs() if isinstance(state.judged, Diagnosis) else set()
    css = {f"--{role}": hex_color(colors[role]) for role in ("target", "truth", "reference")}
    cut = max(len(targets.index), len(references.index)) > MATRIX_LIMIT
    head = (
        h.th(_name(state, c).rpartition("·")[2], h.i(f"{s:.2f}"), cls="ref", title=_name(state, c)) for c, s in columns
    )
    table = h.table(
        h.thead(h.tr(h.td(), h.td(), head)),
        h.tbody(
            h.tr(
                h.th(named(colors["target"], _name(state, r)), cls="w2", scope="row"),
                h.td(f"{score:.2f}", cls="n dim"),
                (_pair_cell(state, ranks.get((r, c)), (r, c) in accepted) for c, _ in columns),
                id=f"matrix-{r}",
            )
            for r, score in _best(targets)
        ),
        cls="matrix",
        css=css,
    )
    aside = f"best {MATRIX_LIMIT} a side" if cut else with_terms("P(relation) · outlined: acceptable", "acceptable")
    return [h.h3("All pairs", h.span(aside)), h.div(table, cls="mx")]


def _pair_cell(state: State, rank: int | None, accepted: bool) -> Element:
    if rank is None:
        return h.td("·", cls="no", title="one and the same thing")
    pair = state.ranked[rank]
    p = pair.p_relation
    marks = ("c", "ok" if accepted else "", "top" if rank == 0 else "")
    return h.td(
        "1" if p >= 0.995 else f"{p:.2f}"[1:],
        cls=" ".join(filter(None, marks)),
        css={"--a": f"{0.06 + 0.84 * p:.2f}", "--p": f"{pair.probability:.3f}"},
        do=f"pair:{rank}",
        # Keys reach the pairs in the table above.
        tabindex=-1,
        title=f"{_name(state, pair.target)} · {_name(state, pair.reference)}: relation {p:.3f}, "
        f"score {pair.log_score:.2f}, P {pair.probability:.3f}, rank {rank + 1}" + (", acceptable" if accepted else ""),
    )


def _best(candidates: Candidates) -> list[tuple[int, float]]:
    best = np.argsort(-candidates.scores, kind="stable")[:MATRIX_LIMIT]
    return [(int(candidates.index[k]), float(candidates.scores[k])) for k in best]


EVIDENCE: dict[str, Callable[[State, Trace], list[Child]]] = {
    "PARSE": parse_evidence,
    "OPM": candidates_evidence,
    "LIFT": lift_evidence,
    "SRM": relations_evidence,
    "ATTRIBUTE": attributes_evidence,
    "PRM": pairs_evidence,
    "LABEL": verdict_evidence,
}
