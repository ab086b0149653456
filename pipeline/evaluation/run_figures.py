"""A run worked out once for all who look: its rows, figures and lists; the verdicts of earlier versions in doubt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import field
from functools import cached_property, lru_cache
from typing import Any, Literal, TypeVar

import numpy as np

from pipeline.datasets.base import load_picture
from pipeline.diagnosis.answer import Judged
from pipeline.diagnosis.story_words import Tone
from pipeline.diagnosis.verdict import RULES_VERSION, Diagnosis
from pipeline.evaluation.browsing import RunRows, completions, labelled_boxes
from pipeline.evaluation.comparing import Comparison, compare
from pipeline.evaluation.confusion import Confusion, Standings, answer_standings, count_standings
from pipeline.evaluation.row_stories import row_head
from pipeline.evaluation.run_folder import Run
from pipeline.evaluation.run_names import told_apart
from pipeline.evaluation.search import Field
from pipeline.evaluation.slices import Slices, figure_rows, slice_by
from pipeline.evaluation.summary import RunSummary, summarise_run
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent
from pipeline.system.version import __version__

STANDS_IN = "stands_in"
"""The column, and the field of a search, that says in which relation an answer stands."""
MOST_SHOWN = 12
"""Slices of one dimension."""
FRAMES = 8
"""Decoded frames that are kept."""
PARTS = 8
"""Searches whose figures are kept."""
Drawn = Literal["labelled", "second run", "answered reference", "answered target", "wrong target"]
"""What a box of an answer's picture is."""
Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Listing:
    """The expressions of a run that match a search."""

    figures: RunFigures
    query: str = ""
    error: str = ""  # why the search cannot be carried out; what was found before stays
    # found (N,) int64: numbers of the rows that match, in the order of the list
    found: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    at: tuple[str, str, str] | None = None  # frame, id and text of the one that is open

    @property
    def count(self) -> int:
        """Number of matches."""
        return len(self.found)

    @property
    def place(self) -> int | None:
        """Index of the open expression among the matches."""
        return None if self.at is None else self.place_of(self.figures.rows.number(*self.at[:2]))

    def first_of(self, frame: str) -> int | None:
        """Index of the first match in a frame."""
        names, of_row = self.figures.rows.frames
        here = of_row[self.found] == names.index(frame) if frame in names else np.zeros(0, np.bool_)
        return next(iter(np.flatnonzero(here).tolist()), None)

    def place_of(self, number: int | None) -> int | None:
        """Index of a row of the run among the matches."""
        return None if number is None else next(iter(np.flatnonzero(self.found == number).tolist()), None)


class FoundFigures:
    """Figures of some expressions of a run ((K,) int64, rising), or of all; each is made when it is first read, or says
    why it cannot be."""

    def __init__(
        self, run: Run, second: Run | None, standings: Callable[[], Standings | str], rows: np.ndarray | None = None
    ) -> None:
        self.run, self.second = run, second
        self.columns = run.on_file.column_names
        self.count = run.on_file.num_rows if rows is None else len(rows)
        self._rows, self._standings = rows, standings
        self._slices: dict[str, Slices | str] = {}

    @cached_property
    def summary(self) -> RunSummary | str:
        """Verdicts and costs of modules."""
        whole = self._rows is None
        return _or_why(lambda: summarise_run(figure_rows(self.run.on_file) if whole else self._part))

    @cached_property
    def names(self) -> tuple[str, str] | None:
        """Names of the run and of the second one, so that they can be told apart; None for one alone."""
        return None if self.second is None else told_apart(self.run, self.second)

    @cached_property
    def comparison(self) -> Comparison | str | None:
        """Changes by the second run."""
        other = self.second
        return None if other is None else _or_why(lambda: compare(self.run.on_file, other.on_file, part=self._rows))

    def slices(self, dimension: str) -> Slices | str:
        """Slices by a dimension; the most frequent values of texts."""
        if dimension not in self._slices:
            of_run = {self.run.name: self.run.on_file if self._rows is None else self._part}
            self._slices[dimension] = _or_why(lambda: slice_by(of_run, dimension, most=MOST_SHOWN))
        return self._slices[dimension]

    @cached_property
    def _part(self) -> pa.Table:
        return figure_rows(self.run.on_file, self._rows)

    @cached_property
    def confusion(self) -> Confusion | str:
        """Asked relations against the answers' relations."""
        found = self._standings()
        return found if isinstance(found, str) else count_standings(found)


