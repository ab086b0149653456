"""A run: verdicts, costs, slices, the confusion of relations, and the list of expressions with its search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

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
from spatialviz.app.answer import MEANING, ORACLE_WORDS, verdict_chip
from spatialviz.app.markup import BAD, Child, Element, h, heading, note, panel, segments
from spatialviz.app.run_browser import PAGE, STANDS_IN, Listing, RunFigures

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


def summary_html(figures: RunFigures) -> Element:
    """Verdicts with their intervals, and what each module costs."""
    summary = figures.summary
    if isinstance(summary, str):
        return panel(shares_html(figures.run.shares), note(summary))
    count = h.span(f"{summary.expressions} expressions", cls="dim")
    head = h.div(h.b(figures.run.name), count, cls="runhead")
    return panel(head, shares_html(figures.run.shares), _verdicts(summary), _costs(summary))


def shares_html(shares: Sequence[Share]) -> Element | None:
    """What the figures below can show and cannot, in a line; in full where the mouse rests."""
    if not shares:
        return None
    hint = "\n".join(share.sentence for share in shares)
    title = title_of(shares)
    if title:
        return note(title[:1].upper() + title[1:]).with_(title=hint)
    return h.div(shares[0].sentence, cls="small dim oneline", title=hint)


def percent(e: Estimate) -> str:
    """An estimate in percent with one digit."""
    return f"{100 * e.value:.1f}" if math.isfinite(e.value) else "–"


def between(e: Estimate) -> str:
    """Its interval in percent."""
    # Whole percents say nothing of a share of a few.
    digits = 1 if e.value < 0.02 else 0
    return f"[{100 * e.low:.{digits}f}, {100 * e.high:.{digits}f}]" if math.isfinite(e.low + e.high) else ""


def _along(start: float, width: float) -> dict[str, str]:
    """Styles of a mark on a scale from 0 to 1."""
    return {"left": f"{start:.2%}", "width": f"{width:.2%}"}


def _verdicts(summary: RunSummary) -> tuple[Child, ...]:
    rows = []
    for verdict, share in summary.verdicts.items():
        if not share.count:
            continue
        e = share.estimate
        whisker = h.u(css=_along(e.low, e.high - e.low)) if math.isfinite(e.low + e.high) else None
        hint = f"{MEANING[verdict]}; {e.formatted()} %, 95 % interval over {summary.unit}s"
        details = ", ".join(
            f"{d.lower().replace('_', ' ')} {s.count}" for (v, d), s in summary.details.items() if v == verdict
        )
        if verdict == "CORRECT" and summary.lucky.count:
            details = f"lucky {summary.lucky.count}"
        hint += f"; {details}" if details else ""
        bar = h.span(
            h.i(css={"width": f"{e.value:.2%}"}), whisker, cls="t", css={"--c": hex_color(COLORS[verdict])}
        )  # fmt: skip
        rows.append(
            h.div(
                verdict_chip(verdict), bar, h.span(share.count, cls="n dim"), h.span(h.b(percent(e)), cls="n"),
                h.span(between(e), cls="n dim"), cls="vrow", title=hint, **searches(f"verdict:{verdict}"),
            )
        )  # fmt: skip
    return heading("Verdicts", f"% of expressions · 95 % over {summary.unit}s"), rows


def _costs(summary: RunSummary) -> tuple[Element, ...]:
    """Shapley values beside single deltas, on one scale with zero in the same place."""
    fair = {"PARSE": summary.parse, **summary.deltas.shapley, "residual": summary.residual}
    alone = summary.deltas.single
    values = [e.value for e in (*fair.values(), *alone.values())]
    below, above = max(0.0, -min(values)), max(1e-3, *values)
    span = below + above

    def bar(e: Estimate, kind: str, name: str) -> Element:
        at = _along((below + min(e.value, 0.0)) / span, abs(e.value) / span)
        return h.i(cls=kind, css=at, title=f"{name} {e.formatted(signed=True)}")

    rows = []
    for name, e in fair.items():
        single = alone.get(name)
        bars, shown = [bar(e, "", "Shapley")], None
        if single is not None:
            bars.append(bar(single, "hollow", "alone"))
            shown = h.span(f"{100 * single.value:+.1f}", cls="low" if single.value < 0 else "")
        scale = {"--c": hex_color(COST_COLORS[name]), "--z": f"{below / span:.2%}"}
        rows.append(
            h.tr(
                h.td(h.b(name)), h.td(h.div(bars, cls="cost", css=scale), cls="bars"),
                h.td(h.b(f"{100 * e.value:+.1f}"), cls="n"), h.td(shown, cls="n dim"), title=COST_WORDS[name],
            )
        )  # fmt: skip
    total = float(sum(e.value for e in summary.loss.values()))
    accuracy, words = summary.accuracy, residual_words(summary)
    head = h.tr(h.td(), h.td(), h.th("Shapley", cls="n"), h.th("alone", cls="n"))
    first = h.tr(
        h.td(h.b("as answered"), " ", h.span(f"accuracy {between(accuracy)}", cls="dim"), colspan=2),
        h.td(h.b(percent(accuracy)), cls="n"),
        h.td(),
        title=f"set-valued accuracy, every acceptable target counts: {accuracy.formatted()}",
    )
    last = h.tr(h.td("sum", colspan=2), h.td(h.b(f"{100 * total:.1f}"), cls="n"), h.td(), cls="sum")
    return (
        heading("What each module costs", "points of accuracy"),
        h.table(head, first, rows, last, cls="costs"),
        h.div(f"{ADDS_UP} {words[:1].upper() + words[1:]}.", cls="small dim"),
    )


def slices_html(figures: RunFigures, cut: str) -> Element:
    """The run cut by one dimension; a row, or a part of its bar, searches for its expressions."""
    found = figures.slices(cut)
    chosen = h.div(segments("cut", CUTS, cut, "Cut the run by"), cls="cuts")
    if isinstance(found, str):
        return panel(heading("Slices"), chosen, note(found))
    head = h.tr(h.td(), h.th("n", cls="n"), h.th("right", cls="n"), h.td())
    table = h.table(head, (_slice(s, found) for s in found.slices), cls="slices")
    return panel(heading("Slices", f"by {found.dimension.title}"), chosen, table)


def _slice(s: Slice, found: Slices) -> Element:
    parts = []
    for verdict in filter(s.counts.get, VERDICTS):
        count = s.counts[verdict]
        hint = f"{verdict}: {count} of {s.n} ({s.verdicts[verdict].value:.1%})"
        way = {} if s.query is None else searches(f"{s.query} verdict:{verdict}".strip())
        parts.append(h.i(css={"--c": hex_color(COLORS[verdict]), "width": f"{count / s.n:.2%}"}, title=hint, **way))
    hint = f"{s.name}: set-valued accuracy {s.set_correct.formatted()} over {found.unit}s"
    cells = h.td(s.n, cls="n dim"), h.td(percent(s.set_correct), cls="n"), h.td(h.div(parts, cls="stack"), cls="bars")
    if s.query is None:
        return h.tr(h.td(s.name, cls="w"), cells, title=hint)
    return h.tr(h.td(s.name, cls="w"), cells, cls="r", title=f"{hint}; search: {s.query}", **searches(s.query))


def confusion_html(figures: RunFigures) -> Element:
    """Which relation was asked, and in which the answer stands, as a heat map."""
    found = figures.confusion
    if isinstance(found, str):
        return panel(heading("Relations"), note(found))
    shown = [k for k, name in enumerate(found.columns) if name not in OTHERS or found.counts[:, k].any()]
    heads = (h.th(h.span(_said(found.columns[k])), title=_said(found.columns[k])) for k in shown)
    body = (_line(found, r, shown) for r in range(len(found.rows)) if found.counts[r].any())
    return panel(
        heading("Relations", "asked ↓ · the answer stands in →"),
        h.div(h.table(h.tr(h.td(), heads), body), cls="cmx"),
        h.div(
            "Expressions, shaded by their share of the row. Green: the asked relation holds of the answer's two "
            "objects.",
            cls="small dim",
            title=found.note,
        ),
    )


def _said(name: str) -> str:
    return str(PHRASE.get(name, name))


def _line(found: Confusion, r: int, shown: list[int]) -> Element:
    total = max(1, int(np.sum(found.counts[r])))
    row, cells = found.rows[r], []
    for k in shown:
        count, name = int(found.counts[r, k]), found.columns[k]
        if not count:
            cells.append(h.td("·", cls="o"))
            continue
        kind = "g" if name == row else "q" if name in OTHERS and name != NO_ANSWER else "b"
        hint = f"asked {_said(row)}, stands in {_said(name)}: {count} of {total} ({count / total:.1%})"
        shade = {"--a": f"{0.12 + 0.8 * count / total:.2f}"}
        way = searches(f"relation:{row} {STANDS_IN}={quote(name)}")
        cells.append(h.td(_short(count), cls=f"c {kind}", css=shade, title=hint, **way))
    return h.tr(h.th(_said(row), cls="a", **searches(f"relation:{row}")), cells)


def _short(count: int) -> str:
    return str(count) if count < 1000 else f"{count / 1000:.1f}k" if count < 9950 else f"{count / 1000:.0f}k"


MARGIN = "S of the best acceptable pair less S of the best other one"
SORTED = {
    "margin": f"sort by how far the right pair is behind ({MARGIN})",
    "verdict": "sort by verdict",
}
SYNTAX = 'verdict:SRM  class:"trash can",bin  margin<0.1  -lucky  sort:margin'
SYNTAX_HINT = (
    "All terms must hold; a comma means or, a minus not. field:value, field:none, * for anything; numbers take < <= > "
    ">= = !=; yes-or-no fields stand alone; free words and quoted phrases must stand in the expression; sort:FIELD or "
    "sort:-FIELD. Tab takes what is offered, Enter searches."
)


def searches(query: str) -> dict[str, str]:
    """Attributes by which a click lists what a search finds."""
    return {"do": f"find:{query}"}


def search_html(query: str) -> Element:
    """The search field."""
    field = h.input(
        cls="find runs", field="find", value=query, title=SYNTAX_HINT, spellcheck="false", autocomplete="off",
        placeholder="search", aria_label="Search the expressions of the run",
    )  # fmt: skip
    return panel(field, cls="search")


def offers_html(offered: Sequence[str]) -> Element:
    """Words that the last one of the search may become, and below how a search is written."""
    words = (
        h.button(word, role="option", aria_selected=str(not k).lower(), tabindex="-1", local=f"take:{word}")
        for k, word in enumerate(offered)
    )
    return panel(
        h.div(words, cls="cmp", role="listbox", aria_label="Words to go on with") if offered else None,
        h.div(SYNTAX, cls="syntax dim", title=SYNTAX_HINT),
        cls="offered",
    )


def no_run_html() -> Element:
    """What stands there without a run."""
    view = h.code("spatialviz view --run RUN")
    hint = ("No run is open. ", h.code("spatialviz eval"), " writes one; open it with ", view, ".")
    return panel(h.div(hint, cls="dim hint"))


def listing_html(listing: Listing | None, thumbs: Mapping[str, str]) -> Element:
    """Verdicts of the run as a bar and chips, then the expressions that match the search."""
    if listing is None:
        return no_run_html()
    error = note(listing.error, BAD) if listing.error else None
    return panel(_verdict_chips(listing), error, _head(listing), _rows(listing, thumbs))


def _verdict_chips(listing: Listing) -> tuple[Element, Element]:
    asked = {word[8:] for word in listing.query.split() if word.startswith("verdict:")}
    bars, chips = [], []
    for verdict, count in listing.counts.items():
        color, share, on = hex_color(COLORS[verdict]), count / listing.total, verdict in asked
        # The same chip again shows all failures.
        search = "find:" if on else f"find:verdict:{verdict}"
        hint = f"{verdict}: {count} of {listing.total} ({share:.1%}): {MEANING[verdict]}"
        bars.append(h.i(css={"--c": color, "width": f"{share:.2%}"}, do=search, tabindex="-1", title=hint))
        chips.append(
            h.button(
                f"{verdict} ", h.b(count), cls="vc", css={"--c": color}, do=search, title=hint,
                aria_pressed=str(on).lower(),
            )
        )  # fmt: skip
    return h.div(bars, cls="stack tall"), h.div(chips, cls="vcs")


def _head(listing: Listing) -> Element:
    place = "" if listing.place is None else f"{listing.place + 1} of "
    first = listing.page * PAGE + 1 if listing.keys else 0
    last = min(first + PAGE - 1, len(listing.keys))
    turned = (("‹", listing.page - 1, "Page before"), ("›", listing.page + 1, "Next page"))
    back, forth = (h.button(t, cls="try", do=f"find-page:{to}", aria_label=name) for t, to, name in turned)
    pages = None if listing.pages == 1 else ("\u00a0", back, f" {first}–{last} ", forth)
    return heading(h.b(f"{place}{len(listing.keys)} found"), _orders(listing.query), pages)


def _orders(query: str) -> list[Element | str]:
    """What the list may be sorted by; the same again turns the order round, and once more leaves it."""
    words = query.split()
    plain = [word for word in words if not word.startswith("sort:")]
    now = next((word for word in words if word.startswith("sort:")), "")
    chips: list[Element | str] = []
    for name, hint in SORTED.items():
        then = {f"sort:{name}": f"sort:-{name}", f"sort:-{name}": ""}.get(now, f"sort:{name}")
        mark = {f"sort:{name}": " ↑", f"sort:-{name}": " ↓"}.get(now, "")
        search = f"find:{' '.join([*plain, then]).strip()}"
        on = str(bool(mark)).lower()
        chips += [h.button(f"{name}{mark}", cls="try", title=hint, do=search, aria_pressed=on), " "]
    return chips


def _rows(listing: Listing, thumbs: Mapping[str, str]) -> Element:
    rows = []
    for place, row in enumerate(listing.rows, start=listing.page * PAGE):
        picture = thumbs.get(row["frame"])
        image = h.img(src=picture, alt="", cls="thumb wide") if picture else h.span(cls="thumb wide")
        margin = "" if row["margin"] is None else f"{row['margin']:+.2f}"
        luck = " · luck" if row["lucky"] else ""
        chip = verdict_chip(row["verdict"], row["detail"])
        rows.append(
            h.tr(
                h.td(image, cls="shot"),
                h.td(h.b(row["text"]), h.div(row["frame"], luck, cls="dim small"), cls="w all"),
                h.td(chip, h.div(margin, cls="dim small", title=MARGIN), cls="n"),
                id=f"failure-{place}", cls="r", do=f"failure:{place}", title=row["said"],
                aria_current="true" if (row["frame"], row["id"]) == listing.at else None,
            )
        )  # fmt: skip
    return h.table(rows or h.tr(h.td("Nothing matches.", cls="dim")), cls="found")
