"""The Run tab: verdicts, what each module costs, slices, and the confusion of relations, each a way to its failures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.confusion import NO_ANSWER, OTHERS, Confusion
from pipeline.evaluation.search_words import quote
from pipeline.evaluation.shared_makers import Share, title_of
from pipeline.evaluation.slices import Slice, Slices
from pipeline.evaluation.summary import RunSummary, residual_words
from pipeline.geometry.palette import VERDICTS as COLORS
from pipeline.geometry.palette import hex_color
from pipeline.language.relation_names import PHRASE
from pipeline.metrics.intervals import Estimate
from spatialviz.app.failures import MEANING, searches, verdict_chip
from spatialviz.app.run_figures import STANDS_IN, RunFigures
from spatialviz.app.text import heading, note, panel, safe, segments
from spatialviz.app.why import ORACLE_WORDS

CUTS = {
    "relation": "relation", "class": "class", "distance": "distance", "size": "size", "occlusion": "occlusion",
    "same_class": "same class",
}  # fmt: skip
"""Dimensions that a run is cut by here, and what they are called in the choice."""
COST_COLORS = {
    "PARSE": COLORS["PARSE"], "RECALL": COLORS["OPM-TARGET"], "LIFT": COLORS["LIFT"], "SRM": COLORS["SRM"],
    "CONF": COLORS["OPM-CONF"], "ATTRIBUTE": COLORS["ATTRIBUTE"], "residual": COLORS["LABEL"],
}  # fmt: skip
COST_WORDS = {
    "PARSE": "the expression as it was meant",
    "residual": "what all of these together do not mend",
} | {name: f"{words}: {meaning}" for name, (words, meaning) in ORACLE_WORDS.items()}
ADDS_UP = (
    "Full bars (Shapley, fair shares) add up with the accuracy to 100. Hollow bars (one oracle alone) do not: "
    "errors overlap, and a bar below 0 made up for another's error."
)


def summary_html(figures: RunFigures) -> str:
    """Verdicts with their intervals, and what each module costs."""
    summary = figures.summary
    if isinstance(summary, str):
        return panel(shares_html(figures.run.shares), note(summary))
    count = f'<span class="dim">{summary.expressions} expressions</span>'
    head = f'<div class="runhead"><b>{safe(figures.run.name)}</b>{count}</div>'
    return panel(head, shares_html(figures.run.shares), _verdicts(summary), _costs(summary))


def shares_html(shares: Sequence[Share]) -> str:
    """What the figures below can show and cannot, in a line; in full where the mouse rests."""
    if not shares:
        return ""
    hint = "\n".join(share.sentence for share in shares)
    title = title_of(shares)
    if title:
        return f'<div title="{safe(hint)}">{note(title[:1].upper() + title[1:])}</div>'
    return f'<div class="small dim oneline" title="{safe(hint)}">{safe(shares[0].sentence)}</div>'


def percent(e: Estimate) -> str:
    """An estimate in percent with one digit."""
    return f"{100 * e.value:.1f}" if math.isfinite(e.value) else "–"


def between(e: Estimate) -> str:
    """Its interval in percent."""
    # Whole percents say nothing of a share of a few.
    digits = 1 if e.value < 0.02 else 0
    return f"[{100 * e.low:.{digits}f}, {100 * e.high:.{digits}f}]" if math.isfinite(e.low + e.high) else ""


def _verdicts(summary: RunSummary) -> str:
    rows = []
    for verdict, share in summary.verdicts.items():
        if not share.count:
            continue
        e = share.estimate
        whisker = ""
        if math.isfinite(e.low + e.high):
            whisker = f'<u style="left:{100 * e.low:.2f}%;width:{100 * (e.high - e.low):.2f}%"></u>'
        hint = f"{MEANING[verdict]}; {e.formatted()} %, 95 % interval over {summary.unit}s"
        details = ", ".join(
            f"{d.lower().replace('_', ' ')} {s.count}" for (v, d), s in summary.details.items() if v == verdict
        )
        if verdict == "CORRECT" and summary.lucky.count:
            details = f"lucky {summary.lucky.count}"
        hint += f"; {details}" if details else ""
        rows.append(
            f'<div class="vrow" {searches(f"verdict:{verdict}")} title="{safe(hint)}">{verdict_chip(verdict)}'
            f'<span class="t" style="--c:{hex_color(COLORS[verdict])}"><i style="width:{100 * e.value:.2f}%"></i>'
            f'{whisker}</span><span class="n dim">{share.count}</span>'
            f'<span class="n"><b>{percent(e)}</b></span><span class="n dim">{between(e)}</span></div>'
        )
    return heading("Verdicts", f"% of expressions · 95 % over {summary.unit}s") + "".join(rows)


def _costs(summary: RunSummary) -> str:
    """Shapley values beside single deltas, on one scale with zero in the same place."""
    fair = {"PARSE": summary.parse, **summary.deltas.shapley, "residual": summary.residual}
    alone = summary.deltas.single
    values = [e.value for e in (*fair.values(), *alone.values())]
    below, above = max(0.0, -min(values)), max(1e-3, *values)
    span = below + above

    def bar(value: float, kind: str, name: str) -> str:
        start, width = (below + min(value, 0.0)) / span, abs(value) / span
        return f'<i class="{kind}" style="left:{100 * start:.2f}%;width:{100 * width:.2f}%" title="{name}"></i>'

    rows = []
    for name, e in fair.items():
        single = alone.get(name)
        bars = bar(e.value, "", f"Shapley {e.formatted(signed=True)}")
        shown = ""
        if single is not None:
            bars += bar(single.value, "hollow", f"alone {single.formatted(signed=True)}")
            sign = ' class="low"' if single.value < 0 else ""
            shown = f"<span{sign}>{100 * single.value:+.1f}</span>"
        rows.append(
            f'<tr title="{safe(COST_WORDS[name])}"><td><b>{name}</b></td>'
            f'<td style="width:56%"><div class="cost" style="--c:{hex_color(COST_COLORS[name])};'
            f'--z:{100 * below / span:.2f}%">{bars}</div></td>'
            f'<td class="n"><b>{100 * e.value:+.1f}</b></td><td class="n dim">{shown}</td></tr>'
        )
    total = float(sum(e.value for e in summary.loss.values()))
    head = '<tr><th></th><th></th><th class="n">Shapley</th><th class="n">alone</th></tr>'
    first = (
        f'<tr title="set-valued accuracy, every acceptable target counts: {safe(summary.accuracy.formatted())}">'
        '<td colspan="2"><b>as answered</b> '
        f'<span class="dim">accuracy {between(summary.accuracy)}</span></td>'
        f'<td class="n"><b>{percent(summary.accuracy)}</b></td><td></td></tr>'
    )
    last = f'<tr class="sum"><td colspan="2">sum</td><td class="n"><b>{100 * total:.1f}</b></td><td></td></tr>'
    words = residual_words(summary)
    return (
        heading("What each module costs", "points of accuracy")
        + f'<table class="costs">{head}{first}{"".join(rows)}{last}</table>'
        + f'<div class="small dim">{ADDS_UP} {safe(words[:1].upper() + words[1:])}.</div>'
    )


def slices_html(figures: RunFigures, cut: str) -> str:
    """The run cut by one dimension; a row, or a part of its bar, searches for its expressions."""
    found = figures.slices(cut)
    chosen = f'<div class="cuts">{segments("cut", CUTS, cut)}</div>'
    if isinstance(found, str):
        return panel(heading("Slices"), chosen, note(found))
    head = '<tr><th></th><th class="n">n</th><th class="n">right</th><th></th></tr>'
    rows = "".join(_slice(s, found) for s in found.slices)
    return panel(
        heading("Slices", safe(f"by {found.dimension.title}")),
        chosen,
        f'<table class="slices">{head}{rows}</table>',
    )


def _slice(s: Slice, found: Slices) -> str:
    parts = []
    for verdict in VERDICTS:
        count = s.counts.get(verdict, 0)
        if not count:
            continue
        hint = f"{verdict}: {count} of {s.n} ({s.verdicts[verdict].value:.1%})"
        way = "" if s.query is None else searches(f"{s.query} verdict:{verdict}".strip())
        parts.append(
            f'<i style="--c:{hex_color(COLORS[verdict])};width:{100 * count / s.n:.2f}%" {way} title="{hint}"></i>'
        )
    hint = f"{s.name}: set-valued accuracy {s.set_correct.formatted()} over {found.unit}s" + (
        "" if s.query is None else f"; search: {s.query}"
    )
    way = "" if s.query is None else searches(s.query)
    return (
        f'<tr class="{"r" if way else ""}" {way} title="{safe(hint)}"><td class="w">{safe(s.name)}</td>'
        f'<td class="n dim">{s.n}</td><td class="n">{percent(s.set_correct)}</td>'
        f'<td style="width:52%"><div class="stack">{"".join(parts)}</div></td></tr>'
    )


def confusion_html(figures: RunFigures) -> str:
    """Which relation was asked, and in which the answer stands, as a heat map."""
    found = figures.confusion
    if isinstance(found, str):
        return panel(heading("Relations"), note(found))
    shown = [k for k, name in enumerate(found.columns) if name not in OTHERS or found.counts[:, k].any()]
    asked = [k for k in range(len(found.rows)) if found.counts[k].any()]
    heads = "".join(f'<th title="{safe(_said(found.columns[k]))}"><span>{safe(_said(found.columns[k]))}</span></th>'
                    for k in shown)  # fmt: skip
    body = "".join(_line(found, r, shown) for r in asked)
    return panel(
        heading("Relations", "asked ↓ · the answer stands in →"),
        f'<div class="cmx"><table><tr><td></td>{heads}</tr>{body}</table></div>',
        f'<div class="small dim" title="{safe(found.note)}">Expressions, shaded by their share of the row. Green: the '
        "asked relation holds of the answer's two objects.</div>",
    )


def _said(name: str) -> str:
    return str(PHRASE.get(name, name))


def _line(found: Confusion, r: int, shown: list[int]) -> str:
    total = max(1, int(np.sum(found.counts[r])))
    row, cells = found.rows[r], []
    for k in shown:
        count, name = int(found.counts[r, k]), found.columns[k]
        if not count:
            cells.append('<td class="o">·</td>')
            continue
        kind = "g" if name == row else "q" if name in OTHERS and name != NO_ANSWER else "b"
        hint = f"asked {_said(row)}, stands in {_said(name)}: {count} of {total} ({count / total:.1%})"
        query = f"relation:{row} {STANDS_IN}={quote(name)}"
        cells.append(
            f'<td class="c {kind}" style="--a:{0.12 + 0.8 * count / total:.2f}" {searches(query)} '
            f'title="{safe(hint)}">{_short(count)}</td>'
        )
    return f'<tr><th class="a" {searches(f"relation:{row}")}>{safe(_said(row))}</th>{"".join(cells)}</tr>'


def _short(count: int) -> str:
    return str(count) if count < 1000 else f"{count / 1000:.1f}k" if count < 9950 else f"{count / 1000:.0f}k"