class RunFigures(FoundFigures):
    """The figures of one run, with its rows.

    `second`: to compare with.

    Raises InputError: the run has no verdicts, or the two have no expression in common.
    """

    def __init__(self, run: Run, second: Run | None) -> None:
        super().__init__(run, second, lambda: self.standings)
        require(
            "verdict" in self.columns,
            "the run has no verdicts",
            cause="made by an earlier release? run `eval` again",
            path=run.folder,
        )
        self.rows = RunRows(run.on_file, run.folder, None if second is None else second.on_file)
        self._frames: Recent[str, np.ndarray] = Recent(FRAMES)
        self._recorded: Recent[int, tuple[Recorded | None]] = Recent(FRAMES)
        self._parts: Recent[bytes, FoundFigures] = Recent(PARTS)

    def of(self, found: np.ndarray) -> FoundFigures:
        """Figures of some of its rows ((F,) int64, in any order)."""
        rows = np.sort(found)
        if len(rows) == self.count:
            return self

        def standings() -> Standings | str:
            found = self.standings
            return found if isinstance(found, str) else found.take(rows)

        return self._parts.get(rows.tobytes(), lambda: FoundFigures(self.run, self.second, standings, rows))

    @cached_property
    def counts(self) -> dict[tuple[str, str | None], int]:
        """Number of answers by verdict and detail."""
        rows = self.run.on_file.select(["verdict", "detail"])
        told = rows.group_by(["verdict", "detail"]).aggregate([([], "count_all")]).to_pylist()
        return {(row["verdict"], row["detail"]): row["count_all"] for row in told}

    @cached_property
    def standings(self) -> Standings | str:
        """Relation in which each answer stands; makes rows searchable by it."""
        run = self.run
        made_with = (run.manifest.get("labels") or {}).get("content_hash")
        found = _or_why(lambda: answer_standings(run.on_file, run.labels, made_with))
        if not isinstance(found, str):
            self.rows.add_column(STANDS_IN, found.column())
        return found

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """Fields of a search, with the values in the run."""
        _ = self.standings
        return completions(self.rows.records)

    @cached_property
    def _labelled(self) -> np.ndarray | str:
        return _or_why(lambda: labelled_boxes(self.run.on_file, self.run.labels))

    def recorded(self, number: int) -> Recorded | None:
        """Verdict of a row; None for a row without."""
        return self._recorded.get(number, lambda: (recorded_verdict(self.rows.read(np.array([number]))[0]),))[0]

    def colors(self, frame_id: str) -> np.ndarray:
        """(H, W, 3) uint8 of a frame of the run; InputError for a broken frame."""
        return self._frames.get(frame_id, lambda: load_picture(self.run.source.dataset, frame_id).rgb)

    def boxes(self, number: int, row: Mapping[str, Any]) -> list[tuple[Drawn, np.ndarray]]:
        """Boxes to draw of a row, the top last: (4,) pixels x0, y0, x1, y1 each.

        The labelled pair where the answer is another one; the second run's where it differs; the answer over them.
        """
        found: list[tuple[Drawn, np.ndarray]] = []
        if not isinstance(self._labelled, str) and not row["set_correct"]:
            found.extend(("labelled", box) for box in self._labelled[number][::-1])
        if row.get("change") not in (None, "same"):
            other = (row["second_reference_box"], row["second_box"])
            found.extend(("second run", np.array(box)) for box in other if box is not None)
        if row["reference_box"] is not None:
            found.append(("answered reference", np.array(row["reference_box"])))
        if row["box"] is not None:
            found.append(("answered target" if row["set_correct"] else "wrong target", np.array(row["box"])))
        return found


def _or_why(find: Callable[[], Found]) -> Found | str:
    try:
        return find()
    except InputError as error:
        return str(error)


@lru_cache(maxsize=8)
def figures_of(run: Run, second: Run | None = None) -> RunFigures:
    """The figures of a run, the same for all."""
    return RunFigures(run, second)


AGAIN = "spatialviz eval --judge-again RUN --out NEW"


@dataclass(frozen=True)
class Recorded:
    """The verdict on an expression as its run has it."""

    verdict: str
    detail: str | None
    lucky: bool
    tone: Tone
    head: str
    sentence: str

    def is_that(self, judged: Judged) -> bool:
        """Compare with a verdict of now."""
        return isinstance(judged, Diagnosis) and (self.verdict, self.detail, self.lucky) == (
            judged.verdict,
            judged.detail,
            judged.lucky,
        )


def recorded_verdict(row: Mapping[str, Any]) -> Recorded | None:
    """Verdict of a row of a run's records; None without a verdict."""
    if row.get("verdict") is None:
        return None
    lucky, said = bool(row.get("lucky")), row.get("said") or ""
    return Recorded(row["verdict"], row.get("detail"), lucky, *row_head(row), said)


def judged_by(manifest: Mapping[str, Any]) -> str:
    """Version behind a run's verdicts, in words; empty for the rules of this version."""
    version, rules = manifest.get("version", "?"), manifest.get("verdict_rules", 1)
    if rules == RULES_VERSION:
        return ""
    return f"judged by spatialviz {version} with rules {rules} of verdicts (this is {__version__}, {RULES_VERSION})"


def doubts_of(run: Run) -> tuple[str, ...]:
    """Doubts about judgements of an earlier version, in a sentence; none of a run of this version."""
    by = judged_by(run.manifest)
    return (f"The run was {by}: {AGAIN} judges it again.",) if by else ()
