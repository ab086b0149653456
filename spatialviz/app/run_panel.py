"""The run of a client's dataset: its figures, its search, its pages, and stepping from failure to failure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from spatialviz.app.context import Context, Part, command
from spatialviz.app.markup import Element, panel
from spatialviz.app.place import Place
from spatialviz.app.run_browser import Listing, RunBrowser, RunFigures, figures_of
from spatialviz.app.run_html import (
    CUTS,
    confusion_html,
    listing_html,
    offers_html,
    search_html,
    shares_html,
    slices_html,
    summary_html,
)

FILLED = 4
"""Small pictures that are read at once, behind whatever the user does."""


class RunPanel(Part):
    """Searches the run of the source that a client looks at, and shows its figures."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._browsers = {name: RunBrowser(figures_of(run)) for name, run in ctx.shared.runs.items()}
        self._thumbs: dict[str, str] = {}
        self._source: str | None = None
        self._cut = next(iter(CUTS))

    @property
    def _browser(self) -> RunBrowser | None:
        return self._browsers.get(self.state.source)

    def follow(self) -> None:
        """Show the run of the source that is looked at now; no row is open any more in another frame."""
        source = self.state.source
        if source == self._source:
            listing = self.state.listing
            if listing is not None and listing.at is not None and listing.at[0] != self.state.frame_id:
                self.state = replace(self.state, listing=replace(listing, at=None))
                self._draw()
            return
        self._source, self._thumbs = source, {}
        browser = self._browser
        self._ready(None if browser is None else browser.first.query)
        self._set(None if browser is None else browser.first)
        self._draw_figures()

    def reveal(self, frame: str, expression: str) -> None:
        """Mark an expression as the one that is open, among all of the run where the search did not find it."""
        listing, browser = self.state.listing, self._browser
        if listing is None or browser is None:
            return
        if (frame, expression) not in listing.keys:
            everything = browser.searched(listing, "")
            if (frame, expression) not in everything.keys:
                browser.searched(listing, listing.query)
                return
            listing = everything
            self._ready(listing.query)
        self._set(browser.opened(listing, listing.keys.index((frame, expression))))

    @property
    def found(self) -> str | None:
        """What is searched for, where it is not what a run is searched for at first."""
        listing, browser = self.state.listing, self._browser
        return None if listing is None or browser is None or listing.query == browser.first.query else listing.query

    @command("find")
    def find(self, query: str) -> None:
        """Search, and look at the run."""
        self.state = replace(self.state, evaluating=True)
        self.search(query)

    def search(self, query: str | None) -> None:
        """List what matches a search; without one, what a run shows at first."""
        listing, browser = self.state.listing, self._browser
        if listing is None or browser is None:
            return
        query = browser.first.query if query is None else query
        if query == listing.query:
            return
        found = browser.searched(listing, query)
        self._ready(found.query)
        self._set(found)

    def _ready(self, query: str | None) -> None:
        """Have the field of the search hold this one, with nothing offered; without a run there is none."""
        self.ctx.page.show("search", None if query is None else search_html(query))
        self.ctx.page.show("offers", None if query is None else offers_html(()))

    @command("complete")
    def complete(self, typed: str) -> None:
        """Offer words for the last one of a search that is being typed."""
        if self._browser is not None:
            self.ctx.page.show("offers", offers_html(self._browser.offered(typed)))

    @command("find-page")
    def turn(self, page: int) -> None:
        """Show another page of the list."""
        listing, browser = self.state.listing, self._browser
        if listing is not None and browser is not None:
            self._set(browser.turned(listing, page))

    @command("failure")
    def open(self, place: int) -> None:
        """Look at the expression at a place of the list."""
        listing, browser = self.state.listing, self._browser
        if listing is None or browser is None or not 0 <= place < len(listing.keys):
            return
        opened = browser.opened(listing, place)
        self._set(opened)
        self.ctx.go(Place(self.state.source, opened.open_row["frame"], opened.open_row["text"]))

    @command("next-failure")
    def step(self, step: int) -> None:
        """Look at the next or the previous one of the list."""
        listing = self.state.listing
        if listing is not None and listing.keys:
            at = listing.place
            self.open((0 if step > 0 else len(listing.keys) - 1) if at is None else (at + step) % len(listing.keys))

    def _set(self, listing: Listing | None) -> None:
        self.state = replace(self.state, listing=listing)
        self.ctx.say_address()
        self._draw()
        if listing is not None:
            self._fill(listing)

    def _draw(self) -> None:
        browser = self._browser
        shares = None if browser is None else panel(shares_html(browser.figures.run.shares))
        self.ctx.page.show("listing", shares, listing_html(self.state.listing, self._thumbs))

    def _fill(self, listing: Listing) -> None:
        """Read the small pictures of the page that is shown, a few at a time."""
        missing = [f for f in dict.fromkeys(row["frame"] for row in listing.rows) if f not in self._thumbs]
        source = self._source
        if not missing or source is None:
            return

        def fill() -> None:
            now = self.state.listing
            if source != self._source or now is None or now.rows != listing.rows:
                return
            for frame in missing[:FILLED]:
                self._thumbs[frame] = self.ctx.shared.pictures.url(source, frame)
            self._draw()
            self._fill(now)

        self.ctx.post(fill)

    # ---- figures ------------------------------------------------------------------------

    def _draw_figures(self) -> None:
        """Show the figures of the run that is looked at, one part after the other."""
        page, browser = self.ctx.page, self._browser
        for region in ("run-summary", "run-slices", "run-confusion"):
            page.show(region)

        def draw(region: str, made: Callable[[RunFigures], Element]) -> None:
            if browser is not None and browser is self._browser:
                page.show(region, made(browser.figures))

        self.ctx.post(lambda: draw("run-summary", summary_html))
        self.ctx.post(lambda: draw("run-slices", lambda figures: slices_html(figures, self._cut)))
        self.ctx.post(lambda: draw("run-confusion", confusion_html))

    @command("cut")
    def cut(self, dimension: str) -> None:
        """Cut the run by another dimension."""
        if dimension in CUTS and self._browser is not None:
            self._cut = dimension
            self.ctx.page.show("run-slices", slices_html(self._browser.figures, dimension))
