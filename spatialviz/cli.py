"""Command line: parses the arguments, runs the command, and reports errors.

Commands are declared in `cli_*.py`, which import next to nothing, so that --help is fast. The function `run_NAME` in
the module that the table names does the work and prints it; it returns the exit status, or None where all is fine.
"""

from __future__ import annotations

import atexit
import gc
import inspect
import io
import os
import re
import shutil
import sys
import textwrap
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from types import SimpleNamespace
from typing import Annotated, Any, Union

import tyro
from tyro.conf import subcommand

from pipeline import __version__
from pipeline.system.errors import InputError
from pipeline.system.execution import PROVIDER_VARIABLE, VERBOSE_VARIABLE
from pipeline.system.limits import LIMITS_OPTION, LIMITS_VARIABLE, set_limits
from spatialviz.error_lines import TOLD, error_line
from spatialviz.options import BAD, FINE, INTERRUPTED, UNREAD, one_line_warnings, warn
from spatialviz.plain_text import plain_streams, unfiltered

GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "browse, ask": {
        "view": ("cli_ask", "run_view"),
        "ask": ("cli_ask", "run_ask"),
        "relations": ("cli_ask", "run_relations"),
        "frames": ("cli_ask", "run_frames"),
        "doctor": ("cli_ask", "run_doctor"),
        "render": ("cli_ask", "run_render"),
    },
    "label, check, correct": {
        "label": ("cli_labels", "run_labels"),
        "map": ("cli_labels", "run_scenes"),
        "check": ("cli_labels", "run_check"),
        "audit": ("cli_labels", "run_review"),
        "show": ("cli_labels", "run_corrections"),
        "review": ("cli_labels", "run_review"),
        "correct": ("cli_labels", "run_corrections"),
        "propagate": ("cli_labels", "run_propagate"),
        "undo": ("cli_labels", "run_corrections"),
        "journal": ("cli_labels", "run_corrections"),
        "export": ("cli_labels", "run_exchange"),
        "import": ("cli_labels", "run_exchange"),
    },
    "evaluate, debug": {
        "eval": ("cli_runs", "run_eval"),
        "import-run": ("cli_runs", "run_predictions"),
        "export-run": ("cli_runs", "run_predictions"),
        "failures": ("cli_runs", "run_eval"),
        "query": ("cli_runs", "run_eval"),
        "whatif": ("cli_runs", "run_cases"),
        "save-case": ("cli_runs", "run_cases"),
        "replay": ("cli_runs", "run_cases"),
        "report": ("cli_runs", "run_cases"),
        "mcp": ("cli_runs", "run_mcp"),
    },
    "models": {
        "models": ("cli_models", "run_models"),
        "detect": ("cli_models", "run_models"),
        "train": ("cli_models", "run_training"),
        "retrain": ("cli_models", "run_training"),
        "ablation": ("cli_models", "run_training"),
        "bench": ("cli_models", "run_bench"),
    },
}
"""The commands that are listed: the module of their options, and that of the function that runs them."""
FORMS: dict[str, tuple[str, str]] = {
    "glossary": ("cli_ask", "run_ask"),
    "confirm": ("cli_labels", "run_corrections"),
    "measure": ("cli_ask", "run_relations"),
    "merge": ("cli_labels", "run_labels"),
    "redo": ("cli_labels", "run_corrections"),
    "effective": ("cli_labels", "run_corrections"),
    "calibrate": ("cli_models", "run_models"),
    "tables": ("cli_runs", "run_eval"),
    "install": ("cli_models", "run_training"),
    "judge-again": ("cli_runs", "run_predictions"),
    "context": ("cli_ask", "run_frames"),
    "world": ("cli_ask", "run_world"),
}
"""Commands of earlier names, each now an option of another."""
OPTIONS = {
    ("ask", "--glossary"): "glossary",
    ("ask", "--confirm"): "confirm",
    ("ask", "--world"): "world",
    ("relations", "--measure"): "measure",
    ("label", "--merge"): "merge",
    ("undo", "--redo"): "redo",
    ("export", "--effective"): "effective",
    ("detect", "--calibrate"): "calibrate",
    ("report", "--tables"): "tables",
    ("models", "--install"): "install",
    ("eval", "--judge-again"): "judge-again",
    ("frames", "--mesh"): "context",
}
"""The option that stands for each of these."""
RENAMED = {"bench srm": "ablation", "bench-srm": "ablation"}
"""Earlier names of commands, which still work."""
_BY_ANSWERS = (
    "two detectors are compared by their answers: `spatialviz failures A --compare B --answers`, of runs or of "
    "files that `ask --json` wrote"
)
REMOVED = {
    "agree": _BY_ANSWERS,
    "import-recording": "every command reads the recording where it is; `frames DATASET --remember` keeps what you say "
    "of its camera and unit in spatialviz.toml beside it",
}
REMOVED_OPTIONS = {
    ("query", "--csv"): "`--json` prints a JSON object a row",
    ("ablation", "--labels"): "networks learn from the rule on whole objects as they are",
    ("ask", "--complete"): "the page completes while you type; a refused question names what is in the frame",
    ("frames", "--plan"): "the plan of a scene's cameras is in the page: `spatialviz view DATASET`",
    ("save-case", "--copy-srm"): "a relation network that does not come with the program is always in the case",
    ("show", "--support"): "boxes are not snapped any more: drag the lower face in the page's side views",
    **dict.fromkeys((("view", "--also"), ("detect", "--agree")), _BY_ANSWERS),
    **dict.fromkeys(
        (("whatif", "--decision-map"), ("whatif", "--move"), ("whatif", "--cells")),
        "there is no map of the floor: `--do center:0:0.5` moves the object and answers again",
    ),
    ("import", "--crowds"): "new annotations with iscrowd 1 are objects as all others",
    ("import", "--outline"): "a polygon within 1.5 pixels of the exported mask is that mask",
    **dict.fromkeys(
        (("review", "--detector"), ("review", "--other")),
        "answers of two detectors are compared by `spatialviz failures A --compare B --answers`",
    ),
    **dict.fromkeys(
        (("review", "--overlap"), ("review", "--second-opinion-of")),
        "every reviewer is shown what nobody has settled (--author), the items that two have judged by --agreement",
    ),
    **dict.fromkeys(
        (("journal", "--kind"), ("journal", "--key")),
        "`show LABELS FRAME --object N` or `--pair A,B` says who set what, `journal --json` has every field",
    ),
    ("audit", "--networks"): "labels are reviewed: `review LABELS` asks networks",
    ("review", "--accept"): "accept what a filter finds in the page, or by `correct LABELS --edits FILE`",
    ("review", "--progress"): "`review LABELS --queue FILE` says how much is left, `journal LABELS` who did what",
    **dict.fromkeys(
        (("review", name) for name in ("--features", "--folds", "--passes", "--seed", "--linter", "--no-linter")),
        "the queue is made one way, with the networks or, faster, with --no-networks",
    ),
}
"""Earlier commands, and where they went."""
COMMANDS = {name: command for group in (*GROUPS.values(), FORMS) for name, command in group.items()}
ABOUT = "See why an RGB-D spatial-reasoning pipeline answered what it answered."


