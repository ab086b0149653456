"""The verdict on the current answer: what failed, what would mend it, winner against right pair, all pairs at once."""

from __future__ import annotations

import numpy as np

from pipeline.answering.ranking import Candidates
from pipeline.diagnosis.verdict import Diagnosis, threshold
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.palette import VERDICTS as COLORS
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.relation_names import PHRASE
from spatialviz.app.edit_scene import REGION_COLORS
from spatialviz.app.failures import verdict_chip
from spatialviz.app.relation_region import asked_pair
from spatialviz.app.state import State
from spatialviz.app.text import dot, heading, note, panel, safe

MATRIX_LIMIT = 14
ORACLE_WORDS = {
    "RECALL": ("missing objects", "every labelled object the detector missed joins the candidates"),
    "LIFT": ("true geometry", "every candidate that is an object gets the geometry of its own labelled pixels"),
    "SRM": ("true relations", "the relation of every pair of real objects is .99, .5 or .01, as labelled"),
    "CONF": ("true confidences", "real objects of the asked class get .99, false positives .01"),
    "ATTRIBUTE": ("true attributes", "attributes of real objects are .99, .5 or .01, as far as they are known"),
}


def verdict_line(state: State) -> str:
    """The verdict in one line, for the head of the answer; a click shows why."""
    if isinstance(state.judged, Diagnosis):
        d = state.judged
        detail = "lucky" if d.lucky else d.detail
        return (
            f'<div class="vline" onclick="svTab(\'Why\')" title="{safe(state.judged.text)}">'
            f"{verdict_chip(d.verdict, detail)}<span>{safe(state.judged.text)}</span></div>"
        )
    if isinstance(state.judged, str):
        said = safe(f"No verdict: {state.judged}")
        return f'<div class="vline dim" onclick="svTab(\'Why\')" title="{said}"><span>{said}</span></div>'
    return ""


def mend_button(state: State) -> str:
    """A button that leads to the labels of the verdict; it stands out where the label itself is in doubt."""
    if not state.correctable:
        return ""
    doubted = isinstance(state.judged, Diagnosis) and state.judged.verdict == "LABEL"
    click = "event.stopPropagation();sv('mend')"
    return (
        f'<span class="try mend{" go" if doubted else ""}" role="button" onclick="{click}" '
        'title="the labelled pair and its expression (Shift+M)">correct this label</span>'
    )


def why_html(state: State) -> str:
    """Everything about the verdict."""
    judged = state.judged
    if state.trace is None:
        return panel('<div class="dim" style="padding:.7em 0">Nothing is asked.</div>')
    if judged is None:
        return panel(
            '<div class="dim" style="padding:.7em 0">No verdict: nothing is known of the truth in this frame. It needs '
            "labels (a run) or annotations.</div>",
            _placement(state),
            _matrix(state),
        )
    if isinstance(judged, str):
        said = f'<div class="dim" style="padding:.7em 0">No verdict: {safe(judged)}. {mend_button(state)}</div>'
        return panel(said, _placement(state), _matrix(state))
    chip = verdict_chip(judged.verdict, "lucky" if judged.lucky else judged.detail)
    head = f'<div style="padding:.55em 0 .3em;display:flex;align-items:center">{chip}{mend_button(state)}</div>'
    return panel(
        head,
        f'<div class="said">{safe(judged.text)}</div>',
        _placement(state),
        _other(state),
        _decomposition(state, judged),
        _oracles(judged),
        _matrix(state),
    )


def _placement(state: State) -> str:
    """Where the chosen target falls in the relation's region, by the rule, and why."""
    asked = asked_pair(state)
    if asked is None:
        return ""
    names = (safe(state.shown.names[i]) for i in asked.places)
    shown = "region: shown" if state.flags.region else "region: show it"
    click = f'<span class="try" onclick="sv(\'flag:region\')" title="in the scene (Shift+R)">{shown}</span>'
    legend = "".join(
        f"<span>{dot(color)}{'holds' if label == 'T' else 'in doubt'} ({label})</span>"
        for label, color in REGION_COLORS.items()
    )
    return (
        heading("By the rule", click)
        + f'<div class="dim">{f" {safe(PHRASE[asked.relation])} ".join(names)}</div>'
        + f"<div>{safe(asked.placement.why)}</div>"
        + (f'<div class="legend">{legend}</div>' if state.flags.region else "")
    )


