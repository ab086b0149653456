"""Evaluate: facets at the left, search with filters, and the rows of the list in the middle."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.diagnosis.story_words import Tone
from pipeline.evaluation.browsing import Facet, FacetValue
from pipeline.evaluation.comparing import CHANGES
from pipeline.evaluation.run_figures import Listing
from pipeline.evaluation.run_notes import MARKS, Notes
from pipeline.geometry.palette import VERDICTS as COLORS
from pipeline.language.glossary import glossary
from spatialviz.app.answer import verdict_chip
from spatialviz.app.frames import STROKES
from spatialviz.app.markup import Child, Element, button, h, note, panel, segments, sign, textbox, toggle

SHOWN_VALUES, FEW_VALUES = 7, 11
"""Values of a folded facet; up to so many are never folded."""
EXPLAINED = ("change", "verdict", "second_verdict", "mends")
"""Facets with glossary words as values."""
TITLES = {"mends": "mended by one module alone"}
SYNTAX = 'verdict:SRM  class:"trash can",bin  margin<0.1  -lucky  sort:margin'
SYNTAX_HINT = (
    "All terms must hold; a comma means or, a minus not. field:value, field:none, * for anything; numbers take < <= > "
    ">= = !=; yes-or-no fields stand alone; free words and quoted phrases must stand in the expression; sort:FIELD or "
    "sort:-FIELD. Tab takes what is offered, Enter searches."
)


def hint(word: str) -> str:
    """Glossary entry of a word."""
    return glossary()[word].hint


def no_run_html(dataset: Path, annotated: bool, labels: Path | None) -> Element:
    """What Evaluate needs, and the commands that make it; `labels` are those that are open."""
    name, given = shlex.quote(str(dataset)), "LABELS" if labels is None else shlex.quote(str(labels))
    # Another, stronger detector: one that is judged by labels of its own making is right by construction.
    truth = "" if annotated else "--detector yolo-seg --model LARGE.onnx "
    made = (
        None if labels is not None else f"spatialviz label {name} {truth}--out LABELS",
        f"spatialviz eval {name} --labels {given} --detector yolo-seg --model FILE.onnx --out RUN",
        "spatialviz view --run RUN",
    )
    said = "Evaluate shows the answers of a run, and none is open. Labels and a detector make one:"
    return panel(h.p(said), h.pre("\n".join(filter(None, made)), cls="file", tabindex=0), cls="norun")


# ---- facets


def facets_html(facets: Sequence[Facet], opened: Collection[str], error: str) -> Element:
    """All facets, their bars on one scale; each value has a box to include and a small box to exclude."""
    if error:
        return panel(h.p("The search cannot be read.", cls="dim"))
    most = max((v.count for f in facets for v in f.values), default=0) or 1
    return h.div((_facet(f, f.name in opened, most) for f in facets), cls="facets", role="group", aria_label="Filters")


def _facet(facet: Facet, opened: bool, most: int) -> Element:
    name, few = f"facet-{facet.name}", len(facet.values) <= FEW_VALUES
    shown = [v for k, v in enumerate(facet.values) if opened or few or k < SHOWN_VALUES or v.state]
    rest = len(facet.values) - len(shown)
    more = h.button(
        f"{rest} more" if rest else "fewer", cls="more", do=f"facet-more:{facet.name}", aria_expanded=not rest
    )
    return h.section(
        h.h2(TITLES.get(facet.name, facet.title), id=f"{name}-name", title=hint("facet")),
        h.div((_value(facet, v, most) for v in shown), role="group", aria_labelledby=f"{name}-name"),
        more if rest or (opened and not few) else None,
        id=name,
        cls="facet",
    )


def _value(facet: Facet, value: FacetValue, most: int) -> Element:
    name = CHANGES.get(value.name, value.name) if facet.name == "change" else value.name
    row = h.button(
        h.span(cls="box"),
        h.span(name, cls="which"),
        h.span(f"{value.count:,}", cls="n"),
        do=f"facet:{value.term}",
        role="checkbox",
        aria_checked={1: "true", -1: "mixed"}.get(value.state, "false"),
        css={"--v": f"{value.count / most:.3f}"},
        color=COLORS.get(value.name),
        title=hint(name) if name in glossary() and facet.name in EXPLAINED else name,
        cls="value",
    )
    leave = sign("−", f"facet-not:{value.term}", f"without {name}", "not", aria_pressed=value.state < 0)
    return h.div(row, None if facet.ranges else leave, cls="valuerow")


# ---- the search and what is done with what it finds


def search_html(query: str, tried: Sequence[str]) -> Element:
    """Field of the search, and terms to try."""
    example = "search, such as verdict:SRM class:chair margin<0.1   ( / )"
    name = "Search the expressions of the run"
    field = textbox(name, SYNTAX_HINT, "find runs", field="find", value=query, placeholder=example)
    terms = (h.button(term, do=f"facet:{term}", title="add to the search, or take away") for term in tried)
    return h.div(field, h.div("try", terms, cls="tried", role="group", aria_label="Terms to try", title=SYNTAX_HINT))


def offers_html(offered: Sequence[str]) -> Element | None:
    """Completions of the search's last word, and the search syntax."""
    if not offered:
        return None
    words = (
        h.button(word, role="option", aria_selected=not k, tabindex="-1", local=f"take:{word}")
        for k, word in enumerate(offered)
    )
    return h.div(
        h.div(words, cls="cmp", role="listbox", aria_label="Words to go on with"),
        h.div(SYNTAX, cls="syntax dim", title=SYNTAX_HINT),
        cls="offered",
    )