def options_of(name: str) -> type:
    """Class of a command's options: of "import-run" ImportRunCommand."""
    return getattr(import_module(f"spatialviz.{COMMANDS[name][0]}"), f"{name.title().replace('-', '')}Command")


def listing() -> str:
    """Text of `spatialviz --help`: commands in groups; tyro lists them ungrouped."""
    width, about_at = shutil.get_terminal_size().columns, max(map(len, COMMANDS)) + 4
    lines = ["usage: spatialviz [-h] [--version] COMMAND ...", "", *textwrap.wrap(ABOUT, width)]
    lines += ["Without COMMAND: view. `spatialviz COMMAND --help` lists its arguments and options."]
    lines += [f"Every command takes {LIMITS_OPTION} NAME=VALUE,... for what is large on purpose: docs/limits.md."]
    for group, commands in GROUPS.items():
        lines += ["", f"{group}:"]
        for name in commands:
            about = inspect.getdoc(options_of(name)).split("\n\n")[0]  # pyright: ignore[reportOptionalMemberAccess]
            first = f"  {name}".ljust(about_at)
            lines += textwrap.wrap(about, width, initial_indent=first, subsequent_indent=" " * about_at)
    return "\n".join(lines)


def _said(name: str) -> tuple[str, ...]:
    """Words of a command as people say it: of one that an option stands for, both."""
    return next((said for said, own in OPTIONS.items() if own == name), (name,))


