"""Command serving agents: opens the named datasets, runs and cases."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from pipeline.datasets.demo import DEMO_NAME, demo_run
from pipeline.datasets.saved_case import MANIFEST
from pipeline.diagnosis.cases.replay import find_cases
from pipeline.diagnosis.opened import Opened
from pipeline.evaluation.run_folder import RUN_FILE, open_run
from pipeline.labels.reading import open_labels
from pipeline.system.errors import InputError, UnknownFormat, extra_module, needed, require
from spatialviz.agent_verbs import Correcting, OpenRun, Session
from spatialviz.cli_runs import McpCommand
from spatialviz.options import SourceOptions


def run_mcp(command: McpCommand) -> None:
    extra_module("mcp.server.mcpserver", "a server for agents", "mcp")
    from spatialviz.agent_server import serve  # Of the extra.

    with ExitStack() as keep:
        serve(open_session(command, keep))


def open_session(command: McpCommand, keep: ExitStack) -> Session:
    """Open everything named by the command; `keep` closes the session."""
    require(command.paths, "nothing was named to be served", expected="spatialviz mcp demo, or the paths of your own")
    require(
        command.allow_corrections == (command.author is not None),
        "--allow-corrections and --author go together",
        cause="corrections are by somebody's name",
    )
    labels = None if command.labels is None else open_labels(command.labels)
    datasets: dict[str, Opened] = {}
    runs: dict[str, OpenRun] = {}
    cases: dict[str, Path] = {}
    dataset = None

    def free(name: str) -> str:
        taken = {*datasets, *runs, *cases}
        return next(n for n in (name, *(f"{name}-{k}" for k in range(2, len(taken) + 3))) if n not in taken)

    for path in command.paths:
        folder = Path(path)
        name = free(folder.resolve().name)
        if (folder / RUN_FILE).is_file():
            runs[name] = OpenRun(open_run(folder), keep)
        elif (folder / MANIFEST).is_file():
            cases[name] = folder
        else:
            try:
                datasets[name] = Opened(command.source.open(path, labels=labels), labels)
                dataset = path
            except UnknownFormat as error:
                try:
                    find_cases(folder)
                except InputError:
                    raise error from None
                cases[name] = folder
        built_in = path == DEMO_NAME and not folder.exists() and command.source == SourceOptions() and labels is None
        if built_in:
            runs[free("demo-run")] = OpenRun(open_run(demo_run()), keep)
    require(
        labels is None or len(datasets) == 1,
        "--labels are of one dataset",
        got=f"{len(datasets)} datasets",
        path=command.labels,
    )
    if command.author is None:
        return Session(datasets, runs, cases)
    folder = needed(command.labels, "--allow-corrections needs labels to correct", expected="--labels LABELS")
    assert dataset is not None
    return Session(datasets, runs, cases, Correcting(dataset, folder, command.author, command.journal, command.source))
