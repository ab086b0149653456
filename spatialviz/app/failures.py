"""The bottom dock's list of a run's expressions, by verdict, and the search in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.geometry.palette import VERDICTS as COLORS
from pipeline.geometry.palette import hex_color
from spatialviz.app.markup import Element, h
from spatialviz.app.run_browser import PAGE, Listing
from spatialviz.app.text import BAD, heading, note, panel

MEANING = {
    "CORRECT": "the answer is the labelled target",
    "PARSE": "the expression was read as something else",
    "LABEL": "the answer is right, too, or the label is wrong, as a person or its own relations say",
    "OPM-TARGET": "no candidate is a right target",
    "OPM-REF": "no candidate pair is a right one",
    "LIFT": "a 3D box is off",
    "ATTRIBUTE": "a colour, size or shape is judged wrongly",
    "SRM": "the relation network is wrong",
    "OPM-CONF": "a false detection outscored the right one",
    "PRM": "confidences overruled the relation",
    "COMPOUND": "several modules together",
}
"""What each verdict says, in a few words."""
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


def verdict_chip(verdict: str, detail: str | None = None) -> Element:
    """A verdict in its colour, with its detail."""
    more = (" ", h.i(detail.lower().replace("_", " "))) if detail else None
    return h.span(verdict, more, cls="vd", css={"--c": hex_color(COLORS[verdict])}, title=MEANING[verdict])


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
    return panel(_verdicts(listing), error, _head(listing), _rows(listing, thumbs))


def _verdicts(listing: Listing) -> tuple[Element, Element]:
    asked = {word[8:] for word in listing.query.split() if word.startswith("verdict:")}
    bars, chips = [], []
    for verdict in VERDICTS:
        count = listing.counts.get(verdict, 0)
        if not count:
            continue
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