def filters_html(listing: Listing, notes: Notes, first: str, view: str) -> Element:
    """Saved searches, common searches, and the choice of view."""
    ready = {"failures": first, "all": ""}
    if listing.figures.second is not None:
        ready["what the second run broke"] = "change:broken"
    chips = [_filter(name, query, listing.query) for name, query in ready.items()]
    for name, query in notes.filters.items():
        drop = sign("×", f"filter-drop:{name}", f"forget “{name}”")
        chips.append(h.span(_filter(name, query, listing.query), drop, cls="kept"))
    known = listing.error or listing.query in (*ready.values(), *notes.filters.values())
    keep = _naming("keep as …", "filter-keep", "Keep this search under a name", "a name, then Enter: kept with the run")
    return h.div(
        h.div(chips, None if known else keep, cls="filters", role="group", aria_label="Kept searches"),
        h.span(cls="grow"),
        segments("rows-view", {"grid": "Grid", "table": "Table"}, view, "Show as"),
        cls="filtersrow",
    )


def _filter(name: str, query: str, now: str) -> Element:
    return toggle(name, f"find:{query}", query == now, query or "every expression", cls="try")


def _naming(example: str, do: str, name: str, hint: str, **more: object) -> Element:
    """Small field of a name."""
    given = {"field": "naming", "enter": do, "value": "", "placeholder": example, "maxlength": 40}
    return textbox(name, hint, "naming", **given, **more)


def bar_html(listing: Listing, view: str, selected: int, marks: Mapping[str, int], notes: Notes) -> Element:
    """Number of results, choice of view, and actions on the selected rows."""
    total, count = listing.figures.rows.records.num_rows, f"{listing.count:,}"
    found = h.h2(h.span(h.b(count), f" of {total:,} found", role="status"), cls="count")
    if listing.error:
        return h.div(note(listing.error, "bad"), cls="foundbar")
    if selected:
        own: Child = h.div(
            h.b(f"{selected:,} selected"),
            _naming("mark as …", "mark-rows", "Mark the selected", "one word, then Enter", list="known-marks"),
            h.datalist((h.option(value=name) for name in notes.marks), id="known-marks"),
            (_unmark(name, n) for name, n in marks.items()),
            button("make cases", "row-cases", "keep each of the selected as a small folder that `replay` runs again"),
            button("none", "choose-none", "select nothing (Escape)"),
            cls="chosen",
            role="group",
            aria_label="The selected",
        )
    else:
        every = button(f"select all {count}", "choose-all", "all that the search finds (Ctrl+A in the list)")
        legend = (
            h.span(h.i(cls=f"stroke {style}{' wrong' * (name == 'wrong target')}", color=color), name)
            for name, (color, style) in STROKES.items()
            if listing.figures.second is not None or name != "second run"
        )
        own = h.div(legend, cls="lines") if view == "grid" else None, every if listing.count else None
    return h.div(found, h.span(cls="grow"), own, cls="foundbar")


def _unmark(name: str, count: int) -> Element:
    hint, said = f"take the mark from the selected: {count:,} have it", f"take the mark {name} from the selected"
    return button(f"#{name} ×", f"unmark-rows:{name}", hint, aria_label=said)


# ---- rows

COLUMNS = {
    "text": ("expression", ""),
    "verdict": ("verdict", ""),
    "second_verdict": ("second run", ""),
    "margin": ("margin", hint("margin")),
    "p_relation": ("P(relation)", "the probability of the asked relation for the answer"),
    "object_distance": ("distance", "of the labelled target, metres"),
    "frame": ("frame", ""),
    MARKS: ("marks", ""),
}
"""Columns of the table: title and tooltip."""
NUMBERS = ("margin", "p_relation", "object_distance")


