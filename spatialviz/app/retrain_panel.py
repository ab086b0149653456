"""Retraining on the labels as they are corrected, in a process of its own that all clients see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from pipeline.answering.opening import Pipeline
from pipeline.corrections.journal_location import JournalLocation
from pipeline.corrections.review.label_jobs import CANCELLED, RetrainingJob, TrainingProgress
from pipeline.evaluation.run_folder import Run
from pipeline.relations.installed import install_network
from pipeline.system.errors import InputError
from spatialviz.app.layout import Page
from spatialviz.app.place import Place
from spatialviz.app.retrain_html import retrain_html
from spatialviz.app.state import State


class RetrainPanel:
    """Trains, compares, makes the run again, and installs by choice.

    Parameters
    ----------
    page : Page
    sources : mapping of str to Source
    runs : mapping of str to Run
    journals : mapping of str to JournalPlace
        By name of the source.
    folder : Path
        Where trained networks are written.
    state : callable
    go : callable
        Looks at a place.
    use : callable
        Answers the question that is asked with an installed network.
    note : callable
    post : callable
        Runs something later, on the client's own thread.
    """

    def __init__(
        self,
        page: Page,
        sources: Mapping[str, Pipeline],
        runs: Mapping[str, Run],
        journals: Mapping[str, JournalLocation],
        folder: Path,
        *,
        state: Callable[[], State],
        go: Callable[[Place], None],
        use: Callable[[str], None],
        note: Callable[[str], None],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        self._page, self._sources, self._runs = page, sources, runs
        self._journals, self._folder = journals, folder
        self._state, self._go, self._use, self._note, self._post = state, go, use, note, post
        self._last = {name: place.jobs.training.seen for name, place in journals.items()}
        self._leave = [
            place.jobs.training.listen(lambda name=name: post(lambda: self._follow(name)))
            for name, place in journals.items()
        ]

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "retrain": lambda _: self.start(),
            "stop-training": lambda _: self.stop(),
            "install": self.install,
            "replayed": self.open_expression,
        }

    def close(self) -> None:
        """Listen no more; what runs goes on, for those who stay or come back."""
        for leave in self._leave:
            leave()

    @property
    def _training(self) -> TrainingProgress:
        place = self._journals.get(self._state().source)
        return TrainingProgress() if place is None else place.jobs.training.seen

    def _follow(self, name: str) -> None:
        """Say what has begun or ended, whoever began it, and draw."""
        was, now = self._last[name], self._journals[name].jobs.training.seen
        self._last[name] = now
        if now.running and not was.running:
            self._note(f"retraining on the labels of {name}")
        elif was.running and not now.running:
            done = f"not retrained: {now.problem}" if now.record is None else (
                f"retrained in {now.seconds:.0f} s: {now.record['folder']}"
            )  # fmt: skip
            self._note("retraining was stopped" if now.problem == CANCELLED else done)
        self.draw()

    def start(self) -> None:
        """Train on the labels of the source that is looked at, as they are now."""
        name = self._state().source
        place = self._journals.get(name)
        if place is None or self._training.running:
            return
        run = self._runs.get(name)
        place.jobs.train(
            RetrainingJob(
                place.labels.root,
                self._folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S}",
                None if place.where is None else str(place.where),
                place.project,
                str(self._sources[name].dataset.root),
                run=None if run is None else run.folder,
            )
        )

    def stop(self) -> None:
        """End a training, whoever began it; nothing of it stays."""
        place = self._journals.get(self._state().source)
        if place is not None:
            place.jobs.training.stop()

    def install(self, name: str) -> None:
        """Install the trained network under a name, and answer the question that is asked with it."""
        training = self._training
        if training.record is None:
            return
        try:
            done = install_network(Path(training.record["network"]), name.strip())
        except InputError as error:
            self._page.toast("Not installed", str(error), bad=True)
            self._note(f"not installed: {error}")
            return
        self._note(f"installed: --srm {done.name} is {done.path}")
        self._journals[self._state().source].jobs.training.change(lambda now: replace(now, installed=done.name))
        self._use(done.name)

    def open_expression(self, said: str) -> None:
        """Ask an expression of the comparison: "frame|text"."""
        frame, _, text = said.partition("|")
        self._go(Place(self._state().source, frame, text))

    def draw(self) -> None:
        """Bring the section up to what is known."""
        name = self._state().source
        place = self._journals.get(name)
        if place is None:
            return
        try:
            journal = place.to_read()
            corrections = 0 if journal is None else journal.count()
        except InputError:
            corrections = None
        self._page.show("review-train", retrain_html(self._training, corrections, name in self._runs))
