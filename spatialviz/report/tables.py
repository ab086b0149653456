"""Tables of an answer as HTML: modules, decomposition, ranked pairs, relations. Everything is escaped."""

from __future__ import annotations

from html import escape
from math import log

from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.stages import failed_stages
from pipeline.diagnosis.verdict import ORACLE_WORDS, Diagnosis
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import letter
from spatialviz.report.picture import AnswerRoles

SHOWN_PAIRS = 8
_MODULES = (
    ("PARSE", "expression", ("parse",)),
    ("OPM", "proposals", ("opm",)),
    ("LIFT", "3D boxes", ("frame", "lift")),
    ("ATTRIBUTE", "attributes", ()),
    ("SRM", "relations", ("srm",)),
    ("PRM", "ranking", ("prm",)),
    ("LABEL", "the label", ()),
)


def modules_html(answered: Answer) -> str:
    """Strip of the modules with their times, the blamed one marked."""
    blamed = () if answered.diagnosis is None else failed_stages(answered.trace, answered.diagnosis)
    times = {} if answered.trace is None else answered.trace.timings
    cells = []
    judged = answered.diagnosis
    for name, what, stages in _MODULES:
        if name == "ATTRIBUTE" and (judged is None or "ATTRIBUTE" not in judged.oracles):
            continue
        took = sum(times.get(s, 0.0) for s in stages) * 1000
        shown = f"{took:.1f} ms" if any(s in times for s in stages) else "–"
        mark = ' class="blamed"' if name in blamed else ""
        text = ' <span class="sr">blamed</span>' if name in blamed else ""
        cells.append(f"<li{mark}><b>{name}</b><span>{what}</span><em>{shown}</em>{text}</li>")
    return f'<ol class="modules">{"".join(cells)}</ol>'


def decomposition_html(d: Diagnosis, cast: AnswerRoles) -> str:
    """Answer against the best right pair, factor by factor, as contributions to the log score."""
    if d.winner is None or d.right is None or d.contributions is None:
        return _missed_html(d)
    if d.winner == d.right:
        return '<p class="quiet">The answer is the best right pair: nothing is lost.</p>'
    widest = max(*(abs(v) for v in d.contributions.values()), 0.1)
    rows = []
    for factor, share in d.contributions.items():
        ours, theirs = getattr(d.winner, f"p_{factor}"), getattr(d.right, f"p_{factor}")
        side = "ours" if share >= 0 else "theirs"
        drawn = abs(share) >= 5e-4
        bar = f'<span class="bar {side}" style="width:{50 * abs(share) / widest:.1f}%"></span>' if drawn else ""
        phrase = escape(PHRASE.get(d.case.relation, d.case.relation))
        name = f"relation “{phrase}”" if factor == "relation" and phrase else factor
        rows.append(
            f'<tr><th scope="row">{name}</th><td>{ours:.3f}</td><td>{theirs:.3f}</td>'
            f'<td class="wide"><span class="axis">{bar}</span></td><td>{share:+.2f}</td></tr>'
        )
    total = d.winner.log_score - d.right.log_score
    rows.append(
        f'<tr class="sum"><th scope="row">log score</th><td>{d.winner.log_score:.2f}</td>'
        f'<td>{d.right.log_score:.2f}</td><td class="wide"></td><td>{total:+.2f}</td></tr>'
    )
    head = (
        '<tr><th scope="col">factor</th><th scope="col">answer'
        f"<small>{_pair(cast, d.winner.target, d.winner.reference)}</small></th>"
        '<th scope="col">best right pair'
        f"<small>{_pair(cast, d.right.target, d.right.reference)}</small></th>"
        '<th scope="col" class="wide hint"><span>← right pair</span><span>answer →</span></th>'
        '<th scope="col">Δ log</th></tr>'
    )
    return f'<table class="decomposition"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>{_needed(d)}'


def _needed(d: Diagnosis) -> str:
    lines = []
    for n in d.needed:
        ways = []
        if n.right_above is not None:
            ways.append(f"of the right pair above <b>{n.right_above:.3g}</b> (is {n.right:.3g})")
        if n.winner_below is not None:
            ways.append(f"of the answer below <b>{n.winner_below:.3g}</b> (is {n.winner:.3g})")
        if ways:
            lines.append(f"<li>{n.factor} {', or '.join(ways)}</li>")
    together = " and ".join(ORACLE_WORDS[name] for name in d.repair)
    repairs = [ORACLE_WORDS[name] for name in d.mends] or ([together] if together else [])
    mended = "".join(f"<li>{repair}</li>" for repair in repairs)
    if not lines and not mended:
        return ""
    return f'<h3>Each of these alone makes it right</h3><ul class="needed">{"".join(lines)}{mended}</ul>'


