"""The command that opens the page."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from pipeline.system.errors import InputError
from spatialviz.exits import FINE
from spatialviz.source_options import SourceOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipeline.answering.opening import Pipeline
    from pipeline.corrections.journal_location import JournalLocation
    from pipeline.diagnosis.whatif.state import ViewState
    from pipeline.evaluation.run_folder import Run
    from pipeline.labels.reading import Labels


@dataclass(frozen=True)
class View:
    """Open a dataset in the browser; without DATASET, the built-in demo."""

    dataset: Positional[str] = "demo"
    """Dataset folder, or "demo": the built-in one, with a run of a simulated detector unless another is named. With
    --run, the run's own; with --state, the one that it names."""
    run_folder: Annotated[Path | None, arg(name="run")] = None
    """A run folder that `eval` wrote: its failures are listed, with its detector and relation scorer."""
    compare: Path | None = None
    """With --run: another run on the same dataset, whose answers are shown beside."""
    labels: Path | None = None
    """Labels that say what is true. Default: the run's, else the frame's annotations."""
    journal: str | None = None
    """Where corrections are kept: a path, or postgresql://user@host/database for a team. Default: journal.sqlite beside
    the labels."""
    project: str | None = None
    """Whose corrections, where several datasets share a database. Default: the name of the dataset's folder."""
    author: str | None = None
    """Under whose name labels are corrected. Default: the name that the browser's tab used last, else that of the
    login."""
    state: str | None = None
    """A view as a string, "sv1:...", as the page copies it: what is opened, and what is looked at first. No link can
    carry it: the page's address has no room for it."""
    also: str | None = None
    """A second detector, NAME or NAME=MODEL, whose boxes are shown beside those of the first; it answers nothing."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    port: int = 8080
    """Port; if it is taken, the next free one is used."""
    host: str = "127.0.0.1"
    """Address to listen on. Anything but this machine's own is open to others: there is no password."""
    theme: Literal["dark", "light"] = "dark"
    """Colours of the page."""
    open_browser: bool = True
    """Open the page in the default browser."""

    def run(self) -> int:
        from pipeline.answering.opening import open_sources
        from pipeline.datasets.demo import DEMO_NAME, demo_run
        from pipeline.diagnosis.whatif.state import decode
        from pipeline.evaluation.run_folder import open_run
        from pipeline.labels.pictures import labelled_up
        from pipeline.labels.reading import open_labels
        from spatialviz.app.server import serve

        if self.author is not None and not self.author.strip():
            raise InputError("--author must not be empty")
        view = None if self.state is None else decode(self.state)
        dataset, folder = (self.dataset, self.run_folder) if view is None else self._named(view)
        built_in = dataset == DEMO_NAME and not Path(DEMO_NAME).exists()
        if folder is None and built_in and self.labels is None and self.source == SourceOptions():
            folder = demo_run()
        runs, others, labels = {}, {}, {}
        if self.compare is not None and folder is None:
            raise InputError("--compare needs --run", expected="--run RUN --compare OTHER_RUN", path=self.compare)
        if folder is not None:
            own = None if self.labels is None else str(self.labels)
            run = open_run(folder, dataset=None if dataset == DEMO_NAME else dataset, labels=own)
            name = Path(run.spec.dataset).name
            sources, runs = {name: self._with_second(run)}, {name: run}
            if own is not None:
                _check_labels(run.labels, run.source)
            if self.compare is not None:
                others = {name: open_run(self.compare, dataset=run.spec.dataset)}
        else:
            found = None if self.labels is None else open_labels(self.labels)
            options = self.source.options()
            options = options if found is None else labelled_up(found.manifest, options)
            sources, left_out = open_sources(dataset, **options, also=self.also)
            for name, reason in left_out.items():
                print(f"spatialviz: left out {name}: {reason}", file=sys.stderr)
            if found is not None:
                if len(sources) > 1:
                    raise InputError("--labels are of one dataset", got=f"{len(sources)} datasets", path=self.labels)
                _check_labels(found, next(iter(sources.values())))
                labels = dict.fromkeys(sources, found)
        corrected = dict(labels)
        for name, run in runs.items():
            try:
                corrected[name] = run.labels
            except InputError as error:
                print(f"spatialviz: nothing can be corrected, the run's labels are not here: {error}", file=sys.stderr)
        serve(
            sources,
            runs=runs,
            others=others,
            labels=labels,
            journals={name: self._journal(found) for name, found in corrected.items()},
            author=self.author,
            opened_by=self._words(dataset, folder),
            first_view=None if view is None else _in(view, sources),
            host=self.host,
            port=self.port,
            dark=self.theme == "dark",
            open_browser=self.open_browser,
        )
        return FINE

    def _with_second(self, run: Run) -> Pipeline:
        """The run's source, with the second detector beside its own."""
        from pipeline.answering.opening import open_pipeline

        if self.also is None:
            return run.source
        opened = open_pipeline(run.spec.dataset, **{**run.spec.options, "also": self.also})
        return replace(run.source, beside=opened.beside, beside_setup=opened.beside_setup)

    def _journal(self, labels: Labels) -> JournalLocation:
        """Where corrections are kept; those of the built-in demo with the user's own data, not in the installation."""
        from platformdirs import user_data_path

        from pipeline.corrections.journal_location import JournalLocation
        from pipeline.datasets.demo import demo_run

        where: str | Path | None = self.journal
        if where is None and labels.root.resolve().is_relative_to(demo_run().parent.resolve()):
            where = user_data_path("spatialviz", ensure_exists=True) / "demo-journal.sqlite"
        place = JournalLocation(labels, where, self.project)
        place.check()
        return place

    def _named(self, view: ViewState) -> tuple[str, Path | None]:
        """The dataset and the run to open: those of the command line, else those that the view names."""
        from pipeline.datasets.demo import DEMO_NAME
        from pipeline.evaluation.run_folder import RUN_FILE

        if self.run_folder is not None or self.dataset != DEMO_NAME:
            return self.dataset, self.run_folder
        if view.run is not None:
            if (Path(view.run) / RUN_FILE).is_file():
                print(f"spatialviz: opening the run that the view names: {view.run}", file=sys.stderr)
                return self.dataset, Path(view.run)
            print(f"spatialviz: the run of the view is not here: {view.run}", file=sys.stderr)
        if view.dataset != DEMO_NAME and not (Path(view.dataset).name == view.dataset and Path(view.dataset).is_dir()):
            raise InputError(
                "the view is of a dataset that is not in this folder", got=view.dataset,
                expected="spatialviz view DATASET --state STRING",
            )  # fmt: skip
        return view.dataset, None

    def _words(self, dataset: str, folder: Path | None) -> list[str]:
        """The command line that opens this page again; without a password."""
        from pipeline.corrections.journal_location import journal_words

        words = ["view"]
        if folder is None or self.dataset != "demo":
            words.append(dataset)
        opened = (("--run", folder), ("--compare", self.compare), ("--labels", self.labels), ("--also", self.also))
        for option, value in opened:
            words += [] if value is None else [option, str(value)]
        words += journal_words(self.journal, self.project)
        words += [] if self.author is None else ["--author", self.author]
        return words if folder is not None else [*words, *self.source.words()]


def _check_labels(labels: Labels, source: Pipeline) -> None:
    """Raise InputError where labels know none of the frames."""
    if set(source.dataset.frame_ids).isdisjoint(labels.frames.column("frame").to_pylist()):
        raise InputError("the labels are of other frames than the dataset has", path=labels.root)


def _in(view: ViewState, sources: Mapping[str, Pipeline]) -> ViewState:
    """The view as one of these sources; InputError where it is of none."""
    name = view.dataset
    if name not in sources and len(sources) == 1:
        # A folder may have another name here.
        name = next(iter(sources))
    if name not in sources:
        raise InputError("the view is of another dataset", got=view.dataset, expected=" or ".join(sources))
    if view.frame not in sources[name].dataset.frame_ids:
        raise InputError(f"the dataset {name} has no frame of the view", got=view.frame)
    return replace(view, dataset=name)
