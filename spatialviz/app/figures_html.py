"""Figures of a run: accuracy by module, changes in a second run, slices, confusion of relations."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.story_words import capital
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.comparing import CHANGES
from pipeline.evaluation.confusion import NO_ANSWER, OTHERS, Confusion
from pipeline.evaluation.leakage import title_of
from pipeline.evaluation.plots import LOSS_COLORS
from pipeline.evaluation.run_figures import STANDS_IN, FoundFigures, doubts_of
from pipeline.evaluation.search import FAILURES, narrowed, quote
from pipeline.evaluation.slices import Slice, Slices
from pipeline.evaluation.summary import SHORT, RunSummary, Share, cost_words, residual_words
from pipeline.geometry.palette import VERDICTS as COLORS
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.metrics.intervals import Estimate
from pipeline.system.frozen import dataclass
from spatialviz.app.answer import verdict_chip
from spatialviz.app.evaluate_html import hint
from spatialviz.app.markup import Child, Element, h, heading, note, panel, segments

CUTS = {name: name.replace("_", " ") for name in ("relation", "class", "distance", "size", "occlusion", "same_class")}
"""Dimensions for slicing a run, with titles."""
AXIS = 10
"""Start of the scale, rounded to a multiple, percent."""


@dataclass(frozen=True)
class Sample:
    """Expressions that figures are of: all of a run, or those that a search finds."""

    figures: FoundFigures
    query: str = ""  # Empty for the whole run
    found: int = 0  # How many the search finds

    @property
    def said(self) -> str:
        """How many expressions, in words."""
        count = self.figures.count
        return f"the {count:,} found" if self.query else f"all {count:,}"

    def finds(self, query: str) -> dict[str, str]:
        """Attributes of an element listing a search's results among these on click."""
        return {"do": f"find:{narrowed(self.query, query) if self.query else query}"}


def summary_html(of: Sample) -> Element:
    """Losses of accuracy, and the verdicts with confidence intervals; of the whole run, or of what is found."""
    summary, run = of.figures.summary, of.figures.run
    total = run.on_file.num_rows
    choice: Child = h.span(counted(total, "expression"))
    if 0 < of.found < total:
        choices = {"all": f"all {total:,}", "found": f"{of.found:,} found"}
        choice = segments("figures-of", choices, "found" if of.query else "all", "Figures of")
    name = h.div(h.h2(h.b(run.name), title=run.folder.name), choice, cls="runhead")
    limits = None
    if run.shares:
        # In a line; in full as a tooltip.
        title, full = title_of(run.shares), "\n".join(share.sentence for share in run.shares)
        limits = note(capital(title)) if title else h.div(run.shares[0].sentence, cls="small dim oneline")
        limits = limits.with_(title=full)
    told = note(summary) if isinstance(summary, str) else (_waterfall(of, summary), _verdicts(of, summary))
    return panel(name, limits, map(note, doubts_of(run)), told)


def percent(e: Estimate) -> str:
    """Estimate in percent with a decimal digit."""
    return f"{100 * e.value:.1f}" if math.isfinite(e.value) else "–"


def between(e: Estimate) -> str:
    """Confidence interval in percent."""
    # Whole percents are too coarse for a share of a few.
    digits = 1 if e.value < 0.02 else 0
    return f"[{100 * e.low:.{digits}f}, {100 * e.high:.{digits}f}]" if math.isfinite(e.low + e.high) else ""


