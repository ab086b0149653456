"""The pipeline as connected stages: how each fared, which failed and why, and the evidence of PARSE and PRM."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.asked_names import taken_as, unused_words
from pipeline.answering.json_records import probability, why_no_answer
from pipeline.answering.pair_table import HOLDS, ScoredPair
from pipeline.answering.ranking import Candidates
from pipeline.diagnosis.verdict import MODULE_OF, Diagnosis, threshold
from pipeline.geometry.palette import VERDICTS, hex_color, palette
from pipeline.language.counted import counted
from pipeline.language.glossary import glossary
from pipeline.language.lexicon import wording
from pipeline.language.tree import Attachment, Node, Span
from spatialviz.app.answer import verdict_evidence
from spatialviz.app.markup import Child, Element, cell, chosen, h, hint_of, named, term, was, with_terms
from spatialviz.app.stage_objects import attributes_evidence, candidates_evidence, lift_evidence, relations_evidence
from spatialviz.app.state import State

Mark: TypeAlias = Literal["good", "doubt", "bad", "idle"]


@dataclass(frozen=True)
class Stage:
    """How a stage fared: by a mark, in plain words, and what it took."""

    name: str
    mark: Mark
    words: str
    cost: str = ""


def failed_stages(state: State) -> tuple[str, ...]:
    """The stages that failed: by the verdict, else where the question stopped."""
    judged = state.judged
    if state.error:
        return ("PARSE",)
    if isinstance(judged, Diagnosis):
        if judged.verdict != "COMPOUND":
            return (MODULE_OF[judged.verdict],) if judged.verdict in MODULE_OF else ()
        return tuple(dict.fromkeys("OPM" if part in ("CONF", "RECALL") else part for part in judged.repair))
    if state.trace is None or why_no_answer(state.trace) is None:
        return ()
    return ("OPM",) if state.trace.missing else ("PRM",)


def opened(state: State) -> str:
    """The stage whose evidence is open: the one that was chosen, else the one that failed, else that of the pairs."""
    return state.stage or next(iter(failed_stages(state)), "PRM")


def stages_html(state: State, open_stage: str = "") -> Element:
    """The stages in order, each with the evidence below its head where it is the open one.

    `open_stage` is as `State.stage`: a name of EVIDENCE, "" for `opened`, and anything else for none.
    """
    open_stage = open_stage or opened(state)
    return h.ol((_item(state, stage, open_stage, failed_stages(state)) for stage in stages(state)), cls="stages")


def _item(state: State, stage: Stage, open_stage: str, failed: tuple[str, ...]) -> Element:
    trace, key = state.trace if stage.name == open_stage else None, stage.name.lower()
    marks = ("stage", stage.mark, "open" if trace is not None else "", "failed" if stage.name in failed else "")
    evidence = None
    if trace is not None:
        how = {"id": f"evidence-{key}", "role": "region", "aria_label": f"evidence of {stage.name}"}
        evidence = h.div(EVIDENCE[stage.name](state, trace), cls="evidence", **how)
    return h.li(
        h.button(
            h.b(stage.name),
            h.span(stage.words, cls="line"),
            h.span(stage.cost, cls="cost"),
            cls="head",
            do=f"stage:{stage.name}",
            id=f"head-{key}",
            aria_expanded=str(trace is not None).lower(),
            aria_controls=f"evidence-{key}",
            title=hint_of(stage.name),
        ),
        _sentence(state) if failed[:1] == (stage.name,) else None,
        evidence,
        cls=" ".join(filter(None, marks)),
        id=f"stage-{key}",
    )


def _sentence(state: State) -> Element:
    """Why the answer is wrong, or why there is none."""
    if isinstance(state.judged, Diagnosis):
        return h.p(state.judged.text, cls="sentence")
    if state.error:
        return h.p(state.error, cls="sentence refused")
    return h.p(None if state.trace is None else why_no_answer(state.trace), cls="sentence")


def stages(state: State) -> list[Stage]:
    """All stages: one that failed stands out, and where the answer is right no other is in doubt."""
    trace, failed = state.trace, failed_stages(state)
    if trace is None:
        found = [Stage(name, "idle", glossary()[name].short) for name in EVIDENCE if name not in ("ATTRIBUTE", "LABEL")]
        if state.error:
            found[0] = Stage("PARSE", "bad", "could not be asked")
        return [*found, _label(state)]
    made = (_parse(trace), _opm(trace), _lift(state, trace), _srm(state, trace), _attribute(state), _prm(trace))
    right = isinstance(state.judged, Diagnosis) and state.judged.correct
    return [
        replace(s, mark="bad" if s.name in failed else "good" if right and s.name != "LABEL" else s.mark)
        for s in (*filter(None, made), _label(state))
    ]


def _ms(trace: Trace, stage: str) -> str:
    value = trace.timings.get(stage, 0.0) * 1000
    return f"{value:.1f} ms" if value < 100 else f"{value:.0f} ms"


def _sound(is_so: object) -> Mark:
    return "good" if is_so else "doubt"


def _parse(trace: Trace) -> Stage:
    several = f"one of {len(trace.query.readings)} readings" if len(trace.query.readings) > 1 else ""
    reading = trace.query.default if trace.ranking is None else trace.ranking.reading
    words = "; ".join(filter(None, (reading.description, several, *parse_notes(trace))))
    return Stage("PARSE", _sound(not unused_words(trace.query)), words, _ms(trace, "parse"))


def _opm(trace: Trace) -> Stage:
    counts = ", ".join(f"{len(c.index)} for “{name}”" for name, c in trace.candidates.items())
    words = f"candidates: {counts} (detector: {trace.detector})"
    if trace.answered is not None and not any(len(c.index) for c in trace.candidates.values()):
        return Stage("OPM", "idle", f"no proposals are given (detector: {trace.detector})")
    return Stage("OPM", "bad" if trace.missing else "good", words, _ms(trace, "opm"))


def _lift(state: State, trace: Trace) -> Stage:
    objects = [(state.shown.names[i], state.shown.objects[i].lifted.quality.concerns) for i in state.roles]
    doubts = [f"{name}: {concern}" for name, concerns in objects for concern in concerns]
    doubts += ["the up vector is assumed to be image-up"] if trace.viewer.up_source == "assumed" else []
    doubts += ["the depth is estimated"] if trace.frame.depth_source else []
    doubts += ["the depth looks odd"] if state.loaded is not None and state.loaded.doubt else []
    words = "; ".join(doubts) or f"{counted(len(trace.objects), 'object')} in 3D"
    # An object that was lifted for an earlier question costs nothing now.
    cost = _ms(trace, "lift") if trace.timings.get("lift", 0.0) > 1e-4 else "cached"
    return Stage("LIFT", _sound(not doubts), words, cost)


def _srm(state: State, trace: Trace) -> Stage:
    chosen, cost = state.chosen, _ms(trace, "srm")
    if trace.answered is not None and trace.scorer != trace.detector:
        return Stage("SRM", "idle", "relations are not given")
    if chosen is None or chosen.reference is None:
        return Stage("SRM", "good" if trace.objects else "idle", f"relations are scored by {trace.scorer}", cost)
    words = f"“{trace.phrase}” has {probability(chosen.p_relation)} for the chosen pair (scorer: {trace.scorer})"
    return Stage("SRM", _sound(chosen.holds and abs(chosen.relation_probability - HOLDS) >= 0.1), words, cost)


def _attribute(state: State) -> Stage | None:
    """Of questions that say something of an object alone."""
    if not any(pair.factors for pair in state.ranked):
        return None
    factors = () if state.chosen is None else state.chosen.factors
    words = ", ".join(f"“{f.text}” has {probability(f.probability)}" for f in factors) or "no pair is chosen"
    return Stage("ATTRIBUTE", _sound(all(f.holds for f in factors)), words)


def _prm(trace: Trace) -> Stage:
    reason, ranking, cost = why_no_answer(trace), trace.ranking, _ms(trace, "prm")
    if trace.answered is not None:
        return Stage("PRM", "idle", f"{trace.answered}; what ranked it is not given")
    if reason is not None or ranking is None:
        return Stage("PRM", "idle" if trace.missing else "bad", "nothing to rank" if trace.missing else reason or "")
    if len(ranking.pairs) == 1:
        return Stage("PRM", "good", "the only candidate pair", cost)
    words = f"{len(ranking.pairs)} pairs, the best leads by {ranking.margin:.2f}"
    return Stage("PRM", _sound(ranking.margin >= 0.1), words, cost)


def _label(state: State) -> Stage:
    annotated = 0 if state.loaded is None else len(state.loaded.context.frame.annotations)
    if isinstance(state.judged, Diagnosis):
        return Stage("LABEL", "good" if state.judged.correct else "idle", glossary()[state.judged.verdict].verdict)
    if isinstance(state.judged, str):
        return Stage("LABEL", "idle", "no verdict")
    words = f"the dataset annotates {counted(annotated, 'object')}" if annotated else "nothing is known of this frame"
    return Stage("LABEL", "good" if annotated else "idle", words)


def parse_evidence(state: State, trace: Trace) -> list[Child]:
    """Words, readings, notes and the tree."""
    return [
        h.div((_chip(state, trace.query.text[span.start : span.end], span) for span in trace.query.spans), cls="chips"),
        _readings(trace),
        [h.p(note, cls="dim") for note in parse_notes(trace)],
        h.ul(_noun(trace.root), cls="tree"),
    ]


def parse_notes(trace: Trace) -> list[str]:
    """What was taken for something else, and what was not used, each with the reason."""
    expression = trace.query.expression
    notes = [expression.note] if expression is not None and expression.note else []
    labels = {label: c.labels for label, c in trace.candidates.items()}
    notes += [f"“{text}” taken as {meant.name}" for text, meant in taken_as(trace.query, labels)]
    return notes + [f"not used: “{words}”: {why}" for words, why in unused_words(trace.query)]


def _chip(state: State, text: str, span: Span) -> Element:
    if span.role == "target" or span.role == "reference":
        css = {"--c": hex_color(palette(state.dark)[span.role])}
        return h.button(text, cls="chip", css=css, do=f"chip:{span.role}", title=f"select the {span.role}")
    if span.role == "unused":
        return h.span(h.s(text), cls="chip rel unused", title=f"not used: {span.note}")
    return h.span(text, cls="chip rel", title=span.role)


def _readings(trace: Trace) -> Element | None:
    """The readings, where there are several, with the score of each."""
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
    """A noun with all that is said of it below it."""
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


SHOWN_PAIRS = 30
MATRIX_LIMIT = 14


def pairs_evidence(state: State, trace: Trace) -> list[Child]:
    """The ranked pairs, then why they are so."""
    if not state.ranked:
        return [h.p("There are no pairs to rank.", cls="dim")]
    return [_ranked(state), _against(state), _matrix(state, trace)]


def _ranked(state: State) -> list[Child]:
    """The ranked pairs with each factor; the weakest factor of a pair stands out."""
    fit = any(p.factors for p in state.ranked)
    names = {"tgt": "P(target)", "ref": "P(reference)", "rel": "P(relation)"}
    names |= {"fit": "P(attributes)"} if fit else {}
    names["P"] = "posterior"
    heads = (h.th(term(name, shown), cls="n") for shown, name in names.items())
    more = "" if len(state.ranked) <= SHOWN_PAIRS else f"best {SHOWN_PAIRS} of {len(state.ranked)}"
    return [
        h.h3("Ranked pairs", h.span(more)),
        h.table(
            h.thead(h.tr(h.th("#", cls="n"), h.th("target, reference"), heads)),
            h.tbody(_row(state, i, pair, fit) for i, pair in enumerate(state.ranked[:SHOWN_PAIRS])),
            cls="pairs",
        ),
    ]


def _numbers(pair: ScoredPair, fit: bool) -> list[float]:
    """The factors of a pair, then its posterior."""
    return [pair.p_target, pair.p_reference, pair.p_relation, *([pair.p_attributes] * fit), pair.probability]


def _row(state: State, i: int, pair: ScoredPair, fit: bool) -> Element:
    colors = palette(state.dark)
    target, *others = state.at(pair)
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
    return h.tr(
        cell(i + 1, None if rank in (None, i + 1) else f"was rank {rank}", "n dim"),
        h.td(
            h.div(named(colors["target"], state.shown.names[target])),
            None
            if pair.reference is None
            else h.div(named(colors["reference"], ", ".join(state.shown.names[k] for k in others))),
            cls="w",
        ),
        cells,
        cell(h.b(f"{posterior:.2f}"), was(posterior, old[-1])),
        id=f"pair-{i}",
        do=f"pair:{i}",
        **chosen(state.at(pair) == state.pair, "r"),
    )


def _against(state: State) -> list[Child]:
    """The answer against the best acceptable pair, factor by factor, as log-contributions."""
    d = state.judged
    if not isinstance(d, Diagnosis) or not d.gold or d.winner is None or d.right is None or d.winner == d.right:
        return []
    config = d.evidence.answers.source.config.rank
    weights = {"target": config.target_weight, "reference": config.reference_weight, "relation": config.relation_weight}
    shares = {name: weights.get(name, 1.0) * share for name, share in (d.contributions or {}).items()}
    scale = max(1e-9, *(abs(v) for v in shares.values()))
    needed = {n.factor: n.right_above for n in d.needed}
    rows = []
    for name, share in shares.items():
        above, right = needed.get(name), getattr(d.right, f"p_{name}")
        css = {"--c": hex_color(VERDICTS["SRM" if share > 0 else "CORRECT"]), "width": f"{abs(share) / scale / 2:.1%}"}
        wanted = None if above is None else h.div(f"> {threshold(above, right)[0]}", cls="dim", title=hint_of("needed"))
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
        h.th("right", cls="n"),
        h.th("right · answer", title="which of the two the factor favours"),
        h.th(term("Δ log"), cls="n"),
    )
    return [
        h.h3("Answer against the right pair"),
        h.dl(h.dt("answer"), _ends(state, d.winner), h.dt("right"), _ends(state, d.right), cls="facts"),
        h.table(h.thead(head), h.tbody(rows), cls="against"),
    ]


def _ends(state: State, pair: ScoredPair) -> Element:
    colors = palette(state.dark)
    target, reference = (_name(state, i) for i in (pair.target, pair.reference))
    return h.dd(named(colors["target"], target), " · ", named(colors["reference"], reference))


def _name(state: State, place: int | None) -> str:
    at = None if place is None else state.shown.place.get(place)
    return "?" if at is None else state.shown.names[at]


def _matrix(state: State, trace: Trace) -> list[Child]:
    """All candidate pairs as a heat map, targets down and references across; a click chooses the pair."""
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
    is_chosen, p = state.at(pair)[:2] == (state.pair or ())[:2], pair.p_relation
    marks = ("c", "sel" if is_chosen else "", "ok" if accepted else "", "top" if rank == 0 else "")
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