def _other(state: State) -> str:
    """The other run's answer beside this one: what moved."""
    other, mine = state.other, state.ranked[0] if state.ranked else None
    if other is None:
        return ""
    if other.error:
        return heading("The other run", safe(other.name)) + note(other.error)
    verdict = ""
    if isinstance(other.judged, Diagnosis):
        d = other.judged
        verdict = verdict_chip(d.verdict, "lucky" if d.lucky else d.detail)
    rows = []
    for name, pair, trace in (("this", mine, state.trace), ("other", other.best, other.trace)):
        if pair is None or trace is None or pair.reference is None:
            rows.append(f'<tr><td class="dim">{name}</td><td colspan="6">no answer</td></tr>')
            continue
        names = " · ".join(safe(trace.objects[i].label) for i in (pair.target, pair.reference))
        factors = (pair.p_target, pair.p_reference, pair.p_relation)
        cells = "".join(f'<td class="n">{p:.2f}</td>' for p in factors)
        rows.append(f'<tr><td class="dim">{name}</td><td class="w">{names}</td>{cells}</tr>')
    moved = ""
    if mine is not None and other.best is not None and state.trace is not None and other.trace is not None:
        ours, theirs = (t.objects[p.target].bbox for t, p in ((state.trace, mine), (other.trace, other.best)))
        same = float(iou_2d(ours, theirs)[0, 0])
        moved = "the same target" if same >= 0.5 else "another target"
    head = '<tr><th></th><th></th><th class="n">tgt</th><th class="n">ref</th><th class="n">rel</th></tr>'
    return (
        heading("Against the other run", f"{safe(other.name)}: {moved}")
        + f'<div style="padding-bottom:3px">{verdict}</div><table>{head}{"".join(rows)}</table>'
    )


def _decomposition(state: State, d: Diagnosis) -> str:
    """Winner against the best acceptable pair, factor by factor, as log-contributions."""
    if not d.gold or d.winner is None or d.right is None or d.contributions is None or d.winner == d.right:
        return ""
    colors = palette(state.dark)
    config = d.evidence.answers.source.config.rank
    weights = {"target": config.target_weight, "reference": config.reference_weight, "relation": config.relation_weight}
    shares = {name: weights.get(name, 1.0) * share for name, share in d.contributions.items()}
    scale = max(1e-9, *(abs(v) for v in shares.values()))
    needed = {n.factor: n for n in d.needed}
    rows = []
    for name, share in shares.items():
        width = 50 * abs(share) / scale
        side = f"left:50%;width:{width:.1f}%" if share >= 0 else f"right:50%;width:{width:.1f}%"
        color = hex_color(COLORS["SRM"]) if share > 0 else hex_color(COLORS["CORRECT"])
        change = needed.get(name)
        above = None if change is None or change.right_above is None else threshold(change.right_above, change.right)
        wanted = "" if above is None else f"&gt; {above[0]}"
        rows.append(
            f'<tr><td>{name}</td><td class="n">{getattr(d.winner, f"p_{name}"):.2f}</td>'
            f'<td class="n">{getattr(d.right, f"p_{name}"):.2f}</td>'
            f'<td style="width:38%"><div class="diverge"><i style="--c:{color};{side}"></i></div></td>'
            f'<td class="n">{share:+.2f}</td><td class="n dim">{wanted}</td></tr>'
        )
    total = d.winner.log_score - d.right.log_score
    pairs = [
        f"{dot(colors['target'])}{safe(_name(state, s.target))} · "
        f"{dot(colors['reference'])}{safe(_name(state, s.reference))}"
        for s in (d.winner, d.right)
    ]
    head = (
        '<tr><th></th><th class="n">answer</th><th class="n">right</th><th>for the right · for the answer</th>'
        '<th class="n">Δ log</th><th class="n" title="the right pair wins as soon as its factor is above this, '
        'all else as it is">needed</th></tr>'
    )
    return (
        heading("Answer against the right pair") + f'<div class="facts"><span>answer</span><span>{pairs[0]}</span>'
        f"<span>right</span><span>{pairs[1]}</span></div>"
        + f'<table>{head}{"".join(rows)}<tr class="sum"><td>S</td><td></td><td></td><td></td>'
        f'<td class="n"><b>{total:+.2f}</b></td><td></td></tr></table>'
    )


def _name(state: State, place: int | None) -> str:
    at = None if place is None else state.shown.place.get(place)
    return "?" if at is None else state.shown.names[at]