def heads_html(query: str, columns: Sequence[str]) -> Element:
    """Column heads: a click sorts by the column, a second reverses, a third resets."""
    words = query.split()
    plain = [word for word in words if not word.startswith("sort:")]
    now = next((word for word in words if word.startswith("sort:")), "")
    fixed = (("tick", "selected"), ("shot", "picture"))
    cells = [h.div(h.span(label, cls="unseen"), role="columnheader", cls=f"c-{name}") for name, label in fixed]
    for name in columns:
        title, said = COLUMNS[name]
        up, down = f"sort:{name}", f"sort:-{name}"
        then, order, mark = {up: (down, "ascending", " ↑"), down: ("", "descending", " ↓")}.get(now, (up, "none", ""))
        press = h.button(f"{title}{mark}", title=said or title, do=f"find:{' '.join([*plain, then]).strip()}")
        # Marks have no order.
        shown, order = (title, None) if name == MARKS else (press, order)
        numeric = " n" if name in NUMBERS else ""
        cells.append(h.div(shown, role="columnheader", aria_sort=order, cls=f"c-{name}{numeric}"))
    return h.div(h.div(cells, role="row", aria_rowindex="1", cls="expr"), role="rowgroup", cls="columns")


GLYPHS: dict[Tone, str] = {"right": "✓", "also right": "✓", "wrong": "✕", "none": "–"}


def row_html(row: Mapping[str, Any], view: str, columns: Sequence[str]) -> Element:
    """Expression as a card of the grid, or as a row of the table."""
    head = h.div(h.i(GLYPHS[row["tone"]], cls=row["tone"].replace(" ", "-")), row["head"], cls="head")
    # What a card has no room for is in its words.
    detail, lucky = (None, False) if view == "grid" else (row["detail"], bool(row["lucky"]))
    verdict = verdict_chip(row["verdict"], detail, lucky)
    marks = [h.span(f"#{name}", cls="tagged") for name in row[MARKS]]
    image = h.img(alt="", decoding="async", draggable="false")
    second, change = _second(row), row.get("change", "same")
    changed = None if change in (None, "same") else h.i(CHANGES[change], cls=f"change {change}")
    lead = "" if row["margin"] is None else f"Margin {row['margin']:+.2f}.".replace("-", "−")
    told = " ".join(filter(None, (row["said"], lead)))
    if row.get("second_said") and change != "same":
        told += f"\nSecond run: {row['second_said']}"
    if view == "grid":
        return h.div(
            h.div(image, h.span(cls="tick"), h.span(marks, cls="marks"), cls="snap"),
            head,
            h.div(row["text"], cls="asked"),
            h.div(changed, verdict, second or h.span(row["frame"], cls="dim"), cls="says"),
            cls="expr tile",
            role="option",
            title=told,
            aria_label=_label(row),
        )
    other = (changed, " ", second) if second else h.span(CHANGES["same"], cls="dim")
    cells: dict[str, Child] = {
        "text": h.div(row["text"], cls="asked"),
        "verdict": (head, verdict),
        "second_verdict": other,
        **{name: "" if row[name] is None else f"{row[name]:.2f}".replace("-", "−") for name in NUMBERS},
        "frame": row["frame"],
        MARKS: marks,
    }
    looks = {"shot": " snap", "frame": " dim cut"} | dict.fromkeys(NUMBERS, " n")
    shown = {"tick": h.span(cls="tick"), "shot": image, **{name: cells[name] for name in columns}}
    return h.div(
        (h.div(cell, role="gridcell", cls=f"c-{name}{looks.get(name, '')}") for name, cell in shown.items()),
        cls="expr",
        role="row",
        title=told,
    )


def _second(row: Mapping[str, Any]) -> Element | None:
    """Verdict of the second run, where different."""
    if row.get("change", "same") == "same":
        return None
    if row["second_verdict"] is None:
        return h.span("not in the second run", cls="dim")
    return h.span("→ ", verdict_chip(row["second_verdict"], row["second_detail"], bool(row["second_lucky"])))


def _label(row: Mapping[str, Any]) -> str:
    parts = [row["text"], row["head"], row["verdict"], row["frame"], *(f"marked {name}" for name in row[MARKS])]
    if row.get("change") not in (None, "same"):
        parts.insert(3, f"{CHANGES[row['change']]} in the second run: {row['second_verdict']}")
    return ", ".join(parts)