def _waterfall(of: Sample, summary: RunSummary) -> tuple[Child, ...]:
    """Bars from the accuracy as measured, module by module, to 100, each starting at the end of the previous."""
    lead = h.p(cost_words(summary), cls="lead", title=f"{hint('accuracy')} {residual_words(summary)}.")
    if summary.deltas is None:
        return heading("Where the accuracy goes"), lead
    shares = {name: e for name, e in summary.loss.items() if name != "accuracy"}
    alone = {name: e for name, e in {"PARSE": summary.parse, **summary.deltas.single}.items() if name in shares}
    base = summary.accuracy.value
    low = math.floor(max(0.0, base + min(0.0, *(e.value for e in alone.values())) - 0.02) * 100 / AXIS) * AXIS / 100
    span = 1 - low

    def bar(start: float, stop: float, cls: str) -> Element:
        a, b = sorted(((start - low) / span, (stop - low) / span))
        return h.i(css={"left": f"{a:.2%}", "width": f"{max(b - a, 0.004):.2%}"}, cls=cls)

    track = h.span(bar(low, base, "base"), cls="track")
    said = f"{hint('accuracy')}\n{between(summary.accuracy)}: {hint('interval')}"
    rows = [_fall(h.div, "as it is", between(summary.accuracy), percent(summary.accuracy), track, title=said)]
    at, causes = base, ",".join(dict.fromkeys(verdict for verdict, _ in summary.residual_causes))
    queries = {
        "PARSE": "verdict:PARSE",
        "RECALL": f"{FAILURES} verdict:OPM-TARGET,OPM-REF",
        "residual": f"verdict:{causes or 'LABEL'}",
        "unknown": f"{FAILURES} -untold:none" if "untold" in of.figures.columns else FAILURES,
    }
    for name, e in shares.items():
        said = f"{_named(name)}: {hint(_named(name) if name == 'unknown' else name)}"
        said += f"\nFair share {e.formatted(signed=True)} points."
        reached, mark = h.span(), None
        if name in alone:
            value = base + alone[name].value
            reached = h.span(f"{100 * value:.1f}", cls="n dim")
            mark = h.u(css={"left": f"{(value - low) / span:.2%}"})
            said += f" With it alone {reached.text} in place of {100 * base:.1f}."
        track = h.span(bar(at, at + e.value, "less" * (e.value < 0)), mark, cls="track", color=LOSS_COLORS[name])
        found = of.finds(queries.get(name, f"{FAILURES} mends:{name}"))
        points = f"{100 * e.value:+.1f}".replace("-", "−")
        rows.append(_fall(h.button, _named(name), SHORT[name], points, reached, track, title=said, **found))
        at += e.value
    for name, why in summary.untold.items():
        why = f"{_named(name)}: what it costs cannot be worked out: {why}"
        rows.append(_fall(h.div, _named(name), SHORT[name], "–", title=why))
    ends = (h.span(f"{100 * (low + part * span):.0f}") for part in (0, 0.5, 1))
    axis = h.div(
        h.span(),
        h.span("share", cls="n", title=hint("Shapley")),
        h.span("alone", cls="n", title=hint("alone")),
        h.span(ends, cls="track"),
        cls="fall axis",
    )
    explained = "Each bar is a module's fair share of what is lost; all add up to 100. "
    alone_said = " the accuracy with this module alone replaced by the truth."
    return (
        heading("Where the accuracy goes", f"% of {of.said}"),
        lead,
        h.div(axis, rows, cls="falls"),
        h.p(explained, h.u(cls="key"), alone_said, cls="small dim"),
    )


def _fall(make: Callable[..., Element], name: str, words: str, value: str, *more: Child, **look: object) -> Element:
    """Row of the losses."""
    return make(h.span(h.b(name), " ", words, cls="module"), h.b(value, cls="n"), more, cls="fall", **look)


def _named(name: str) -> str:
    """Name of a bar: the verdicts as listed."""
    return "not worked out" if name == "unknown" else shown_oracle(name)


def _verdicts(of: Sample, summary: RunSummary) -> tuple[Child, ...]:
    shown = ((verdict, share) for verdict, share in summary.verdicts.items() if share.count)
    unit = h.span(f"% of {of.said} · 95 % over {summary.unit}s", title=hint("interval"))
    return heading("Verdicts", unit), (_verdict(of, summary, *one) for one in shown)


def _verdict(of: Sample, summary: RunSummary, verdict: str, share: Share) -> Element:
    e = share.estimate
    spread = {"left": f"{e.low:.2%}", "width": f"{e.high - e.low:.2%}"}
    whisker = h.u(css=spread) if math.isfinite(e.low + e.high) else None
    details = ", ".join(
        f"{d.lower().replace('_', ' ')} {s.count}" for (v, d), s in summary.details.items() if v == verdict
    )
    if verdict == "CORRECT" and summary.lucky.count:
        details = f"lucky {summary.lucky.count}: {hint('lucky')}"
    said = f"{hint(verdict)}\n{e.formatted()} %, 95 % interval over {summary.unit}s"
    return h.button(
        verdict_chip(verdict),
        h.span(h.i(css={"width": f"{e.value:.2%}"}), whisker, cls="t", color=COLORS[verdict]),
        h.span(share.count, cls="n dim"),
        h.span(h.b(percent(e)), cls="n"),
        h.span(between(e), cls="n dim"),
        cls="vrow",
        title="\n".join(filter(None, (said, details))),
        **of.finds(f"verdict:{verdict}"),
    )


# ---- a second run


def comparison_html(of: Sample) -> Element | None:
    """Failures fixed and introduced by the second run; each number lists its expressions."""
    found, names = of.figures.comparison, of.figures.names
    if found is None or names is None:
        return None
    both = f"first {names[0]} → second {names[1]}"
    title = heading("Second run", h.span(both, title=both))
    if isinstance(found, str):
        return panel(title, note(found))
    boxes = (
        h.button(
            h.b(f"{found.changes[name]:,}"),
            h.span(CHANGES[name]),
            cls=f"change {name}",
            title=hint(CHANGES[name]),
            **of.finds(f"change:{name}"),
        )
        for name in ("fixed", "broken", "verdict", "other_reason")
    )
    gained, test = found.differences[found.measure], found.tests[found.measure]
    only = {"first": found.only_before, "second": found.only_after}
    few = ", ".join(f"{counted(n, 'expression')} only in the {which}" for which, n in only.items() if n)
    said = h.p(
        "Accuracy ",
        h.b(f"{gained.formatted(signed=True)} points"),
        f" on {counted(found.shared, 'shared expression')}; ",
        h.span(_by_chance(test.p_value), title=f"p = {test.p_value:.2g}. {hint('chance')}"),
        f". {few}." if few else ".",
    )
    return panel(title, said, h.div(boxes, cls="changes"))


