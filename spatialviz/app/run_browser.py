"""A run: its figures, worked out once for all clients, and which of its expressions are found and shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, TypeVar

import numpy as np

from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.confusion import Confusion, Standings, answer_standings, count_standings
from pipeline.evaluation.loss_plots import MOST_SHOWN
from pipeline.evaluation.run_folder import Run
from pipeline.evaluation.search import Field, complete, completions, find_rows
from pipeline.evaluation.slices import Slices, slice_by
from pipeline.evaluation.summary import RunSummary, summarise_run
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError

Figure = TypeVar("Figure")
PAGE = 20
COLUMNS = ("id", "frame", "text", "verdict", "detail", "lucky", "margin", "said", "target", "relation", "reference")
FIRST = ("-verdict:CORRECT,LABEL", "-verdict:CORRECT", "")
"""What is listed first: the first of these that finds something. With LABEL the answer is right, too, or the label was
marked as wrong."""
OFFERED = 12
"""Words that are offered for one that is begun."""
LONGEST_SEARCH = 2000
"""Characters; more is no search that somebody typed."""


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
    query: str = ""
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
    def open_row(self) -> dict[str, Any]:
        """That of the open one, where its page is shown."""
        return next((r for r in self.rows if (r["frame"], r["id"]) == self.at), {})

    @property
    def place(self) -> int | None:
        """The open one among those that match."""
        return self.keys.index(self.at) if self.at in self.keys else None


class RunBrowser:
    """Searches one run's records."""

    def __init__(self, figures: RunFigures) -> None:
        self.figures = figures
        run, records = figures.run, figures.run.records
        if "verdict" not in records.column_names:
            cause = "made by an earlier release? run `eval` again"
            raise InputError("the run has no verdicts", cause=cause, path=run.folder)
        self._records = records
        self._found = np.arange(0)
        verdicts = records.column("verdict").to_pylist()
        counts = {name: verdicts.count(name) for name in VERDICTS if name in verdicts}
        listing = Listing(run.name, records.num_rows, counts)
        self.first = next((found for q in FIRST if (found := self._search(listing, q)).keys), listing)

    def searched(self, listing: Listing, query: str) -> Listing:
        """The listing of another search, from its first page."""
        # From the second search on it may ask for what the labels say of the answer.
        self._records = self.figures.records
        return self._search(listing, " ".join(query[:LONGEST_SEARCH].split()))

    def _search(self, listing: Listing, query: str) -> Listing:
        try:
            self._found = find_rows(self._records, query)
        except InputError as error:
            return replace(listing, query=query, error=str(error))
        found = self._records.select(["frame", "id"]).take(self._found)
        keys = zip(found.column("frame").to_pylist(), found.column("id").to_pylist(), strict=True)
        return self.turned(replace(listing, query=query, error="", keys=tuple(keys)), 0)

    def offered(self, typed: str) -> list[str]:
        """What the last word of a search that is being typed may become."""
        return complete(typed, self.figures.fields, OFFERED) if 0 < len(typed) <= LONGEST_SEARCH else []

    def turned(self, listing: Listing, page: int) -> Listing:
        """The listing at another page."""
        page = min(max(page, 0), listing.pages - 1)
        shown = self._found[page * PAGE : (page + 1) * PAGE]
        return replace(listing, page=page, rows=tuple(self._records.select(list(COLUMNS)).take(shown).to_pylist()))

    def opened(self, listing: Listing, place: int) -> Listing:
        """The listing with the expression at a place of the matches open, on its page."""
        moved = listing if place // PAGE == listing.page else self.turned(listing, place // PAGE)
        return replace(moved, at=listing.keys[place])


STANDS_IN = "stands_in"
"""The column, and the field of a search, that says in which relation an answer stands."""


class RunFigures:
    """The figures of one run; each is made when it is first read, or says why it cannot be.

    Parameters
    ----------
    run : Run
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self._slices: dict[str, Slices | str] = {}

    @cached_property
    def summary(self) -> RunSummary | str:
        """Verdicts, and what each module costs."""
        return _or_why(lambda: summarise_run(self.run.records))

    def slices(self, dimension: str) -> Slices | str:
        """The run cut by a dimension; of texts the most frequent ones."""
        if dimension not in self._slices:
            records = {self.run.name: self.run.records}
            self._slices[dimension] = _or_why(lambda: slice_by(records, dimension, most=MOST_SHOWN))
        return self._slices[dimension]

    @cached_property
    def confusion(self) -> Confusion | str:
        """The relation that was asked against the one in which the answer stands."""
        return self._standings if isinstance(self._standings, str) else count_standings(self._standings)

    @cached_property
    def records(self) -> pa.Table:
        """The run's records, with the column `stands_in` where the labels are at hand."""
        records = self.run.records
        if isinstance(self._standings, str) or STANDS_IN in records.column_names:
            return records

        return records.append_column(STANDS_IN, pa.array(self._standings.column()))

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """What the run can be searched by, with the values that occur."""
        return completions(self.records)

    @cached_property
    def _standings(self) -> Standings | str:
        made_with = self.run.manifest.get("labels") or {}
        return _or_why(lambda: answer_standings(self.run.records, self.run.labels, made_with.get("content_hash")))


def _or_why(figure: Callable[[], Figure]) -> Figure | str:
    """A figure, or why there is none."""
    try:
        return figure()
    except InputError as error:
        return str(error)


@lru_cache(maxsize=8)
def figures_of(run: Run) -> RunFigures:
    """The figures of a run, the same for every client."""
    return RunFigures(run)
