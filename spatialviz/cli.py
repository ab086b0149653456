"""The command line: it parses, hands the command to what runs it, and tells what went wrong.

Commands are declared in `cli_*.py`, which import next to nothing, so that --help is fast. The function `run_NAME` in
the module that the table names does the work and prints it; it returns the exit status, or None where all is fine.
"""

from __future__ import annotations

import inspect
import io
import os
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from typing import Annotated, Any, Union

import tyro
from tyro.conf import subcommand

from pipeline import __version__
from pipeline.system.errors import InputError
from pipeline.system.limits import LIMITS_OPTION, LIMITS_VARIABLE, set_limits
from pipeline.system.onnx_session import PROVIDER_VARIABLE, VERBOSE_VARIABLE
from spatialviz.cli_ask import (
    Ask,
    Context,
    Doctor,
    Eval,
    ExportRun,
    Failures,
    Frames,
    Glossary,
    ImportRecording,
    ImportRun,
    JudgeAgain,
    Mcp,
    Measure,
    Query,
    Relations,
    Render,
    Replay,
    Report,
    SaveCase,
    Tables,
    View,
    WhatIf,
)
from spatialviz.cli_labels import (
    Audit,
    Check,
    Confirm,
    Correct,
    Effective,
    Export,
    Import,
    Label,
    Merge,
    Redo,
    Review,
    Show,
    ShowJournal,
    Undo,
)
from spatialviz.cli_models import (
    Ablation,
    Agree,
    Calibrate,
    Detect,
    Install,
    Models,
    Retrain,
    Train,
)
from spatialviz.options import BAD, FINE, INTERRUPTED, TOLD, UNREAD, error_line, one_line_warnings, warn
from spatialviz.plain_text import plain_streams, unfiltered

GROUPS: dict[str, dict[str, tuple[type, str]]] = {
    "browse, ask": {
        "view": (View, "run_view"),
        "ask": (Ask, "run_ask"),
        "relations": (Relations, "run_ask"),
        "measure": (Measure, "run_ask"),
        "frames": (Frames, "run_ask"),
        "import-recording": (ImportRecording, "run_ask"),
        "doctor": (Doctor, "run_doctor"),
        "context": (Context, "run_ask"),
        "render": (Render, "run_ask"),
        "glossary": (Glossary, "run_ask"),
    },
    "label, check, correct": {
        "label": (Label, "run_labels"),
        "merge": (Merge, "run_labels"),
        "check": (Check, "run_labels"),
        "audit": (Audit, "run_audit"),
        "show": (Show, "run_corrections"),
        "review": (Review, "run_review"),
        "correct": (Correct, "run_corrections"),
        "confirm": (Confirm, "run_corrections"),
        "undo": (Undo, "run_corrections"),
        "redo": (Redo, "run_corrections"),
        "journal": (ShowJournal, "run_corrections"),
        "effective": (Effective, "run_corrections"),
        "export": (Export, "run_exports"),
        "import": (Import, "run_exports"),
    },
    "evaluate, debug": {
        "eval": (Eval, "run_eval"),
        "import-run": (ImportRun, "run_predictions"),
        "export-run": (ExportRun, "run_predictions"),
        "judge-again": (JudgeAgain, "run_predictions"),
        "failures": (Failures, "run_eval"),
        "query": (Query, "run_eval"),
        "tables": (Tables, "run_eval"),
        "whatif": (WhatIf, "run_cases"),
        "save-case": (SaveCase, "run_cases"),
        "replay": (Replay, "run_cases"),
        "report": (Report, "run_cases"),
        "mcp": (Mcp, "run_mcp"),
    },
    "models": {
        "models": (Models, "run_models"),
        "detect": (Detect, "run_models"),
        "agree": (Agree, "run_models"),
        "calibrate": (Calibrate, "run_models"),
        "train": (Train, "run_training"),
        "retrain": (Retrain, "run_training"),
        "install": (Install, "run_training"),
        "ablation": (Ablation, "run_training"),
    },
}
"""Every command: its options, and the module of the function that runs it."""
RENAMED = {"bench srm": "ablation", "bench-srm": "ablation"}
"""Earlier names of commands, which still work."""
REMOVED = {"bench": "benches are scripts of a checkout: `cd tests; python -m benchmarks.stages`, and others beside it"}
"""Earlier commands, and where they went."""
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
ABOUT = "See why an RGB-D spatial-reasoning pipeline answered what it answered."


