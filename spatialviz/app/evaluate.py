"""Evaluate: the run of a client's dataset, searched, listed by range, selected, marked, and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.evaluation.facets import with_value
from pipeline.evaluation.run_notes import MARKS
from pipeline.evaluation.search import complete
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command
from spatialviz.app.evaluate_html import (
    VIEWS,
    bar_html,
    facets_html,
    filters_html,
    heads_html,
    offers_html,
    row_html,
    search_html,
)
from spatialviz.app.figures_html import CUTS, comparison_html, confusion_html, slices_html, summary_html
from spatialviz.app.markup import Element
from spatialviz.app.place import Place
from spatialviz.app.run_figures import STANDS_IN, Listing, RunFigures, figures_of

FIRST = ("-verdict:CORRECT,LABEL", "-verdict:CORRECT", "")
"""What is listed first: the first of these that finds something. With LABEL the answer is right, too, or the label was
marked as wrong."""
OFFERED = 12
"""Words that are offered for one that is begun."""
LONGEST_SEARCH = 2000
"""Characters; more is no search that somebody typed."""
AT_ONCE = 400
"""Rows that are sent at once, at most."""
FILLED = 4
"""Pictures that are made at once, behind whatever the user does."""


class Evaluate(Part):
    """The run of the source that a client looks at."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        others = ctx.shared.others
        self._all = {name: figures_of(run, others.get(name)) for name, run in ctx.shared.runs.items()}
        self._source: str | None = None
        self._first = ""
        self._found = np.zeros(0, np.int64)
        self._selected = np.zeros(0, np.bool_)
        self._opened: set[str] = set()
        self._view, self._cut = "grid", next(iter(CUTS))
        self._version, self._span = 0, (0, 0)
        self._stale = self._figured = False
        self._told: int | None = None

    @property
    def _figures(self) -> RunFigures | None:
        return self._all.get(self.state.source)

    @property
    def _now(self) -> tuple[Listing, RunFigures] | None:
        listing, figures = self.state.listing, self._figures
        return None if listing is None or figures is None else (listing, figures)

    # ---- following the state --------------------------------------------------------

    def follow(self) -> None:
        """Show the run of the source that is looked at now; no row is open any more in another frame."""
        source, listing = self.state.source, self.state.listing
        if source != self._source:
            self._source = source
            self._begin()
        elif listing is not None and listing.at is not None and listing.at[0] != self.state.frame_id:
            self.state = replace(self.state, listing=replace(listing, at=None, place=None))
        if self.state.evaluating and self._stale:
            self._draw()
        if self._asked != self._told:
            self._told = self._asked
            self.ctx.page.call("place", self._told)

    @property
    def _asked(self) -> int | None:
        """Where the expression that is asked now is in the list; None where it is no row of it."""
        state, now = self.state, self._now
        if now is None or state.expression_id(state.text) is not None:
            return None if now is None else now[0].place
        rows = now[1].rows
        number = rows.asked(state.frame_id, state.text)
        return None if number is None else self._place_of(rows.keys[number])

    def _begin(self) -> None:
        figures = self._figures
        self._figured = False
        if figures is None:
            self.state = replace(self.state, listing=None)
            return
        rows = figures.rows
        self._selected = np.zeros(rows.records.num_rows, np.bool_)
        self._first = next((q for q in FIRST if len(rows.find(q))), "")
        self.state = replace(self.state, listing=Listing(rows.records.num_rows))
        self._search(self._first)

    @property
    def found(self) -> str | None:
        """What is searched for, where it is not what a run is searched for at first."""
        listing = self.state.listing
        return None if listing is None or listing.query == self._first else listing.query

    # ---- searching ------------------------------------------------------------------

    @command("find")
    def find(self, query: str) -> None:
        """Search."""
        self.search(query)
        self.ctx.say_address()

    def search(self, query: str | None) -> None:
        """List what matches a search; without one, what a run shows at first."""
        now = self._now
        if now is None:
            return
        query = self._first if query is None else " ".join(query[:LONGEST_SEARCH].split())
        if query != now[0].query:
            self._search(query)
            self._draw()

    def _search(self, query: str) -> None:
        listing, figures = self._now or (None, None)
        assert listing is not None
        assert figures is not None
        if STANDS_IN in query:
            # That column is there once it was worked out.
            _ = figures.confusion
        try:
            self._found = figures.rows.find(query)
        except InputError as error:
            self.state = replace(self.state, listing=replace(listing, query=query, error=str(error)))
        else:
            self._version += 1
            self._span = (0, 0)
            fresh = replace(listing, query=query, error="", count=len(self._found))
            self.state = replace(self.state, listing=replace(fresh, place=self._place_of(listing.at)))
        self._stale = True

    def _place_of(self, at: tuple[str, ...] | None) -> int | None:
        """Where an expression is in the list."""
        figures = self._figures
        number = None if at is None or figures is None else figures.rows.number(at[0], at[1])
        places = np.zeros(0) if number is None else np.flatnonzero(self._found == number)
        return int(places[0]) if len(places) else None

    @command("complete")
    def complete(self, typed: str) -> None:
        """Offer words for the last one of a search that is being typed."""
        figures, offered = self._figures, list[str]()
        if figures is not None and 0 < len(typed) <= LONGEST_SEARCH:
            offered = complete(typed, figures.fields, OFFERED)
        self.ctx.page.show("offers", offers_html(offered))

    @command("facet")
    def add(self, term: str) -> None:
        """Ask for one more value of a facet, or no more for it."""
        self._refine(term, without=False)

    @command("facet-not")
    def leave_out(self, term: str) -> None:
        """Leave out what has a value, or no more."""
        self._refine(term, without=True)

    def _refine(self, term: str, without: bool) -> None:
        now = self._now
        if now is not None:
            try:
                query = with_value(now[0].query, term[:LONGEST_SEARCH], now[1].rows.records.schema, without)
            except InputError as error:
                self.ctx.fail(error)
            else:
                self.find(query)

    @command("facet-more")
    def unfold(self, name: str) -> None:
        """Show all values of a facet, or the first ones."""
        self._opened ^= {name}
        self._draw()

    @command("filter-keep")
    def keep(self, name: str) -> None:
        """Keep the search under a name."""
        now = self._now
        if now is not None:
            self._noted(lambda: now[1].rows.keep(name, now[0].query))

    @command("filter-drop")
    def drop(self, name: str) -> None:
        """Forget a search that was kept."""
        now = self._now
        if now is not None:
            self._noted(lambda: now[1].rows.keep(name, None))

    def _noted(self, note: Callable[[], None]) -> None:
        try:
            note()
        except InputError as error:
            self.ctx.fail(error)
        self._draw()

    # ---- the list -------------------------------------------------------------------

    @command("rows-view")
    def show_as(self, view: str) -> None:
        """Show the list as a grid of pictures, or as a table."""
        if view in VIEWS:
            self._view = view
            self._draw()

    @command("rows")
    def send_rows(self, span: str) -> None:
        """Send the rows from one place of the list up to another: "120,180"."""
        now = self._now
        if now is None:
            return
        first, stop = self._within(span)
        stop = min(stop, first + AT_ONCE)
        self._span = (first, stop)
        numbers = self._found[first:stop]
        rows = now[1].rows.read(numbers)
        self.ctx.page.call("rows", {
            "version": self._version, "first": first, "rows": [row_html(row, self._view).html for row in rows],
        })  # fmt: skip
        urls = {first + k: now[1].picture(int(n), row) for k, (n, row) in enumerate(zip(numbers, rows, strict=True))}
        self._send_pictures({k: url for k, url in urls.items() if url})
        self._make_pictures([(k, rows[k - first]) for k, url in urls.items() if not url])

    def _make_pictures(self, missing: list[tuple[int, dict[str, Any]]]) -> None:
        """Make the pictures of rows in sight, a few at a time."""
        version, span, figures = self._version, self._span, self._figures
        if not missing or figures is None:
            return

        def make() -> None:
            if (version, span) != (self._version, self._span):
                return
            made = {k: figures.picture(int(self._found[k]), row, make=True) for k, row in missing[:FILLED]}
            self._send_pictures(made)
            self._make_pictures(missing[FILLED:])

        self.ctx.post(make)

    def _send_pictures(self, urls: dict[int, str]) -> None:
        if urls:
            self.ctx.page.call("pictures", {"version": self._version, "urls": urls})

    def _within(self, span: str) -> tuple[int, int]:
        """Two places of the list."""
        ends = [int(n) for n in span.split(",") if n.isdecimal()]
        first, stop = ends if len(ends) == 2 else (0, 0)
        return min(first, len(self._found)), max(min(stop, len(self._found)), min(first, len(self._found)))

    @command("failure")
    def open(self, place: int) -> None:
        """Explain the expression at a place of the list."""
        now = self._now
        if now is None or not 0 <= place < len(self._found):
            return
        (row,) = now[1].rows.read(self._found[place : place + 1])
        at = row["frame"], row["id"], row["text"]
        self.state = replace(self.state, evaluating=False, listing=replace(now[0], at=at, place=place))
        self.ctx.go(Place(self.state.source, at[0], at[2]))
        self.ctx.draw()

    @command("next-failure")
    def step(self, step: int) -> None:
        """Explain the next or the previous one of the list."""
        listing = self.state.listing
        if listing is not None and listing.count:
            at = self._asked if listing.place is None else listing.place
            self.open((0 if step > 0 else listing.count - 1) if at is None else (at + step) % listing.count)

    def reveal(self, frame: str, expression: str) -> None:
        """Mark an expression as the one that is open, among all of the run where the search did not find it."""
        now = self._now
        number = None if now is None else now[1].rows.number(frame, expression)
        if now is None or number is None:
            return
        (row,) = now[1].rows.read(np.array([number]))
        at = frame, expression, row["text"]
        if self._place_of(at) is None:
            self.search("")
        listing = self.state.listing
        assert listing is not None
        self.state = replace(self.state, listing=replace(listing, at=at, place=self._place_of(at)))
        self.ctx.say_address()

    # ---- the selected ---------------------------------------------------------------

    @command("choose")
    def choose(self, place: int) -> None:
        """Select a row, or no more."""
        if 0 <= place < len(self._found):
            number = self._found[place]
            self._choose(np.array([number]), not self._selected[number])

    @command("choose-span")
    def choose_span(self, span: str) -> None:
        """Select all rows from one place to another, both included."""
        first, stop = self._within(span)
        self._choose(self._found[first : stop + 1], True)

    @command("choose-all")
    def choose_all(self) -> None:
        """Select all that the search has found."""
        self._choose(self._found, True)

    @command("choose-none")
    def choose_none(self) -> None:
        """Select nothing."""
        self._choose(np.flatnonzero(self._selected), False)

    def _choose(self, numbers: np.ndarray, on: bool) -> None:
        self._selected[numbers] = on
        self._show_bar()
        self._show_chosen()

    def _show_chosen(self) -> None:
        """Where selected ones stand in the list, as spans."""
        ends = np.flatnonzero(np.diff(self._selected[self._found].astype(np.int8), prepend=0, append=0))
        self.ctx.page.call("chosen", {"version": self._version, "spans": ends.reshape(-1, 2).tolist()})

    @command("mark-rows")
    def mark(self, name: str) -> None:
        """Give the selected a mark."""
        if name.strip():
            self._mark(name, True)

    @command("unmark-rows")
    def unmark(self, name: str) -> None:
        """Take a mark from the selected."""
        self._mark(name, False)

    def _mark(self, name: str, on: bool) -> None:
        figures = self._figures
        if figures is not None:
            self._noted(lambda: figures.rows.mark(np.flatnonzero(self._selected).tolist(), name, on))

    def selected(self) -> list[dict[str, Any]]:
        """The rows that are selected."""
        return [] if self._figures is None else self._figures.rows.read(np.flatnonzero(self._selected))

    # ---- drawing --------------------------------------------------------------------

    def _draw(self) -> None:
        now, page = self._now, self.ctx.page
        if now is None or not self.state.evaluating:
            self._stale = True
            return
        self._stale = False
        listing, figures = now
        rows, second = figures.rows, figures.second
        with page.together():
            page.show("search", search_html(listing.query))
            page.show("offers")
            page.show("filters", filters_html(listing, rows.notes, self._first, second is not None, self._view))
            facets = () if listing.error else rows.facets(listing.query)
            page.show("facet-list", facets_html(facets, self._opened, listing.error))
            self._show_bar()
        self._told = self._asked
        page.call("found", {
            "version": self._version, "total": listing.count, "view": self._view, "place": self._told,
            "head": heads_html(listing.query, second is not None).html if self._view == "table" else "",
            "label": f"{listing.count} expressions", "noted": rows.stamp,
        })  # fmt: skip
        self._show_chosen()
        self._show_figures(figures)

    def _show_bar(self) -> None:
        now = self._now
        if now is None:
            return
        listing, figures = now
        numbers, marks = np.flatnonzero(self._selected), dict[str, int]()
        if len(numbers):
            of_mark = figures.rows.records.column(MARKS).take(numbers).combine_chunks().flatten().value_counts()
            marks = {c["values"]: c["counts"] for c in of_mark.to_pylist()}
        second, notes = figures.second is not None, figures.rows.notes
        self.ctx.page.show("found-bar", bar_html(listing, self._view, second, len(numbers), marks, notes))

    # ---- figures --------------------------------------------------------------------

    def _show_figures(self, figures: RunFigures) -> None:
        """Of the whole run, one part after the other, once."""
        if self._figured:
            return
        self._figured, page = True, self.ctx.page
        parts: list[tuple[str, Callable[[RunFigures], Element | None]]] = [
            ("run-summary", summary_html), ("run-compared", comparison_html),
            ("run-slices", lambda figures: slices_html(figures, self._cut)), ("run-confusion", confusion_html),
        ]  # fmt: skip
        for region, _ in parts:
            page.show(region)

        def draw() -> None:
            # One after the other, so that rows that are asked for need not wait for all.
            if parts and self._figures is figures:
                region, made = parts.pop(0)
                page.show(region, made(figures))
                self.ctx.post(draw)

        self.ctx.post(draw)

    @command("cut")
    def cut(self, dimension: str) -> None:
        """Cut the run by another dimension."""
        if dimension in CUTS and self._figures is not None:
            self._cut = dimension
            self.ctx.page.show("run-slices", slices_html(self._figures, dimension))
