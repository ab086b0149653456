"""What a page shows: the sources, runs, labels and journals that a command line names, opened for a server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from platformdirs import user_data_path

from pipeline.answering.pipeline import Pipeline, open_sources
from pipeline.corrections.unsaved import JournalLocation, journal_words
from pipeline.datasets.demo import DEMO_NAME, demo_run
from pipeline.datasets.saved_case import MANIFEST
from pipeline.diagnosis.asking import pathless_edits
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.diagnosis.cases.saving import OpenedCase, open_case
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.state import ViewState, decode
from pipeline.evaluation.run_folder import RUN_FILE, open_run
from pipeline.labels.by_hand import begun_labels, default_folder, grows
from pipeline.labels.reading import Labels, labelled_up, open_labels
from pipeline.system.errors import InputError, require
from pipeline.system.remote import is_url
from spatialviz.app.listening import Listening
from spatialviz.app.server import serve
from spatialviz.cli_ask import ViewCommand
from spatialviz.options import SourceOptions, warn


def open_view(command: ViewCommand, listening: Listening, dark: bool | None) -> None:
    """Open what the command names, and serve it until the end."""
    view = None if command.state is None else decode(command.state)
    dataset, folder = (command.dataset, command.run_folder) if view is None else _named(command, view)
    built_in = dataset == DEMO_NAME and not Path(DEMO_NAME).exists()
    if folder is None and built_in and command.labels is None and command.source == SourceOptions():
        folder = demo_run()
    runs, others, labels = {}, {}, {}
    require(
        command.compare is None or folder is not None,
        "--compare needs --run",
        expected="--run RUN --compare OTHER_RUN",
        path=command.compare,
    )
    sources: dict[str, Pipeline] = {}
    cases: dict[str, OpenedCase] = {}
    alone = folder is None and command.labels is None and command.source == SourceOptions()
    if alone and (Path(dataset) / MANIFEST).is_file():
        kept = _case(dataset)
        name, m = kept.root.resolve().name, kept.manifest
        sources, cases = {name: kept.source}, {name: kept}
        edits = Edits() if m.edits is None else pathless_edits(m.edits)
        view = view or ViewState(name, m.frame.id, m.text, edits=edits)
    elif folder is not None:
        own = None if command.labels is None else str(command.labels)
        run = open_run(folder, dataset=None if dataset == DEMO_NAME else dataset, labels=own)
        name = Path(run.spec.dataset).name
        sources, runs = {name: run.source}, {name: run}
        if own is not None:
            _check_labels(run.labels, run.source)
        if command.compare is not None:
            others = {name: open_run(command.compare, dataset=run.spec.dataset)}
    else:
        begun = command.labels is not None and _is_new(command.labels)
        found = None if command.labels is None or begun else open_labels(command.labels)
        options = command.source.arguments()
        options = options if found is None else labelled_up(found.manifest, options)
        sources, left_out = open_sources(dataset, **options, browse=True)
        warn(*(f"left out {name}: {reason}" for name, reason in left_out.items()))
        for name, opened in sources.items():
            if missing := getattr(opened.dataset, "untold", ()):
                warn(f"{name} can only be looked at, nothing is measured without {' and '.join(missing)}")
        one = command.labels is None or len(sources) <= 1
        require(one, "--labels are of one dataset", got=f"{len(sources)} datasets", path=command.labels)
        if found is not None:
            _check_labels(found, next(iter(sources.values())))
            labels = dict.fromkeys(sources, found)
    corrected = {} if cases else {**_by_hand(command, sources), **labels}
    for name, run in runs.items():
        try:
            corrected[name] = run.labels
        except InputError as error:
            warn(f"nothing can be corrected, the run's labels are not here: {error}")
    serve(
        sources,
        runs=runs,
        others=others,
        labels=labels,
        journals={name: _journal(command, found) for name, found in corrected.items()},
        author=command.author,
        opened_by=_words(command, dataset, folder),
        first_view=None if view is None else _in(view, sources),
        cases=cases,
        host=command.host,
        port=command.port,
        dark=dark,
        open_browser=command.open_browser,
        access=listening.access,
        max_clients=command.max_clients,
        listening=listening,
    )


def _case(folder: str) -> OpenedCase:
    """Saved case; what is not as it was when it was kept is warned of."""
    opened = open_case(folder)
    replayed = replay_case(opened)
    warn(*(f"since the case was kept: {change}" for change in (*opened.notes, *replayed.changes)))
    return opened


def _is_new(labels: str) -> bool:
    """True for an empty folder, where labels can begin. A missing folder may be a typing error."""
    if is_url(labels):
        return False
    folder = Path(labels).expanduser()
    require(
        folder.exists(),
        "there are no labels here",
        path=folder,
        expected="labels, or an empty folder in which labels are begun by hand (mkdir makes one)",
    )
    return folder.is_dir() and not any(folder.iterdir())


def _by_hand(command: ViewCommand, sources: Mapping[str, Pipeline]) -> dict[str, Labels]:
    """Labels open to begin by hand: in the named folder, or beside recordings without annotations."""
    if command.run_folder is not None or (command.labels is not None and not _is_new(command.labels)):
        return {}
    found: dict[str, Labels] = {}
    for name, source in sources.items():
        folder = command.labels
        if folder is None and not source.dataset.class_names:
            folder = default_folder(source.dataset, user_data_path("spatialviz") / "labels")
        try:
            if folder is not None:
                found[name] = begun_labels(source.dataset, folder, command.source.camera())
        except InputError as error:
            warn(f"no labels can be begun: {error}")
    return found


def _journal(command: ViewCommand, labels: Labels) -> JournalLocation:
    """Location of the journal; of the built-in demo among the user's own data, not in the installation."""
    where: str | Path | None = command.journal.journal
    if grows(labels):
        warn(f"what is labelled by hand is kept in {labels.root}")
    if where is None and labels.root.resolve().is_relative_to(demo_run().parent.resolve()):
        where = user_data_path("spatialviz", ensure_exists=True) / "demo-journal.sqlite"
    location = JournalLocation(labels, where, command.journal.project)
    if problem := location.check():
        warn(f"corrections wait until their journal can be reached: {problem}")
    return location