def listing() -> str:
    """What `spatialviz --help` prints: the commands in groups; tyro can list them in one row only."""
    width, about_at = shutil.get_terminal_size().columns, max(map(len, COMMANDS)) + 4
    lines = ["usage: spatialviz [-h] [--version] COMMAND ...", "", *textwrap.wrap(ABOUT, width)]
    lines += ["Without COMMAND: view. `spatialviz COMMAND --help` lists its arguments and options."]
    lines += [f"Every command takes {LIMITS_OPTION} NAME=VALUE,... for what is large on purpose: docs/limits.md."]
    for group, commands in GROUPS.items():
        lines += ["", f"{group}:"]
        for name, (options, _) in commands.items():
            about = inspect.getdoc(options).split("\n\n")[0]  # pyright: ignore[reportOptionalMemberAccess]
            first = f"  {name}".ljust(about_at)
            lines += textwrap.wrap(about, width, initial_indent=first, subsequent_indent=" " * about_at)
    return "\n".join(lines)


def run(arguments: Sequence[str]) -> int:
    """Parse a command and run it; returns the exit status."""
    commands = tuple(Annotated[options, subcommand(name)] for name, (options, _) in COMMANDS.items())
    config = (tyro.conf.PositionalMetavarFromFieldName, tyro.conf.DisallowNone)
    told = io.StringIO()
    try:
        # Its help is in colour, and holds nothing of strangers.
        with redirect_stderr(told), redirect_stdout(unfiltered(sys.stdout)):
            command: Any = tyro.cli(
                Union[commands],  # pyright: ignore
                prog="spatialviz",
                args=arguments,
                description=ABOUT,
                config=config,
            )
    except SystemExit:
        text = " ".join(re.sub(r"[╭─╮│╰╯]", " ", told.getvalue()).split())
        if wrong := re.search(r"Error parsing (\S+):.*?('[^']*').* Argument helptext: \S+ (INT|FLOAT)", text):
            expected = "a whole number" if wrong[3] == "INT" else "a number"
            raise InputError(f"{wrong[1]} cannot be this", got=wrong[2], expected=expected) from None
        sys.stderr.write(told.getvalue())
        sys.stdout.flush()
        raise
    if (show := getattr(command, "show", 0)) < 0:
        raise InputError("--show is a count", got=show, expected="at least 0")
    name, module = next((name, module) for name, (kind, module) in COMMANDS.items() if kind is type(command))
    work = getattr(import_module(f"spatialviz.{module}"), f"run_{name.replace('-', '_')}")
    return work(command) or FINE


def _with_limits(arguments: list[str]) -> list[str]:
    """The arguments without `--limits`, which every command takes; the limits are set."""
    left: list[str] = []
    words = iter(arguments)
    for word in words:
        if word.partition("=")[0] != LIMITS_OPTION:
            left.append(word)
        else:
            set_limits(word.partition("=")[2] or next(words, ""))
    return left


@contextmanager
def _own_settings() -> Iterator[None]:
    """What a command sets for itself and for the processes it starts ends with it: a program may run several."""
    before = {name: os.environ.get(name) for name in (LIMITS_VARIABLE, PROVIDER_VARIABLE, VERBOSE_VARIABLE)}
    with warnings.catch_warnings():
        one_line_warnings()
        try:
            yield
        finally:
            for name, value in before.items():
                os.environ.pop(name, None)
                if value is not None:
                    os.environ[name] = value


def _drop_unwritten() -> None:
    """Drop what a closed pipe or a full disk did not take: at its end the interpreter would try again, and complain."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0 fine, 1 the answer is no, 2 bad usage or input."""
    with plain_streams():
        try:
            status = _status(list(sys.argv[1:] if argv is None else argv))
        except BrokenPipeError:
            # The reader went away (for example `| head`); nothing is left to say.
            status = UNREAD
        _drop_unwritten()
        return status


def _status(arguments: list[str]) -> int:
    """The exit status of a command that is run; BrokenPipeError where nobody reads what it says."""
    try:
        with _own_settings():
            status = _run_words(arguments)
        # What is still buffered may not be taken either.
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        warn("stopped")
        return INTERRUPTED
    except BrokenPipeError:
        raise
    except Exception as error:
        if os.environ.get("SPATIALVIZ_DEBUG") and not isinstance(error, TOLD):
            raise
        warn(error_line(error))
        return BAD


def _run_words(arguments: list[str]) -> int:
    """Do what the words of a command line say; returns the exit status."""
    if arguments in (["--version"], ["-V"], ["--help"], ["-h"]):
        print(listing() if "h" in arguments[0] else f"spatialviz {__version__}")
        return FINE
    arguments = _with_limits(arguments)
    if not arguments or arguments[0].startswith("-"):
        arguments = ["view", *arguments]
    for count in (2, 1):
        if new := RENAMED.get(" ".join(arguments[:count])):
            arguments = [new, *arguments[count:]]
    if gone := REMOVED.get(arguments[0].partition("-")[0]):
        raise InputError(f"'{arguments[0]}' is no command any more", cause=gone)
    return run(arguments)
