"""The bottom dock's list of a run's expressions, by verdict, and the search in it."""

from __future__ import annotations

import json
from collections.abc import Sequence

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.geometry.palette import VERDICTS as COLORS
from pipeline.geometry.palette import hex_color
from spatialviz.app.run_browser import PAGE, Listing
from spatialviz.app.text import BAD, note, panel, safe

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


SORTED = {
    "margin": "sort by how far the right pair is behind (S of the best acceptable pair less S of the best other one)",
    "verdict": "sort by verdict",
}


def verdict_chip(verdict: str, detail: str | None = None) -> str:
    """A verdict in its colour, with its detail."""
    color = hex_color(COLORS[verdict])
    more = f" <i>{safe(detail.lower().replace('_', ' '))}</i>" if detail else ""
    return f'<span class="vd" style="--c:{color}" title="{safe(MEANING[verdict])}">{safe(verdict)}{more}</span>'


SYNTAX = 'verdict:SRM  class:"trash can",bin  margin<0.1  -lucky  sort:margin'
SYNTAX_HINT = (
    "All terms must hold; a comma means or, a minus not. field:value, field:none, * for anything; numbers take < <= > "
    ">= = !=; yes-or-no fields stand alone; free words and quoted phrases must stand in the expression; sort:FIELD or "
    "sort:-FIELD. Tab takes what is offered, Enter searches."
)


def sends(message: str) -> str:
    """JavaScript that sends a message, as it stands in an attribute."""
    return safe(f"sv({json.dumps(message)})")


def searches(query: str) -> str:
    """An attribute by which a click lists what a search finds."""
    return f"onclick=\"event.stopPropagation();svTab('Failures');{sends(f'find:{query}')}\""


def search_html(query: str) -> str:
    """The search field. It is drawn once, so that nothing is lost while one types."""
    return panel(
        f'<input class="find runs" value="{safe(query)}" title="{safe(SYNTAX_HINT)}" spellcheck="false" '
        'autocomplete="off" '
        'placeholder="search" '
        'oninput="svTyped(this)" onkeydown="svKey(event,this)">',
        style="padding:.5em .8em 0",
    )


def offers_html(offered: Sequence[str], query: str | None = None) -> str:
    """Words that the last one of the search may become, and below how a search is written.

    With `query` the field takes this text.
    """
    words = "".join(
        f'<span class="{"" if k else "on"}" data-w="{safe(word)}" '
        f'onmousedown="event.preventDefault();svTake(this.dataset.w)">{safe(word)}</span>'
        for k, word in enumerate(offered)
    )
    put = (
        "" if query is None else (f'<img src="" style="display:none" onerror="{safe(f"svFind({json.dumps(query)})")}">')
    )
    return panel(
        f'<div class="cmp">{words}</div>' if words else "",
        f'<div class="syntax dim" title="{safe(SYNTAX_HINT)}">{safe(SYNTAX)}</div>{put}',
        style="padding-bottom:.2em",
    )


def no_run_html() -> str:
    """What stands there without a run."""
    return panel(
        '<div class="dim" style="padding:.7em 0">No run is open. <code>spatialviz eval</code> writes one; open it '
        "with <code>spatialviz view --run RUN</code>.</div>"
    )


def listing_html(listing: Listing | None, thumbs: dict[str, str]) -> str:
    """Verdicts of the run as a bar and chips, then the expressions that match the search."""
    if listing is None:
        return no_run_html()
    error = note(listing.error, BAD) if listing.error else ""
    return panel(_verdicts(listing), error, _head(listing), _rows(listing, thumbs))


def _verdicts(listing: Listing) -> str:
    asked = {word[8:] for word in listing.query.split() if word.startswith("verdict:")}
    bars, chips = [], []
    for verdict in VERDICTS:
        count = listing.counts.get(verdict, 0)
        if not count:
            continue
        color, share = hex_color(COLORS[verdict]), count / listing.total
        # The same chip again shows all failures.
        search = "" if verdict in asked else f"verdict:{verdict}"
        click = f"sv('find:{search}')"
        hint = f"{verdict}: {count} of {listing.total} ({share:.1%}): {MEANING[verdict]}"
        bars.append(f'<i style="--c:{color};width:{100 * share:.2f}%" onclick="{click}" title="{safe(hint)}"></i>')
        chips.append(
            f'<span class="vc{" on" if verdict in asked else ""}" style="--c:{color}" onclick="{click}" '
            f'title="{safe(hint)}">{verdict} <b>{count}</b></span>'
        )
    bar = f'<div class="stack" style="height:12px;cursor:pointer">{"".join(bars)}</div>'
    return f'{bar}<div class="vcs">{"".join(chips)}</div>'


def _head(listing: Listing) -> str:
    place = "" if listing.place is None else f"{listing.place + 1} of "
    first = listing.page * PAGE + 1 if listing.keys else 0
    last = min(first + PAGE - 1, len(listing.keys))
    pages = (
        ""
        if listing.pages == 1
        else (
            f'<span class="try" onclick="sv(\'find-page:{listing.page - 1}\')">‹</span> {first}–{last} '
            f'<span class="try" onclick="sv(\'find-page:{listing.page + 1}\')">›</span>'
        )
    )
    return (
        f'<div class="h" style="text-transform:none;letter-spacing:0"><b>{place}{len(listing.keys)} found</b>'
        f"<span>{_orders(listing.query)} &nbsp;{pages}</span></div>"
    )


def _orders(query: str) -> str:
    """What the list may be sorted by; the same again turns the order round, and once more leaves it."""
    words = query.split()
    plain = [word for word in words if not word.startswith("sort:")]
    now = next((word for word in words if word.startswith("sort:")), "")
    chips = []
    for name, hint in SORTED.items():
        then = {f"sort:{name}": f"sort:-{name}", f"sort:-{name}": ""}.get(now, f"sort:{name}")
        mark = {f"sort:{name}": " ↑", f"sort:-{name}": " ↓"}.get(now, "")
        click = safe(f"sv({json.dumps('find:' + ' '.join([*plain, then]).strip())})")
        on = " on" if mark else ""
        chips.append(f'<span class="try{on}" title="{safe(hint)}" onclick="{click}">{name}{mark}</span>')
    return " ".join(chips)


def _rows(listing: Listing, thumbs: dict[str, str]) -> str:
    rows = []
    for k, row in enumerate(listing.rows):
        place = listing.page * PAGE + k
        here = (row["frame"], row["id"]) == listing.at
        picture = thumbs.get(row["frame"], "")
        image = f'<img class="thumb wide" src="{picture}">' if picture else '<span class="thumb wide"></span>'
        margin = "" if row["margin"] is None else f"{row['margin']:+.2f}"
        luck = " · luck" if row["lucky"] else ""
        rows.append(
            f'<tr class="r{" sel" if here else ""}" onclick="sv(\'failure:{place}\')" title="{safe(row["said"])}">'
            f'<td style="width:52px">{image}</td>'
            f'<td class="w" style="width:100%"><b>{safe(row["text"])}</b><div class="dim" style="font-size:11px">'
            f"{safe(row['frame'])}{luck}</div></td>"
            f'<td class="n">{verdict_chip(row["verdict"], row["detail"])}<div class="dim" style="font-size:11px" '
            f'title="S of the best acceptable pair less S of the best other one">{margin}</div></td></tr>'
        )
    if not rows:
        rows = ['<tr><td class="dim">Nothing matches.</td></tr>']
    return f'<table class="found">{"".join(rows)}</table>'
