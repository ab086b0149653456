"""Paging through the expressions of a run: which of them match, which are shown, which one is open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from pipeline.diagnosis.search import find
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.errors import InputError
from pipeline.evaluation.run_folder import Run

PAGE = 20
COLUMNS = ("id", "frame", "text", "verdict", "detail", "lucky", "margin", "said", "target", "relation", "reference")
FAILURES = "-verdict:CORRECT"
"""What is listed first."""


@dataclass(frozen=True)
class Listing:
    """The expressions of a run that match a search.

    Attributes
    ----------
    run : str
        Name of the run's system.
    query : str
    error : str
        Why the search cannot be carried out; the rows are then those of the search before.
    total : int
        Expressions of the run.
    counts : dict of str to int
        Of all expressions, by verdict, in the verdicts' order.
    keys : tuple of (str, str)
        (frame, id) of all that match, in order.
    rows : tuple of dict
        Those on the page that is shown.
    page : int
    at : (str, str) or None
        The one that is open.
    """

    run: str
    total: int
    counts: dict[str, int]
    query: str = FAILURES
    error: str = ""
    keys: tuple[tuple[str, str], ...] = ()
    rows: tuple[dict[str, Any], ...] = ()
    page: int = 0
    at: tuple[str, str] | None = None

    @property
    def pages(self) -> int:
        """How many pages there are; at least one."""
        return max(1, -(-len(self.keys) // PAGE))

    @property
    def place(self) -> int | None:
        """The open one among those that match."""
        return self.keys.index(self.at) if self.at in self.keys else None


class RunBrowser:
    """Searches one run's records."""

    def __init__(self, run: Run) -> None:
        self.run = run
        records = run.records
        if "verdict" not in records.column_names:
            cause = "made by an earlier release? run `eval` again"
            raise InputError("the run has no verdicts", cause=cause, path=run.folder)
        self._found = records
        verdicts = records.column("verdict").to_pylist()
        counts = {name: verdicts.count(name) for name in VERDICTS if name in verdicts}
        self.first = self.searched(Listing(run.name, records.num_rows, counts), FAILURES)

    def searched(self, listing: Listing, query: str) -> Listing:
        """The listing of another search, from its first page."""
        query = " ".join(query.split())
        try:
            self._found = find(self.run.records, query)
        except InputError as error:
            return replace(listing, query=query, error=str(error))
        keys = zip(self._found.column("frame").to_pylist(), self._found.column("id").to_pylist(), strict=True)
        return self.turned(replace(listing, query=query, error="", keys=tuple(keys)), 0)

    def turned(self, listing: Listing, page: int) -> Listing:
        """The listing at another page."""
        page = min(max(page, 0), listing.pages - 1)
        rows = self._found.slice(page * PAGE, PAGE).select(list(COLUMNS)).to_pylist()
        return replace(listing, page=page, rows=tuple(rows))

    def opened(self, listing: Listing, place: int) -> Listing:
        """The listing with the expression at a place of the matches open, on its page."""
        if not 0 <= place < len(listing.keys):
            return listing
        moved = listing if place // PAGE == listing.page else self.turned(listing, place // PAGE)
        return replace(moved, at=listing.keys[place])