def _named(command: ViewCommand, view: ViewState) -> tuple[str, Path | None]:
    """Dataset and run to open, of the command line, else of the view."""
    if command.run_folder is not None or command.dataset != DEMO_NAME:
        return command.dataset, command.run_folder
    if view.run is not None:
        if (Path(view.run) / RUN_FILE).is_file():
            warn(f"opening the run that the view names: {view.run}")
            return command.dataset, Path(view.run)
        warn(f"the run of the view is not here: {view.run}")
    require(
        view.dataset == DEMO_NAME or (Path(view.dataset).name == view.dataset and Path(view.dataset).is_dir()),
        "the view is of a dataset that is not in this folder",
        got=view.dataset,
        expected="spatialviz view DATASET --state STRING",
    )
    return view.dataset, None


def _words(command: ViewCommand, dataset: str, folder: Path | None) -> list[str]:
    """Command line reopening this page, without a password."""
    words = ["view"]
    if folder is None or command.dataset != "demo":
        words.append(dataset)
    given = {"run": folder, "compare": command.compare, "labels": command.labels}
    words += [word for name, value in given.items() if value is not None for word in (f"--{name}", str(value))]
    words += journal_words(command.journal.journal, command.journal.project)
    words += [] if command.author is None else ["--author", command.author]
    return words if folder is not None else [*words, *command.source.words()]


def _check_labels(labels: Labels, source: Pipeline) -> None:
    """Raise InputError for labels knowing none of the frames."""
    require(
        not set(source.dataset.frame_ids).isdisjoint(labels.frames.column("frame").to_pylist()),
        "the labels are of other frames than the dataset has",
        path=labels.root,
    )


def _in(view: ViewState, sources: Mapping[str, Pipeline]) -> ViewState:
    """View as one of these sources; InputError for no match."""
    name = view.dataset
    if name not in sources and len(sources) == 1:
        # A folder may have another name here.
        name = next(iter(sources))
    require(name in sources, "the view is of another dataset", got=view.dataset, expected=" or ".join(sources))
    require(
        view.frame in sources[name].dataset.frame_ids, f"the dataset {name} has no frame of the view", got=view.frame
    )
    return replace(view, dataset=name)
