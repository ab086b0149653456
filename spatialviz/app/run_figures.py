"""What a run comes to: summary, slices, confusion. Worked out once for all clients, when first asked for."""

from __future__ import annotations

from functools import cached_property, lru_cache

from pipeline.evaluation.confusion import Confusion, Standings, answer_standings, count_standings
from pipeline.evaluation.loss_plots import MOST_SHOWN
from pipeline.evaluation.run_folder import Run
from pipeline.evaluation.search import Field, completions
from pipeline.evaluation.slices import Slices, slice_by
from pipeline.evaluation.summary import RunSummary, summarise_run
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError

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
        try:
            return summarise_run(self.run.records)
        except InputError as error:
            return str(error)

    def slices(self, dimension: str) -> Slices | str:
        """The run cut by a dimension; of texts the most frequent ones."""
        if dimension not in self._slices:
            try:
                found: Slices | str = slice_by({self.run.name: self.run.records}, dimension, most=MOST_SHOWN)
            except InputError as error:
                found = str(error)
            self._slices[dimension] = found
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
        try:
            made_with = self.run.manifest.get("labels") or {}
            return answer_standings(self.run.records, self.run.labels, made_with.get("content_hash"))
        except InputError as error:
            return str(error)


@lru_cache(maxsize=8)
def figures_of(run: Run) -> RunFigures:
    """The figures of a run, the same for every client."""
    return RunFigures(run)
