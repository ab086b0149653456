"""What all pages of one server are made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.corrections.journal_location import JournalLocation
from pipeline.datasets import has_moves
from pipeline.diagnosis.whatif.state import ViewState
from pipeline.evaluation.run_folder import Run
from pipeline.labels.reading import Labels
from spatialviz.app.frames import FrameStore


@dataclass(frozen=True)
class Shared:
    """What all pages of a server are made from.

    Attributes
    ----------
    store : FrameStore
        Datasets by name; the first is shown first.
    runs, others : mapping of str to Run
        Evaluations to debug, and those whose answers are shown beside, by the names of their sources.
    labels : mapping of str to Labels
        What is true where there is no run.
    journals : mapping of str to JournalLocation
        Labels that may be corrected.
    author : str or None
        Under whose name they are, until the page says another.
    opened_by : tuple of str
        The words of the command line, for commands that open the page again.
    first_view : ViewState or None
        What is shown first.
    dark : bool
    """

    store: FrameStore
    runs: Mapping[str, Run]
    others: Mapping[str, Run]
    labels: Mapping[str, Labels]
    journals: Mapping[str, JournalLocation]
    author: str | None = None
    opened_by: tuple[str, ...] = ()
    first_view: ViewState | None = None
    dark: bool = True

    @property
    def moving(self) -> bool:
        """Whether a dataset has a robot's moves."""
        return any(has_moves(opened.dataset) for opened in self.store.sources.values())

    @property
    def second(self) -> bool:
        """Whether a second detector stands beside the own one."""
        return any(opened.second_detector is not None for opened in self.store.sources.values())
