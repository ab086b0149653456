"""Retraining on the labels as one client has corrected them, in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from time import perf_counter
from typing import Any

import viser

from pipeline.background import Background, start_background
from pipeline.correcting.journal_place import JournalPlace
from pipeline.errors import InputError
from pipeline.evaluation.run_folder import Run
from pipeline.jobs import Source
from pipeline.review.circle import CircleJob, circle_in_background
from pipeline.srm.installed import install_network
from spatialviz.app.layout import Page
from spatialviz.app.place import Place
from spatialviz.app.retrain_html import Training, retrain_html
from spatialviz.app.state import State
from spatialviz.app.text import panel


class RetrainPanel:
    """Trains, compares, makes the run again, and installs by choice.

    Parameters
    ----------
    client : viser.ClientHandle
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
        client: viser.ClientHandle,
        page: Page,
        sources: Mapping[str, Source],
        runs: Mapping[str, Run],
        journals: Mapping[str, JournalPlace],
        folder: Path,
        *,
        state: Callable[[], State],
        go: Callable[[Place], None],
        use: Callable[[str], None],
        note: Callable[[str], None],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        self._client, self._page, self._sources, self._runs = client, page, sources, runs
        self._journals, self._folder = journals, folder
        self._state, self._go, self._use, self._note, self._post = state, go, use, note, post
        self._trainings: dict[str, Training] = {}
        self._jobs: dict[str, Background] = {}

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "retrain": lambda _: self.start(),
            "stop-training": lambda _: self.stop(),
            "install": self.install,
            "replayed": self.open_expression,
        }

    def close(self) -> None:
        """End what is running."""
        for job in self._jobs.values():
            if not job.done:
                job.cancel()

    @property
    def _training(self) -> Training:
        return self._trainings.get(self._state().source, Training())

    def start(self) -> None:
        """Train on the labels of the source that is looked at, as they are now."""
        name = self._state().source
        place = self._journals.get(name)
        if place is None or self._training.running:
            return
        began = perf_counter()
        out = self._folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
        run = self._runs.get(name)
        job = CircleJob(
            place.labels.root,
            out,
            None if place.where is None else str(place.where),
            place.project,
            str(self._sources[name].dataset.root),
            run=None if run is None else run.folder,
        )
        self._trainings[name] = Training(running=True)
        self._note(f"retraining on the labels of {name}")

        def heard(step: tuple[str, int, int]) -> None:
            def show() -> None:
                self._trainings[name] = replace(
                    self._trainings[name], step=step, seconds=perf_counter() - began
                )
                self.draw()

            self._post(show)

        def ended(record: Any, problem: str) -> None:
            seconds = perf_counter() - began

            def show() -> None:
                self._trainings[name] = Training(record=record, problem=problem, seconds=seconds)
                self._note(f"not retrained: {problem}" if problem else f"retrained in {seconds:.0f} s: {out}")
                self.draw()

            self._post(show)

        self._jobs[name] = start_background(circle_in_background, job, on_progress=heard, on_end=ended)
        self.draw()

    def stop(self) -> None:
        """End a training; nothing of it stays."""
        job = self._jobs.get(self._state().source)
        if job is not None and not job.done:
            job.cancel()

    def install(self, name: str) -> None:
        """Install the trained network under a name, and answer the question that is asked with it."""
        training = self._training
        if training.record is None:
            return
        try:
            done = install_network(Path(training.record["network"]), name.strip())
        except InputError as error:
            self._client.add_notification("Not installed", str(error), auto_close_seconds=8)
            self._note(f"not installed: {error}")
            return
        self._trainings[self._state().source] = replace(training, installed=done.name)
        self._note(f"installed: --srm {done.name} is {done.path}")
        self.draw()
        self._use(done.name)

    def open_expression(self, said: str) -> None:
        """Ask an expression of the comparison: "frame|text"."""
        frame, _, text = said.partition("|")
        self._go(Place(self._state().source, frame, text))

    def draw(self) -> None:
        """Bring the section up to what is known."""
        handle, name = self._page.review_train, self._state().source
        place = self._journals.get(name)
        if handle is None or place is None:
            return
        try:
            journal = place.to_read()
            corrections = 0 if journal is None else journal.count()
        except InputError:
            corrections = 0
        handle.content = panel(retrain_html(self._training, corrections, name in self._runs))