def _missed_html(d: Diagnosis) -> str:
    missed = d.missed
    if missed is None:
        return '<p class="quiet">No right pair stood among the candidates, or there was no answer.</p>'
    rows = [
        ("missing", escape(str(d.missed_name))),
        ("how", missed.kind.lower()),
        ("best overlap with a right one", f"{missed.overlap:.2f} (.50 is asked)"),
        ("its score", "–" if missed.score is None else f"{missed.score:.3f}"),
        ("its place by score", "–" if missed.rank is None else str(missed.rank)),
        ("mended by", " and ".join(ORACLE_WORDS[name] for name in d.repair) or "nothing"),
    ]
    return '<dl class="facts">' + "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in rows) + "</dl>"


def pairs_html(answered: Answer, cast: AnswerRoles) -> str:
    """Ranked pairs with their factors, and a lower best right pair."""
    trace = answered.trace
    if trace is None or trace.ranking is None or trace.ranking.degenerate:
        return ""
    pairs = trace.ranking.pairs
    indices = list(range(min(SHOWN_PAIRS, len(pairs))))
    at = next((k for k, p in enumerate(pairs) if (p.target, p.reference) == cast.right), None)
    if at is not None and at not in indices:
        indices.append(at)
    rows = []
    for k in indices:
        p = pairs[k]
        marks = ("winner " if k == 0 else "") + ("right" if k == at else "")
        if k >= SHOWN_PAIRS:
            rows.append('<tr class="gap"><td colspan="8">⋯</td></tr>')
        chip = ' <span class="chip">right</span>' if k == at else ""
        second = "" if p.second_reference is None else f", {escape(cast.name(p.second_reference))}"
        reference = "–" if p.reference is None else escape(cast.name(p.reference))
        rows.append(
            f'<tr class="{marks.strip()}"><td>{k + 1}</td>'
            f'<td class="name target">{escape(cast.name(p.target))}</td>'
            f'<td class="name reference">{reference}{second}{chip}</td>'
            f"<td>{p.p_target:.3f}</td><td>{p.p_reference:.3f}</td><td>{p.p_relation:.3f}</td>"
            f"<td>{log(max(p.product, 1e-12)):.2f}</td><td>{_meter(p.probability)}</td></tr>"
        )
    asked = trace.phrase or "relation"
    head = "".join(
        f'<th scope="col"{" class=name" if k in (1, 2) else ""}>{title}</th>'
        for k, title in enumerate(
            ("#", "target", "reference", "P(target)", "P(reference)", f"P({escape(asked)})", "ln product", "posterior")
        )
    )
    more = len(pairs) - len(indices)
    note = f'<p class="quiet">and {more} more pairs</p>' if more > 0 else ""
    return (
        f'<div class="scroll"><table class="pairs"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>{note}"
    )


def relations_html(answered: Answer, cast: AnswerRoles) -> str:
    """Relations of the answer's pair, and of the best right pair, with the label's word."""
    trace, judged = answered.trace, answered.diagnosis
    if trace is None or cast.target is None or cast.reference is None:
        return ""
    pairs = [("answer", (cast.target, cast.reference))]
    if cast.right is not None and cast.right != pairs[0][1]:
        pairs.append(("best right pair", cast.right))
    rows = []
    for n, relation in enumerate(trace.scores.relations):
        cells = []
        for _, (a, b) in pairs:
            text = ""
            if judged is not None and relation in judged.truth.states:
                i, j = cast.labelled.get(a), cast.labelled.get(b)
                if i is not None and j is not None and judged.truth.judged[i, j]:
                    text = letter(judged.truth.states[relation][i, j])
            p = float(trace.scores.probabilities[a, b, n])
            cells.append(f'<td>{_meter(p)}</td><td class="state">{text or "–"}</td>')
        mark = ' class="asked"' if relation == trace.relation else ""
        rows.append(f'<tr{mark}><th scope="row">{escape(PHRASE[relation])}</th>{"".join(cells)}</tr>')
    head = "".join(
        f'<th scope="col">{title}<small>{_pair(cast, *ends)}</small></th><th scope="col" class="state">label</th>'
        for title, ends in pairs
    )
    return (
        f'<div class="scroll"><table class="relations"><thead><tr><th scope="col">relation</th>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
        '<p class="quiet">The label says T holds, U in doubt, F does not; – not judged, or no labelled object.</p>'
    )


def _pair(cast: AnswerRoles, target: int, reference: int | None) -> str:
    if reference is None or not all(0 <= index < len(cast.objects) for index in (target, reference)):
        return ""
    return f"{escape(cast.name(target))} / {escape(cast.name(reference))}"


def _meter(p: float) -> str:
    return f'<span class="meter"><span style="width:{100 * p:.1f}%"></span></span><span class="number">{p:.3f}</span>'
