"""Evaluate: search, list by range, selection, marks and kept searches of a dataset's run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from pipeline.evaluation.browsing import complete, examples, with_value
from pipeline.evaluation.run_figures import STANDS_IN, Listing, figures_of
from pipeline.evaluation.run_notes import MARKS
from pipeline.evaluation.search import FAILURES
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command, there
from spatialviz.app.evaluate_html import (
    COLUMNS,
    bar_html,
    facets_html,
    filters_html,
    heads_html,
    no_run_html,
    offers_html,
    row_html,
    search_html,
)
from spatialviz.app.figures_html import CUTS, Sample, comparison_html, confusion_html, slices_html, summary_html
from spatialviz.app.frames import pictures_of
from spatialviz.app.markup import Element
from spatialviz.app.state import Place, Side

FIRST = (FAILURES, "")
"""Default searches, in order; the first with results is listed."""
OFFERED = 12
"""Completions of a word, at most."""
LONGEST_SEARCH = 2000
"""Characters, more than anybody types."""
AT_ONCE = 400
"""Rows per message, at most."""
FIGURES = ("run-summary", "run-compared", "run-slices", "run-confusion")
SIDES: dict[str, Side] = {"broken": "b", "fixed": "a"}
"""Run whose answer explains a change; of others the one that was shown last."""
REGIONS = ("search", "offers", "filters", "facet-list", *FIGURES)
"""Regions of a run in the page."""
FILLED = 4
"""Pictures per background job."""


class Evaluate(Part):
    """Run of a client's current pipeline."""

    def __init__(self, ctx: Context, go: Callable[[Place], None], say_address: Callable[[], None]) -> None:
        super().__init__(ctx)
        self._go, self._say_address = go, say_address
        others = ctx.shared.others
        self._all = {name: figures_of(run, others.get(name)) for name, run in ctx.shared.runs.items()}
        self._source: str | None = None
        self._first = ""
        self._selected = np.zeros(0, np.bool_)
        self._opened: set[str] = set()
        self._columns: list[str] = []
        self._view, self._cut = "grid", next(iter(CUTS))
        self._version, self._span = 0, (0, 0)
        self._stale = self._whole = False
        self._sample: Sample | None = None
        self._told: int | None = None

    @property
    def _listing(self) -> Listing:
        return there(self.state.listing)

    # ---- state ----------------------------------------------------------------------

    def follow(self) -> None:
        """Show the run of the current pipeline; close the open row in another frame."""
        source, listing = self.state.source, self.state.listing
        if source != self._source:
            self._source = source
            self._begin()
        elif listing is not None and listing.at is not None and listing.at[0] != self.state.frame_id:
            self.state = replace(self.state, listing=replace(listing, at=None))
        if self.state.evaluating and self._stale:
            self._draw()
        if self.state.listed != self._told:
            self._told = self.state.listed
            self.ctx.page.call("place", self._told)

    def _begin(self) -> None:
        figures, self._sample, self._stale = self._all.get(self.state.source), None, True
        self.state = replace(self.state, listing=None if figures is None else Listing(figures))
        if figures is not None:
            rows = figures.rows
            self._selected = np.zeros(rows.records.num_rows, np.bool_)
            self._first = next((q for q in FIRST if len(rows.find(q))), "")
            self._search(self._first)

    @property
    def found(self) -> str | None:
        """Search text; None for a run's default search."""
        listing = self.state.listing
        return None if listing is None or listing.query == self._first else listing.query

    # ---- searching ------------------------------------------------------------------

    @command("find")
    def find(self, query: str) -> None:
        self.search(query)
        self._say_address()

    @command("alike")
    def list_alike(self, kind: str) -> None:
        """List the answers of a verdict and its detail, apart by a space."""
        verdict, _, detail = kind.partition(" ")
        self.state = replace(self.state, evaluating=True)
        self.search(f"verdict:{verdict}" + (f" detail:{detail}" if detail else ""))
        self.ctx.draw()

    def search(self, query: str | None) -> None:
        """List the matches of a search, by default a run's first search."""
        query = self._first if query is None else " ".join(query[:LONGEST_SEARCH].split())
        if self.state.listing is not None and query != self.state.listing.query:
            self._search(query)
            self._draw()

    def _search(self, query: str) -> None:
        listing = self._listing
        if STANDS_IN in query:
            # The column is computed with the confusion.
            _ = listing.figures.standings
        try:
            listing = replace(listing, query=query, error="", found=listing.figures.rows.find(query))
            self._version, self._span = self._version + 1, (0, 0)
            # Of failures alone the accuracy is 0.
            self._whole = query in (self._first, "")
        except InputError as error:
            listing = replace(listing, query=query, error=str(error))
        self.state, self._stale = replace(self.state, listing=listing), True

    @command("complete")
    def complete(self, typed: str) -> None:
        """Suggest completions for the last word of a search."""
        fields = self._listing.figures.fields
        offered = complete(typed, fields, OFFERED) if 0 < len(typed) <= LONGEST_SEARCH else ()
        self.ctx.page.show("offers", offers_html(offered))

    @command("facet", "facet-not")
    def refine(self, term: str, by: str) -> None:
        """Toggle a value of a facet, as wanted or excluded."""
        listing, without = self._listing, by == "facet-not"
        self.find(with_value(listing.query, term[:LONGEST_SEARCH], listing.figures.rows.records.schema, without))

    @command("facet-more")
    def unfold(self, name: str) -> None:
        """Toggle between all values of a facet and the first few."""
        self._opened ^= {name}
        self._draw()

    @command("filter-keep", "filter-drop")
    def keep(self, name: str, by: str) -> None:
        """Save the search under a name, or delete a saved search."""
        self._note(lambda listing: listing.figures.rows.keep(name, listing.query if by == "filter-keep" else None))

    def _note(self, change: Callable[[Listing], None]) -> None:
        try:
            change(self._listing)
        finally:
            self._draw()

    # ---- list -----------------------------------------------------------------------

    @command("rows-view")
    def show_as(self, view: Literal["grid", "table"]) -> None:
        """Show the list as a grid of pictures, or as a table."""
        self._view = view
        self._draw()

    @command("rows")
    def send_rows(self, first: int, stop: int) -> None:
        """Send a range of rows of the list."""
        listing = self._listing
        first, stop = self._within(first, stop)
        self._span = first, stop = first, min(stop, first + AT_ONCE)
        numbers = listing.found[first:stop].tolist()
        rows = listing.figures.rows.read(listing.found[first:stop])
        self.ctx.page.call(
            "rows",
            {
                "version": self._version,
                "first": first,
                "rows": [row_html(row, self._view, self._columns).html for row in rows],
            },
        )
        urls = [pictures_of(listing.figures).url(n, row) for n, row in zip(numbers, rows, strict=True)]
        self._send_pictures({k: url for k, url in enumerate(urls, first) if url})
        self._make_pictures(listing, [(k, rows[k - first]) for k, url in enumerate(urls, first) if not url])

    def _make_pictures(self, listing: Listing, missing: list[tuple[int, dict[str, Any]]]) -> None:
        """Make the pictures of visible rows, a few at a time."""
        version, span = self._version, self._span

        def make() -> None:
            if (version, span) == (self._version, self._span):
                pictures = pictures_of(listing.figures)
                self._send_pictures({k: pictures.url(int(listing.found[k]), row, True) for k, row in missing[:FILLED]})
                self._make_pictures(listing, missing[FILLED:])

        if missing:
            self.ctx.post(make)

    def _send_pictures(self, urls: dict[int, str]) -> None:
        if urls:
            self.ctx.page.call("pictures", {"version": self._version, "urls": urls})

    def _within(self, first: int, stop: int) -> tuple[int, int]:
        """Range clipped to the list."""
        first, stop = np.clip([first, stop], 0, self._listing.count).tolist()
        return first, max(first, stop)

    @command("failure")
    def open(self, place: int) -> None:
        """Explain the expression at a position of the list."""
        listing = self._listing
        if 0 <= place < listing.count:
            (row,) = listing.figures.rows.read(listing.found[place : place + 1])
            at = row["frame"], row["id"], row["text"]
            side = SIDES.get(str(row.get("change")), self.state.side)
            self.state = replace(self.state, evaluating=False, listing=replace(listing, at=at))
            self._go(Place(self.state.source, at[0], at[2], side=side))
            self.ctx.draw()

    @command("next-failure")
    def step(self, step: int) -> None:
        """Explain the next or the previous expression of the list."""
        count, at = self._listing.count, self._listing.place
        if count:
            at = self.state.listed if at is None else at
            self.open(self._from_here(step) if at is None else (at + step) % count)

    def _from_here(self, step: int) -> int:
        """Position in the list of the next expression, or the previous, from the current frame on."""
        listing, indices = self._listing, self.ctx.shared.pictures.timeline(self.state.source).indices
        names, of_row = listing.figures.rows.frames
        frames = np.array([indices.get(name, 0) for name in names])[of_row[listing.found]]
        ahead = (frames - indices[self.state.frame_id]) * step % len(indices)
        return int(np.flatnonzero(ahead == ahead.min())[0 if step > 0 else -1])

    def reveal(self, frame: str, expression: str) -> None:
        """Mark an expression as open, listing the whole run where the search lacks it."""
        listing = self.state.listing
        number = None if listing is None else listing.figures.rows.number(frame, expression)
        if listing is not None and number is not None:
            (row,) = listing.figures.rows.read(np.array([number]))
            opened = replace(listing, at=(frame, expression, row["text"]))
            self.state = replace(self.state, listing=opened)
            if opened.place is None:
                self.search("")
            self._say_address()

    # ---- selection ------------------------------------------------------------------

    @command("choose")
    def choose(self, place: int) -> None:
        """Toggle the selection of a row."""
        if 0 <= place < self._listing.count:
            numbers = self._listing.found[place : place + 1]
            self._choose(numbers, not self._selected[numbers].all())

    @command("choose-span")
    def choose_span(self, first: int, last: int) -> None:
        """Select a range of rows, both ends included."""
        first, stop = self._within(first, last)
        self._choose(self._listing.found[first : stop + 1], True)

    @command("choose-all=all", "choose-none=none")
    def choose_many(self, which: str) -> None:
        """Select all results of the search, or none."""
        self._choose(self._listing.found if which == "all" else np.flatnonzero(self._selected), which == "all")

    def _choose(self, numbers: np.ndarray, on: bool) -> None:
        self._selected[numbers] = on
        self._show_bar()
        self._show_chosen()

    def _show_chosen(self) -> None:
        """Send the selected positions of the list, as spans."""
        ends = np.flatnonzero(np.diff(self._selected[self._listing.found].astype(np.int8), prepend=0, append=0))
        self.ctx.page.call("chosen", {"version": self._version, "spans": ends.reshape(-1, 2).tolist()})

    @command("mark-rows", "unmark-rows")
    def mark(self, name: str, by: str) -> None:
        """Add a mark to the selected rows, or remove the mark."""
        if name.strip():
            numbers = np.flatnonzero(self._selected).tolist()
            self._note(lambda listing: listing.figures.rows.mark(numbers, name, by == "mark-rows"))

    def selected(self) -> list[dict[str, Any]]:
        """Selected rows."""
        return self._listing.figures.rows.read(np.flatnonzero(self._selected))

    # ---- drawing --------------------------------------------------------------------

    def _draw(self) -> None:
        listing, page = self.state.listing, self.ctx.page
        self._stale = not self.state.evaluating
        if self._stale:
            return
        if listing is None:
            self._show_none()
            return
        rows = listing.figures.rows
        facets = () if listing.error else rows.facets(listing.query)
        self._told = self.state.listed
        self._columns = rows.filled(listing.found, COLUMNS)
        # Before it is said how many there are: who scrolls then scrolls these.
        page.call(
            "found",
            {
                "version": self._version,
                "total": listing.count,
                "view": self._view,
                "place": self._told,
                "head": heads_html(listing.query, self._columns).html if self._view == "table" else "",
                "frame": rows.widest_frame,
                "label": f"{listing.count} expressions",
                "noted": rows.stamp,
            },
        )
        page.fill(
            {
                "search": search_html(listing.query, examples(facets)),
                "offers": None,
                "filters": filters_html(listing, rows.notes, self._first, self._view),
                "facet-list": facets_html(facets, self._opened, listing.error),
            }
        )
        self._show_bar()
        self._show_chosen()
        self._show_figures(listing)

    def _show_none(self) -> None:
        """Say what a run is made of, in place of its list."""
        dataset, place = self.ctx.source.dataset, self.ctx.shared.journals.get(self.state.source)
        # Labels begun by hand have no folder before the first stroke.
        labels = None if place is None or not place.labels.root.exists() else place.labels.root
        told = no_run_html(dataset.root, bool(dataset.class_names), labels)
        self.ctx.page.fill({**dict.fromkeys(REGIONS), "found-bar": told})

    def _show_bar(self) -> None:
        listing, numbers, marks = self._listing, np.flatnonzero(self._selected), dict[str, int]()
        rows = listing.figures.rows
        if len(numbers):
            of_mark = rows.records.column(MARKS).take(numbers).combine_chunks().flatten().value_counts()
            marks = {c["values"]: c["counts"] for c in of_mark.to_pylist()}
        self.ctx.page.show("found-bar", bar_html(listing, self._view, len(numbers), marks, rows.notes))

    # ---- figures --------------------------------------------------------------------

    def _show_figures(self, listing: Listing) -> None:
        """Figures of the run, or of what is found, drawn in turn."""
        figures, count = listing.figures, listing.count
        whole = self._whole or not count
        sample = Sample(figures if whole else figures.of(listing.found), "" if whole else listing.query, count)
        if sample == self._sample:
            return
        if self._sample is None:
            self.ctx.page.fill(dict.fromkeys(FIGURES))
        self._sample = sample
        parts: list[tuple[str, Callable[[], Element | None]]] = [
            ("run-summary", lambda: summary_html(sample)),
            ("run-compared", lambda: comparison_html(sample)),
            ("run-slices", lambda: slices_html(sample, self._cut)),
            ("run-confusion", lambda: confusion_html(sample)),
        ]

        def draw() -> None:
            # One per job, so that requested rows need not wait for all.
            if parts and self._sample is sample:
                region, made = parts.pop(0)
                self.ctx.page.show(region, made())
                self.ctx.post(draw)

        self.ctx.post(draw)

    @command("figures-of")
    def choose_sample(self, which: Literal["all", "found"]) -> None:
        """Show the figures of the whole run, or of what is found."""
        self._whole = which == "all"
        self._show_figures(self._listing)

    @command("cut")
    def cut(self, dimension: str) -> None:
        """Slice the run by another dimension."""
        if dimension in CUTS and self._sample is not None:
            self._cut = dimension
            self.ctx.page.show("run-slices", slices_html(self._sample, dimension))
