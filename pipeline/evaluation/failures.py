"""Expressions of a run that a search found: a table, and each of them answered again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, overload

from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import answer, labelled_truth
from pipeline.diagnosis.opened import Opened
from pipeline.diagnosis.verdict import shown_verdict
from pipeline.evaluation.browsing import SHOWN, RunRows
from pipeline.evaluation.search import find_failures
from pipeline.evaluation.systems import EvalSpec
from pipeline.language.counted import counted
from pipeline.system.arrow import pa
from pipeline.system.errors import needed
from pipeline.system.in_notebook import InNotebook

Answered = Callable[[str, str], Answer]
"""Answers an expression of the labels again, by its frame and id."""


@dataclass(frozen=True)
class Failure(InNotebook):
    """One expression of a run.

    Attributes
    ----------
    row : mapping
        Its record: column -> value, as in `records.parquet`.
    """

    row: Mapping[str, Any]
    again: Answered = field(repr=False, compare=False)

    def __repr__(self) -> str:
        return f"<Failure {self.row['text']!r} on {self.row['frame']!r}: {self.verdict}>"

    @property
    def verdict(self) -> str:
        """With its detail: "OPM-TARGET RANK"."""
        return shown_verdict(self.row["verdict"], self.row["detail"], bool(self.row["lucky"]))

    @cached_property
    def answer(self) -> Answer:
        """It, answered with the run's models now and judged as in the run; InputError where data or models are gone."""
        return self.again(self.row["frame"], self.row["id"])


@dataclass(frozen=True, eq=False)
class Failures(InNotebook):
    """A table of expressions of a run, in the order of the run or as the search sorts them: `found[0]`, `found[:5]`,
    `len(found)`, and a loop.

    What reads Arrow's streams takes it as it is: `polars.DataFrame(found)`, `pyarrow.table(found)`.

    Attributes
    ----------
    search : str
        What found them.
    table : pyarrow.Table
        All columns of the run's records.
    """

    search: str
    table: pa.Table
    again: Answered = field(repr=False)

    def __repr__(self) -> str:
        return f"<Failures {self.search!r}: {counted(len(self), 'expression')}>"

    def __len__(self) -> int:
        return self.table.num_rows

    def __iter__(self) -> Iterator[Failure]:
        return (self[k] for k in range(len(self)))

    @overload
    def __getitem__(self, key: int) -> Failure: ...
    @overload
    def __getitem__(self, key: slice) -> Failures: ...
    def __getitem__(self, key: int | slice) -> Failure | Failures:
        rows = range(len(self))[key]
        if isinstance(rows, int):
            return Failure(self.table.slice(rows, 1).to_pylist()[0], self.again)
        return Failures(self.search, self.table.take(pa.array(rows, pa.int64())), self.again)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self.table.__arrow_c_stream__(requested_schema)

    @property
    def shown(self) -> pa.Table:
        """The columns that `failures --json` tells."""
        return self.table.select([name for name in SHOWN if name in self.table.column_names])

    def to_pandas(self) -> Any:
        """All columns as a pandas.DataFrame; ImportError without pandas."""
        return self.table.to_pandas()


def found_failures(rows: RunRows, search: str, again: Answered) -> Failures:
    """What `find_failures` finds among the expressions of a run, by their marks too."""
    return Failures(search, find_failures(rows.records, search), again)


def asked_again(opened: Opened, spec: EvalSpec, frame: str, expression: str) -> Answer:
    """An expression of the labels (its id) answered now, and judged as the run of this specification judged it.

    Raises
    ------
    InputError
        The dataset has no such frame, or the labels no such expression.
    """
    assert opened.labels is not None
    source, root = opened.pipeline, opened.labels.root
    truth = needed(labelled_truth(frame, source, opened.labels), f"the labels say nothing of frame {frame}", path=root)
    case = next((c for c in truth.cases if c.id == expression), None)
    case = needed(case, f"the labels have no expression {expression} of frame {frame}", path=root)
    mark, context = spec.marks.get((frame, expression)), source.prepare(frame)
    found = answer(source, context, case.text, truth=truth, case=case, mark=mark, confidence=spec.confidence)
    return replace(found, origin=opened)