def _oracles(d: Diagnosis) -> str:
    """Each oracle alone: is the answer right with it, and by what margin."""
    rows = []
    for k, name in enumerate(("", *d.oracles)):
        subset = 0 if k == 0 else 1 << (k - 1)
        right, margin = bool(d.right_with >> subset & 1), float(d.margins[subset])
        words, hint = ("nothing: as it is", "the pipeline's own answer") if k == 0 else ORACLE_WORDS[name]
        color = hex_color(COLORS["CORRECT"] if right else COLORS["SRM"])
        shown = "–" if not np.isfinite(margin) else f"{margin:+.2f}"
        repair = " on" if name in (d.mends or d.repair) else ""
        rows.append(
            f'<tr class="{repair}" title="{safe(hint)}"><td><b>{name}</b></td><td>{words}</td>'
            f'<td style="color:{color}">{"✓ right" if right else "✗ wrong"}</td><td class="n">{shown}</td></tr>'
        )
    repair = f"smallest repair: {' + '.join(d.repair)}" if d.repair else ""
    if len(d.mends) > 1:
        repair = f"each alone would do: {', '.join(d.mends)}"
    return (
        heading("With the truth in place of", repair) + '<table class="oracles"><tr><th></th><th></th><th>target</th>'
        '<th class="n" title="S of the best acceptable pair less S of the best other one">margin</th></tr>'
        + "".join(rows)
        + "</table>"
    )


def _matrix(state: State) -> str:
    """All candidate pairs as a heat map, targets down and references across; a click chooses the pair."""
    trace = state.trace
    if trace is None or not state.ranked or trace.root.triple is None or trace.relation == "between":
        return ""
    colors = palette(state.dark)
    targets = trace.candidates[trace.query.target]
    references = trace.candidates[trace.root.triple.nodes[0].label]
    rows, columns = _best(targets), _best(references)
    place = {(p.target, p.reference): k for k, p in enumerate(state.ranked)}
    accepted = _accepted(state)
    head = "".join(
        f'<th class="ref" title="{safe(_name(state, c))}">{safe(_number(state, c))}<i>{s:.2f}</i></th>'
        for c, s in columns
    )
    body = []
    for r, score in rows:
        cells = []
        for c, _ in columns:
            k = place.get((r, c))
            if k is None:
                cells.append('<td class="no" title="one and the same thing">·</td>')
                continue
            pair = state.ranked[k]
            chosen = state.at(pair)[:2] == (state.pair or ())[:2]
            marks = f"{' sel' if chosen else ''}{' ok' if (r, c) in accepted else ''}{' top' if k == 0 else ''}"
            hint = (
                f"{_name(state, r)} · {_name(state, c)}: relation {pair.p_relation:.3f}, S {pair.log_score:.2f}, "
                f"P {pair.probability:.3f}, rank {k + 1}" + (", acceptable" if (r, c) in accepted else "")
            )
            cells.append(
                f'<td class="c{marks}" style="--a:{_heat(pair.p_relation):.2f};--p:{pair.probability:.3f}" '
                f'onclick="sv(\'pair:{k}\')" title="{safe(hint)}">{_short(pair.p_relation)}</td>'
            )
        name = f"{dot(colors['target'])}{safe(_name(state, r))}"
        body.append(
            f'<tr><td class="w2" title="{safe(_name(state, r))}">{name}</td><td class="n dim">{score:.2f}</td>'
            f"{''.join(cells)}</tr>"
        )
    cut = max(len(targets.index), len(references.index)) > MATRIX_LIMIT
    more = f"best {MATRIX_LIMIT} a side" if cut else "relation · outlined: acceptable"
    return (
        heading("All pairs", more)
        + f'<div class="mx"><table style="--t:{hex_color(colors["target"])};--g:{hex_color(colors["truth"])};'
        f'--r:{hex_color(colors["reference"])}"><tr><td></td><td></td>{head}</tr>{"".join(body)}</table></div>'
    )


def _best(candidates: Candidates) -> list[tuple[int, float]]:
    order = np.argsort(-candidates.scores, kind="stable")[:MATRIX_LIMIT]
    return [(int(candidates.index[k]), float(candidates.scores[k])) for k in order]


def _accepted(state: State) -> set[tuple[int, int]]:
    """Pairs of candidates that are acceptable, as places in the trace's objects."""
    if not isinstance(state.judged, Diagnosis):
        return set()
    return state.judged.acceptable_pairs()


def _number(state: State, place: int) -> str:
    return _name(state, place).rpartition("·")[2]


def _heat(p: float) -> float:
    return 0.06 + 0.84 * p


def _short(p: float) -> str:
    return "1" if p >= 0.995 else f"{p:.2f}"[1:]