def run(arguments: Sequence[str]) -> int:
    """Parse a command and run it; returns the exit status."""
    # Parsers are made of every option: where the command is known, of its own only.
    name, known = arguments[0], arguments[0] in COMMANDS
    every = () if known else tuple(Annotated[options_of(one), subcommand(one)] for one in COMMANDS)
    config = (tyro.conf.PositionalMetavarFromFieldName, tyro.conf.DisallowNone)
    told = io.StringIO()
    try:
        # Its help is in colour, and holds nothing of strangers.
        with redirect_stderr(told), redirect_stdout(unfiltered(sys.stdout)), _defaults_trusted():
            command: Any = tyro.cli(
                options_of(name) if known else Union[every],  # pyright: ignore
                prog=" ".join(("spatialviz", *_said(name))) if known else "spatialviz",
                args=arguments[1:] if known else arguments,
                # tyro would parse it as a page of a manual.
                description=inspect.getdoc(options_of(name)) if known else ABOUT,
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
    work = getattr(import_module(f"spatialviz.{COMMANDS[name][1]}"), f"run_{name.replace('-', '_')}")
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    return work(command) or FINE


@contextmanager
def _defaults_trusted() -> Iterator[None]:
    """Leave out that tyro looks whether defaults have their types: its checker loads asyncio and unittest, 55 ms."""
    name = "typeguard"
    if name in sys.modules:
        yield
        return
    sys.modules[name] = SimpleNamespace(check_type=lambda value, _: value, TypeCheckError=TypeError)  # pyright: ignore
    try:
        yield
    finally:
        del sys.modules[name]


def _with_limits(arguments: list[str]) -> list[str]:
    """Arguments without `--limits`, common to all commands; the limits are set."""
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
    """Undo settings of a command, for itself and its child processes, at its end: a program may run several."""
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
    """Drop output refused by a closed pipe or a full disk: at its end the interpreter would try again, and complain."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0 fine, 1 the answer is no, 2 bad usage or input."""
    if argv is None:
        # Nothing of what is imported is ever garbage; looking for some takes a tenth of a short command.
        gc.disable()
    with plain_streams():
        try:
            status = _status(list(sys.argv[1:] if argv is None else argv))
        except BrokenPipeError:
            # The reader went away (for example `| head`); nothing is left to say.
            status = UNREAD
        _drop_unwritten()
    if argv is None:
        _end(status)
    return status


def _end(status: int) -> None:
    """End the process where nothing else runs in it: taking its modules apart takes 25 ms of a short command."""
    if threading.active_count() == 1 and sys.gettrace() is None and sys.getprofile() is None:
        atexit._run_exitfuncs()
        os._exit(status)


def _status(arguments: list[str]) -> int:
    """Run a command for its exit status; BrokenPipeError for a closed output."""
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
        if isinstance(error.__cause__, KeyboardInterrupt):
            # Python 3.11 and older wrap what comes while a class is made, as in a library that loads.
            warn("stopped")
            return INTERRUPTED
        if os.environ.get("SPATIALVIZ_DEBUG") and not isinstance(error, TOLD):
            raise
        warn(error_line(error))
        return BAD


def _run_words(arguments: list[str]) -> int:
    """Run the words of a command line; returns the exit status."""
    if arguments in (["--version"], ["-V"], ["--help"], ["-h"]):
        print(listing() if "h" in arguments[0] else f"spatialviz {__version__}")
        return FINE
    arguments = _with_limits(arguments)
    if not arguments or arguments[0].startswith("-"):
        arguments = ["view", *arguments]
    for count in (2, 1):
        if new := RENAMED.get(" ".join(arguments[:count])):
            arguments = [new, *arguments[count:]]
    option = next((word for word in arguments[1:] if (arguments[0], word) in OPTIONS), None)
    if option is not None:
        rest = arguments[1:]
        rest.remove(option)
        arguments = [OPTIONS[arguments[0], option], *rest]
    for (name, option), gone in REMOVED_OPTIONS.items():
        if arguments[0] == name and any(word.partition("=")[0] == option for word in arguments):
            raise InputError(f"{name} has no option {option} any more", cause=gone)
    if gone := REMOVED.get(arguments[0]) or REMOVED.get(arguments[0].partition("-")[0]):
        raise InputError(f"'{arguments[0]}' is no command any more", cause=gone)
    return run(arguments)
