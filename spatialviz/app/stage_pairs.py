"""Evidence of the stage PRM: the ranked pairs, all pairs at once, and the answer against the right pair."""

from __future__ import annotations

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.ranking import Candidates
from pipeline.diagnosis.verdict import Diagnosis, threshold
from pipeline.geometry.palette import VERDICTS as COLORS
from pipeline.geometry.palette import hex_color, palette
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.state import State
from spatialviz.app.text import cell, chosen, named, was

SHOWN_PAIRS = 30
MATRIX_LIMIT = 14
NEEDED = "needed: the right pair wins as soon as its factor is above this, all else as it is"


def pairs_evidence(state: State, trace: Trace) -> list[Child]:
    """The ranked pairs, then why they are so."""
    if not state.ranked:
        return [h.p("There are no pairs to rank.", cls="dim")]
    return [_ranked(state), _against(state), _matrix(state, trace)]


def _ranked(state: State) -> list[Child]:
    """The ranked pairs with each factor; the weakest factor of a pair stands out."""
    fit = any(p.factors for p in state.ranked)
    names = [
        ("target", "P(target | name)"),
        ("ref", "P(reference | name)"),
        ("rel", "P(relation)"),
        *([("fit", "P(attributes and choices)")] if fit else []),
        ("P", "posterior over all pairs"),
    ]
    head = h.tr(
        h.th("#", cls="n"),
        h.th("target, reference"),
        (h.th("tgt" if name == "target" else name, cls="n", title=title) for name, title in names),
    )
    rows = (_row(state, i, pair, fit) for i, pair in enumerate(state.ranked[:SHOWN_PAIRS]))
    more = "" if len(state.ranked) <= SHOWN_PAIRS else f"best {SHOWN_PAIRS} of {len(state.ranked)}"
    return [h.h3("Ranked pairs", h.span(more)), h.table(h.thead(head), h.tbody(rows), cls="pairs")]


def _numbers(pair: ScoredPair, fit: bool) -> list[float]:
    """The factors of a pair, then its posterior."""
    return [pair.p_target, pair.p_reference, pair.p_relation, *([pair.p_attributes] * fit), pair.probability]


def _row(state: State, i: int, pair: ScoredPair, fit: bool) -> Element:
    colors, edited = palette(state.dark), state.edited
    target, *others = state.at(pair)
    ends = ", ".join(state.shown.names[k] for k in others)
    before = None if edited is None else edited.pair_before(pair)
    rank = None if edited is None else edited.rank_before(pair)
    *factors, posterior = _numbers(pair, fit)
    old = [None] * (len(factors) + 1) if before is None else _numbers(before, fit)
    cells = []
    for k, (p, o) in enumerate(zip(factors, old, strict=False)):
        empty = pair.reference is None and k in (1, 2)
        low = p == min(factors) and p < 0.5
        cells.append(cell("–" if empty else f"{p:.2f}", was(p, o), "n low" if low else "n"))
    return h.tr(
        cell(i + 1, None if rank in (None, i + 1) else f"was rank {rank}", "n dim"),
        h.td(
            h.div(named(colors["target"], state.shown.names[target])),
            None if pair.reference is None else h.div(named(colors["reference"], ends)),
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
        css = {"--c": hex_color(COLORS["SRM" if share > 0 else "CORRECT"]), "width": f"{abs(share) / scale / 2:.1%}"}
        wanted = None if above is None else h.div(f"> {threshold(above, right)[0]}", cls="dim", title=NEEDED)
        bar = h.i(cls="for" if share >= 0 else "against", css=css)
        rows.append(
            h.tr(
                h.th(name, scope="row"),
                h.td(f"{getattr(d.winner, f'p_{name}'):.2f}", cls="n"),
                h.td(f"{right:.2f}", wanted, cls="n"),
                h.td(h.div(bar, cls="diverge")),
                h.td(f"{share:+.2f}", cls="n"),
            )
        )
    total = d.winner.log_score - d.right.log_score
    rows.append(h.tr(h.th("sum", scope="row"), h.td(colspan=3), h.td(h.b(f"{total:+.2f}"), cls="n"), cls="sum"))
    head = h.tr(
        h.td(),
        h.th("answer", cls="n"),
        h.th("right", cls="n"),
        h.th("right · answer", title="which of the two the factor favours"),
        h.th("Δ log", cls="n"),
    )
    colors = palette(state.dark)

    def ends(pair: ScoredPair) -> list[Child]:
        target, reference = (_name(state, i) for i in (pair.target, pair.reference))
        return [named(colors["target"], target), " · ", named(colors["reference"], reference)]

    pairs = ((h.dt(what), h.dd(ends(p))) for what, p in (("answer", d.winner), ("right", d.right)))
    table = h.table(h.thead(head), h.tbody(rows), cls="against")
    return [h.h3("Answer against the right pair"), h.dl(pairs, cls="facts"), table]


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
    body = (
        h.tr(
            h.th(named(colors["target"], _name(state, r)), cls="w2", scope="row"),
            h.td(f"{score:.2f}", cls="n dim"),
            (_pair_cell(state, ranks.get((r, c)), (r, c) in accepted) for c, _ in columns),
            id=f"matrix-{r}",
        )
        for r, score in _best(targets)
    )
    head = (
        h.th(_name(state, c).rpartition("·")[2], h.i(f"{s:.2f}"), cls="ref", title=_name(state, c)) for c, s in columns
    )
    cut = max(len(targets.index), len(references.index)) > MATRIX_LIMIT
    css = {f"--{role}": hex_color(colors[role]) for role in ("target", "truth", "reference")}
    table = h.table(h.thead(h.tr(h.td(), h.td(), head)), h.tbody(body), cls="matrix", css=css)
    aside = f"best {MATRIX_LIMIT} a side" if cut else "relation · outlined: acceptable"
    return [h.h3("All pairs", h.span(aside)), h.div(table, cls="mx")]


def _pair_cell(state: State, rank: int | None, accepted: bool) -> Element:
    if rank is None:
        return h.td("·", cls="no", title="one and the same thing")
    pair = state.ranked[rank]
    marks = {"sel": state.at(pair)[:2] == (state.pair or ())[:2], "ok": accepted, "top": rank == 0}
    p = pair.p_relation
    return h.td(
        "1" if p >= 0.995 else f"{p:.2f}"[1:],
        cls=" ".join(("c", *(mark for mark, is_so in marks.items() if is_so))),
        css={"--a": f"{0.06 + 0.84 * p:.2f}", "--p": f"{pair.probability:.3f}"},
        do=f"pair:{rank}",
        # Keys reach the pairs in the table above.
        tabindex=-1,
        title=f"{_name(state, pair.target)} · {_name(state, pair.reference)}: relation {p:.3f}, "
        f"score {pair.log_score:.2f}, P {pair.probability:.3f}, rank {rank + 1}" + (", acceptable" if accepted else ""),
    )


def _best(candidates: Candidates) -> list[tuple[int, float]]:
    order = np.argsort(-candidates.scores, kind="stable")[:MATRIX_LIMIT]
    return [(int(candidates.index[k]), float(candidates.scores[k])) for k in order]