def _by_chance(p: float) -> str:
    if p < 0.01:
        return f"so uneven by chance less than once in 100 (p {p:.1g})"
    return f"{'hardly chance' if p < 0.05 else 'may well be chance'} (p {p:.2f})"


# ---- slices and confusion


def slices_html(of: Sample, cut: str) -> Element:
    """Run by a dimension; a row, or a part of its bar, searches for its expressions."""
    found = of.figures.slices(cut)
    chosen = h.div(segments("cut", CUTS, cut, "Cut the run by"), cls="cuts")
    if isinstance(found, str):
        return panel(heading("Slices"), chosen, note(found))
    head = h.tr(h.td(), h.th("n", cls="n"), h.th("correct", cls="n", title=hint("accuracy")), h.td())
    table = h.table(head, (_slice(of, s, found) for s in found.slices), cls="slices")
    return panel(heading("Slices", f"by {found.dimension.title}"), chosen, table)


def _slice(of: Sample, s: Slice, found: Slices) -> Element:
    parts = (_part(of, s, verdict) for verdict in VERDICTS if s.counts.get(verdict))
    told = f"{s.name}: accuracy {s.set_correct.formatted()} over {found.unit}s"
    name: Child = s.name
    if s.query is not None:
        name = h.button(s.name, cls="plain", title=f"{told}; search: {s.query}", **of.finds(s.query))
    return h.tr(
        h.th(name, cls="w", scope="row"),
        h.td(s.n, cls="n dim"),
        h.td(percent(s.set_correct), cls="n", title=told),
        h.td(h.div(parts, cls="stack"), cls="bars"),
    )


def _part(of: Sample, s: Slice, verdict: str) -> Element:
    """Part of a slice's bar."""
    count = s.counts[verdict]
    told = f"{verdict}: {count} of {s.n} ({s.verdicts[verdict].value:.1%})"
    way = {} if s.query is None else of.finds(f"{s.query} verdict:{verdict}")
    look = {"color": COLORS[verdict], "css": {"width": f"{count / s.n:.2%}"}}
    return h.i(title=told, **look, **way, tabindex="-1", aria_hidden="true")


def confusion_html(of: Sample) -> Element:
    """Confusion of asked and answered relations, as a heat map."""
    found = of.figures.confusion
    if isinstance(found, str):
        return panel(heading("Relations"), note(found))
    shown = [k for k, name in enumerate(found.columns) if name not in OTHERS or found.counts[:, k].any()]
    heads = (h.th(h.span(_phrase(found.columns[k])), scope="col", title=_phrase(found.columns[k])) for k in shown)
    body = (_line(of, found, r, shown) for r in range(len(found.rows)) if found.counts[r].any())
    key = "Expressions, shaded by their share of the row. Green: the asked relation holds of the answer's two objects."
    return panel(
        heading("Relations", "asked ↓ · the answer stands in →"),
        h.div(h.table(h.tr(h.td(), heads), body), cls="cmx"),
        h.div(key, cls="small dim", title=found.note),
    )


def _phrase(name: str) -> str:
    return str(PHRASE.get(name, name))


def _line(of: Sample, found: Confusion, r: int, shown: list[int]) -> Element:
    row, total = found.rows[r], max(1, int(np.sum(found.counts[r])))
    cells = (_cell(of, row, found.columns[k], int(found.counts[r, k]), total) for k in shown)
    ask = h.button(_phrase(row), cls="plain", **of.finds(f"relation:{row}"))
    return h.tr(h.th(ask, cls="a", scope="row"), cells)


def _cell(of: Sample, asked: str, stands: str, count: int, total: int) -> Element:
    if not count:
        return h.td("·", cls="o")
    kind = "g" if stands == asked else "q" if stands in OTHERS and stands != NO_ANSWER else "b"
    told = f"asked {_phrase(asked)}, stands in {_phrase(stands)}: {count} of {total} ({count / total:.1%})"
    press = h.button(_few(count), title=told, **of.finds(f"relation:{asked} {STANDS_IN}={quote(stands)}"))
    return h.td(press, cls=f"c {kind}", css={"--a": f"{0.12 + 0.8 * count / total:.2f}"})


def _few(count: int) -> str:
    return str(count) if count < 1000 else f"{count / 1000:.1f}k" if count < 9950 else f"{count / 1000:.0f}k"
