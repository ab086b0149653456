"""The run of a client's dataset: its search, its pages, and stepping from failure to failure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from pipeline.evaluation.run_folder import Run
from spatialviz.app.failures import listing_html, offers_html, search_html
from spatialviz.app.frames import FrameStore
from spatialviz.app.layout import Page
from spatialviz.app.place import Place
from spatialviz.app.run_browser import Listing, RunBrowser
from spatialviz.app.run_figures import figures_of
from spatialviz.app.run_html import shares_html
from spatialviz.app.run_tab import RunTab
from spatialviz.app.state import State
from spatialviz.app.text import panel

FILLED = 4
"""Small pictures that are read at once, behind whatever the user does."""


class RunPanel:
    """Searches the run of the source that a client looks at.

    Parameters
    ----------
    runs : mapping of str to Run
        By name of the source.
    store : FrameStore
    page : Page
    state : callable
        Gives the client's state.
    show : callable
        Takes a new listing into it.
    go : callable
        Looks at a place.
    post : callable
        Runs something later, on the client's own thread.
    """

    def __init__(
        self,
        runs: Mapping[str, Run],
        store: FrameStore,
        page: Page,
        state: Callable[[], State],
        show: Callable[[Listing | None], None],
        go: Callable[[Place], None],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        figures = {name: figures_of(run) for name, run in runs.items()}
        self._browsers = {name: RunBrowser(found) for name, found in figures.items()}
        self._tab = RunTab(figures, page, post)
        self._store, self._page, self._state, self._show, self._go, self._post = store, page, state, show, go, post
        self._thumbs: dict[str, str] = {}
        self._source: str | None = None

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "find": self.search,
            "complete": self.complete,
            "cut": self._tab.cut,
            "find-page": lambda page: self.turn(int(page)),
            "failure": lambda place: self.open(int(place)),
            "next-failure": lambda step: self.step(int(step)),
        }

    @property
    def _browser(self) -> RunBrowser | None:
        return self._browsers.get(self._state().source)

    def follow(self) -> None:
        """Show the run of the source that is looked at now; no row is open any more in another frame."""
        source = self._state().source
        if source == self._source:
            listing = self._state().listing
            if listing is not None and listing.at is not None and listing.at[0] != self._state().frame_id:
                self._show(replace(listing, at=None))
                self._draw()
            return
        self._source, self._thumbs = source, {}
        browser = self._browser
        self._ready(None if browser is None else browser.first.query)
        self._set(None if browser is None else browser.first)
        self._tab.show(source)

    def expression(self, frame: str, text: str) -> str | None:
        """The id of the expression that was opened from the list, where it is the one that is asked."""
        listing = self._state().listing
        if listing is None or listing.at is None or listing.at[0] != frame:
            return None
        row = next((r for r in listing.rows if (r["frame"], r["id"]) == listing.at), None)
        return listing.at[1] if row is not None and row["text"] == text else None

    def reveal(self, frame: str, expression: str) -> None:
        """Mark an expression as the one that is open, among all of the run where the search did not find it."""
        listing, browser = self._state().listing, self._browser
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
        listing, browser = self._state().listing, self._browser
        return None if listing is None or browser is None or listing.query == browser.first.query else listing.query

    def search(self, query: str | None) -> None:
        """List what matches a search; without one, what a run shows at first."""
        listing, browser = self._state().listing, self._browser
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
        fields = (None, None) if query is None else (search_html(query), offers_html(()))
        self._page.show("search", fields[0])
        self._page.show("offers", fields[1])

    def complete(self, typed: str) -> None:
        """Offer words for the last one of a search that is being typed."""
        browser = self._browser
        if browser is not None:
            self._page.show("offers", offers_html(browser.offered(typed)))

    def turn(self, page: int) -> None:
        """Show another page of the list."""
        listing, browser = self._state().listing, self._browser
        if listing is not None and browser is not None:
            self._set(browser.turned(listing, page))

    def open(self, place: int) -> None:
        """Look at the expression at a place of the list."""
        listing, browser = self._state().listing, self._browser
        if listing is None or browser is None or not 0 <= place < len(listing.keys):
            return
        opened = browser.opened(listing, place)
        self._set(opened)
        row = next(r for r in opened.rows if (r["frame"], r["id"]) == opened.at)
        self._go(Place(self._state().source, row["frame"], row["text"]))

    def step(self, step: int) -> None:
        """Look at the next or the previous one of the list."""
        listing = self._state().listing
        if listing is not None and listing.keys:
            at = listing.place
            self.open((0 if step > 0 else len(listing.keys) - 1) if at is None else (at + step) % len(listing.keys))

    def _set(self, listing: Listing | None) -> None:
        self._show(listing)
        self._draw()
        if listing is not None:
            self._fill(listing)

    def _draw(self) -> None:
        browser = self._browser
        shares = None if browser is None else panel(shares_html(browser.figures.run.shares))
        self._page.show("listing", shares, listing_html(self._state().listing, self._thumbs))

    def _fill(self, listing: Listing) -> None:
        """Read the small pictures of the page that is shown, a few at a time."""
        missing = [f for f in dict.fromkeys(row["frame"] for row in listing.rows) if f not in self._thumbs]
        source = self._source
        if not missing or source is None:
            return

        def fill() -> None:
            now = self._state().listing
            if source != self._source or now is None or now.rows != listing.rows:
                return
            for frame in missing[:FILLED]:
                self._thumbs[frame] = self._store.thumb(source, frame)[0]
            self._draw()
            self._fill(now)

        self._post(fill)
